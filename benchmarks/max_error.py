"""What `max_error` costs and what it saves: the hierarchy against the sum over all samples, for five materials.

    python benchmarks/max_error.py

writes docs/figures/max_error.json and .png, and the tables of docs/benchmarks.md between their marks. Takes about four
minutes on two cores; ``--quick`` goes through the same steps in half a minute, and writes nothing.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.gather.gather import DEFAULT_MAX_ERROR, count_evaluations, gather_all
from pellucid.metrics import relative_rmse
from support.pixels import body_mask, see
from support.record import DOCS, FIGURES, fill, markdown_table, save
from support.scenes import load, teapot_spec
from support.timing import timed

COMMAND = "python benchmarks/max_error.py"
MATERIALS = ("marble", "skin1", "wholemilk", "cream", "ketchup")
MAX_ERRORS = (0.05, 0.1, 0.2, 0.4)
GOAL = 0.002
SPP = 4


def visible_points(scene: Any, lookup: Any, count: int) -> np.ndarray:
    """Find points of the teapot that the camera sees, in the order of the pixels: ``(count, 3) float``."""
    sensor = scene.sensors()[0]
    rows, columns = np.nonzero(body_mask(scene, sensor, lookup))
    chosen = np.sort(np.random.default_rng(0).permutation(len(rows))[:count])
    return see(scene, sensor, lookup, columns[chosen] + 0.5, rows[chosen] + 0.5)[0]


def measure(
    material: str, resolution: tuple[int, int], sample_count: int, point_count: int, repeats: int
) -> list[dict]:
    """Compare one material at every `max_error`, on the same samples under the same light."""
    scene = load(teapot_spec(resolution, material))
    prepared = pellucid.prepare(scene, "two_pass", sample_count=sample_count)
    integrator = prepared.integrator
    (lit,) = integrator.prepared.bodies
    octree, table, strictness = lit.state
    points = visible_points(scene, integrator.prepared.lookup, point_count)
    p = mi.Point3f(np.ascontiguousarray(points.T))
    method = mi.load_dict({"type": "pellucid_exact"}).method
    exact = np.stack([c.numpy() for c in gather_all(*method.build(lit)[:2], table, p)], axis=-1)
    rows = []
    for max_error in MAX_ERRORS:
        integrator.method = integrator.method.with_parameters(max_error=max_error)
        weighed, accepted, _ = count_evaluations(octree, table, p, max_error / strictness)
        timing = timed(lambda: integrator.render(scene, 0, 0, SPP), repeats)
        rows.append(
            {
                "material": material,
                "max_error": max_error,
                "rmse": relative_rmse(prepared.exitance(points), exact),
                "weighed": weighed / len(points),
                "accepted": accepted / len(points),
                "seconds": timing.median,
            }
        )
        row = rows[-1]
        print(
            f"{material:10} {max_error:6}  RMSE {row['rmse']:.4%}  {row['weighed']:7.0f} records visited per point"
            f"  {row['seconds']:.2f} s a picture",
            flush=True,
        )
    return rows


def tables(rows: list[dict]) -> None:
    """Put the errors, and what they cost, into the documentation."""
    errors = [
        [f"**{e:g}**" if e == DEFAULT_MAX_ERROR else f"{e:g}"]
        + [f"{r['rmse']:.3%}" for m in MATERIALS for r in rows if (r["material"], r["max_error"]) == (m, e)]
        + [f"{np.mean([r['weighed'] for r in rows if r['max_error'] == e]):.0f}"]
        + [f"{np.median([r['seconds'] for r in rows if r['max_error'] == e]):.2f} s"]
        for e in MAX_ERRORS
    ]
    head = ["max_error [sr]", *MATERIALS, "records visited per point", "picture"]
    fill(DOCS / "benchmarks.md", "max_error", f"`{COMMAND}`\n\n{markdown_table(head, errors)}")


def plot(rows: list[dict]) -> None:
    """Draw the error and the work against `max_error`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    for material in MATERIALS:
        mine = [r for r in rows if r["material"] == material]
        left.loglog([r["max_error"] for r in mine], [r["rmse"] for r in mine], "o-", ms=4, label=material)
        right.loglog([r["weighed"] for r in mine], [r["rmse"] for r in mine], "o-", ms=4)
    left.axhline(GOAL, color="0.7", lw=0.8)
    left.axvline(DEFAULT_MAX_ERROR, color="0.7", lw=0.8)
    left.set(xlabel="max_error [sr]", ylabel="RMSE / mean")
    right.set(xlabel="records visited per point", ylabel="RMSE / mean")
    left.legend()
    figure.savefig(FIGURES / "max_error.png", dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    mi.set_variant("llvm_ad_rgb")
    setup = ((192, 144), 20_000, 2000, 1) if quick else ((1024, 768), 150_000, 30_000, 3)
    rows = [row for material in MATERIALS[: 2 if quick else None] for row in measure(material, *setup)]
    worst = max(row["rmse"] for row in rows if row["max_error"] == DEFAULT_MAX_ERROR)
    print(f"worst RMSE at the default, {DEFAULT_MAX_ERROR} sr: {worst:.3%} (goal: below {GOAL:.1%})")
    if not quick:
        save("max_error", COMMAND, {"spp": SPP, "rows": rows})
        plot(rows)
        tables(rows)


if __name__ == "__main__":
    main()
