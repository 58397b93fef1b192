"""The hierarchy in numbers: kernel evaluations a second, error against max_error, cost and memory against sample count.

    python benchmarks/gather_rate.py

writes docs/figures/gather_rate.json and .png, and the tables in docs/theory/tree.md between their marks. Takes about
two minutes on two cores; ``--quick`` ends with the tree of a hundred thousand samples, and writes nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM)

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip
import numpy as np  # isort: skip

mi.set_variant("llvm_ad_rgb")

from pellucid.gather.gather import DEFAULT_MAX_ERROR, count_evaluations, gather, gather_all  # noqa: E402
from pellucid.gather.octree import Octree, build_octree  # noqa: E402
from pellucid.gather.source import steepness  # noqa: E402
from pellucid.model.medium import Medium  # noqa: E402
from pellucid.model.profiles import ProfileTable  # noqa: E402

DOCS = Path(__file__).resolve().parents[1] / "docs"
MATERIALS = ("marble", "wholemilk", "skin1", "ketchup", "spectralon")
ERRORS = (0.4, 0.3, 0.2, 0.15, 0.1, 0.05)
SAMPLES = 150_000
POINTS = 1 << 20  # a picture 1024 wide, four points a pixel, of which the object covers a third
CORES = os.cpu_count() or 1
LIGHT = np.array([0.6, 0.5, 0.62]) / np.linalg.norm([0.6, 0.5, 0.62])
# Floating-point operations of one evaluation, a fused multiply-add for two; integers and gathers are not counted.
TREE_OPERATIONS, FLAT_OPERATIONS = 42, 32


def sphere(count: int, medium: Medium, natural: int = SAMPLES) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Spread samples on a sphere as large as ``natural`` samples of the medium ask for: p, area, power, radius [mm]."""
    total = natural * np.pi * medium.mfp.min() ** 2
    radius = np.sqrt(total / (4 * np.pi))
    rng = np.random.default_rng(0)
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * 2.399963229728653
    n = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    n += rng.normal(size=n.shape) * (0.9 / np.sqrt(count))
    n /= np.linalg.norm(n, axis=1)[:, None]
    area = np.full(count, total / count)
    power = (np.maximum(n @ LIGHT, 0) * area)[:, None] * [1.0, 0.9, 0.8]
    return radius * n, area, power, radius


def seen(radius: float, count: int) -> mi.Point3f:
    """About ``count`` points of the sphere in the order of the pixels of a picture, four a pixel."""
    side = int(np.sqrt(count / np.pi))
    y, x = np.mgrid[0:side, 0:side]
    inside = np.random.default_rng(1).random((side * side, 4, 2))
    xy = ((np.stack([x, y], -1).reshape(-1, 1, 2) + inside) / side * 2 - 1).reshape(-1, 2)
    xy = xy[(xy**2).sum(axis=1) < 0.9999]
    p = radius * np.column_stack([xy, np.sqrt(1 - (xy**2).sum(axis=1))])
    return mi.Point3f(np.ascontiguousarray(p.T, np.float32))


def seconds(work: Callable[[], object], repeats: int) -> np.ndarray:
    """Time some work, after one run that compiles it: rows of wall time and of processor time over all cores.

    Processor time does not count what other programs take meanwhile.
    """
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter(), time.process_time()
        dr.eval(work())
        dr.sync_thread()
        times.append((time.perf_counter() - begin[0], (time.process_time() - begin[1]) / CORES))
    return np.array(times[1:])


def arithmetic_limit(repeats: int) -> float:
    """Measure the floating-point operations a second of all cores: fused multiply-adds in registers."""
    Float, UInt, chains, rounds = dr.llvm.Float, dr.llvm.UInt32, 16, 20_000
    factor, summand, end = dr.opaque(Float, 0.999), dr.opaque(Float, 0.001), dr.opaque(UInt, rounds)
    lanes = 1 << 15

    def work() -> object:
        start = [dr.arange(Float, lanes) + k for k in range(chains)]

        def body(i, x):
            return i + 1, [dr.fma(dr.fma(v, factor, summand), factor, summand) for v in x]

        return dr.while_loop((UInt(0), start), lambda i, x: i < end, body)[1]

    return 4 * chains * rounds * lanes / seconds(work, repeats)[:, 1].min()


def color(values: tuple) -> np.ndarray:
    return np.stack([v.numpy() for v in values], axis=1).astype(np.float64)


def measure_rate(repeats: int) -> dict:
    """Time the sums over tree and list, interleaved, and count what they weigh."""
    medium = Medium.from_preset("marble")
    table = ProfileTable.from_medium(medium)
    p, area, power, radius = sphere(SAMPLES, medium)
    tree = build_octree(p, area, power)
    points, few = seen(radius, POINTS), seen(radius, POINTS // 32)
    count, short = dr.width(points), 8192
    weighed, accepted, stops = count_evaluations(tree, table, points, DEFAULT_MAX_ERROR)
    tree_times, list_times, limits = [], [], []
    for _ in range(repeats):
        tree_times.append(seconds(lambda: gather(tree, table, points), 1)[0])
        list_times.append(seconds(lambda: gather_all(p[:short], power[:short], table, few), 1)[0])
        limits.append(arithmetic_limit(1))
    wall, processor = np.min(tree_times, axis=0)
    rate, list_rate = weighed / processor, short * dr.width(few) / np.min(list_times, axis=0)[1]
    return {
        "samples": SAMPLES,
        "points": count,
        "max_error": DEFAULT_MAX_ERROR,
        "seconds": wall,
        "processor_seconds": processor,
        "weighed_per_point": weighed / count,
        "accepted_per_point": accepted / count,
        "lane_efficiency": weighed / (8 * stops),
        "evaluations_per_second": rate,
        "evaluations_per_second_list": list_rate,
        "arithmetic_limit": max(limits),
        "share_tree": rate * TREE_OPERATIONS / max(limits),
        "share_list": list_rate * FLAT_OPERATIONS / max(limits),
    }


def errors_of(tree: Octree, table: ProfileTable, points: mi.Point3f) -> list[dict]:
    """Compare with the sum over all samples: root mean square over the mean, all channels together."""
    exact = color(gather(tree, table, points, 0))
    rows = []
    for max_error in ERRORS:
        off = color(gather(tree, table, points, max_error)) - exact
        weighed = count_evaluations(tree, table, points, max_error)[0]
        rmse = float(np.sqrt((off**2).mean()) / exact.mean())
        rows.append({"max_error": max_error, "rmse": rmse, "weighed": weighed / dr.width(points)})
    return rows


def measure_errors() -> list[dict]:
    """Measure the error over the lit half of a sphere, and on the dark side of a slab, in five materials."""
    results = []
    for name in MATERIALS:
        medium = Medium.from_preset(name)
        table = ProfileTable.from_medium(medium)
        p, area, power, radius = sphere(SAMPLES, medium)
        row = {"material": name, "psi": steepness(table)[0]}
        row["sphere"] = errors_of(build_octree(p, area, power), table, seen(radius, 4000))
        side, spacing = 387, np.sqrt(np.pi) * medium.mfp.min()
        rng = np.random.default_rng(2)
        corner = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)
        p = np.column_stack([corner + rng.random((side**2, 2)), np.zeros(side**2)]) * spacing
        area = np.full(len(p), spacing**2)
        tree = build_octree(p, area, np.repeat(area[:, None], 3, axis=1))
        for depth in (3, 10):
            q = np.column_stack([rng.random((2000, 2)) * side * spacing, np.full(2000, depth * medium.mfp.min())])
            row[f"slab {depth}"] = errors_of(tree, table, mi.Point3f(np.ascontiguousarray(q.T, np.float32)))
        results.append(row)
        print(name, {k: [f"{100 * e['rmse']:.3f}" for e in v] for k, v in row.items() if isinstance(v, list)})
    return results


def measure_scaling(largest: int, repeats: int) -> list[dict]:
    """Put more and more samples on the same sphere."""
    medium = Medium.from_preset("marble")
    table = ProfileTable.from_medium(medium)
    rows = []
    for count in [int(c) for c in (1e4, 3e4, 1e5, 3e5, 1e6, 3e6, 1e7) if c <= largest]:
        p, area, power, radius = sphere(count, medium)
        p, area, power = (a.astype(np.float32) for a in (p, area, power))
        begin = time.perf_counter()
        tree = build_octree(p, area, power)
        built = time.perf_counter()
        tree.records(DEFAULT_MAX_ERROR)
        laid_out = time.perf_counter()
        points = seen(radius, POINTS)
        gathered = seconds(lambda tree=tree, points=points: gather(tree, table, points), repeats)[:, 1].min()
        weighed = count_evaluations(tree, table, points, DEFAULT_MAX_ERROR)[0]
        rows.append(
            {
                "samples": count,
                "build_seconds": built - begin,
                "records_seconds": laid_out - built,
                "bytes_per_sample": tree.nbytes / count,
                "voxels_per_sample": tree.voxel_count / count,
                "weighed_per_point": weighed / dr.width(points),
                "microseconds_per_point": gathered / dr.width(points) * 1e6,
            }
        )
        print({k: float(f"{v:.4g}") for k, v in rows[-1].items()})
    return rows


def plot(result: dict, path: Path) -> None:
    """Draw cost and memory against samples, and error against max_error."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (cost, memory, error) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    rows = result["scaling"]
    n = [r["samples"] for r in rows]
    cost.semilogx(n, [r["microseconds_per_point"] for r in rows], "o-", label="time [µs]")
    cost.semilogx(n, [r["weighed_per_point"] / 1000 for r in rows], "s-", label="records visited [1000]")
    cost.set(xlabel="samples", title=f"A shading point at max_error {DEFAULT_MAX_ERROR}", ylim=(0, None))
    cost.legend()
    memory.semilogx(n, [r["bytes_per_sample"] for r in rows], "o-", label="bytes a sample")
    memory.axhline(100, color="0.7", zorder=0)
    memory.semilogx(n, [1e6 * (r["build_seconds"] + r["records_seconds"]) / r["samples"] for r in rows], "s-")
    memory.lines[-1].set_label("µs to build, a sample")
    memory.set(xlabel="samples", title="The tree", ylim=(0, 110))
    memory.legend()
    for row in result["errors"]:
        line = error.loglog(ERRORS, [100 * e["rmse"] for e in row["sphere"]], "o-", label=row["material"])[0]
        error.loglog(ERRORS, [100 * e["rmse"] for e in row["slab 10"]], ":", color=line.get_color())
    error.axhline(0.2, color="0.7", zorder=0)
    error.set(xlabel="max_error [sr]", title="RMSE [% of mean]; dotted: behind 10 mfp")
    error.set_xticks(ERRORS, [str(e) for e in ERRORS])
    error.minorticks_off()
    error.legend()
    figure.savefig(path, dpi=110)


def tables(result: dict) -> dict[str, str]:
    """Write the results as Markdown."""
    rate = result["rate"]
    lines = [
        "| | tree | list |",
        "| --- | --- | --- |",
        f"| evaluations a second | {rate['evaluations_per_second']:.3g} | {rate['evaluations_per_second_list']:.3g} |",
        f"| share of the arithmetic limit ({rate['arithmetic_limit'] / 1e9:.0f} GFLOP/s measured) "
        f"| {rate['share_tree']:.0%} | {rate['share_list']:.0%} |",
        f"| {rate['points']:,} points, {rate['samples']:,} samples, max_error {rate['max_error']} "
        f"| {rate['processor_seconds']:.2f} s | |",
        f"| records visited, accepted per point | {rate['weighed_per_point']:.0f}, {rate['accepted_per_point']:.0f} "
        f"| {rate['samples']:,} |",
        f"| places of a lane in use | {rate['lane_efficiency']:.0%} | 100% |",
    ]
    texts = {"rate": "\n".join(lines)}
    lines = [f"| material | where | {' | '.join(str(e) for e in ERRORS)} |", "| --- " * (len(ERRORS) + 2) + "|"]
    for row in result["errors"]:
        for where, name in (("sphere", "sphere"), ("slab 3", "behind 3 mfp"), ("slab 10", "behind 10 mfp")):
            cells = " | ".join(f"{100 * e['rmse']:.3f}" for e in row[where])
            lines.append(f"| {row['material']} | {name} | {cells} |")
    weighed = " | ".join(f"{e['weighed']:.0f}" for e in result["errors"][0]["sphere"])
    lines.append(f"| records visited | sphere | {weighed} |")
    texts["errors"] = "\n".join(lines)
    lines = [
        "| samples | build [s] | records [s] | bytes a sample | records visited | time per point [µs] |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for r in result["scaling"]:
        lines.append(
            f"| {r['samples']:,} | {r['build_seconds']:.2f} | {r['records_seconds']:.2f} | {r['bytes_per_sample']:.1f} "
            f"| {r['weighed_per_point']:.0f} | {r['microseconds_per_point']:.2f} |"
        )
    texts["scaling"] = "\n".join(lines)
    return texts


def insert(path: Path, texts: dict[str, str]) -> None:
    """Replace what stands between ``<!-- name -->`` and ``<!-- end -->``."""
    page = path.read_text()
    for name, text in texts.items():
        before, rest = page.split(f"<!-- {name} -->\n", 1)
        after = rest.split("<!-- end -->", 1)[1]
        page = f"{before}<!-- {name} -->\n{text}\n<!-- end -->{after}"
    path.write_text(page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small trees, once; writes nothing")
    quick = parser.parse_args().quick
    largest, repeats = (100_000, 1) if quick else (10_000_000, 5)
    result = {"rate": measure_rate(repeats)}
    print(json.dumps(result["rate"], indent=1))
    result["errors"] = measure_errors()
    result["scaling"] = measure_scaling(largest, repeats)
    if quick:
        return
    figures = DOCS / "figures"
    (figures / "gather_rate.json").write_text(json.dumps(result, indent=1) + "\n")
    plot(result, figures / "gather_rate.png")
    insert(DOCS / "theory" / "tree.md", tables(result))


if __name__ == "__main__":
    main()
