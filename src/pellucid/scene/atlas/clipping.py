"""Triangles of texture space cut into the squares of its texels, exactly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# So many texel-triangle pairs at once: what they need stays in the cache of a core.
AT_ONCE = 1 << 16


class Fragments(NamedTuple):
    """Pieces of triangles, one for every texel that a triangle touches.

    Attributes
    ----------
    triangle, texel : (n,) int64
        Whose piece, and in which texel: ``row * resolution + column``.
    area : (n,) float64
        Of the piece [texels].
    centre : (n, 2) float64
        Its centre of mass [texels].
    """

    triangle: Index
    texel: Index
    area: Array
    centre: Array


def cut_triangles(corners: Array, resolution: int) -> Fragments:
    """Cut triangles into the texels of a square texture.

    The area of a triangle in the unit square is the integral along its border of ``c dy``, where c is x clamped to [0, 1];
    its moments are those of ``c^2 / 2 dy`` and ``y c dy``. Along an edge c is constant, linear and constant again, so all
    three have closed forms.

    Parameters
    ----------
    corners : (t, 3, 2) float
        Triangles in the unit square, of either orientation.
    resolution : int
        Texels along each side.

    Returns
    -------
    Fragments
        Triangles in their order. Those too flat to have an area (below 1e-12 texels) are one point, in the texel of their centre.
    """
    corners = np.clip(corners, 0, 1) * resolution
    x, y = corners[..., 0], corners[..., 1]
    twice = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    flat = np.abs(twice) < 2e-12
    parts = [_points(np.flatnonzero(flat), corners[flat].mean(axis=1), resolution)]
    # All of one orientation, so that every area counts as positive.
    corners = np.where(twice[:, None, None] < 0, corners[:, ::-1], corners)
    for triangles in _portions(corners, np.flatnonzero(~flat)):
        parts.append(_cut(corners[triangles], triangles, resolution))
    triangle, texel, area, centre = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(triangle, kind="stable") if flat.any() else slice(None)
    return Fragments(triangle[order], texel[order], area[order], centre[order])


def _points(triangle: Index, place: Array, resolution: int) -> Fragments:
    """Let triangles without an area be points."""
    column, row = np.minimum(place.astype(np.int64), resolution - 1).T
    return Fragments(triangle, row * resolution + column, np.zeros(len(triangle)), place)


def _portions(corners: Array, triangles: Index) -> Iterator[Index]:
    """Divide triangles into consecutive portions that touch about as many texels each."""
    touched = np.prod(np.ptp(corners[triangles], axis=1) + 2, axis=1)
    ends = np.searchsorted(np.cumsum(touched), np.arange(1, np.sum(touched) / AT_ONCE + 1) * AT_ONCE)
    return (portion for portion in np.split(triangles, np.unique(ends)) if len(portion))


def _cut(corners: Array, triangles: Index, resolution: int) -> Fragments:
    """Cut counter-clockwise triangles into rows, and the rows into texels."""
    x, y = np.ascontiguousarray(corners.T)  # corner, triangle
    low = np.floor(y.min(axis=0)).astype(np.int64)
    high = np.maximum(np.ceil(y.max(axis=0)).astype(np.int64), low + 1)
    owner, row = _ranges(low, np.minimum(high, resolution))
    x0, y0, x1, y1 = _cut_edges(x[:, owner], y[:, owner] - row)
    first, end, inner, outer = _columns(x0, y0, x1, y1, resolution)
    strip, column = _ranges(first, end)

    # A whole texel needs no work; where triangles are large, most are whole.
    area, inside = np.ones(len(strip)), np.full((len(strip), 2), 0.5)
    cut = np.flatnonzero((column < inner[strip]) | (column >= outer[strip]))
    s, c = strip[cut], column[cut]
    area[cut], moment_x, moment_y = _moments(x0[:, s] - c, y0[:, s], x1[:, s] - c, y1[:, s])
    mass = np.maximum(area[cut], 1e-300)
    # Rounding may put the centre of a sliver beyond its texel.
    inside[cut] = np.clip(np.stack([moment_x / mass, moment_y / mass], axis=-1), 0, 1)

    real = np.flatnonzero(area > 0)
    strip, column = strip[real], column[real]
    centre = np.stack([column, row[strip]], axis=-1) + inside[real]
    return Fragments(triangles[owner[strip]], row[strip] * resolution + column, area[real], centre)


def _ranges(first: Index, end: Index) -> tuple[Index, Index]:
    """List the whole numbers from ``first`` to below ``end`` of every range: whose they are, and the numbers."""
    count = np.maximum(end - first, 0)
    owner = np.repeat(np.arange(len(count)), count)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count)


def _cut_edges(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Cut the edges of polygons, (corners, n), to the strip 0 <= y <= 1: the ends of what is left, y equal where nothing is."""
    dx, dy = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y
    slope = np.divide(dx, dy, out=np.zeros_like(dx), where=dy != 0)
    y0, y1 = np.clip(y, 0, 1), np.clip(y + dy, 0, 1)
    return x + (y0 - y) * slope, y0, x + (y1 - y) * slope, y1


def _columns(x0: Array, y0: Array, x1: Array, y1: Array, resolution: int) -> tuple[Index, Index, Index, Index]:
    """Find the texels, from first to below end, that each strip of a triangle touches, and those that it covers whole."""
    rising, falling = y1 > y0, y1 < y0
    touched = rising.any(axis=0) & falling.any(axis=0)
    low, high = np.minimum(x0, x1), np.maximum(x0, x1)
    # The border rises on the right of a counter-clockwise triangle and falls on its left.
    first, inner = np.where(falling, low, resolution).min(axis=0), np.where(falling, high, 0).max(axis=0)
    outer, end = np.where(rising, low, resolution).min(axis=0), np.where(rising, high, 0).max(axis=0)
    first, end = np.floor(first).astype(np.int64), np.ceil(end).astype(np.int64)
    end = np.where(touched, np.minimum(np.maximum(end, first + 1), resolution), first)
    spanned = np.sum((y1 - y0) * rising, axis=0) > 1 - 1e-12
    return first, end, np.ceil(inner).astype(np.int64), np.where(spanned, np.floor(outer), 0).astype(np.int64)


def _moments(x0: Array, y0: Array, x1: Array, y1: Array) -> tuple[Array, Array, Array]:
    """Integrate 1, x and y over the part of polygons with edges (k, n) that lies in 0 <= x <= 1 and in its strip."""
    dx, dy = x1 - x0, y1 - y0
    inverse = np.divide(1.0, dx, out=np.zeros_like(dx), where=dx != 0)
    # Parameters along the edge between which x is within [0, 1], and x clamped before and after.
    s0, s1 = np.clip(-x0 * inverse, 0, 1), np.clip((1 - x0) * inverse, 0, 1)
    s0, s1 = np.minimum(s0, s1), np.maximum(s0, s1)
    c0, c1 = np.clip(x0, 0, 1), np.clip(x1, 0, 1)
    within, after = s1 - s0, 1 - s1
    one = s0 * c0 + within * 0.5 * (c0 + c1) + after * c1
    square = s0 * c0 * c0 + within * (c0 * c0 + c0 * c1 + c1 * c1) / 3 + after * c1 * c1
    along = (s0 * s0 * c0 + after * (1 + s1) * c1 + within * (s0 * (2 * c0 + c1) + s1 * (c0 + 2 * c1)) / 3) / 2
    area = np.sum(dy * one, axis=0)
    return area, np.sum(dy * square, axis=0) / 2, np.sum(dy * (y0 * one + dy * along), axis=0)
