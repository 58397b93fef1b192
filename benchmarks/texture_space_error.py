"""Figures 7, 9 and 10 of Chang et al. 2008, and frames in motion: how far pictures are from the exact sum over all samples.

    python benchmarks/texture_space_error.py

writes docs/figures/texture_space_error.json and pictures, and the tables of docs/benchmarks.md between their marks. Takes
about six minutes on two cores; ``--only`` one part keeps what is saved of the others, ``--quick`` goes through the same
steps small, and writes nothing.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.model.medium import Medium
from pellucid.realtime.engine import Engine
from support.images import save_rows
from support.realtime import (
    camera_of,
    frame_errors,
    halved,
    model_scene,
    on_screen,
    reference,
    say,
    see_pixels,
    settled,
    slope,
    tone_errors,
)
from support.record import DOCS, FIGURES, fill, markdown_table, save, saved

COMMAND = "python benchmarks/texture_space_error.py"
NAME = "texture_space_error"
COUNTS = (49, 100, 169, 256, 400, 900, 1600, 2500, 4900, 10000)
MATERIALS = ("skin1", "skin2", "marble", "wholemilk", "ketchup")
CASES = {"figure 9": ("antique_head", 10.0, 1600), "figure 10": ("wanderer", 30.0, 2500)}
PAPER = {("figure 9", "skin1"): 0.0096, ("figure 9", "skin2"): 0.0098, ("figure 10", "skin1"): 0.0138,
         ("figure 10", "skin2"): 0.0119}  # fmt: skip
FIGURE7 = ("wanderer", 30.0, "skin2")
FRAMES = {
    "texture_space": [(model, "marble", 10.0) for model in
                      ("sphere", "horned_head", "relief_head", "philosopher", "longneck", "antique_head", "wanderer")],
    "hybrid": [*(("longneck", "skin1", size) for size in (10.0, 20.0, 30.0)),
               *(("wanderer", material, 30.0) for material in ("skin1", "marble", "cream"))],
}  # fmt: skip
"""What `texture_space_table.py` and `texture_space_hybrid.py` measure the time of: `FRAME_SAMPLES` samples."""
FRAME_SAMPLES = 900

FINE = {"resolution": 1024}
"""Texels as fine as the engine has them."""

PAPER_ERROR = 0.3
"""Threshold of the hierarchy that the paper compares with [sr]."""

REFERENCE_SAMPLES = 60_000
QUICK = {"side": 64, "samples": 4000}
FULL = {"side": 512, "samples": REFERENCE_SAMPLES}
AMPLIFIED = 20


def compare(figure: str, material: str, setup: dict[str, int]) -> tuple[dict[str, Any], list[tuple[str, np.ndarray]]]:
    """Fill one row of figures 9 and 10: errors of our pictures, and how long each method takes for one."""
    model, size, count = CASES[figure]
    side = setup["side"]
    scene = model_scene(model, material, size, side=side)
    camera = camera_of(scene)
    seen = see_pixels(scene, camera, (side, side), Medium.from_preset(material).eta)
    exact = reference(scene, seen, "exact", sample_count=setup["samples"])
    few = reference(scene, seen, "two_pass", max_error=PAPER_ERROR)
    many = reference(scene, seen, "two_pass", max_error=PAPER_ERROR, sample_count=setup["samples"])
    engine = settled(Engine(scene), samples=count)
    pictures = {"engine": engine.linear(camera, (side, side))}
    begin = time.perf_counter()
    engine.set_light(0, position=engine.lights[0].position)
    engine.linear(camera, (side, side))
    seconds = time.perf_counter() - begin
    for name, points in (("points", True), ("discs", False)):
        pictures[name] = reference(
            scene, seen, "texture_space", sample_count=count, point_samples=points, **FINE
        ).picture
    row: dict[str, Any] = {"figure": figure, "material": material, "model": model, "size": size, "samples": count}
    row["two_pass itself"] = tone_errors(few.picture, exact, seen.mask)
    row["two_pass, samples as exact"] = tone_errors(many.picture, exact, seen.mask)
    for name, picture in pictures.items():
        row[name] = {
            "exact": tone_errors(picture, exact, seen.mask),
            "two_pass": tone_errors(picture, few, seen.mask),
            "two_pass, many": tone_errors(picture, many, seen.mask),
        }
    row["seconds"] = {
        "engine": seconds,
        "two_pass": few.seconds,
        "two_pass, many": many.seconds,
        "exact": exact.seconds,
    }
    shown = [(f"{name}, {material}", on_screen(p, exact.average)) for name, p in
             (("texture space", pictures["engine"]), ("two_pass", many.picture), ("exact", exact.picture))]  # fmt: skip
    shown.append((f"difference x {AMPLIFIED}", AMPLIFIED * np.abs(shown[0][1] - shown[2][1])))
    say(f"{figure}, {material}: engine {row['engine']['exact']['image']:.4f} against exact, "
        f"{row['engine']['two_pass']['image']:.4f} against two_pass, which is off by "
        f"{row['two_pass itself']['image']:.4f} itself; {row['seconds']}")  # fmt: skip
    return row, shown


def convergence(setup: dict[str, int]) -> list[dict[str, Any]]:
    """Figure 7: RMSE against the number of samples, which enter at points, as in the paper, or over discs."""
    model, size, material = FIGURE7
    side = setup["side"]
    scene = model_scene(model, material, size, side=side)
    camera = camera_of(scene)
    seen = see_pixels(scene, camera, (side, side), Medium.from_preset(material).eta)
    exact = reference(scene, seen, "exact", sample_count=setup["samples"])
    engine = settled(Engine(scene))
    rows = []
    for count in COUNTS:
        engine.settings.samples = count
        row: dict[str, Any] = {"samples": count}
        row["engine"] = tone_errors(engine.linear(camera, (side, side)), exact, seen.mask)
        for name, points in (("points", True), ("discs", False)):
            found = reference(scene, seen, "texture_space", sample_count=count, point_samples=points, **FINE)
            row[name] = tone_errors(found.picture, exact, seen.mask)
        say(
            "figure 7: " + ", ".join(f"{k} {v['image']:.5f}" if isinstance(v, dict) else f"{v}" for k, v in row.items())
        )
        rows.append(row)
    return rows


def moving_frames(setup: dict[str, int]) -> list[dict[str, Any]]:
    """Measure the error of frames in motion, whose times are measured elsewhere: summed at one pixel of 16, and at every one."""
    rows = []
    for method, cases in FRAMES.items():
        for model, material, size in cases:
            scene = model_scene(model, material, size, side=setup["side"])
            camera = camera_of(scene)
            seen = see_pixels(scene, camera, (setup["side"],) * 2, Medium.from_preset(material).eta)
            exact = reference(scene, seen, "exact", sample_count=setup["samples"])
            engine = settled(Engine(scene), samples=FRAME_SAMPLES, method=method)
            row: dict[str, Any] = {"method": method, "model": model, "material": material, "size": size}
            for mode, interpolated in (("interpolated", True), ("every pixel", False)):
                engine.settings.interpolated = interpolated
                row[mode] = frame_errors(engine, camera, exact, seen.mask)
            say(", ".join(f"{k} {v['image']:.4f}" if isinstance(v, dict) else f"{v}" for k, v in row.items()))
            rows.append(row)
    return rows


def fits(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Fit the powers of the number of samples."""
    counts = [row["samples"] for row in rows]
    return {name: slope(counts, [row[name]["image"] for row in rows]) for name in ("engine", "points", "discs")}


def error_table(rows: list[dict[str, Any]]) -> None:
    """Put figures 9 and 10 into the documentation."""
    head = ["", "material", "samples", "against `two_pass`", "paper", "against `exact`", "covered pixels", "integrator: discs",
            "points", "`two_pass` itself", "frame", "`two_pass`", "times"]  # fmt: skip
    lines = []
    for row in rows:
        s, engine = row["seconds"], row["engine"]
        paper = PAPER.get((row["figure"], row["material"]))
        lines.append([
            f"{row['figure']}: {row['model']}, {row['size']:g} mm", row["material"], row["samples"],
            f"{engine['two_pass, many']['image']:.4f}", f"{paper:.4f}" if paper else "", f"**{engine['exact']['image']:.4f}**",
            f"{engine['exact']['covered']:.4f}", f"{row['discs']['exact']['image']:.4f}", f"{row['points']['exact']['image']:.4f}",
            f"{row['two_pass itself']['image']:.4f}", f"{s['engine']:.2f} s", f"{s['two_pass, many']:.1f} s",
            f"{s['two_pass, many'] / s['engine']:.0f}",
        ])  # fmt: skip
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, lines)}")


def convergence_table(rows: list[dict[str, Any]]) -> None:
    """Put figure 7 into the documentation."""
    lines = [[row["samples"], *(f"{row[name]['image']:.5f}" for name in ("engine", "points", "discs"))] for row in rows]
    powers = fits(rows)
    lines.append(["**power of N**", *(f"**{powers[name]:.2f}**" for name in ("engine", "points", "discs"))])
    head = ["samples", "real time", "`pellucid_texture_space`, points", "discs"]
    fill(
        DOCS / "benchmarks.md",
        "texture_space_convergence",
        f"`{COMMAND} --only 'figure 7'`\n\n{markdown_table(head, lines)}",
    )


def frames_table(rows: list[dict[str, Any]]) -> None:
    """Put the errors of frames in motion into the documentation."""
    head = ["method", "model", "1 of 16 pixels", "covered pixels", "every pixel", "covered pixels"]
    lines = [
        [row["method"], f"{row['model']}, {row['material']}, {row['size']:g} mm",
         *(f"{row[mode][part]:.4f}" for mode in ("interpolated", "every pixel") for part in ("image", "covered"))]
        for row in rows
    ]  # fmt: skip
    text = f"`{COMMAND} --only frames`\n\n{markdown_table(head, lines)}"
    fill(DOCS / "benchmarks.md", "texture_space_frames", text)


def plot(rows: list[dict[str, Any]]) -> None:
    """Draw figure 7."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(5.4, 3.8), layout="constrained")
    counts = np.array([row["samples"] for row in rows], float)
    for name, power in fits(rows).items():
        axis.loglog(counts, [row[name]["image"] for row in rows], "o-", ms=4, label=f"{name}, N^{power:.2f}")
    first = rows[0]["points"]["image"]
    axis.loglog(counts, first * (counts / counts[0]) ** -0.5, ":", color="0.6", label="N^-0.5")
    axis.set(xlabel="samples N", ylabel="RMSE of the tone-mapped picture", title="wanderer, 30 mm, skin2")
    axis.legend()
    figure.savefig(FIGURES / "texture_space_convergence.png", dpi=110)
    plt.close(figure)


def run(part: str, quick: bool) -> None:
    """Measure a part, and keep it."""
    setup = QUICK if quick else FULL
    results = {} if quick else saved(NAME)
    keep = results | {"setup": FULL}
    if part == "figure 7":
        rows = convergence(setup)
        if not quick:
            save(NAME, COMMAND, keep | {part: rows, "powers": fits(rows)})
            convergence_table(rows)
            plot(rows)
        return
    if part == "frames":
        rows = moving_frames(setup)
        if not quick:
            save("texture_space_frames", f"{COMMAND} --only frames", {"setup": FULL, "rows": rows})
            frames_table(rows)
        return
    rows, pictures = [], []
    for material in MATERIALS[: 2 if quick else None]:
        row, shown = compare(part, material, setup)
        rows.append(row)
        pictures.append(shown)
        if not quick:
            save(NAME, COMMAND, keep | {part: rows})
    if not quick:
        error_table([row for figure in CASES for row in saved(NAME).get(figure, [])])
        name = part.replace(" ", "")
        save_rows(
            DOCS / "gallery" / f"texture_space_{name}.png", [[(c, halved(p)) for c, p in row] for row in pictures[:2]]
        )


def main() -> None:
    parts = ("figure 7", *CASES, "frames")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=parts, help="measure one part, keep the others")
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", pellucid.errors.PellucidWarning)
    for part in [arguments.only] if arguments.only else parts:
        run(part, arguments.quick)


if __name__ == "__main__":
    main()
