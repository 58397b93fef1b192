"""Figure 8 of Chang et al. 2008: samples in texture space against samples around each pixel of the camera's picture.

    python benchmarks/texture_space_baseline.py

writes docs/figures/texture_space_baseline.json, a picture of the gallery, and the table of docs/benchmarks.md between its
marks. Takes a minute on two cores; ``--quick`` goes through the same steps small, and writes nothing.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

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
from support.record import DOCS, fill, markdown_table, save

COMMAND = "python benchmarks/texture_space_baseline.py"
NAME = "texture_space_baseline"
MODEL, SIZE, MATERIAL, COUNT = "antique_head", 10.0, "marble", 1600
LIGHTS = {"lit from the front": 40.0, "lit from behind": 160.0}
METHODS = ("texture_space", "image_space")
PAPER = {"texture_space": 26.9, "image_space": 2.6}
"""Frames a second of figure 8."""

GOAL = 10


def measure(
    light: str, side: int, samples: int, frames: int
) -> tuple[list[dict[str, Any]], list[tuple[str, np.ndarray]]]:
    """Compare both methods under one light: errors against the exact sum, times of frames of the same kind."""
    scene = model_scene(MODEL, MATERIAL, SIZE, LIGHTS[light], side)
    camera, resolution = camera_of(scene), (side, side)
    seen = see_pixels(scene, camera, resolution, Medium.from_preset(MATERIAL).eta)
    exact = reference(scene, seen, "exact", sample_count=samples)
    engine = settled(Engine(scene), samples=COUNT)
    rows, shown = [], []
    for method in METHODS:
        engine.settings.method = method
        picture = engine.linear(camera, resolution)
        row: dict[str, Any] = {"light": light, "method": method, "error": tone_errors(picture, exact, seen.mask)}
        for mode, interpolated in (("every pixel", False), ("interpolated", True)):
            engine.settings.interpolated, engine.settings.timed = interpolated, True
            row[mode] = frame_times(engine, camera, resolution, frames)
        say(f"{light}, {method}: {1 / row['every pixel']['whole']:.1f} fps, RMSE {row['error']['image']:.4f}")
        rows.append(row)
        shown.append((f"{method}, {light}", on_screen(picture, exact.average)))
    shown.append((f"exact, {light}", on_screen(exact.picture, exact.average)))
    return rows, shown


def table(rows: list[dict[str, Any]]) -> None:
    """Put figure 8 into the documentation."""
    lines = []
    for row in rows:
        frame = row["every pixel"]
        lines.append([
            row["light"], row["method"], f"**{row['error']['image']:.4f}**", f"{row['error']['covered']:.4f}",
            f"{1e3 * frame['whole']:.0f} ms", f"{1e3 * frame['integration']:.0f} ms",
            f"{1e3 * row['interpolated']['whole']:.0f} ms", f"{PAPER[row['method']]:.1f} fps",
        ])  # fmt: skip
    head = [
        "",
        "method",
        "RMSE against `exact`",
        "covered pixels",
        "frame, every pixel",
        "its integration",
        "frame, interpolated",
        "paper",
    ]
    text = []
    for light in LIGHTS:
        ours, theirs = (next(r for r in rows if r["light"] == light and r["method"] == m) for m in METHODS)
        whole, part = (theirs["every pixel"][k] / ours["every pixel"][k] for k in ("whole", "integration"))
        fewer = theirs["error"]["image"] / ours["error"]["image"]
        text.append(
            f"{light}: {whole:.1f} times faster per frame, {part:.1f} times in the integration, {fewer:.1f} times less error"
        )
        text[-1] += (
            f" (goal: {GOAL} times faster at no more error, {'met' if whole >= GOAL and fewer >= 1 else '**not met**'})"
        )
    summary = f"Texture space against image space, every pixel: {'; '.join(text)}."
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, lines)}\n\n{summary}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    quick = parser.parse_args().quick
    rows: list[dict[str, Any]] = []
    pictures = []
    for light in LIGHTS:
        found, shown = measure(light, *((96, 4000, 2) if quick else (512, 40_000, 7)))
        rows += found
        pictures.append([(caption, halved(p)) for caption, p in shown])
        if not quick:
            save(NAME, COMMAND, {"model": MODEL, "material": MATERIAL, "size": SIZE, "samples": COUNT, "rows": rows})
    if not quick:
        table(rows)
        save_rows(DOCS / "gallery" / "texture_space_figure8.png", pictures)


if __name__ == "__main__":
    main()
