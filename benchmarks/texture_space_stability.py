"""How steady frames are while a lamp goes slowly by: the error against a converged sweep, and how much of it flickers.

    python benchmarks/texture_space_stability.py

writes docs/figures/texture_space_stability.json, and the table of docs/benchmarks.md between its marks. Takes a minute on
two cores; ``--quick`` goes through the same steps small, and writes nothing.
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

from pellucid.realtime.engine import Engine
from support.realtime import camera_of, model_scene, say, settled, toned, turned
from support.record import DOCS, fill, markdown_table, save

COMMAND = "python benchmarks/texture_space_stability.py"
NAME = "texture_space_stability"
MODEL, SIZE, MATERIAL = "antique_head", 10.0, "marble"
COUNTS = (400, 900, 2500)
STEP = 0.5
"""By which the lamp goes on from frame to frame [degrees]."""


def sweep(engine: Engine, camera: Any, side: int, frames: int, settings: dict[str, Any]) -> np.ndarray:
    """Render a sweep of the lamp: linear pictures ``(frames, h, w, 3)``."""
    settled(engine, **settings)
    position = engine.lights[0].position
    pictures = []
    for k in range(frames):
        engine.set_light(0, position=turned(position, STEP * k))
        pictures.append(engine.linear(camera, (side, side)))
    engine.set_light(0, position=position)
    return np.stack(pictures)


def flicker(pictures: np.ndarray) -> float:
    """Take the root mean square of second differences in time over sqrt(6).

    Of independent noise it is the deviation; a steady change, and an error that stays where it is, have none.
    """
    return float(np.sqrt(np.mean(np.diff(pictures, 2, axis=0) ** 2) / 6))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    quick = parser.parse_args().quick
    side, frames, converged = (64, 4, 2500) if quick else (192, 24, 62500)
    scene = model_scene(MODEL, MATERIAL, SIZE, side=side)
    engine, camera = Engine(scene), camera_of(scene)
    truth = sweep(engine, camera, side, frames, {"samples": converged})
    covered = truth[0].max(axis=2) > 0
    average = float(truth[:, covered].mean())
    shown = toned(truth[:, covered], average)
    rows: list[dict[str, Any]] = [{"method": "converged", "samples": converged, "flicker": flicker(shown)}]
    motion = float(np.sqrt(np.mean(np.diff(shown, axis=0) ** 2)))
    say(f"converged: {motion:.5f} from frame to frame, flicker {rows[0]['flicker']:.6f}")
    for method, counts in (("texture_space", COUNTS), ("hybrid", (900,))):
        for count in counts:
            pictures = sweep(engine, camera, side, frames, {"samples": count, "method": method})[:, covered]
            error = toned(pictures, average) - shown
            row = {
                "method": method,
                "samples": count,
                "rmse": float(np.sqrt(np.mean(error**2))),
                "temporal": float(np.sqrt(np.mean(np.diff(error, axis=0) ** 2))),
                "flicker": flicker(error),
            }
            say(f"{row}")
            rows.append(row)
    if quick:
        return
    save(NAME, COMMAND, {"model": MODEL, "side": side, "frames": frames, "step": STEP, "motion": motion, "rows": rows})
    head = ["method", "samples", "RMSE", "of its change from frame to frame", "flicker", "flicker / RMSE"]
    lines = [
        [row["method"], row["samples"], *(f"{row[k]:.5f}" for k in ("rmse", "temporal", "flicker")),
         f"{row['flicker'] / row['rmse']:.0%}"]
        for row in rows[1:]
    ]  # fmt: skip
    note = f"The converged sweep, of {converged:,} samples, changes by {motion:.5f} from frame to frame."
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, lines)}\n\n{note}")


if __name__ == "__main__":
    main()
