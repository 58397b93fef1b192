"""Neighbours of points on surfaces: a sparse grid of cells that a kernel walks without a stack."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.memory import upload

# Points whose normals differ by more than 120 degrees lie on opposite sides of a thin sheet: they are no neighbours.
# The edges of a tetrahedron (109 degrees) are still joined.
OPPOSITE = -0.5

# Light by way of other surfaces changes with the normal as with the place: the cosine below which a neighbour tells nothing of it.
TURNED = 0.95

# Normals are kept in one number: so many bits a coordinate.
NORMAL_BITS = 10
NORMAL_MASK = (1 << NORMAL_BITS) - 1
NORMAL_SHIFTS = (0, NORMAL_BITS, 2 * NORMAL_BITS)

# The index that stands for "no point".
NONE = 0xFFFFFFFF


class PointGrid:
    """Points sorted into cubic cells, so that all points within one cell size of a place are found in nine runs.

    A row of three cells along x is one contiguous run of the sorted points. Cells are numbered by
    ``x + (y * stride_y + z * stride_z) mod size``, which numbers a dense block when the block is small and wraps around
    when the surface lies sparse in it; points of foreign cells that share a number are told apart by their distance.

    Parameters
    ----------
    p, n
        (n,) positions [scene units] and unit normals.
    cell
        Side of a cell [scene units]: the largest distance that can be asked for.
    """

    def __init__(self, p: mi.Point3f, n: mi.Normal3f, cell: float):
        # Opaque numbers are arguments of the kernels, not part of them: one compilation serves every grid.
        self.cell = dr.opaque(mi.Float, float(cell))
        self.count = dr.width(p)
        low, high = _bounds(p)
        # Two empty cells on each side make the rows next to the outermost points valid.
        extent = np.floor((high - low) / cell).astype(np.int64) + 5
        size, stride = _table(extent, self.count)
        self.origin = dr.opaque(mi.Point3f, (low - 2 * cell).tolist())
        self.rim = dr.opaque(mi.Point3f, (extent - 2.0).tolist())
        self.stride = dr.opaque(mi.Point2u, stride)
        self.mask = dr.opaque(mi.UInt32, size - 1)

        cell_of = self._cell_of(p)
        key = self._row(cell_of.y, cell_of.z) + cell_of.x
        # The index in the lower half makes every key unique: the order does not depend on the sorting algorithm.
        order = np.array((mi.UInt64(key) << 32) | mi.UInt64(dr.arange(mi.UInt32, self.count)))
        order.sort()
        self.order = mi.UInt32(upload(order, mi.UInt64))
        counts = dr.zeros(mi.UInt32, size + int(extent[0]) + 2)
        dr.scatter_add(
            counts, mi.UInt32(1), key, mode=dr.ReduceMode.Direct
        )  # by default, kernels would know the number of cells
        self.start = dr.prefix_sum(counts)
        self.position = dr.gather(mi.Point3f, p, self.order)
        self.normal = dr.gather(mi.Normal3f, n, self.order)
        self.packet = _packets(self.position, self.normal)
        dr.eval(self.order, self.start, self.normal, self.packet)

    def _cell_of(self, p: mi.Point3f) -> mi.Point3u:
        """Number the cell of a place along each axis; places outside of the grid count to its rim, which is empty."""
        q = dr.floor((p - self.origin) / self.cell)
        return mi.Point3u(dr.clip(q, 1, self.rim))

    def _row(self, y: mi.UInt32, z: mi.UInt32) -> mi.UInt32:
        """Number the first cell of a row; the products may wrap around, because the size is a power of two."""
        return (y * self.stride.x + z * self.stride.y) & self.mask

    def visit(self, q: mi.Point3f, state: tuple, step: Callable[..., tuple[tuple, mi.Bool]], active: mi.Bool) -> tuple:
        """Fold over the points in the 27 cells around each place ``q``.

        Parameters
        ----------
        step
            ``step(j, position, facing, valid, *state) -> (state, done)`` sees the sorted index of one point, its position, and
            its normal as `_same_side` reads it; a lane that is ``done`` stops.

        Returns
        -------
        tuple
            The last state.
        """
        cell = self._cell_of(q)

        def condition(row: Any, j: Any, end: Any, live: Any, *_: Any) -> Any:
            return live & ((row < 9) | (j < end))

        def body(row: Any, j: Any, end: Any, live: Any, *state: Any) -> tuple:
            # A lane either steps to its next run or looks at one point: one flat loop keeps the lanes of a packet busy.
            valid = live & (j < end)
            fetch = live & ~valid
            packet = dr.gather(mi.Vector4f, self.packet, j, valid)
            position, facing = mi.Point3f(packet.x, packet.y, packet.z), dr.reinterpret_array(mi.UInt32, packet.w)
            state, done = step(j, position, facing, valid, *state)
            # The middle row comes first: a search for any near point then mostly ends there.
            place = dr.select(row < 5, row + 4, row - 5)
            layer = place // 3
            run = self._row(cell.y + (place - 3 * layer) - 1, cell.z + layer - 1) + cell.x - 1
            first = dr.gather(mi.UInt32, self.start, run, fetch)
            last = dr.gather(mi.UInt32, self.start, run + 3, fetch)
            return (
                dr.select(fetch, row + 1, row),
                dr.select(fetch, first, j + 1),
                dr.select(fetch, last, end),
                live & ~(valid & done),
                *state,
            )

        zero = dr.zeros(mi.UInt32, dr.width(q))
        out = dr.while_loop((zero, mi.UInt32(zero), mi.UInt32(zero), mi.Bool(active), *state), condition, body)
        return out[4:]

    def any_near(self, q: mi.Point3f, n: mi.Normal3f) -> mi.Bool:
        """Tell whether a point of the grid lies nearer than the cell size on the same side of the surface."""
        reach = dr.square(self.cell)

        def step(j: Any, p: Any, facing: Any, valid: Any, found: Any) -> tuple:
            near = valid & (dr.squared_norm(p - q) < reach) & _same_side(facing, n)
            return (found | near,), near

        return self.visit(q, (dr.full(mi.Bool, False, dr.width(q)),), step, mi.Bool(True))[0]

    def first_among_near(self, priority: mi.UInt32) -> mi.Bool:
        """Tell which points, in sorted order, have a lower priority than all others nearer than the cell size."""
        me = dr.arange(mi.UInt32, self.count)
        mine = dr.gather(mi.UInt32, priority, me)
        q, n = self.position, self.normal
        reach = dr.square(self.cell)

        def step(j: Any, p: Any, facing: Any, valid: Any, beaten: Any) -> tuple:
            near = valid & (j != me) & (dr.squared_norm(p - q) < reach) & _same_side(facing, n)
            other = dr.gather(mi.UInt32, priority, j, near)
            # Equal priorities are settled by the index.
            near &= (other < mine) | ((other == mine) & (j < me))
            return (beaten | near,), near

        return ~self.visit(q, (dr.full(mi.Bool, False, self.count),), step, mi.Bool(True))[0]

    def nearest(self, q: mi.Point3f, n: mi.Normal3f) -> mi.UInt32:
        """Find the nearest point within one cell size on the same side: its original index, or ``NONE``."""
        reach = dr.square(self.cell)

        def step(j: Any, p: Any, facing: Any, valid: Any, best: Any, index: Any) -> tuple:
            d2 = dr.squared_norm(p - q)
            nearer = valid & (d2 < best) & _same_side(facing, n)
            return (dr.select(nearer, d2, best), dr.select(nearer, j, index)), mi.Bool(False)

        width = dr.width(q)
        start = (reach + dr.zeros(mi.Float, width), dr.full(mi.UInt32, NONE, width))
        index = self.visit(q, start, step, mi.Bool(True))[1]
        found = index != NONE
        return dr.select(found, dr.gather(mi.UInt32, self.order, index, found), NONE)

    def repulsion(self) -> mi.Vector3f:
        """Add up the unit pushes (1 - d / cell) away from every neighbour nearer than the cell size, in sorted order.

        Source
        ------
        G. Turk, *Re-tiling polygonal surfaces*, SIGGRAPH 1992: force linear in the distance.
        """
        me = dr.arange(mi.UInt32, self.count)
        q, n = self.position, self.normal
        reach, inverse = dr.square(self.cell), dr.rcp(self.cell)

        def step(j: Any, p: Any, facing: Any, valid: Any, push: Any) -> tuple:
            away = q - p
            d2 = dr.squared_norm(away)
            near = valid & (j != me) & (d2 < reach) & (d2 > 0) & _same_side(facing, n)
            weight = dr.rsqrt(d2) - inverse
            return (dr.select(near, push + away * weight, push),), mi.Bool(False)

        return self.visit(q, (dr.zeros(mi.Vector3f, self.count),), step, mi.Bool(True))[0]

    def means(self, values: list[mi.Color3f]) -> list[mi.Color3f]:
        """Average colours of every point over its neighbours on the same smooth piece of the surface, in the order of the points.

        Neighbours nearer than the cell size count by ``1 - d^2 / cell^2``, the less the more their normals differ (none where the cosine is
        below `TURNED`) and the further they lie above or below the tangent plane (none from a quarter of the cell size on).
        """
        q, n, inverse = self.position, self.normal, dr.rcp(dr.square(self.cell))
        packed = [dr.ravel(mi.Vector4f(*dr.gather(mi.Color3f, value, self.order), 0)) for value in values]
        dr.eval(packed)

        def step(j: Any, p: Any, facing: Any, valid: Any, weights: Any, *totals: Any) -> tuple:
            way = p - q
            flat, aligned = 1 - 16 * inverse * dr.square(dr.dot(way, n)), dr.dot(_unpacked(facing), n) - TURNED
            weight = dr.maximum(1 - dr.squared_norm(way) * inverse, 0) * dr.maximum(flat, 0) * dr.maximum(aligned, 0)
            weight = dr.select(valid, weight, 0)
            found = [dr.gather(mi.Vector4f, numbers, j, weight > 0) for numbers in packed]
            sums = [total + weight * mi.Color3f(v.x, v.y, v.z) for v, total in zip(found, totals, strict=True)]
            return (weights + weight, *sums), mi.Bool(False)

        start = dr.zeros(mi.Float, self.count), *(dr.zeros(mi.Color3f, self.count) for _ in values)
        weights, *totals = self.visit(q, start, step, mi.Bool(True))
        means = [dr.empty(mi.Color3f, self.count) for _ in values]
        for mean, total in zip(means, totals, strict=True):
            dr.scatter(mean, total / weights, self.order)
        return means


def _bounds(p: mi.Point3f) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the box around points, (3,) float64 each."""
    ends = [dr.min(p[k]) for k in range(3)] + [dr.max(p[k]) for k in range(3)]
    dr.eval(ends)
    box = np.array([float(end[0]) for end in ends])
    return box[:3], box[3:]


def _packets(p: mi.Point3f, n: mi.Normal3f) -> mi.Float:
    """Interleave positions and packed normals: four floats are fetched in one go. The top two bits stay clear, so that all are
    finite."""
    steps = [mi.UInt32((c + 1) * (0.5 * NORMAL_MASK) + 0.5) for c in dr.clip(n, -1, 1)]
    x, y, z = (step << shift for step, shift in zip(steps, NORMAL_SHIFTS, strict=True))
    return dr.ravel(mi.Vector4f(p.x, p.y, p.z, dr.reinterpret_array(mi.Float, x | y | z)))


def _same_side(facing: mi.UInt32, n: mi.Normal3f) -> mi.Bool:
    """Tell whether the normal of a packet and another one lie on the same side of a surface."""
    return dr.dot(_unpacked(facing), n) > OPPOSITE


def _unpacked(facing: mi.UInt32) -> mi.Normal3f:
    """Read the normal of a packet."""
    x, y, z = (mi.Float((facing >> shift) & NORMAL_MASK) for shift in NORMAL_SHIFTS)
    return mi.Normal3f(x, y, z) * (2 / NORMAL_MASK) - 1


def _table(extent: np.ndarray, count: int) -> tuple[int, tuple[int, int]]:
    """Choose the number of row starts, a power of two of two to four a point, and the strides of y and z."""
    length, dense = int(extent[0]), int(np.prod(extent.astype(float)))
    size = 1 << int(max(min(dense, 2 * count), 4 * length, 1 << 12)).bit_length()
    stride_y, stride_z = length, length * int(extent[1])
    around = np.arange(-2, 3)
    while True:
        step = (around[:, None] * stride_y + around[None, :] * stride_z).ravel()
        step = np.delete(step, len(step) // 2) % size
        # Two of the nine rows around a place must not overlap, or points would be seen twice.
        if np.min(np.minimum(step, size - step)) >= 3:
            return size, (stride_y % size, stride_z % size)
        stride_z += 1
