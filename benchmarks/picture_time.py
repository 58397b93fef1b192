"""What a picture costs: translucent beside opaque, more samples a pixel beside few, and the methods beside each other.

    python benchmarks/picture_time.py

writes docs/figures/picture_time.json and two tables of docs/benchmarks.md between their marks. Takes about five minutes on two cores;
``--quick`` is small and rough, and writes nothing.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.cli.reporter import StageClock
from pellucid.metrics import relative_rmse
from pellucid.model.medium import Medium
from pellucid.progress import reporting_to
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scenes.builtin import build
from pellucid.scenes.models.scene import SHAPES, shape_mesh
from support.pixels import covered_pixels
from support.record import DOCS, fill, markdown_table, median, save
from support.scenes import load, teapot_spec
from support.timing import Timing, interleaved

COMMAND = "python benchmarks/picture_time.py"
SPP = (4, 16)
DEPTH = 6
METHODS = ("two_pass", "texture_space", "single_pass")
MODEL, FINE, SIZE = "antique_head", SHAPES["antique_head"]._replace(edge=1.25, triangles=82_000), 10.0
MANY, PATHS, PIXELS = 600_000, 256, 2000
"""Samples, light paths of each and pixels of the reference."""


# ------------------------------------------------------------------ translucent and opaque


def teapots(resolution: tuple[int, int], repeats: int) -> list[dict[str, Any]]:
    """Time the second pass against Mitsuba's path tracer with a diffuse teapot of the same colour, by samples a pixel."""
    colour = Medium.from_preset("marble").total_diffuse_reflectance.tolist()
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}
    opaque = load(teapot_spec(resolution, box_filter=False, bsdf=bsdf))
    translucent = load(teapot_spec(resolution, box_filter=False))
    path = mi.load_dict({"type": "path", "max_depth": DEPTH})
    integrator = mi.load_dict({"type": "pellucid_two_pass", "max_depth": DEPTH, "irradiance_depth": DEPTH})
    integrator.prepared = integrator.prepare_scene(translucent)
    rows = []
    for spp in SPP:
        exitance: list[float] = []

        def picture(spp: int = spp, exitance: list[float] = exitance) -> Any:
            clock = StageClock()
            with reporting_to(clock):
                result = integrator.render(translucent, 0, 0, spp)
            exitance.append(clock.times["exitance"])
            return result

        times = interleaved({"two_pass": picture, "path": lambda spp=spp: path.render(opaque, 0, 0, spp)}, repeats)
        seconds = {name: timing.median for name, timing in times.items()}
        rows.append({"spp": spp, "seconds": seconds, "exitance": median(exitance[1:])})
        print(rows[-1], flush=True)
    return rows


# ------------------------------------------------------------------ the methods on one body


def head(resolution: tuple[int, int], triangles: int) -> Any:
    """Load a head of so many triangles, as the built-in one is seen and lit."""
    spec = build(MODEL, resolution=resolution, size=SIZE)
    vertices, normals, faces = shape_mesh(FINE._replace(triangles=triangles))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    placed = (vertices - (low + high) / 2) * (SIZE / (high - low).max())
    bsdf = {"type": "pellucid_translucent", "material": "marble", "alpha": 0.3}
    spec[MODEL] = mesh_from_arrays(MODEL, placed, faces, normals, bsdf=bsdf)
    return load(spec)


def methods(scene: Any, repeats: int, many: int, pixels: int) -> dict[str, dict[str, float]]:
    """Time whole pictures by each method, preparation included, and compare the exitance with that of many samples."""
    exact = pellucid.prepare(scene, "exact", sample_count=many, irradiance_paths=PATHS)
    lookup = exact.integrator.prepared.lookup
    rows, columns, points = covered_pixels(scene, scene.sensors()[0], lookup, pixels)
    reference = exact.exitance(points.reshape(-1, 3)).reshape(points.shape).mean(axis=1)
    settings = {"max_depth": DEPTH, "aovs": "exitance"}
    works = {name: mi.load_dict({"type": f"pellucid_{name}", **settings}) for name in METHODS}
    times: dict[str, Timing] = interleaved(
        {name: lambda work=work: work.render(scene, 0, 0, SPP[0]) for name, work in works.items()}, repeats
    )
    found = {}
    for name, timing in times.items():
        error = relative_rmse(np.array(timing.result)[rows, columns, 3:6], reference)
        found[name] = {"seconds": timing.median, "error": error}
        print(name, found[name], flush=True)
    return found


# ------------------------------------------------------------------ results


def as_tables(results: dict[str, Any]) -> tuple[str, str]:
    """Write the tables of both."""
    rows = []
    first = results["teapots"][0]
    for row in results["teapots"]:
        two_pass, path = row["seconds"]["two_pass"], row["seconds"]["path"]
        share = f"{row['exitance']:.2f} s, {row['exitance'] / first['exitance']:.2f} times"
        rows.append([row["spp"], f"{two_pass:.2f} s", f"{path:.2f} s", f"**{two_pass / path:.2f}**", share])
    names = ["samples a pixel", "`pellucid_two_pass`, marble", "`path`, diffuse", "ratio", "of it exitance"]
    base = results["methods"][METHODS[0]]["seconds"]
    lines = [
        [f"`pellucid_{name}`", f"{row['seconds']:.2f} s", f"**{row['seconds'] / base:.2f}**", f"{row['error']:.1%}"]
        for name, row in results["methods"].items()
    ]
    heads = ["method", "whole picture", "of two_pass", "RMSE / mean of the exitance"]
    return tuple(f"`{COMMAND}`\n\n{table}" for table in (markdown_table(names, rows), markdown_table(heads, lines)))


def main() -> None:
    """Measure, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    mi.set_variant("llvm_ad_rgb")
    wide, square, repeats = ((96, 72), (64, 64), 1) if quick else ((1024, 768), (512, 512), 5)
    scene = head(square, 4_000 if quick else FINE.triangles)
    found = methods(scene, repeats, *((20_000, 50) if quick else (MANY, PIXELS)))
    results = {"teapots": teapots(wide, repeats), "methods": found}
    beside_opaque, beside_each_other = as_tables(results)
    print(beside_opaque, beside_each_other, sep="\n\n")
    if quick:
        return
    save("picture_time", COMMAND, results)
    fill(DOCS / "benchmarks.md", "opaque", beside_opaque)
    fill(DOCS / "benchmarks.md", "methods", beside_each_other)


if __name__ == "__main__":
    main()
