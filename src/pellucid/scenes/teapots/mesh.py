"""The Utah teapot as one closed solid: Newell's Bezier patches, tessellated and joined."""

from __future__ import annotations

from typing import NamedTuple

import manifold3d
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Control points by Martin Newell (1975), with the squashed height Jim Blinn gave it and the bottom added later; z is up.
#
# Lid, rim, body and bottom are bodies of revolution: 28 patches share one profile, given here as (radius, height) from
# the middle of the bottom, up the outside, over the rim and up the lid to the top of its knob. A quarter of a ring is a
# cubic whose inner control points lie 0.56 of the radius off the axes.
RING = 0.56
# The published knob is the one exception: 0.45 where 0.56 of its radius would be 0.448.
KNOB_RADIUS, KNOB_RING = 0.8, 0.45
BOTTOM = ((0.0, 0.0), (1.425, 0.0), (1.5, 0.075), (1.5, 0.15))
LOWER_BODY = ((1.5, 0.15), (1.5, 0.225), (2.0, 0.45), (2.0, 0.9))
UPPER_BODY = ((2.0, 0.9), (2.0, 1.35), (1.75, 1.875), (1.5, 2.4))
RIM = ((1.5, 2.4), (1.4375, 2.53125), (1.3375, 2.53125), (1.4, 2.4))
LID = ((1.3, 2.4), (1.3, 2.55), (0.4, 2.55), (0.2, 2.7))
KNOB = ((0.2, 2.7), (0.0, 2.85), (0.8, 3.15), (0.0, 3.15))
PROFILE = (BOTTOM, LOWER_BODY, UPPER_BODY, RIM, LID, KNOB)

# Handle and spout mirror themselves in the plane y = 0, two patches long. A row (x0, z0, x1, z1, half width) is a half
# ring of the tube: from (x0, 0, z0) over (x0, -w, z0) and (x1, -w, z1) to (x1, 0, z1).
HANDLE = (
    (-1.6, 2.025, -1.5, 2.25, 0.3),
    (-2.3, 2.025, -2.5, 2.25, 0.3),
    (-2.7, 2.025, -3.0, 2.25, 0.3),
    (-2.7, 1.8, -3.0, 1.8, 0.3),
    (-2.7, 1.575, -3.0, 1.35, 0.3),
    (-2.5, 1.125, -2.65, 0.9375, 0.3),
    (-2.0, 0.9, -1.9, 0.6, 0.3),
)
SPOUT = (
    (1.7, 1.425, 1.7, 0.6, 0.66),
    (2.6, 1.425, 3.1, 0.825, 0.66),
    (2.3, 2.1, 2.4, 2.025, 0.25),
    (2.7, 2.4, 3.3, 2.4, 0.25),
    (2.8, 2.475, 3.525, 2.49375, 0.25),
    (2.9, 2.475, 3.45, 2.5125, 0.15),
    (2.8, 2.4, 3.2, 2.4, 0.15),
)

# How far the open ends are pushed into the wall of the body, (x, y, z) at the first and last ring, so that the solids overlap.
HANDLE_REACH = ((0.4, 0.0, 0.0), (0.4, 0.0, -0.1))
SPOUT_REACH = ((-0.3, 0.0, 0.0), (0.0, 0.0, 0.0))

# 150,000 samples of marble, whose shortest mean free path is 0.333 mm, as in figure 3 of JB02.
DEFAULT_SIZE = 203.0


class TriangleMesh(NamedTuple):
    """A closed triangle mesh with smooth normals; vertices repeat where two smooth surfaces meet in a crease."""

    vertices: Array
    normals: Array
    faces: NDArray[np.int64]


def _bernstein(t: Array) -> tuple[Array, Array]:
    """Cubic Bernstein polynomials and their derivatives at ``t``: two arrays (n, 4)."""
    s = 1 - t
    value = np.stack([s**3, 3 * t * s**2, 3 * t**2 * s, t**3], -1)
    slope = np.stack([-3 * s**2, 3 * s**2 - 6 * t * s, 6 * t * s - 3 * t**2, 3 * t**2], -1)
    return value, slope


def revolution_patches(curve: tuple[tuple[float, float], ...]) -> Array:
    """Control points (4, 4, 4, 3) of the four patches of a ring: patch, row along the curve, column around the axis."""
    rows = []
    for radius, height in curve:
        off = KNOB_RING if radius == KNOB_RADIUS else RING * radius
        rows.append([(radius, 0, height), (radius, off, height), (off, radius, height), (0, radius, height)])
    quarter = np.array(rows, float)
    turns = [np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], float) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    return np.stack([quarter @ turn.T for turn in turns])


def tube_patches(rows: tuple[tuple[float, ...], ...]) -> Array:
    """Control points (2, 2, 4, 4, 3) of a tube: segment along, half around, row, column."""
    half = np.array([[(x0, 0, z0), (x0, -w, z0), (x1, -w, z1), (x1, 0, z1)] for x0, z0, x1, z1, w in rows])
    other = half[:, ::-1] * (1, -1, 1)
    both = np.stack([half, other])
    return np.stack([both[:, :4], both[:, 3:]])


def patches() -> Array:
    """All 32 published patches, (32, 4, 4, 3) in Newell's units."""
    rings = [revolution_patches(curve) for curve in PROFILE]
    tubes = [tube_patches(rows).reshape(4, 4, 4, 3) for rows in (HANDLE, SPOUT)]
    return np.concatenate(rings + tubes)


def _evaluate(control: Array, resolution: int) -> Array:
    """Positions and unit normals (resolution + 1, k * resolution, 6) of ``k`` patches (k, 4, 4, 3) that close a ring."""
    u, du = _bernstein(np.arange(resolution) / resolution)
    v, dv = _bernstein(np.linspace(0, 1, resolution + 1))
    points, across, onward = (
        np.einsum("ri,kijc,aj->rkac", row, control, column).reshape(resolution + 1, -1, 3)
        for row, column in ((v, u), (v, du), (dv, u))
    )
    normals = np.cross(across, onward)
    # At a pole the ring has no extent and the product vanishes: the ring beside it is symmetric about the answer.
    for row, beside in ((0, 1), (-1, -2)):
        if np.abs(across[row]).max() < 1e-12:
            normals[row] = normals[beside].mean(0)
    return np.concatenate([points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)], -1)


def _sweep(sections: list[Array], resolution: int) -> Array:
    """Rings (r, n, 6) of patch rings that continue each other smoothly, the shared ones once."""
    grids = [_evaluate(control, resolution) for control in sections]
    return np.concatenate([grids[0], *(grid[1:] for grid in grids[1:])])


def _annulus(inner: Array, outer: Array) -> Array:
    """Two rings (2, n, 6) that join the positions of two rings flatly, with a normal of their own."""
    points = np.stack([inner[:, :3], outer[:, :3]])
    edge = np.roll(points, -1, 1) - points
    normal = np.cross(edge, points[::-1] - points).reshape(2, -1, 3) * np.array([1.0, -1.0])[:, None, None]
    normal = normal.sum((0, 1))
    return np.concatenate([points, np.broadcast_to(normal / np.linalg.norm(normal), points.shape)], -1)


def _disk(ring: Array, *, top: bool) -> Array:
    """Two rings (2, n, 6) that close a ring with a flat fan, above it (``top``) or below."""
    centre = np.broadcast_to(ring.mean(0), ring.shape)
    return _annulus(ring, centre) if top else _annulus(centre, ring)


def _solid(grids: list[Array]) -> manifold3d.Manifold:
    """Weld rings stacked upwards into a solid that carries its normals through every cut."""
    corners, triangles, first = [], [], 0
    for grid in grids:
        index = first + np.arange(grid[..., 0].size).reshape(grid.shape[:2])
        a, b = index[:-1], index[1:]
        next_a, next_b = np.roll(a, -1, 1), np.roll(b, -1, 1)
        triangles.append(np.stack([a, next_a, next_b, a, next_b, b], -1).reshape(-1, 3))
        corners.append(grid.reshape(-1, 6))
        first += index.size
    vertices = np.concatenate(corners)
    # Vertices equal in position are one point of the solid; those equal in normal too are one vertex.
    point = _first_equal(vertices[:, :3])
    triangle = _first_equal(vertices)[np.concatenate(triangles)]
    solid = point[triangle]
    keep = (solid[:, 0] != solid[:, 1]) & (solid[:, 1] != solid[:, 2]) & (solid[:, 2] != solid[:, 0])
    split = np.flatnonzero(point != np.arange(len(point))).astype(np.uint32)
    mesh = manifold3d.Mesh(
        vertices.astype(np.float32), triangle[keep].astype(np.uint32), split, point[split].astype(np.uint32)
    )
    return manifold3d.Manifold(mesh)


def _first_equal(rows: Array) -> NDArray[np.int64]:
    """Index (n,) of the first row that equals each row of (n, k), to within rounding."""
    _, first, inverse = np.unique(np.round(rows, 9) + 0.0, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()]


def teapot_mesh(size: float = DEFAULT_SIZE, resolution: int = 18) -> TriangleMesh:
    """Make the teapot a solid: watertight, without self-intersections, filled, its faces outward; it stands on z = 0.

    Parameters
    ----------
    size : float
        Distance from the spout to the back of the handle [mm].
    resolution : int
        Segments along every edge of a patch; the triangles number about 64 times its square.

    Returns
    -------
    TriangleMesh
        Positions [mm], unit normals of the Bezier surfaces, counter-clockwise faces.
    """
    lower = _sweep([revolution_patches(curve) for curve in (BOTTOM, LOWER_BODY, UPPER_BODY, RIM)], resolution)
    upper = _sweep([revolution_patches(curve) for curve in (LID, KNOB)], resolution)
    body = _solid([lower, _annulus(lower[-1], upper[0]), upper])
    tubes = []
    for rows, reach in ((HANDLE, HANDLE_REACH), (SPOUT, SPOUT_REACH)):
        grid = _sweep(list(tube_patches(rows)), resolution)
        ends = [grid[:1] + np.array([*reach[0], 0, 0, 0]), grid[-1:] + np.array([*reach[1], 0, 0, 0])]
        grid = np.concatenate([ends[0]] * any(reach[0]) + [grid] + [ends[1]] * any(reach[1]))
        tubes.append(_solid([_disk(grid[0], top=False), grid, _disk(grid[-1], top=True)]))
    whole = (body + tubes[0] + tubes[1]).to_mesh()
    data = np.asarray(whole.vert_properties, float)
    vertices, normals = data[:, :3], data[:, 3:]
    vertices = vertices * (size / np.ptp(vertices[:, 0]))
    return TriangleMesh(vertices, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.asarray(whole.tri_verts))
