"""The candidates of a receiver group: the clusters of a cut through the light tree, and some lights drawn of each.

Neighbours see nearly the same lights, so the light tree is divided, and lights are drawn, for a group of them at once; each of the
receivers then evaluates one light of each cluster.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....kernels.heap import push, replace_top
from ....kernels.memory import columns, upload
from ..trees.descent import draw
from ..trees.light_tree import CLUSTERS, NOBODY, LightTree, importance

MOST_LIGHTS = 2048
"""Most candidates of a group, 8 bytes of local memory each while they are chosen."""

DRAWS = 8
"""Lights that are drawn of each cluster. Receivers use them in turn, so that neighbours do not share what one light has too much
of; what is learnt of a cluster's visibility they share."""

UNSEEN = 0.5
"""How much clusters of lights count that a group does not see, relative to those it sees."""

HUGE = 1e30

GOLDEN, FRACTION = 2654435769, 3242174889
"""Fractions of 2^32 whose multiples fill the unit interval evenly: the golden ratio's inverse along receiver groups, and the plastic
number's along nodes of lights. So neighbouring groups draw lights evenly from a cluster that they share, and what one of
them has too much of the others have too little of."""


@dataclass
class GroupBounds:
    """Spheres around the receivers of each group, and cones around their normals: axis and cosine."""

    centre: mi.Point3f
    radius: mi.Float
    axis: mi.Normal3f
    cos_cone: mi.Float


def bound_groups(p: NDArray, n: NDArray, group: NDArray) -> GroupBounds:
    """Bound the receivers of each group.

    Parameters
    ----------
    p, n : (k, 3) float
        Receivers and their normals.
    group : (k,) int
        The group of each: 0 and up, without a gap.
    """
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    size = np.bincount(group)
    centre = np.add.reduceat(p, starts) / size[:, None]
    radius = np.sqrt(np.maximum.reduceat(np.square(p - centre[group]).sum(axis=1), starts)) * (1 + 1e-5)
    axis = np.add.reduceat(n, starts)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-6)[:, None]
    cosine = np.minimum.reduceat((n * axis[group]).sum(axis=1), starts) - 1e-5
    (radius,), (cosine,) = columns(radius[:, None]), columns(np.where(size > 1, cosine, 1)[:, None])
    return GroupBounds(mi.Point3f(*columns(centre)), radius, mi.Normal3f(*columns(axis)), cosine)


@dataclass
class Candidates:
    """Up to `MOST_LIGHTS` clusters of lights of each of r receiver groups, those of one beside each other, and lights of each.

    Attributes
    ----------
    first, count : UInt32
        The first of them, and their number, by group.
    lights : UInt32
        Pairs of numbers, `DRAWS` for each cluster: the number of a light, and as bits of a float what multiplies it to stand for
        its cluster.
    place : UInt32
        By cluster where the guide counts its rays.
    """

    first: mi.UInt32
    count: mi.UInt32
    lights: mi.UInt32
    place: mi.UInt32

    def fetch(self, entry: mi.UInt32, drawn: mi.UInt32) -> tuple[mi.UInt32, mi.Float]:
        """Fetch one of the lights drawn of a cluster: its number, and what multiplies it."""
        light, scale = dr.gather(mi.Array2u, self.lights, DRAWS * entry + drawn)
        return light, dr.reinterpret_array(mi.Float, scale)


@dataclass
class Cluster:
    """A cluster of lights, and the luminance that it may send."""

    bound: mi.Float
    node: mi.UInt32


def choose_lights(
    lights: LightTree, visibility: mi.Float, bounds: GroupBounds, row: mi.UInt32, number: mi.UInt32, wanted: mi.UInt32
) -> Candidates:
    """Divide the lights into as many clusters as are wanted, always the one that may send most, as far as it is known to be seen;
    and draw some lights of each.

    Nothing that can send light to a point of the group is left out: what is chosen stands for all lights, without bias.

    Parameters
    ----------
    visibility : Float
        The expected visibility of each cluster of lights, row by row (`visibility.LightGuide`).
    row : UInt32
        The row of each group.
    number : UInt32
        A running number of each group, which its random numbers come from.
    wanted : UInt32
        Clusters, up to `MOST_LIGHTS`.

    Source: cuts as in WFABDG05, by number.
    """
    count = dr.width(number)
    begin = dr.prefix_sum(wanted)
    room = int(dr.sum(wanted)[0])
    drawn = dr.opaque(mi.UInt32, 0, 2 * DRAWS * room)
    zero = dr.opaque(mi.UInt32, 0, count)
    heap = dr.alloc_local(Cluster, MOST_LIGHTS)
    first = row * CLUSTERS
    dr.eval(first)
    heap, size, single = _divide(lights, lights.owner, visibility, bounds, first, heap, wanted, zero)
    place, node, whose = (dr.opaque(mi.UInt32, 0, room) for _ in range(3))
    entries = _unload(heap, size, single, wanted, begin, node, whose)
    dr.eval(entries, node, whose)
    _draw(lights, drawn, place, _in_order(lights, node, whose, begin, wanted), whose, first, number)
    candidates = Candidates(begin, entries, drawn, place)
    dr.eval(candidates)
    return candidates


@dr.syntax
def _divide(lights: LightTree, owner, visibility, bounds: GroupBounds, first, heap, wanted, zero):
    """Divide clusters; returns the heap of them, their number, and that of single lights at the end of its memory."""
    heap[zero] = Cluster(mi.Float(HUGE) + mi.Float(zero), mi.UInt32(1) + zero)
    size, single = zero + 1, mi.UInt32(zero)
    while dr.hint((size > 0) & (size + single < wanted), label="pellucid choose"):
        left = 2 * heap[zero].node
        one = _expected(lights, owner, visibility, bounds, first, left)
        other = _expected(lights, owner, visibility, bounds, first, left + 1)
        swap = other > one
        larger = Cluster(dr.select(swap, other, one), dr.select(swap, left + 1, left))
        smaller = Cluster(dr.select(swap, one, other), dr.select(swap, left, left + 1))
        if left >= lights.leaves_opaque:
            if larger.bound > 0:
                heap[MOST_LIGHTS - 1 - single] = larger
                single += 1
            if smaller.bound > 0:
                heap[MOST_LIGHTS - 1 - single] = smaller
                single += 1
            larger.bound = mi.Float(0)
            smaller.bound = mi.Float(0)
        heap, size = replace_top(heap, size, larger, zero)
        heap, size = push(heap, size, smaller, zero)
    return heap, size, single


def _expected(lights: LightTree, owner, visibility, bounds: GroupBounds, first, node):
    """Bound what a cluster of lights may send to a group, as far as it is known to be seen."""
    cluster = dr.gather(mi.UInt32, owner, node)
    known = cluster != NOBODY
    share = dr.gather(mi.Float, visibility, first + cluster, known)
    seen = dr.select(known, dr.fma(1 - UNSEEN, share, UNSEEN), 1)
    return seen * importance(lights, node, bounds.centre, bounds.axis, bounds.radius, bounds.cos_cone)


@dr.syntax
def _unload(heap, size, single, wanted, begin, node, whose):
    """Store the clusters of each group by entry, and whose all of the entries are: returns the number of clusters."""
    group, k = dr.arange(mi.UInt32, dr.width(size)), mi.UInt32(0)
    while dr.hint(k < wanted, label="pellucid unload"):
        there = k < size + single
        dr.scatter(node, heap[dr.select(k < size, k, MOST_LIGHTS - 1 - (k - size))].node, begin + k, there)
        dr.scatter(whose, group, begin + k)
        k += 1
    return size + single


def _in_order(lights: LightTree, node: mi.UInt32, whose: mi.UInt32, begin: mi.UInt32, wanted: mi.UInt32) -> mi.UInt32:
    """Put the clusters of each group in the order of the tree: those beside each other are seen alike, and rays that are allocated
    evenly along them see about as much as is seen of all."""
    above = dr.lzcnt(node) - dr.lzcnt(lights.leaves_opaque)
    # By the first leaf; entries without a cluster stay behind the others. The rows of a table, one a group, are sorted much faster
    # than all clusters together.
    key = dr.select(node > 0, ((node << above) - lights.leaves_opaque) << 5 | above, NOBODY)
    width = int(dr.max(wanted)[0])
    place = (
        whose * dr.opaque(mi.UInt32, width) + dr.arange(mi.UInt32, dr.width(node)) - dr.gather(mi.UInt32, begin, whose)
    )
    table = dr.opaque(mi.UInt32, NOBODY, width * dr.width(wanted))
    dr.scatter(table, key, place)
    ordered = upload(np.sort(table.numpy().reshape(-1, width), axis=1), mi.UInt32)
    key = dr.gather(mi.UInt32, ordered, place)
    return mi.UInt32(dr.select(key != NOBODY, ((key >> 5) + lights.leaves_opaque) >> (key & 31), 0))


def _draw(lights: LightTree, drawn_lights, place, node, whose, first, number) -> None:
    """Draw lights of each cluster in proportion to their intensity, a lane a light: those of one cluster walk down the same tree,
    side by side. By entry are given the cluster (none: 0) and whose it is; by group where its row begins, and its number."""
    lane = dr.arange(mi.UInt32, DRAWS * dr.width(node))
    entry, drawn = lane // DRAWS, lane % DRAWS
    node, group = (dr.gather(mi.UInt32, by_entry, entry) for by_entry in (node, whose))
    first, number = (dr.gather(mi.UInt32, by_group, group) for by_group in (first, number))
    there = node > 0
    u = mi.Float(((DRAWS * number + drawn) * GOLDEN + node * FRACTION) >> 8) * 2.0**-24
    light = draw(lights.strength, lights.leaves_opaque, node, u, there)
    leaf = light + lights.leaves_opaque
    strength, own = dr.gather(mi.Float, lights.strength, node, there), dr.gather(mi.Float, lights.strength, leaf, there)
    scale = dr.reinterpret_array(mi.UInt32, dr.select(own > 0, strength / own, 0))
    dr.scatter(drawn_lights, mi.Array2u(light, scale), lane, there)
    # The guide's clusters are smaller than some that are chosen: one of the lights tells where to look.
    dr.scatter(place, first + dr.gather(mi.UInt32, lights.owner, leaf, there), entry, there & (drawn == DRAWS - 1))
