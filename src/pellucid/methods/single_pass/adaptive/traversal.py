"""Walk a binary cluster tree by distance: every point meets the clusters that may stand for their members there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....gather.gather import dot, lookup, split
from ....gather.source import Source, make_source
from ....model.profiles import ProfileTable
from ..trees.sample_tree import CUT_PACKETS, SampleTree, cut_records

Visit = Callable[[Any, Any, Any, Any, Any, Any], Any]
"""``(state, own, node, weight, r2, accepted) -> state`` of one point: its own data; weight is the area of the node times R_d for
red, green and blue, and 0 where it is not accepted; r2 its mean squared distance. With `leave`, ``-> (state, mark)``."""

POINTS_PER_LANE = 4
"""Neighbours that one lane walks for: to fetch a record takes longer than to look at it from one point."""

NOTHING_YET, ALL = 0, 0xFFFFFFFF
"""How far a point has passed along the walk: before its first node, and where there is no point."""


def walk_source(samples: SampleTree, table: ProfileTable, max_error: float, negligible: float = 0.0) -> Source:
    """Prepare the records that a walk reads.

    Parameters
    ----------
    max_error : float
        Solid angle [sr] under which clusters may stand for their members.
    negligible : float
        Clusters whose weight is below this share of a plane's are not opened, under whatever solid angle.
    """
    return make_source(
        cut_records(samples, max_error, lambda area: _reach(table, area, negligible)), 0, table, mi.Float
    )


def _reach(table: ProfileTable, area: NDArray, negligible: float) -> NDArray[np.float64]:
    """Find the distance from which on areas have less than a share of the weight of a plane, in all colours."""
    if not negligible:
        return np.full(len(area), np.inf)
    entry = np.arange(table.last, dtype=np.uint32)
    u = table.middles(entry)
    s = (u - table.offset) / table.inv_scale2
    profile = table.values[: table.last, :3].astype(np.float64)
    share = (profile / (np.pi * np.trapezoid(profile, s, axis=0))).max(axis=1)
    falling = np.maximum.accumulate(share[::-1])
    return np.sqrt(np.interp(negligible / np.maximum(area, 1e-300), falling, s[::-1], right=0.0))


def walk(
    source: Source, p: mi.Point3f, start: Any, visit: Visit, coarser: Any = 1.0, own: Any = (), leave: Any = None
) -> Any:
    """Visit, for each point, the clusters of the cut that belongs to it.

    R_d of a cluster is its mean over the members to second order in their spread, as in :mod:`pellucid.gather.gather`. As there,
    a lane walks for several points, which take part where their own cuts are; what one finds does not hang on the others.

    Parameters
    ----------
    p : Point3f
        In the space of the prototype; neighbours in the array should be neighbours in space.
    start : PyTree
        What the visits change, of one point, before the first.
    coarser : Float
        What multiplies the solid angle under which clusters stand for their members, by point.
    own : PyTree
        What else the visits read, by point.
    leave : callable, optional
        Takes the marks of a node, of all points of a lane: they can be put together before they go to memory.

    Returns
    -------
    PyTree
        The last state of each point.

    Source: JB02 eq. 12.
    """
    count = dr.width(p)
    size = dr.opaque(mi.UInt32, count)
    lane = dr.arange(mi.UInt32, -(-count // POINTS_PER_LANE))
    index = [lane * POINTS_PER_LANE + k for k in range(POINTS_PER_LANE)]
    points = [_take((p, mi.Float(coarser), own), dr.minimum(i, size - 1)) for i in index]
    dr.eval(points)

    def step(node, active, passed, states):
        centroid, opening = split(dr.gather(mi.Array4f, source.records, node * CUT_PACKETS, active))
        v, c = split(dr.gather(mi.Array4f, source.records, node * CUT_PACKETS + 1, active))
        area, negligible, cover, _ = dr.gather(mi.Array4f, source.records, node * CUT_PACKETS + 2, active)
        # tr C - 2 psi c + (2 psi) (v . d)^2 / (r^2 + core), see docs/theory/tree.md
        shift = dr.fma(3 - source.twice_psi, c, -dot(v, v))
        # Places along the order of the walk: where the members of the node begin, and where they end.
        level = dr.lzcnt(node)
        begin, end = node << level, ((node + 1) << level) - 1
        opened, passed, states, marks = mi.Bool(False), list(passed), list(states), []
        for k, (place, lenient, data) in enumerate(points):
            d = [a - b for a, b in zip((place.x, place.y, place.z), centroid, strict=True)]
            r2 = dot(d, d)
            wanted = active & (begin > passed[k])
            faint = r2 >= negligible
            far = faint | ((r2 * lenient >= opening) & (r2 >= cover))
            along = dot(d, v)
            r2_mean = dr.fma(along * along, source.twice_psi * dr.rcp(r2 + source.core), r2 + shift)
            r2_mean = dr.select(faint, r2, r2_mean)  # no second order holds for clusters as large as their distance
            accepted = wanted & far & (area > 0)
            weight = mi.Color3f(*lookup(source, dr.maximum(r2_mean, 0), accepted)) * area
            states[k] = visit(states[k], data, node, weight, r2_mean, accepted)
            if leave is not None:
                states[k], mark = states[k]
                marks.append(mark)
            passed[k] = dr.select(wanted & far, end, passed[k])
            opened |= wanted & ~far
        if leave is not None:
            leave(marks)
        after = node + 1
        node = dr.select(opened, node << 1, after >> dr.tzcnt(after))
        return node, active & (node != 1), passed, states

    node = dr.full(mi.UInt32, 1, dr.width(lane))
    passed = [dr.select(i < size, mi.UInt32(NOTHING_YET), ALL) for i in index]
    state = (node, dr.full(mi.Bool, True, dr.width(lane)), passed, [start] * POINTS_PER_LANE)
    # The root that is opened becomes node 2: node 1 is met again only at the end.
    states = dr.while_loop(state, lambda node, active, *_: active, step, label="pellucid walk")[3]
    dr.eval(states)
    return _in_order(states, count)


def _take(values: Any, index: mi.UInt32) -> Any:
    """Gather from all arrays of a PyTree; those of one entry are for all."""
    if isinstance(values, (tuple, list)):
        return type(values)(_take(value, index) for value in values)
    return values if dr.width(values) == 1 else dr.gather(type(values), values, index)


def _in_order(states: list[Any], count: int) -> Any:
    """Put the states of all lanes back into the order of the points."""
    if isinstance(states[0], (tuple, list)):
        return type(states[0])(_in_order(list(parts), count) for parts in zip(*states, strict=True))
    point = dr.arange(mi.UInt32, count)
    lane, place = point // POINTS_PER_LANE, point % POINTS_PER_LANE
    found = states[0]
    for k, state in enumerate(states):
        value = dr.gather(type(state), state, lane)
        found = value if k == 0 else dr.select(place == k, value, found)
    return found
