"""From a signed distance to a closed triangle mesh: one vertex for every piece of surface in a cell of a grid."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Ints = NDArray[np.int64]
Distance = Callable[[Floats], Floats]

# Fine cells along the edge of a coarse one.
BLOCK = 4

# Corner 4 i + 2 j + k of a cell lies at (i, j, k); edge 4 axis + n starts at corner STARTS[axis, n] and runs along its axis.
CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
STARTS = np.array([np.flatnonzero(CORNERS[:, axis] == 0) for axis in range(3)])
ENDS = np.array([(start, start + (4 >> axis)) for axis in range(3) for start in STARTS[axis]])


@cache
def _pieces() -> tuple[Ints, Ints]:
    """For each of the 256 sets of corners inside (bit c for corner c): the piece of surface that each edge belongs to,
    (256, 12) int, -1 for an edge that is not cut, and how many pieces there are, (256,) int.

    On a face of the cell where the corners inside lie across from each other, the surface goes around each of them, in
    both cells at the face. So two triangles meet in every edge of the mesh, four only where the two pieces at such a face
    are one in both cells.
    """
    piece, count = np.full((256, 12), -1), np.zeros(256, int)
    faces = [np.flatnonzero((CORNERS[ENDS, axis] == side).all(1)) for axis in range(3) for side in (0, 1)]
    for case in range(256):
        inside = (case >> ENDS) & 1
        cut = inside[:, 0] != inside[:, 1]
        corner = np.where(inside[:, 0] == 1, ENDS[:, 0], ENDS[:, 1])
        label = np.where(cut, np.arange(12), -1)
        for face in faces:
            on_face = face[cut[face]]
            pairs = [on_face] if len(on_face) == 2 else [on_face[corner[on_face] == c] for c in set(corner[on_face])]
            for pair in pairs:
                label[np.isin(label, label[pair])] = label[pair].min()
        names = np.unique(label[cut])
        piece[case, cut] = np.searchsorted(names, label[cut])
        count[case] = len(names)
    return piece, count


def gradient(distance: Distance, points: Floats, step: float) -> Floats:
    """Slope (3, n) of a distance at ``points`` (3, n), by central differences."""
    offsets = step * np.eye(3, dtype=points.dtype)[..., None]
    return np.stack([distance(points + o) - distance(points - o) for o in offsets]) / (2 * step)


def _active_cells(distance: Distance, low: Floats, high: Floats, edge: float) -> tuple[Ints, Floats]:
    """Find the fine cells (n, 3) that the surface passes through, and the distances at their corners (n, 8)."""
    coarse = BLOCK * edge
    shape = np.ceil((high - low) / coarse).astype(int)
    blocks = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3)
    centre = distance((low + (blocks + 0.5) * coarse).T.astype(np.float32))
    # Smooth unions bend the distance a little: the margin keeps every block that the surface may touch.
    blocks = blocks[np.abs(centre) < 1.3 * np.sqrt(0.75) * coarse]
    side = np.arange(BLOCK + 1)
    lattice = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1)
    points = low + edge * (BLOCK * blocks[:, None, None, None] + lattice)
    value = distance(points.reshape(-1, 3).T.astype(np.float32)).reshape(len(blocks), *lattice.shape[:3])
    corner = np.stack([value[:, i : i + BLOCK, j : j + BLOCK, k : k + BLOCK] for i, j, k in CORNERS], -1)
    inside = (corner < 0).sum(-1)
    chosen = (inside > 0) & (inside < 8)
    where = np.argwhere(chosen)
    return BLOCK * blocks[where[:, 0]] + where[:, 1:], corner[chosen]


def surface_mesh(distance: Distance, low: Floats, high: Floats, edge: float) -> tuple[Floats, Floats, Ints]:
    """Mesh the zero of a distance that is negative inside and positive on the whole border of the box.

    Parameters
    ----------
    distance : callable
        Takes (3, n) points, gives (n,) distances [mm].
    low, high : (3,) float
        Corners of the box [mm].
    edge : float
        Side of a cell [mm], about the side of a triangle.

    Returns
    -------
    vertices, normals : (n, 3) float64
        On the surface to second order; the normals are those of the distance.
    faces : (m, 3) int
        Closed, counter-clockwise seen from outside.

    Source
    ------
    G. Nielson, *Dual marching cubes*, IEEE Visualization 2004; the vertices are moved down the distance onto the surface.
    """
    cells, value = _active_cells(distance, low, high, edge)
    shape = cells.max(0) + 2
    key = np.ravel_multi_index(tuple(cells.T), tuple(shape))
    order = np.argsort(key)
    cells, value, key = cells[order], value[order], key[order]
    piece, count = _pieces()
    case = (value < 0) @ (1 << np.arange(8))
    first = np.cumsum(count[case]) - count[case]

    # The vertex of a piece begins in the middle of the points where the surface cuts the edges of the cell.
    a, b = ENDS.T
    cell, local = np.nonzero(piece[case] >= 0)
    t = value[cell, a[local]] / (value[cell, a[local]] - value[cell, b[local]])
    cuts = cells[cell] + CORNERS[a[local]] + t[:, None] * (CORNERS[b[local]] - CORNERS[a[local]])
    owner = first[cell] + piece[case[cell], local]
    middle = np.stack([np.bincount(owner, cuts[:, k]) for k in range(3)]) / np.bincount(owner)
    points = (low[:, None] + edge * middle).astype(np.float32)
    slope = gradient(distance, points, 0.25 * edge)
    for _ in range(2):
        points -= distance(points) / np.maximum((slope**2).sum(0), 0.25) * slope
    normals = gradient(distance, points, 0.4 * edge).T.astype(float)
    vertices = points.T.astype(float)

    faces = []
    for axis in range(3):
        inside, other = value[:, 0] < 0, value[:, 4 >> axis] < 0
        # The edge from corner 0 is shared by four cells; going around it they begin one cell further back.
        shifts = np.zeros((4, 3), int)
        shifts[1:3, (axis + 1) % 3] = shifts[2:, (axis + 2) % 3] = 1
        for chosen, reverse in ((inside & ~other, False), (~inside & other, True)):
            ring = []
            for shift in shifts[::-1] if reverse else shifts:
                cell = np.searchsorted(key, np.ravel_multi_index(tuple((cells[chosen] - shift).T), tuple(shape)))
                local = 4 * axis + np.searchsorted(STARTS[axis], shift @ (4, 2, 1))
                ring.append(first[cell] + piece[case[cell], local])
            faces.append(_split(vertices, np.stack(ring, -1)))
    return vertices, normals / np.linalg.norm(normals, axis=1, keepdims=True), np.concatenate(faces)


def _split(points: Floats, quad: Ints) -> Ints:
    """Cut quadrilaterals (n, 4) along their shorter diagonals: (2 n, 3)."""
    a, b, c, d = points[quad].transpose(1, 0, 2)
    turn = ((a - c) ** 2).sum(-1) > ((b - d) ** 2).sum(-1)
    quad = np.where(turn[:, None], np.roll(quad, -1, 1), quad)
    return np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
