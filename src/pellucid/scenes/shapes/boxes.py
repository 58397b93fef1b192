"""Boxes: walls, beams, and slabs with holes in them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Point = tuple[float, float, float]
Extent = tuple[Point, Point]
Hole = tuple[tuple[float, float], tuple[float, float]]


def box(low: Point, high: Point) -> tuple[Array, Index]:
    """Corners (8, 3) and outward faces (12, 3) of a box."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def boxes(extents: Sequence[Extent]) -> tuple[Array, Index]:
    """Many boxes as one mesh with flat faces: vertices and faces."""
    parts = [box(low, high) for low, high in extents]
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + 8 * k for k, (_, f) in enumerate(parts)])


def perforated(low: Sequence[float], high: Sequence[float], axis: int, holes: Sequence[Hole]) -> list[Extent]:
    """A slab as boxes around its ``holes``, which go through it along an axis; they are given in the other two coordinates."""
    u, v = [k for k in range(3) if k != axis]
    cuts = [sorted({low[k], high[k], *(corner[c] for hole in holes for corner in hole)}) for c, k in enumerate((u, v))]
    extents: list[Extent] = []
    for u0, u1 in pairwise(cuts[0]):
        for v0, v1 in pairwise(cuts[1]):
            middle = (0.5 * (u0 + u1), 0.5 * (v0 + v1))
            if any(a[0] < middle[0] < b[0] and a[1] < middle[1] < b[1] for a, b in holes):
                continue
            a, b = [*low], [*high]
            a[u], b[u], a[v], b[v] = u0, u1, v0, v1
            extents.append(((a[0], a[1], a[2]), (b[0], b[1], b[2])))
    return extents
