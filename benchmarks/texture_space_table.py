"""Tables 2 and 3 and figure 6 of Chang et al. 2008: frames a second for seven models and 49 to 2500 samples, whole and third stage alone.

    python benchmarks/texture_space_table.py

writes docs/figures/texture_space_table.json, model by model, and the tables of docs/benchmarks.md between their marks. Takes
about four minutes on two cores; ``--only sphere`` measures one model and keeps what is saved of the others, ``--only 'figure 6'``
measures that figure and draws it, ``--quick`` goes through the same steps small, and writes nothing.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.model.medium import Medium
from pellucid.realtime.engine import Engine
from support.images import save_row
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

COMMAND = "python benchmarks/texture_space_table.py"
NAME = "texture_space_table"
COUNTS = (49, 100, 169, 256, 400, 900, 1600, 2500)
SIDE, FRAMES = 512, 7
MATERIAL = "marble"
MODES = {"interpolated": True, "every pixel": False}

PAPER_WHOLE = {
    "sphere": ("Sphere", 119.2, 99.3, 78.5, 62.9, 47.2, 25.3, 15.0, 9.8),
    "horned_head": ("CowHead", 156.6, 142.7, 126.9, 110.4, 91.5, 57.1, 37.0, 25.2),
    "relief_head": ("TexHead", 148.6, 128.0, 110.4, 91.8, 72.6, 42.4, 26.5, 17.6),
    "philosopher": ("MaxPlanck", 135.2, 120.2, 102.5, 83.1, 64.7, 37.3, 22.9, 15.1),
    "longneck": ("Parasaur", 148.4, 127.9, 110.0, 93.7, 74.7, 43.2, 27.0, 18.2),
    "antique_head": ("Igea", 145.7, 122.6, 103.3, 85.5, 67.0, 38.2, 23.4, 15.4),
    "wanderer": ("Santa", 152.0, 118.7, 106.3, 90.7, 69.0, 39.7, 24.8, 16.5),
}
PAPER_THIRD = {
    "sphere": ("Sphere", 449.3, 242.4, 150.2, 101.2, 66.0, 29.9, 16.6, 10.4),
    "horned_head": ("CowHead", 1144.9, 634.1, 408.6, 278.1, 181.7, 82.9, 46.4, 29.1),
    "relief_head": ("TexHead", 819.1, 449.8, 277.7, 187.8, 122.3, 55.6, 31.1, 19.5),
    "philosopher": ("MaxPlanck", 698.3, 376.9, 233.6, 157.8, 102.8, 47.2, 26.6, 16.7),
    "longneck": ("Parasaur", 874.2, 485.0, 291.8, 199.1, 129.8, 57.3, 31.9, 20.3),
    "antique_head": ("Igea", 702.9, 377.8, 238.0, 163.2, 107.1, 48.8, 26.9, 16.8),
    "wanderer": ("Santa", 734.1, 402.5, 248.9, 170.1, 110.6, 50.6, 28.3, 16.7),
}
"""Frames a second on a GeForce 8800 GTX (CLHHC08 tables 2 and 3), after the paper's name of the model."""

FIGURE6 = (
    ("philosopher", "skimmilk", 900, 47.2),
    ("longneck", "skin1", 1600, 31.9),
    ("relief_head", "marble", 2500, 19.5),
)
"""Models that stand for the paper's, materials, numbers of samples, and the paper's frames a second, which are those of table 3."""

SIZE, REFERENCE_SAMPLES = 10.0, 60_000
SHOWN = "antique_head"
"""The model that speaks for all."""

GOAL, HOPE = 900, 400
"""From so many samples on the interpolated mode is to be faster than the paper, whole frame; and from so many it is hoped for."""


def measure(name: str, side: int, counts: tuple[int, ...], frames: int) -> dict[str, Any]:
    """Fill the rows of one model: times [s] by mode and number of samples."""
    scene = model_scene(name, MATERIAL, side=side)
    engine, camera = Engine(scene), camera_of(scene)
    row: dict[str, Any] = {"triangles": scene.shapes()[0].face_count(), "side": side, "modes": {}}
    for mode, interpolated in MODES.items():
        engine.settings.interpolated = interpolated
        row["modes"][mode] = []
        for count in counts:
            engine.settings.samples = count
            times = {"samples": count}
            for part, light, timed in (("whole", True, False), ("camera", False, False), ("stages", True, True)):
                engine.settings.timed = timed
                found = frame_times(engine, camera, (side, side), frames, light)
                times[part] = found if timed else found["whole"]
            row["modes"][mode].append(times)
            say(
                f"{name:13} {mode:12} {count:5}: {1 / times['whole']:6.1f} fps, camera alone {1 / times['camera']:6.1f}"
            )
    frame = engine.frame(camera, (side, side), moving=True)
    row["covered"] = int((frame.pixels.max(axis=2) > 0).sum())
    return row


def rows_of(rows: dict[str, Any], part: str, paper: dict[str, tuple]) -> list[list[str]]:
    """Put frames a second beside the paper's, three lines a model; bold where ours are more."""
    lines = []
    for name, row in rows.items():
        title, *theirs = paper[name]
        for mode in MODES:
            rates = [1 / times[part] for times in row["modes"][mode]]
            cells = [
                f"**{ours:.0f}**" if ours > other else f"{ours:.0f}" for ours, other in zip(rates, theirs, strict=True)
            ]
            lines.append([name if mode == "interpolated" else "", f"{row['triangles']:,}", mode, *cells])
        lines.append(["", "", f"{title}, 8800 GTX", *(f"{rate:.0f}" for rate in theirs)])
    return lines


def verdict(rows: dict[str, Any]) -> str:
    """Say for which models and numbers of samples whole interpolated frames are faster than the paper's."""
    missed = []
    for count in (HOPE, GOAL, 1600, 2500):
        k = COUNTS.index(count)
        slower = [n for n, row in rows.items() if 1 / row["modes"]["interpolated"][k]["whole"] <= PAPER_WHOLE[n][1 + k]]
        missed.append(f"{count}: " + (f"slower for {', '.join(slower)}" if slower else "faster for all"))
    return f"Whole interpolated frames against the paper, by samples (goal: from {GOAL}, better from {HOPE}). {'; '.join(missed)}."


def stages(rows: dict[str, Any]) -> str:
    """Tell what a frame is made of, for one model."""
    name = SHOWN if SHOWN in rows else next(iter(rows))
    parts = []
    for mode in MODES:
        times = rows[name]["modes"][mode][COUNTS.index(GOAL)]["stages"]
        parts.append(f"{mode}: " + ", ".join(f"{stage} {1e3 * t:.1f}" for stage, t in times.items()) + " ms")
    return f"Stages of `{name}` at {GOAL} samples, each timed by itself. {'; '.join(parts)}."


def tables(rows: dict[str, Any]) -> None:
    """Put both tables into the documentation."""
    rows = {name: rows[name] for name in PAPER_WHOLE if name in rows}
    head = ["model", "triangles", "", *map(str, COUNTS)]
    whole, third = (rows_of(rows, p, t) for p, t in (("whole", PAPER_WHOLE), ("camera", PAPER_THIRD)))
    covered = ", ".join(f"{name} {row['covered']:,}" for name, row in rows.items())
    text = (
        f"`{COMMAND}`\n\nFrames a second, light and camera moving:\n\n{markdown_table(head, whole)}\n\n{verdict(rows)}"
    )
    text += f"\n\nFrames a second, the camera alone moving:\n\n{markdown_table(head, third)}\n\n{stages(rows)}"
    fill(DOCS / "benchmarks.md", NAME, f"{text} Pixels that show the model: {covered}.")
    if SHOWN in rows:
        fill(
            DOCS / "texture_space.md",
            "texture_space_summary",
            markdown_table(head, rows_of({SHOWN: rows[SHOWN]}, "whole", PAPER_WHOLE)),
        )


def figure6(side: int, samples: int) -> tuple[list[dict[str, Any]], list[tuple[str, Any]]]:
    """Compare the frames of figure 6 with the exact sum; how long they take does not depend on the material."""
    rows, pictures = [], []
    for name, material, count, paper in FIGURE6:
        scene = model_scene(name, material, SIZE, side=side)
        camera, engine = camera_of(scene), settled(Engine(scene), samples=count)
        seen = see_pixels(scene, camera, (side, side), Medium.from_preset(material).eta)
        exact = reference(scene, seen, "exact", sample_count=samples)
        picture = engine.linear(camera, (side, side))
        row: dict[str, Any] = {"model": name, "material": material, "samples": count, "paper": paper}
        row["error"] = tone_errors(picture, exact, seen.mask)
        say(f"figure 6, {name}, {material}: RMSE {row['error']['image']:.4f}")
        rows.append(row)
        pictures.append((f"{name}, {material}, {count} samples", halved(on_screen(picture, BRIGHTER * exact.average))))
    return rows, pictures


def figure6_table(rows: list[dict[str, Any]]) -> None:
    """Put figure 6 into the documentation."""
    head = [
        "figure 6, camera alone moving",
        "samples",
        "interpolated",
        "every pixel",
        "paper",
        "RMSE against `exact`",
        "covered pixels",
    ]
    lines, times = [], saved(NAME)["rows"]
    for row in rows:
        place = COUNTS.index(row["samples"])
        rates = [f"{1 / times[row['model']]['modes'][mode][place]['camera']:.0f} fps" for mode in MODES]
        lines.append([
            f"{row['model']}, {row['material']}, {SIZE:g} mm", row["samples"], *rates, f"{row['paper']} fps",
            f"**{row['error']['image']:.4f}**", f"{row['error']['covered']:.4f}",
        ])  # fmt: skip
    text = f"`{COMMAND} --only 'figure 6'`\n\n{markdown_table(head, lines)}"
    fill(DOCS / "benchmarks.md", "texture_space_figure6", text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = (*PAPER_WHOLE, "figure 6")
    parser.add_argument("--only", choices=parts, help="measure one model or the figure, keep the others")
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    arguments = parser.parse_args()
    for name in [arguments.only] if arguments.only else parts[-3 if arguments.quick else 0 :]:
        if arguments.quick:
            figure6(96, 4000) if name == "figure 6" else measure(name, 128, (49, 900), 2)
            continue
        if name == "figure 6":
            figure, pictures = figure6(SIDE, REFERENCE_SAMPLES)
            save("texture_space_figure6", f"{COMMAND} --only 'figure 6'", figure)
            figure6_table(figure)
            save_row(DOCS / "gallery" / "texture_space_figure6.png", pictures)
            continue
        rows = saved(NAME).get("rows", {}) | {name: measure(name, SIDE, COUNTS, FRAMES)}
        save(NAME, COMMAND, {"material": MATERIAL, "side": SIDE, "frames": FRAMES, "rows": rows})
        tables(rows)


if __name__ == "__main__":
    main()
