"""Walk a binary cluster tree by distance: every point meets the clusters that may stand for their members there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..model.profiles import ProfileTable
from .device import Source, make_source
from .gather import dot, lookup, split
from .sample_tree import CUT_PACKETS, SampleTree, cut_records

Visit = Callable[[Any, Any, Any, Any, Any], Any]
"""``(state, node, weight, r2, accepted) -> state``: weight is the area of the node times R_d for red, green and blue, and 0 where
it is not accepted; r2 its mean squared distance."""


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


def walk(source: Source, p: mi.Point3f, state: Any, visit: Visit, coarser: Any = 1.0) -> Any:
    """Visit, for each point, the clusters of the cut that belongs to it.

    R_d of a cluster is its mean over the members to second order in their spread, as in :mod:`pellucid.tree.gather`.

    Parameters
    ----------
    p : Point3f
        In the space of the prototype.
    state : PyTree
        What the visits change, by point.
    coarser : Float
        What multiplies the solid angle under which clusters stand for their members, by point.

    Source: JB02 eq. 12.
    """
    place = [p.x, p.y, p.z]

    def step(node, active, state):
        centroid, opening = split(dr.gather(mi.Array4f, source.records, node * CUT_PACKETS, active))
        v, c = split(dr.gather(mi.Array4f, source.records, node * CUT_PACKETS + 1, active))
        area, negligible, _, _ = dr.gather(mi.Array4f, source.records, node * CUT_PACKETS + 2, active)
        d = [a - b for a, b in zip(place, centroid, strict=True)]
        r2 = dot(d, d)
        faint = r2 >= negligible
        far = faint | (r2 * coarser >= opening)
        along = dot(d, v)
        # tr C - 2 psi c + (2 psi) (v . d)^2 / (r^2 + core), see docs/theory/tree.md
        shift = dr.fma(3 - source.twice_psi, c, -dot(v, v))
        r2_mean = dr.fma(along * along, source.twice_psi * dr.rcp(r2 + source.core), r2 + shift)
        r2_mean = dr.select(faint, r2, r2_mean)  # no second order holds for clusters as large as their distance
        accepted = active & far & (area > 0)
        weight = mi.Color3f(*lookup(source, dr.maximum(r2_mean, 0), accepted)) * area
        state = visit(state, node, weight, r2_mean, accepted)
        after = node + 1
        node = dr.select(far, after >> dr.tzcnt(after), node << 1)
        return node, active & (node != 1), state

    node = dr.full(mi.UInt32, 1, dr.width(p))
    start = (node, dr.full(mi.Bool, True, dr.width(p)), state)
    # The root that is opened becomes node 2: node 1 is met again only at the end.
    return dr.while_loop(start, lambda node, active, state: active, step, label="pellucid walk")[2]
