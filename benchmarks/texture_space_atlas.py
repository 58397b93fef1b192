"""Figure 12 of Chang et al. 2008: an atlas that keeps areas against one that does not, on a head with horns.

    python benchmarks/texture_space_atlas.py

writes docs/figures/texture_space_atlas.json, a picture of the gallery, and the table of docs/benchmarks.md between its
marks. Takes a minute on two cores; ``--quick`` goes through the same steps small, and writes nothing.

The other atlas is Floater's: the mesh, cut open where its neck is flat, has its boundary laid along a circle and
every other vertex on a mean of its neighbours.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from pellucid.methods import register_method
from pellucid.methods.texture_space.drawing import CoveredTexels
from pellucid.methods.texture_space.integrator import TextureSpace, TextureState
from pellucid.model.medium import Medium
from pellucid.scene.atlas.layout import build_atlas
from pellucid.scene.atlas.texels import rasterise
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scenes.builtin import build
from pellucid.scenes.models.scene import SHAPES, shape_mesh
from support.images import save_rows
from support.realtime import camera_of, halved, on_screen, reference, say, see_pixels, tone_errors
from support.record import DOCS, fill, markdown_table, save
from support.scenes import load

COMMAND = "python benchmarks/texture_space_atlas.py"
NAME = "texture_space_atlas"
CASES = {
    "horned_head": ("marble", (0.0, 0.87, -0.49), 16.0),
    "antique_head": ("skin1", (0.0, -0.2, -1.0), 14.0),
}
"""Material, the direction in which the neck ends, and how far from there it is cut off [mm of the unscaled shape]."""

SIZE, COUNT, CAP = 10.0, 2500, 0.08
RESOLUTION = 1024


class KeptAtlas(TextureSpace):
    """Takes any bijection for an atlas, however it stretches."""

    name = "kept_atlas"

    def spread(self, lit: Any) -> None:
        """Make texels of the texture coordinates of the mesh."""
        atlas = build_atlas(lit.body, self.resolution, stretch=np.inf)
        texels = rasterise(atlas)
        lit.state = TextureState(CoveredTexels(texels), atlas.surface.extent)
        lit.samples = texels.samples


register_method("kept_atlas", f"{__name__}:KeptAtlas")


# ------------------------------------------------------------------ Floater's parameterisation


def cap_of(vertices: np.ndarray, faces: np.ndarray, direction: tuple, depth: float) -> np.ndarray:
    """Find the end of a neck: the connected patch of faces that are furthest in a direction, ``(m,) bool``."""
    along = vertices @ np.asarray(direction) / np.linalg.norm(direction)
    end = np.flatnonzero(along[faces].mean(axis=1) > along.max() - depth)
    n = len(vertices)
    touches = csr_matrix(
        (np.ones(3 * len(end)), (np.repeat(np.arange(len(end)), 3), faces[end].ravel())), (len(end), n)
    )
    _, piece = connected_components(touches @ touches.T, directed=False)
    chosen = np.zeros(len(faces), bool)
    chosen[end[piece == np.bincount(piece).argmax()]] = True
    return chosen


def boundary_of(faces: np.ndarray) -> np.ndarray:
    """Walk along the only boundary of a patch: ``(b,) int``.

    Raises
    ------
    ValueError
        When the patch is no disk.
    """
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {tuple(edge) for edge in half.tolist()}
    following = {a: b for a, b in there if (b, a) not in there}
    used = len(np.unique(faces))
    edges = len({tuple(sorted(edge)) for edge in there})
    loop = [next(iter(following))]
    while following[loop[-1]] != loop[0] and len(loop) <= len(following):
        loop.append(following[loop[-1]])
    if len(loop) != len(following) or used - edges + len(faces) != 1:
        raise ValueError(f"The patch is no disk: Euler number {used - edges + len(faces)}, cut it elsewhere.")
    return np.array(loop)


def around_a_circle(points: np.ndarray) -> np.ndarray:
    """Lay a loop of points along a circle of diameter 1 in the unit square, by its length."""
    length = np.linalg.norm(np.roll(points, -1, 0) - points, axis=1)
    angle = 2 * np.pi * (np.cumsum(length) - length) / length.sum()
    return 0.5 + 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)


def floater(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Lay a disk out in a circle by mean value coordinates: ``(n, 2)``, for the vertices that it uses.

    Source: M. Floater, *Mean value coordinates*, CAGD 2003; the convex combinations are those of Flo97.
    """
    loop = boundary_of(faces)
    n = len(vertices)
    rows, columns, weights = [], [], []
    for k in range(3):
        i, j, other = faces[:, k], faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = vertices[j] - vertices[i], vertices[other] - vertices[i]
        lu, lv = np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1)
        half = np.tan(0.5 * np.arccos(np.clip((u * v).sum(1) / (lu * lv), -1, 1)))
        rows += [i, i]
        columns += [j, other]
        weights += [half / lu, half / lv]
    matrix = csr_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (n, n))
    inner = np.setdiff1d(np.unique(faces), loop)
    uv = np.zeros((n, 2))
    uv[loop] = around_a_circle(vertices[loop])
    total = np.asarray(matrix.sum(1)).ravel()
    system = csr_matrix((total[inner], (np.arange(len(inner)),) * 2)) - matrix[inner][:, inner]
    uv[inner] = spsolve(system.tocsc(), matrix[inner][:, loop] @ uv[loop])
    return uv


def laid_out(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Mesh a model whose texture coordinates are Floater's: vertices, normals, faces, uv."""
    vertices, normals, faces = shape_mesh(SHAPES[name])
    cap = cap_of(vertices, faces, *CASES[name][1:])
    parts, scale = [faces[~cap], faces[cap]], [1 - CAP, CAP]
    source, joined, uv = [], [], []
    for part, size, place in zip(parts, scale, (0.0, 1 - CAP), strict=True):
        used, local = np.unique(part, return_inverse=True)
        joined.append(local.reshape(-1, 3) + sum(map(len, source)))
        source.append(used)
        uv.append(place + size * floater(vertices[used], local.reshape(-1, 3)))
    chosen = np.concatenate(source)
    return vertices[chosen], normals[chosen], np.concatenate(joined), np.concatenate(uv)


# ------------------------------------------------------------------ both atlases


def measure(name: str, side: int, samples: int) -> tuple[dict[str, Any], list[tuple[str, np.ndarray]]]:
    """Compare both atlases on one model."""
    material = CASES[name][0]
    bsdf = {"type": "pellucid_translucent", "material": material, "alpha": 0.0}
    spec = build(name, bsdf=bsdf, size=SIZE, resolution=(side, side))
    scene = load(spec)
    camera = camera_of(scene)
    seen = see_pixels(scene, camera, (side, side), Medium.from_preset(material).eta)
    exact = reference(scene, seen, "exact", sample_count=samples)
    vertices, normals, faces, uv = laid_out(name)
    low, high = vertices.min(0), vertices.max(0)
    placed = (vertices - (low + high) / 2) * (SIZE / (high - low).max())
    stretched = load(spec | {name: mesh_from_arrays(name, placed, faces, normals, uv, bsdf)})
    settings = {"sample_count": COUNT, "resolution": RESOLUTION, "point_samples": True}
    row: dict[str, Any] = {"model": name, "material": material}
    shown = []
    for title, method, place in (("Floater", "kept_atlas", stretched), ("area-preserving", "texture_space", scene)):
        found = reference(place, seen, method, **settings)
        prepared = pellucid.prepare(place, method, irradiance_depth=2, **settings)
        area = prepared.integrator.prepared.bodies[0].samples.area
        largest = float(np.percentile(area, 99.9) / np.median(area))
        row[title] = tone_errors(found.picture, exact, seen.mask) | {"texels": len(area), "largest": largest}
        shown.append((f"{title}, RMSE {row[title]['image']:.4f}", on_screen(found.picture, exact.average)))
        say(f"{name}, {title}: {row[title]}")
    shown.append(("exact", on_screen(exact.picture, exact.average)))
    return row, shown


def table(rows: list[dict[str, Any]]) -> None:
    """Put figure 12 into the documentation."""
    head = [
        "model",
        "material",
        "atlas",
        "RMSE",
        "covered pixels",
        "texels",
        "area of a texel, 99.9th percentile over median",
    ]
    lines = [
        [row["model"], row["material"], title, f"**{row[title]['image']:.4f}**", f"{row[title]['covered']:.4f}",
         f"{row[title]['texels']:,}", f"{row[title]['largest']:.1f}"]
        for row in rows for title in ("Floater", "area-preserving")
    ]  # fmt: skip
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, lines)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    quick = parser.parse_args().quick
    rows, pictures = [], []
    for name in CASES:
        row, shown = measure(name, *((96, 4000) if quick else (512, 40_000)))
        rows.append(row)
        pictures.append([(caption, halved(p)) for caption, p in shown])
    if not quick:
        save(NAME, COMMAND, {"size": SIZE, "samples": COUNT, "resolution": RESOLUTION, "rows": rows})
        table(rows)
        save_rows(DOCS / "gallery" / "texture_space_figure12.png", pictures)


if __name__ == "__main__":
    main()
