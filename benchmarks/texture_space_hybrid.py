"""Figures 11, 13 and 14 of Chang et al. 2008: sizes and materials, with many samples and with the hybrid method.

    python benchmarks/texture_space_hybrid.py

writes docs/figures/texture_space_hybrid.json, pictures of the gallery, and the tables of docs/benchmarks.md between their
marks. Takes about four minutes on two cores; ``--only`` one figure keeps what is saved of the others, ``--quick`` goes
through the same steps small, and writes nothing.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
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
    BRIGHTER,
    camera_of,
    frame_times,
    halved,
    model_scene,
    on_screen,
    reference,
    say,
    see_pixels,
    settled,
    tone_errors,
)
from support.record import DOCS, fill, markdown_table, save, saved

COMMAND = "python benchmarks/texture_space_hybrid.py"
NAME = "texture_space_hybrid"
GLOBAL, LOCAL = 900, 401
CASES = {
    "figure 13": [
        ("longneck", "skin1", 10.0, 900),
        ("longneck", "skin1", 20.0, 3600),
        ("longneck", "skin1", 30.0, 14400),
    ],
    "figure 14": [
        ("wanderer", "skin1", 30.0, 2500),
        ("wanderer", "marble", 30.0, 14400),
        ("wanderer", "cream", 30.0, 62500),
    ],
}
PAPER = {
    "figure 13": [(55.0, 17.3), (13.4, 17.3), (3.3, 17.3)],
    "figure 14": [(18.2, 21.8), (3.0, 21.6), (0.6, 22.2)],
}
"""Frames a second there: many samples, hybrid."""

GOAL_ERROR, GOAL_SPREAD = 0.0144, 0.10
FIGURE11 = {
    "a": ("antique_head", [("skin1", 10.0), ("skin1", 70.0)]),
    "b": ("antique_head", [("skimmilk", 10.0), ("skin1", 40.0)]),
}
STEPS = 5


def compare(
    case: tuple[str, str, float, int], setup: dict[str, int]
) -> tuple[dict[str, Any], list[tuple[str, np.ndarray]]]:
    """Fill a row: a picture with many samples and one by the hybrid method, their errors and times."""
    model, material, size, count = case
    side = setup["side"]
    scene = model_scene(model, material, size, side=side)
    camera, resolution = camera_of(scene), (side, side)
    seen = see_pixels(scene, camera, resolution, Medium.from_preset(material).eta)
    exact = reference(scene, seen, "exact", sample_count=setup["samples"])
    engine = settled(Engine(scene))
    row: dict[str, Any] = {"model": model, "material": material, "size": size, "samples": count}
    shown = []
    for kind, method, n in (
        ("plain", "texture_space", count),
        ("few", "texture_space", GLOBAL),
        ("hybrid", "hybrid", GLOBAL),
    ):
        engine.settings.method, engine.settings.samples = method, n
        picture = engine.linear(camera, resolution)
        row[kind] = {"error": tone_errors(picture, exact, seen.mask)}
        for mode, interpolated in (("interpolated", True), ("every pixel", False)):
            engine.settings.interpolated = interpolated
            row[kind][mode] = frame_times(engine, camera, resolution, setup["frames"])["whole"]
        shown.append((f"{n}{f' + {LOCAL}' if kind == 'hybrid' else ''} samples", on_screen(picture, exact.average)))
        say(f"{model}, {material}, {size:g} mm, {kind}: {1 / row[kind]['interpolated']:.1f} fps, "
            f"every pixel {1 / row[kind]['every pixel']:.1f}, RMSE {row[kind]['error']['image']:.4f}")  # fmt: skip
    shown.append((f"exact: {material}, {size:g} mm", on_screen(exact.picture, exact.average)))
    return row, shown


def table(results: dict[str, Any]) -> None:
    """Put figures 13 and 14 into the documentation."""
    head = ["", "samples", "frame, interpolated", "every pixel", "paper", "RMSE", f"RMSE of {GLOBAL} samples",
            f"hybrid {GLOBAL} + {LOCAL}: frame, interpolated", "every pixel", "paper", "RMSE"]  # fmt: skip
    lines, notes = [], []
    for figure, cases in PAPER.items():
        rows = results.get(figure, [])
        for row, (many, hybrid) in zip(rows, cases, strict=False):
            plain, ours = row["plain"], row["hybrid"]
            lines.append([
                f"{figure}: {row['model']}, {row['material']}, {row['size']:g} mm", f"{row['samples']:,}",
                f"{1 / plain['interpolated']:.1f} fps", f"{1 / plain['every pixel']:.1f} fps", f"{many:.1f} fps",
                f"{plain['error']['image']:.4f}", f"{row['few']['error']['image']:.4f}",
                f"**{1 / ours['interpolated']:.1f} fps**", f"{1 / ours['every pixel']:.1f} fps", f"{hybrid:.1f} fps",
                f"**{ours['error']['image']:.4f}**",
            ])  # fmt: skip
        if rows:
            times = np.array([row["hybrid"]["interpolated"] for row in rows])
            spread = float(times.max() / times.min() - 1)
            worst = max(row["hybrid"]["error"]["image"] for row in rows)
            rate, error = (("met" if ok else "**not met**") for ok in (spread <= GOAL_SPREAD, worst <= GOAL_ERROR))
            notes.append(f"{figure}: the hybrid's frame times differ by {spread:.0%} (goal: {GOAL_SPREAD:.0%}, {rate}), "
                         f"its largest RMSE is {worst:.4f} (goal: {GOAL_ERROR}, {error}).")  # fmt: skip
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, lines)}\n\n{' '.join(notes)}")


def figure11(side: int) -> list[list[tuple[str, np.ndarray]]]:
    """Let size and material go over from one setting to another in one engine: rows of pictures."""
    rows = []
    for model, ((first, small), (last, large)) in FIGURE11.values():
        scene = model_scene(model, first, small, side=side)
        camera, a, b = camera_of(scene), Medium.from_preset(first), Medium.from_preset(last)
        engine = settled(Engine(scene), method="hybrid", samples=3600)
        row = []
        for t in np.linspace(0, 1, STEPS):
            mixed = {k: (1 - t) * getattr(a, k) + t * getattr(b, k) for k in ("sigma_a", "sigma_s_prime")}
            size = (1 - t) * small + t * large
            engine.set_medium(0, replace(a, **mixed))
            engine.set_size(size)
            picture = engine.linear(camera, (side, side))
            average = float(picture.mean() / (picture.max(axis=2) > 0).mean())
            row.append((f"{size:.0f} mm", on_screen(picture, BRIGHTER * average)))
        rows.append(row)
        say(f"figure 11: {first} {small:g} mm to {last} {large:g} mm")
    return rows


def main() -> None:
    parts = ("figure 11", *CASES)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=parts, help="one figure, keep the others")
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", pellucid.errors.PellucidWarning)
    quick = arguments.quick
    setup = {"side": 96, "samples": 4000, "frames": 2} if quick else {"side": 512, "samples": 100_000, "frames": 5}
    for part in [arguments.only] if arguments.only else parts:
        picture = DOCS / "gallery" / f"texture_space_{part.replace(' ', '')}.png"
        if part == "figure 11":
            pictures = figure11(48 if quick else 300)
        else:
            rows, pictures = [], []
            for case in CASES[part]:
                row, shown = compare(case, setup)
                rows.append(row)
                pictures.append([(caption, halved(p)) for caption, p in shown])
                if not quick:
                    save(NAME, COMMAND, saved(NAME) | {"setup": setup, part: rows})
        if not quick:
            save_rows(picture, pictures)
            table(saved(NAME))


if __name__ == "__main__":
    main()
