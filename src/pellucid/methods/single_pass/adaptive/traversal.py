"""Walk a binary cluster tree by distance: every point meets the clusters that may stand for their members there.

The octree of :mod:`pellucid.gather.gather` has a walk of its own. It sums power that is stored in the records of nodes; here light is
measured between walks, so nodes are found by number, and what is done at each is given by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....gather.gather import cosine, dot, lookup, split
from ....gather.source import Source, make_source
from ....model.profiles import ProfileTable
from ..trees.sample_tree import WALK_FLOAT4S, SampleTree, walk_records

Visit = Callable[[Any, mi.UInt32, mi.Color3f, mi.Float, mi.Bool], Any]
"""``(state, node, weight, r2, accepted) -> state``: weight is the area of the node times R_d, and 0 where it is not accepted; r2 the
mean squared distance to its members."""


def walk_source(samples: SampleTree, table: ProfileTable, max_error: float, negligible: float = 0.0) -> Source:
    """Prepare the records that a walk reads.

    Parameters
    ----------
    max_error : float
        Solid angle [sr] under which clusters may stand for their members.
    negligible : float
        Clusters whose weight is below this share of a plane's are not opened, under whatever solid angle.
    """
    records = walk_records(samples, max_error, lambda area: _reach(table, area, negligible))
    return make_source(records, 0, table, mi.Float)


def footprint(table: ProfileTable) -> float:
    """Evaluate the area over which a point averages the light around it: ``(integral of R)^2 / integral of R^2`` over the plane."""
    s, profile = _samples_of(table)
    mean = profile.mean(axis=1)
    return float(np.pi * np.trapezoid(mean, s) ** 2 / np.trapezoid(mean**2, s))


def _samples_of(table: ProfileTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Give squared distances ``(m,)`` and R_d there ``(m, 3)``."""
    s = (table.middles(np.arange(table.last, dtype=np.uint32)) - table.offset) / table.inv_scale2
    return s, table.values[: table.last, :3].astype(np.float64)


def _reach(table: ProfileTable, area: NDArray, negligible: float) -> NDArray[np.float64]:
    """Find the distance from which on areas have less than a share of the weight of a plane, in all colours."""
    if not negligible:
        return np.full(len(area), np.inf)
    s, profile = _samples_of(table)
    share = (profile / (np.pi * np.trapezoid(profile, s, axis=0))).max(axis=1)
    falling = np.maximum.accumulate(share[::-1])
    return np.sqrt(np.interp(negligible / np.maximum(area, 1e-300), falling, s[::-1], right=0.0))


def walk(
    source: Source, p: mi.Point3f, start: Any, visit: Visit, coarser: Any = 1.0, n: mi.Normal3f | None = None
) -> Any:
    """Visit, for each point, the clusters of the cut that belongs to it.

    R_d of a cluster is its mean over the members to second order in their spread, as in :mod:`pellucid.gather.gather`. What a point
    finds depends on no other.

    Parameters
    ----------
    p : Point3f
        In the space of the prototype; neighbours in the array should be neighbours in space.
    start : PyTree
        What the visits change, before the first.
    coarser : Float
        What multiplies the solid angle under which clusters stand for their members, by point.
    n : Normal3f, optional
        Normals of the surface there, away from the inside; without them it is flat.

    Returns
    -------
    PyTree
        The last state of each point.

    Source: JB02 eq. 12.
    """
    coarser = mi.Float(coarser)
    normal = [] if n is None or source.curve is None else [n.x, n.y, n.z]
    dr.make_opaque(p, normal, coarser)

    def step(node, active, state):
        centroid, opening = split(dr.gather(mi.Array4f, source.records, node * WALK_FLOAT4S, active))
        v, c = split(dr.gather(mi.Array4f, source.records, node * WALK_FLOAT4S + 1, active))
        area, negligible, cover, _ = dr.gather(mi.Array4f, source.records, node * WALK_FLOAT4S + 2, active)
        d = [a - b for a, b in zip((p.x, p.y, p.z), centroid, strict=True)]
        r2 = dot(d, d)
        faint = r2 >= negligible
        far = faint | ((r2 * coarser >= opening) & (r2 >= cover))
        # tr C - 2 psi c + (2 psi) (v . d)^2 / (r^2 + core), see docs/theory/tree.md
        shift = dr.fma(3 - source.twice_psi, c, -dot(v, v))
        along = dot(d, v)
        r2_mean = dr.fma(along * along, source.twice_psi * dr.rcp(r2 + source.core), r2 + shift)
        r2_mean = dr.select(faint, r2, r2_mean)  # no second order holds for clusters as large as their distance
        accepted = active & far & (area > 0)
        mu = cosine(normal, d, r2)
        weight = mi.Color3f(*lookup(source, dr.maximum(r2_mean, 0), accepted, mu=mu)) * area
        state = visit(state, node, weight, r2_mean, accepted)
        after = node + 1
        node = dr.select(far, after >> dr.tzcnt(after), node << 1)
        return node, active & (node != 1), state

    count = dr.width(p)
    state = dr.full(mi.UInt32, 1, count), dr.full(mi.Bool, True, count), start
    # The root that is opened becomes node 2: node 1 is met again only at the end.
    state = dr.while_loop(state, lambda node, active, _: active, step, label="pellucid walk")[2]
    dr.eval(state)
    return state
