"""How the single pass grows: with translucent surface, with lights, in memory; and from where on it beats the two passes.

    python benchmarks/single_pass_scaling.py

writes docs/figures/single_pass_scaling.json and .png, point by point, and the tables of docs/single_pass.md between their marks.
Takes about six minutes on two cores; ``--only lights`` measures one curve and keeps what is saved of the others (``surface``,
``lights``, ``crossing``), ``--quick`` goes through the first two points of each on coarse scenes, and writes nothing.

Every point is measured in a process of its own, so that its peak of memory is its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.scenes.teapots.table import TABLE_SIZE
from support.equal_error import FINEST
from support.record import DOCS, FIGURES, fill, markdown_table, save, saved
from support.scenes import load, published
from support.single_pass import PUBLISHED, light_reference, samples_in_view, take_picture
from support.timing import run

COMMAND = "python benchmarks/single_pass_scaling.py"
NAME = "single_pass_scaling"
RESOLUTION = (320, 240)
TEAPOT = 173_671
"""Irradiance samples of the teapot at its default size; they grow with its square."""

Point = dict[str, Any]
CURVES: dict[str, list[Point]] = {
    "surface": [{"scene": "mezquita", "samples": n * 1e6, "lit": 16_384} for n in (1, 4, 16, 64)],
    "lights": [{"scene": "teapot_table", "lights": n, "lit": 16_384} for n in (400, 2000, 10_000, 100_000, 1_000_000)],
    "crossing": [
        {"scene": "teapot_table", "size": TABLE_SIZE * (n / TEAPOT) ** 0.5, "method": method}
        for n in (TEAPOT / 4, TEAPOT, 4 * TEAPOT, 16 * TEAPOT)
        for method in ("single_pass", "two_pass")
    ],
}
COARSE = {"mezquita": {"detail": 56, "bays": (4, 8)}, "teapot_table": {"detail": 6}}


# ------------------------------------------------------------------ one point, in a process of its own


def measure(point: Point) -> dict[str, Any]:
    """Render one picture, and tell what it took."""
    options = {
        k: tuple(v) if k == "bays" else v for k, v in point.items() if k in ("samples", "size", "bays", "detail")
    }
    lights = {}
    if "lights" in point:  # an eighth for the two emitters, which share it, the rest for what they light
        lights = {"direct": point["lights"] // 8, "indirect": point["lights"] * 7 // 8}
    method = ({"type": "pellucid_two_pass"} if point.get("method") == "two_pass" else PUBLISHED) | lights
    spec = published(point["scene"], resolution=point.get("resolution", RESOLUTION), integrator=method, **options)
    result = two_pass(spec) if point.get("method") == "two_pass" else single_pass(spec, point.get("lit", 0))
    return point | result | {"peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024}


def single_pass(spec: dict[str, Any], lit: int) -> dict[str, Any]:
    """Measure the adaptive mode; and the reference, scaled up from a few samples."""
    picture = take_picture(spec, 1)
    counts = picture.effort.counts
    result = {
        "samples": counts["samples"],
        "in_view": samples_in_view(picture.seen),
        "light_samples": counts["light samples"],
        "eye_points": sum(len(s) for s in picture.seen),
        "shadow_rays": counts["shadow rays"],
        "stages": picture.stages,
        "total": picture.seconds,
        "peak_bytes_before_reference": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }
    if lit:
        cost = light_reference(picture.scene, picture.state, picture.seen, FINEST, lit)
        result["reference"] = {"seconds": cost.seconds, "shadow_rays": cost.shadow_rays, "lit": cost.done}
    return result


def two_pass(spec: dict[str, Any]) -> dict[str, Any]:
    """Measure `pellucid_two_pass`, light paths and all, by kernels that a run with few samples has compiled."""
    scene = load(spec)
    few = mi.load_dict(spec["integrator"] | {"sample_count": 2000, "sampling": "poisson"})
    few.render(scene, spp=1)
    integrator = mi.load_dict(spec["integrator"])
    preparing, integrator.prepared = run_once(lambda: integrator.prepare_scene(scene))
    rendering = run(lambda: integrator.render(scene, spp=1))[0]
    samples = sum(len(lit.samples) for lit in integrator.prepared.bodies)
    return {"samples": samples, "stages": {"prepare": preparing, "picture": rendering}, "total": preparing + rendering}


def run_once(work: Any) -> tuple[float, Any]:
    """Time work whose result is no array."""
    kept: list[Any] = []
    seconds = run(lambda: kept.append(work()))[0]
    return seconds, kept[0]


# ------------------------------------------------------------------ results


def slope(x: list[float], y: list[float]) -> float:
    """Fit a power law: the slope in logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(x) > 1 else float("nan")


def column(points: list[Point], *keys: str) -> list[float]:
    """Collect a nested value of every point."""
    found = []
    for point in points:
        value: Any = point
        for key in keys:
            value = value[key]
        found.append(float(value))
    return found


def summary(curves: dict[str, list[Point]]) -> dict[str, Any]:
    """Fit slopes, memory a sample, and where the two methods take as long."""
    found: dict[str, Any] = {}
    for name, axis in (("surface", "samples"), ("lights", "light_samples")):
        points = curves.get(name, [])
        if len(points) > 1:
            x = column(points, axis)
            found[name] = {
                "time": slope(x, column(points, "stages", "exitance")),
                "shadow_rays": slope(x, column(points, "shadow_rays")),
                "reference_time": slope(x, column(points, "reference", "seconds")),
                "reference_shadow_rays": slope(x, column(points, "reference", "shadow_rays")),
            }
    points = curves.get("surface", [])
    if len(points) > 1:
        first, last = ((p["samples"], p["peak_bytes_before_reference"]) for p in (points[0], points[-1]))
        found["bytes_a_sample"] = (last[1] - first[1]) / (last[0] - first[0])
    found["crossing"] = crossing(curves.get("crossing", []))
    return found


def crossing(points: list[Point]) -> float | None:
    """Find the number of samples at which both methods take as long, between points or along their last power law."""
    ours, theirs = ([p for p in points if p["method"] == m] for m in ("single_pass", "two_pass"))
    n = min(len(ours), len(theirs))
    if n < 2:
        return None
    x = np.log(column(ours[:n], "samples"))
    gap = np.log(column(ours[:n], "total")) - np.log(column(theirs[:n], "total"))
    signs = np.flatnonzero(np.diff(np.sign(gap)) < 0)
    k = int(signs[0]) if len(signs) else n - 2
    if gap[k] <= gap[k + 1]:
        return None
    return float(np.exp(x[k] + (x[k + 1] - x[k]) * gap[k] / (gap[k] - gap[k + 1])))


def tables(curves: dict[str, list[Point]], fits: dict[str, Any]) -> None:
    """Put the curves into the page of the method."""
    document = DOCS / "single_pass.md"
    for name, axis in (("surface", "samples"), ("lights", "light_samples")):
        if points := curves.get(name):
            fill(document, f"scaling_{name}", growth_table(name, axis, points, fits))
    if points := curves.get("crossing"):
        fill(document, "scaling_crossing", crossing_table(points, fits))


def growth_table(name: str, axis: str, points: list[Point], fits: dict[str, Any]) -> str:
    """Lay out a curve of the adaptive mode, and the reference beside it."""
    head = [
        axis.replace("_", " "), "of visible bodies", "shadow rays", "exitance", "samples and lights", "whole picture", "peak memory",
        "reference: shadow rays", "irradiance",
    ]  # fmt: skip
    rows = [
        [f"{p[axis]:,}", f"{p['in_view']:,}", f"{p['shadow_rays'] / 1e6:.2f} M", f"{p['stages']['exitance']:.1f} s",
         f"{p['stages']['samples'] + p['stages']['lights']:.1f} s", f"{p['total']:.1f} s",
         f"{p['peak_bytes_before_reference'] / 2**30:.2f} GB", f"{p['reference']['shadow_rays'] / 1e6:,.1f} M",
         f"{p['reference']['seconds']:,.1f} s"]
        for p in points
    ]  # fmt: skip
    text = f"`{COMMAND}`\n\n{markdown_table(head, rows)}"
    if fit := fits.get(name):
        text += (
            f"\n\nPowers: time {fit['time']:.2f}, shadow rays {fit['shadow_rays']:.2f}; of the reference {fit['reference_time']:.2f} "
            f"and {fit['reference_shadow_rays']:.2f}."
        )
    if name == "surface" and "bytes_a_sample" in fits:
        text += f" Memory grows by {fits['bytes_a_sample']:.1f} bytes a sample of the scene, copies counted."
    return text


def crossing_table(points: list[Point], fits: dict[str, Any]) -> str:
    """Lay out the times of both methods."""
    pairs: dict[float, dict[str, Point]] = {}
    for p in points:
        pairs.setdefault(p["size"], {})[p["method"]] = p
    rows = [
        [f"{p['single_pass']['samples']:,}"]
        + [f"{p[m]['total']:.1f} s" for m in ("single_pass", "two_pass")]
        + [f"{p[m]['peak_bytes'] / 2**30:.2f} GB" for m in ("single_pass", "two_pass")]
        for p in pairs.values()
        if len(p) == 2
    ]
    head = ["irradiance samples", "`pellucid_single_pass`", "`pellucid_two_pass`", "memory: single pass", "two passes"]
    at = fits["crossing"]
    where = f"Both take as long at about {float(f'{at:.2g}'):,.0f} samples." if at else "The times do not cross."
    return f"`{COMMAND}`\n\n{markdown_table(head, rows)}\n\n{where}"


def plot(curves: dict[str, list[Point]]) -> None:
    """Draw time and shadow rays against surface and lights, and the times of both methods."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    for axis, name, x in ((axes[0], "surface", "samples"), (axes[1], "lights", "light_samples")):
        if points := curves.get(name):
            n = column(points, x)
            axis.loglog(
                n, column(points, "stages", "exitance"), "o-", color="tab:red", ms=4, label="adaptive, time [s]"
            )
            axis.loglog(
                n, column(points, "reference", "seconds"), "o-", color="tab:blue", ms=4, label="reference, time [s]"
            )
            axis.loglog(
                n, np.array(column(points, "shadow_rays")) / 1e6, "s--", color="tab:red", ms=3, label="rays [M]"
            )
            rays = np.array(column(points, "reference", "shadow_rays")) / 1e6
            axis.loglog(n, rays, "s--", color="tab:blue", ms=3, label="rays [M]")
            axis.legend(fontsize=7)
        axis.set(xlabel=x.replace("_", " "), title=name)
    for method, color in (("single_pass", "tab:red"), ("two_pass", "tab:green")):
        if points := [p for p in curves.get("crossing", []) if p["method"] == method]:
            axes[2].loglog(column(points, "samples"), column(points, "total"), "o-", color=color, ms=4, label=method)
    axes[2].set(xlabel="irradiance samples", ylabel="whole picture [s]", title="teapot on its table")
    axes[2].legend(fontsize=7)
    figure.savefig(FIGURES / f"{NAME}.png", dpi=110)
    plt.close(figure)


def in_process(point: Point) -> dict[str, Any] | None:
    """Measure a point in a process of its own; None where that fails, which is told."""
    command = [sys.executable, __file__, "--point", json.dumps(point)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        print(f"  failed: {point}", flush=True)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    parser.add_argument("--only", choices=list(CURVES), help="measure one curve, keep the others")
    parser.add_argument("--point", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.point:
        print(json.dumps(measure(json.loads(arguments.point))))
        return
    for name in [arguments.only] if arguments.only else CURVES:
        print(name, flush=True)
        found: list[Point] = []
        for point in CURVES[name][: 2 if arguments.quick else None]:
            if arguments.quick:
                point = coarse(point)
            result = in_process(point)
            if result is None:
                continue
            found.append(result)
            print(f"  {result}", flush=True)
            if not arguments.quick:
                curves = saved(NAME).get("curves", {}) | {name: found}
                fits = summary(curves)
                save(NAME, COMMAND, {"resolution": RESOLUTION, "curves": curves, "fits": fits})
                tables(curves, fits)
                plot(curves)
        if arguments.quick:
            print(f"  {summary({name: found})}", flush=True)


def coarse(point: Point) -> Point:
    """Make a point small."""
    small = {"resolution": (64, 48), "lit": min(point.get("lit", 0), 512), **COARSE[point["scene"]]}
    if "samples" in point:
        small["samples"] = point["samples"] / 100
    if point["scene"] == "teapot_table":
        small["size"] = point.get("size", TABLE_SIZE) / 5
    return point | small


if __name__ == "__main__":
    main()
