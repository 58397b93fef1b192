"""How evenly each method spreads surface samples, how much noise that leaves, and how long it takes.

    python benchmarks/sample_spread.py

writes docs/figures/sample_spread.json and .png, and the tables in docs/theory/samples.md between their marks.
Takes about three minutes on two cores; ``--quick`` spreads few, and writes nothing.

Noise is the relative error, in the root mean square over the surface, of a constant field summed from the samples with
a kernel: a Gaussian of three mean spacings (what is left at low frequencies), and the dipole of marble at the default
density of one sample in a disc of one mean free path. Each with equal areas A / n, and with the areas the samples get.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import pellucid  # noqa: F401 isort: skip  (points Dr.Jit at its LLVM, which has to come before mitsuba)

import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from support.record import DOCS, FIGURES, fill, markdown_table, median, save, seconds

COMMAND = "python benchmarks/sample_spread.py"
METHODS = ("relaxed", "repulsion", "poisson", "uniform", "random")
COUNT = 30_000
PLACES = 500
DENSE = 16
WIDTHS = (1.0, 1.5, 2.0, 3.0, 5.0)


def bodies() -> dict[str, mi.Shape]:
    """A sphere (not a mesh), a coarse torus and the teapot (meshes with smooth normals), a cube (sharp edges)."""
    import trimesh

    from pellucid.scene.meshes.buffers import mesh_from_arrays
    from pellucid.scenes.teapots.mesh import teapot_mesh

    torus = trimesh.creation.torus(2, 0.7, major_sections=60, minor_sections=30)
    teapot = teapot_mesh()
    return {
        "sphere": mi.load_dict({"type": "sphere"}),
        "torus": mesh_from_arrays("torus", torus.vertices, torus.faces, torus.vertex_normals),
        "cube": mi.load_dict({"type": "cube"}),
        "teapot": mesh_from_arrays("teapot", teapot.vertices, teapot.faces, teapot.normals),
    }


def points(sites) -> np.ndarray:
    return np.array(sites.p, dtype=np.float64).T


def spread(surface, method: str, count: int):
    """Spread samples by one of the methods, or independently of each other: positions and areas."""
    from pellucid.kernels.sequences import fibonacci_lattice
    from pellucid.scene.samples.areas import sample_areas
    from pellucid.scene.samples.surface import sample_surface

    if method != "random":
        samples = sample_surface(surface, count, method, seed=1)
        return samples.p.astype(np.float64), samples.area.astype(np.float64)
    pool = surface.draw(DENSE * count, 2, fibonacci_lattice)
    chosen = np.random.default_rng(1).choice(len(pool), count, replace=False)
    sites = pool.take(mi.UInt32(chosen.astype(np.uint32)))
    return points(sites), sample_areas(surface, sites, 3)


def kernel_sums(p: np.ndarray, weights: list[np.ndarray], places: np.ndarray, reach: float, kernel: Callable):
    """Sum weight times kernel(distance) over the points within reach of every place, for each set of weights."""
    tree = cKDTree(p)
    sums: list[list[np.ndarray]] = [[] for _ in weights]
    # A few places at a time: the pairs of all of them would fill the memory.
    for some in np.array_split(places, max(1, len(places) // 25)):
        pairs = cKDTree(some).sparse_distance_matrix(tree, reach, output_type="ndarray")
        values = kernel(pairs["v"])
        for total, w in zip(sums, weights, strict=True):
            total.append(np.bincount(pairs["i"], w[pairs["j"]] * values, minlength=len(some)))
    return [np.concatenate(total) for total in sums]


def marble(spacing: float) -> Callable:
    """Dipole of marble (blue), with the mean free path at which samples of this spacing are the default number."""
    from pellucid.model.medium import Medium

    medium = Medium.from_preset("marble")
    unit = medium.mfp[2] / (spacing / np.sqrt(np.pi))
    return lambda r: medium.diffuse_reflectance(r * unit)[..., 2]


def noise(p, weights, dense, dense_area, places, reach, kernel) -> list[float]:
    """Relative error of a constant field summed over samples, against the dense points, for each set of weights."""
    truth = kernel_sums(dense, [np.full(len(dense), dense_area)], places, reach, kernel)[0]
    return [float(np.sqrt(np.mean((s / truth - 1) ** 2))) for s in kernel_sums(p, weights, places, reach, kernel)]


def evenness(surface, method: str) -> dict:
    """Measure one method on one body."""
    from pellucid.kernels.sequences import fibonacci_lattice, independent_points

    p, area = spread(surface, method, COUNT)
    spacing = np.sqrt(surface.area / len(p))
    hexagonal = spacing * np.sqrt(2 / np.sqrt(3))
    nearest = cKDTree(p).query(p, k=2, workers=-1)[0][:, 1] / hexagonal
    dense = points(surface.draw(DENSE * COUNT, 4, fibonacci_lattice))
    fine = points(surface.draw(4 * DENSE * COUNT, 5, fibonacci_lattice))
    cells = np.bincount(cKDTree(p).query(fine, workers=-1)[1], minlength=len(p))
    places = points(surface.draw(PLACES, 6, independent_points))
    weights = [np.full(len(p), surface.area / len(p)), area]

    def gaussian(width: float) -> list[float]:
        sigma = width * spacing
        arguments = (dense, surface.area / len(dense), places, 4 * sigma, lambda r: np.exp(-0.5 * (r / sigma) ** 2))
        return noise(p, weights, *arguments)

    blurred = {width: gaussian(width) for width in WIDTHS}
    dipole = noise(p, weights, dense, surface.area / len(dense), places, 20 * spacing, marble(spacing))
    return {
        "samples": len(p),
        "nearest_min": float(nearest.min()),
        "nearest_mean": float(nearest.mean()),
        "area_variation": float(cells.std() / cells.mean()),
        "blur_equal": blurred[3.0][0],
        "blur_own": blurred[3.0][1],
        "dipole_equal": dipole[0],
        "dipole_own": dipole[1],
        "widths": {str(width): both for width, both in blurred.items()},
    }


def plot(results: dict, surface) -> None:
    """Draw the samples of each method on the teapot, and the noise against the width of the blur."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(METHODS) + 1, figsize=(20, 4.4), layout="constrained")
    for axis, method in zip(axes, METHODS, strict=False):
        p, area = spread(surface, method, COUNT)
        seen = (p[:, 1] < 0) & (np.abs(p[:, 0]) < 25) & (np.abs(p[:, 2] - 35) < 25)
        colour = area[seen] / area.mean()
        dots = axis.scatter(p[seen, 0], p[seen, 2], c=colour, s=5, cmap="coolwarm", vmin=0.4, vmax=1.6)
        axis.set(title=method, aspect="equal", xticks=[], yticks=[])
        widths = results["teapot"][method]["widths"]
        line = axes[-1].loglog(WIDTHS, [both[1] for both in widths.values()], label=method)[0]
        axes[-1].loglog(WIDTHS, [both[0] for both in widths.values()], "--", color=line.get_color())
    figure.colorbar(dots, ax=axes[-2], label="area / mean", shrink=0.8)
    axes[-1].set(title="teapot: noise", xlabel="width of the blur [mean spacings]", ylabel="relative error")
    axes[-1].plot([], [], "k--", label="equal areas")
    axes[-1].legend()
    figure.savefig(FIGURES / "sample_spread.png", dpi=110)


def tables(results: dict, times: dict) -> None:
    """Put both tables into the documentation."""
    document = DOCS / "theory" / "samples.md"
    head = ["body", "method", "nearest: least", "mean", "areas vary", "blur, A/n", "blur", "marble, A/n", "marble"]
    rows = [
        [body, method, f"{r['nearest_min']:.2f}", f"{r['nearest_mean']:.2f}", f"{r['area_variation']:.2f}"]
        + [f"{100 * r[key]:.2f} %" for key in ("blur_equal", "blur_own", "dipole_equal", "dipole_own")]
        for body, methods in results.items()
        for method, r in methods.items()
    ]
    fill(document, "evenness", f"`{COMMAND}`\n\n{markdown_table(head, rows)}")
    counts = sorted({int(count) for by_count in times.values() for count in by_count})
    rows = [[m, *(f"{by[str(c)]:.2f} s" if str(c) in by else "-" for c in counts)] for m, by in times.items()]
    fill(document, "times", f"`{COMMAND}`\n\n{markdown_table(['method', *(f'{c:,}' for c in counts)], rows)}")


def seconds_to_spread(surface, count: int, method: str) -> float:
    """Time one method, areas included; once only where it takes long, since all counts share the same kernels."""
    from pellucid.scene.samples.surface import sample_surface

    def work():
        sample_surface(surface, count, method, seed=1)

    if count <= 1_000_000:
        return median(seconds(work))
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few samples; writes nothing")
    quick = parser.parse_args().quick
    largest = 150_000 if quick else 10_000_000
    mi.set_variant("llvm_ad_rgb")
    from pellucid.scene.samples.surface import Surface

    surfaces = {name: Surface([(shape, None)]) for name, shape in list(bodies().items())[3 if quick else 0 :]}
    results = {name: {m: evenness(surface, m) for m in METHODS} for name, surface in surfaces.items()}
    teapot = surfaces["teapot"]
    counts = [count for count in (150_000, 1_000_000, 10_000_000) if count <= largest]
    times: dict[str, dict[str, float]] = {
        method: {str(count): seconds_to_spread(teapot, count, method) for count in counts if count <= most}
        for method, most in (("relaxed", largest), ("repulsion", 1_000_000), ("poisson", largest), ("uniform", largest))
    }
    if quick:
        return
    save("sample_spread", COMMAND, {"count": COUNT, "evenness": results, "seconds": times})
    plot(results, teapot)
    tables(results, times)


if __name__ == "__main__":
    main()
