"""How exact the light of opaque surfaces is that single_pass finds by its light samples, beside paths in equal time.

    python benchmarks/opaque_light.py

writes docs/figures/opaque_light.json and the table of docs/single_pass.md between its marks. Takes five minutes on two cores; ``--quick``
makes small pictures, and writes nothing; ``--only SCENE`` keeps saved results of the other scene.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_dilation

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.scenes.builtin import build
from support.pixels import body_mask
from support.record import DOCS, fill, markdown_table, save, saved
from support.scenes import independent, load

COMMAND = "python benchmarks/opaque_light.py"
NAME = "opaque_light"
SCENES: dict[str, dict[str, Any]] = {
    "mezquita": {"bays": (4, 8), "samples": 1e5},
    "kitchen": {"samples": 6e4, "detail": 64},
}
RESOLUTION, SAMPLES, REFERENCE, SEEDS = (160, 120), 16, 256, 4
LUMINANCE = [0.2126, 0.7152, 0.0722]
DILATED = 2
"""Pixels around bodies that are left out."""


def prepared(scene: Any, seed: int, lights: bool) -> tuple[Any, float]:
    """Prepare a scene: an integrator, and the seconds of all processors that it took."""
    integrator = mi.load_dict({"type": "pellucid_single_pass", "seed": seed, "light_opaque": lights})
    begin = time.process_time()
    integrator.prepared = integrator.prepare_scene(scene)
    return integrator, time.process_time() - begin


def picture(scene: Any, integrator: Any, spp: int, seed: int) -> tuple[np.ndarray, float]:
    """Render a scene: luminance, and the seconds of all processors that it took."""
    begin = time.process_time()
    image = np.array(integrator.render(scene, spp=spp, seed=100_000_000 * seed), float)[..., :3]
    return image @ LUMINANCE, time.process_time() - begin


def measure(name: str, resolution: tuple[int, int], reference: int, seeds: int) -> dict[str, Any]:
    """Compare pictures of a scene with many paths."""
    spec = independent(build(name, resolution=resolution, **SCENES[name]))
    spec["sensor"]["film"]["rfilter"] = {"type": "box"}
    scene = load(spec)
    for lights in (True, False):
        picture(scene, prepared(scene, 0, lights)[0], SAMPLES, 0)  # compiles
    by_paths, preparing = prepared(scene, 0, False)
    bodies = body_mask(scene, scene.sensors()[0], by_paths.prepared.lookup)
    opaque = ~binary_dilation(bodies, iterations=DILATED)
    one, other = (picture(scene, by_paths, reference, seed)[0] for seed in (1, 2))
    truth = (one + other)[opaque] / 2
    left = (one - other)[opaque] / 2  # as noisy as the truth
    rows: dict[str, Any] = {"points": int(opaque.sum())}
    for kind in ("paths", "light samples"):
        images, prepare, render = [], [], []
        for seed in range(3, 3 + seeds):
            integrator, seconds = (by_paths, preparing) if kind == "paths" else prepared(scene, seed, True)
            image, spent = picture(scene, integrator, SAMPLES, seed)
            images.append(image[opaque])
            prepare.append(seconds)
            render.append(spent)
        error = np.array(images) - truth
        shift, own = error.mean(axis=1) / truth.mean(), np.std(left) / np.sqrt(left.size) / truth.mean()
        rows[kind] = {
            "rmse": float(np.sqrt(max(np.mean(error**2) - np.mean(left**2), 0)) / truth.mean()),
            "median": float(np.median(np.abs(error)) / truth.mean()),
            "bias": float(shift.mean()),
            "standard_error": float(np.hypot(shift.std(ddof=1) / np.sqrt(seeds), own)),
            "prepare": float(np.median(prepare)),
            "render": float(np.median(render)),
        }
    paths, ours = rows["paths"], rows["light samples"]
    more = ours["prepare"] + ours["render"] - paths["prepare"]
    rows["equal_time"] = paths["rmse"] * float(np.sqrt(paths["render"] / max(more, paths["render"] / SAMPLES)))
    rows["gain"] = rows["equal_time"] / ours["rmse"]
    print(name, rows, flush=True)
    return rows


def table(results: dict[str, Any]) -> str:
    """Lay out all rows."""
    head = [
        "scene",
        "points",
        "",
        "RMSE",
        "median error",
        "bias",
        "prepared in",
        "picture",
        "RMSE of paths in equal time",
    ]
    body = [
        [name, f"{found['points']:,}", kind, f"{row['rmse']:.1%}", f"{row['median']:.1%}",
         f"{row['bias']:+.2%} +- {row['standard_error']:.2%}", f"{row['prepare']:.1f} s", f"{row['render']:.1f} s",
         f"{found['equal_time']:.1%}: {found['gain']:.1f} times" if kind != "paths" else ""]
        for name, found in results.items()
        for kind, row in found.items()
        if isinstance(row, dict)
    ]  # fmt: skip
    return f"`{COMMAND}`\n\n{markdown_table(head, body)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small pictures, to see that it runs; writes nothing")
    parser.add_argument("--only", choices=SCENES, help="measure one scene")
    arguments = parser.parse_args()
    resolution, reference, seeds = ((32, 24), 32, 2) if arguments.quick else (RESOLUTION, REFERENCE, SEEDS)
    results = {} if arguments.quick else saved(NAME)
    for name in SCENES:
        if arguments.only in (None, name):
            results[name] = measure(name, resolution, reference, seeds)
    if not arguments.quick:
        save(NAME, COMMAND, results)
        fill(DOCS / "single_pass.md", NAME, table(results))


if __name__ == "__main__":
    main()
