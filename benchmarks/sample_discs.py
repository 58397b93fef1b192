"""What error the default number of samples leaves where light changes quickly, with the tabulated profile and with the dipole.

    python benchmarks/sample_discs.py

writes docs/figures/sample_discs.json and the table of docs/theory/samples.md between its marks. Takes about two minutes on two
cores; ``--quick`` measures one material against few samples, and writes nothing.

The reference has the same profile and half a million samples. Errors are those of the exitance at points of the surface, over its mean
on the ball and over the lit plateau of the block.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

from support.record import DOCS, fill, markdown_table, save

COMMAND = "python benchmarks/sample_discs.py"
MATERIALS = ("skin1", "marble")
PROFILES = ("dipole", "tabulated")
MANY, POINTS, ACCURATE = 500_000, 1500, 0.02


def ball(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Describe a ball of 20 mm, half of it lit by a point."""
    lamp = {"type": "point", "position": [60.0, 40.0, 80.0], "intensity": {"type": "rgb", "value": 10_000.0}}
    return {"type": "scene", "body": {"type": "sphere", "radius": 10.0, "bsdf": bsdf}, "lamp": lamp}


def block(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Describe a cube of 30 mm, lit from above; the edge of a black card throws a sharp shadow across its top."""
    to_world = mi.ScalarTransform4f
    card = to_world().translate([20.3, 0, 25]).rotate([0, 0, 1], 17).scale(20)
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    return {
        "type": "scene",
        "body": {"type": "cube", "to_world": to_world().scale(15), "bsdf": bsdf},
        "card": {"type": "rectangle", "to_world": card, "bsdf": black},
        "lamp": {"type": "directional", "direction": [0, 0, -1], "irradiance": {"type": "rgb", "value": 1.0}},
    }


def places(body: str) -> np.ndarray:
    """Spread points over the ball, or over the middle of the top of the block: ``(n, 3) float``."""
    rng = np.random.default_rng(7)
    if body == "block":
        return np.concatenate([rng.uniform(-11, 11, (POINTS, 2)), np.full((POINTS, 1), 15.0)], axis=1)
    p = rng.normal(size=(POINTS, 3))
    return 10 * p / np.linalg.norm(p, axis=1, keepdims=True)


def measure(body: str, material: str, profile: str, many: int) -> dict[str, Any]:
    """Compare the default number of samples with many: errors as shares of what is bright."""
    make = {"ball": ball, "block": block}[body]
    scene = mi.load_dict(make({"type": "pellucid_translucent", "material": material, "profile": profile}))
    at = places(body)

    def exitance(**options: Any) -> np.ndarray:
        prepared = pellucid.prepare(scene, "two_pass", max_error=ACCURATE, irradiance_paths=1, **options)
        return np.asarray(prepared.exitance(at))

    truth, found = exitance(sample_count=many, sampling="uniform"), exitance()
    bright = np.percentile(truth, 95, axis=0) if body == "block" else truth.mean(axis=0)
    error = (found - truth) / bright
    rms = float(np.sqrt((error**2).mean(axis=0)).mean())
    row = {"body": body, "material": material, "profile": profile, "rms": rms, "largest": float(np.abs(error).max())}
    print(row, flush=True)
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Write the RMS error and the largest one, by profile."""
    lines = []
    for body, material in dict.fromkeys((row["body"], row["material"]) for row in rows):
        found = [row for row in rows if (row["body"], row["material"]) == (body, material)]
        lines.append([body, material, *(f"{row['rms']:.1%}, {row['largest']:.0%}" for row in found)])
    return markdown_table(["", "material", *PROFILES], lines)


def main() -> None:
    """Measure, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one material against few samples; write nothing")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore")
    mi.set_variant("llvm_ad_rgb")
    materials, many = (MATERIALS[:1], 50_000) if quick else (MATERIALS, MANY)
    rows = [
        measure(body, material, profile, many)
        for body in ("ball", "block")
        for material in materials
        for profile in PROFILES
    ]
    print(table(rows))
    if not quick:
        save("sample_discs", COMMAND, rows)
        fill(DOCS / "theory" / "samples.md", "sample_discs", f"`{COMMAND}`\n\n{table(rows)}")


if __name__ == "__main__":
    main()
