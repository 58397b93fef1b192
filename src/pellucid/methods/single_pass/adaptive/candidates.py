"""The lights that stand for all lights on a patch of the surface: some of each cluster of a cut through the light tree.

Neighbours see nearly the same lights, so a cut is divided, and lights are drawn, for a patch of them at once; what the lights
send is then found out for each of them, by one light of each cluster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....kernels.heap import push, replace_top
from ....kernels.memory import columns, upload
from ..trees.descent import draw
from ..trees.light_tree import CLUSTERS, NOBODY, LightTree, importance

MOST_LIGHTS = 2048
"""Most lights of a patch, 8 bytes of local memory each while they are chosen."""

SEEN = 1 << 16

DRAWS = 8
"""Lights that are drawn of each cluster. Receivers take them in turn, so that neighbours do not share what one light has too much
of; what is learnt of a cluster's visibility they share."""

DOUBT = 0.0075
"""What seems certain is doubted by so much, so that errors are found, and the estimate has no bias."""

TRUST = 1.5
"""Rays that what is expected of a cluster of lights counts for when rays to it arrive: it is known from clusters around it and from
patches nearby, and neighbours mostly see the same lights alike."""

UNSEEN = 0.5
"""How much clusters of lights count that a patch does not see, relative to those it sees."""

HUGE = 1e30

GOLDEN, FRACTION = 2654435769, 3242174889
"""Fractions of 2^32 whose multiples fill the unit interval evenly: the golden ratio's inverse along patches, and the plastic
number's along nodes of lights. So neighbouring patches draw lights evenly from a cluster that they share, and what one of
them has too much of the others have too little of."""


@dataclass
class Patch:
    """Spheres around points that lie beside each other, and cones around their normals: axis and cosine."""

    centre: mi.Point3f
    radius: mi.Float
    axis: mi.Normal3f
    cos_cone: mi.Float


def bound_patches(p: NDArray, n: NDArray, patch: NDArray) -> Patch:
    """Bound the points of each patch.

    Parameters
    ----------
    p, n : (k, 3) float
        Points and their normals.
    patch : (k,) int
        The patch of each point: 0 and up, without a gap.
    """
    starts = np.flatnonzero(np.diff(patch, prepend=-1))
    size = np.bincount(patch)
    centre = np.add.reduceat(p, starts) / size[:, None]
    radius = np.sqrt(np.maximum.reduceat(np.square(p - centre[patch]).sum(axis=1), starts)) * (1 + 1e-5)
    axis = np.add.reduceat(n, starts)
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-6)[:, None]
    cosine = np.minimum.reduceat((n * axis[patch]).sum(axis=1), starts) - 1e-5
    (radius,), (cosine,) = columns(radius[:, None]), columns(np.where(size > 1, cosine, 1)[:, None])
    return Patch(mi.Point3f(*columns(centre)), radius, mi.Normal3f(*columns(axis)), cosine)


@dataclass
class ChosenLights:
    """Up to `MOST_LIGHTS` clusters of lights of each of r patches, those of one beside each other, and some lights of each.

    Attributes
    ----------
    first, count : UInt32
        The entry of the first, and their number, by patch.
    packets : UInt32
        Pairs of numbers, `DRAWS` + 1 an entry. As bits of floats: the share of the patch that is expected to see the cluster,
        and how much that is in doubt. Then by drawn light: its number, and as bits of a float what multiplies it to stand for
        its cluster.
    place : UInt32
        By entry where what the guide knows of it stands.
    rays, known : UInt32
        By entry the rays that were traced to it, plus `SEEN` times those that arrived: of late, and those that were learnt from.
    """

    first: mi.UInt32
    count: mi.UInt32
    packets: mi.UInt32
    place: mi.UInt32
    rays: mi.UInt32
    known: mi.UInt32

    def fetch(self, entry: Any, drawn: Any) -> tuple[mi.UInt32, mi.Float, mi.Float, mi.Float]:
        """Fetch one of the lights drawn of a cluster: its number, what multiplies it, its visibility, and the doubt about that."""
        pair = (DRAWS + 1) * entry
        light, scale = dr.gather(mi.Array2u, self.packets, pair + 1 + drawn)
        expected = dr.gather(mi.Array2u, self.packets, pair)
        scale, visibility, doubt = (dr.reinterpret_array(mi.Float, bits) for bits in (scale, expected[0], expected[1]))
        return light, scale, visibility, doubt

    def expect(self, around: mi.Float) -> None:
        """Set the visibility of all clusters, by entry, to what is known around them and what rays have taught."""
        entry = dr.arange(mi.UInt32, dr.width(around))
        tried, seen = mi.Float(self.known % SEEN), mi.Float(self.known // SEEN)
        visibility = dr.fma(TRUST, around, seen) / (TRUST + tried)
        doubt = DOUBT + dr.sqrt(visibility * (1 - visibility))
        both = mi.Array2u(*(dr.reinterpret_array(mi.UInt32, value) for value in (visibility, doubt)))
        dr.scatter(self.packets, both, (DRAWS + 1) * entry)
        dr.eval(self.packets)

    def hindsight(self, entry: Any, but: Any = 0, seen: Any = 0) -> mi.Float:
        """Tell the visibility that is to be expected of a cluster after the rays of late, but for one of them, which arrived or not."""
        visibility = dr.reinterpret_array(mi.Float, dr.gather(mi.Array2u, self.packets, (DRAWS + 1) * entry)[0])
        known, rays = (dr.gather(mi.UInt32, counts, entry) for counts in (self.known, self.rays))
        trust = TRUST + mi.Float(known % SEEN)
        return dr.fma(visibility, trust, mi.Float(rays // SEEN) - seen) / (trust + mi.Float(rays % SEEN) - but)

    def count_ray(self, entry: Any, seen: Any) -> None:
        """Count a ray to a light of a cluster."""
        # Direct: other modes have kernels of their own for tables of each size.
        one = dr.select(seen, mi.UInt32(1 + SEEN), 1)
        dr.scatter_add(self.rays, one, entry, mode=dr.ReduceMode.Direct)


@dataclass
class Cluster:
    """A cluster of lights, and the luminance that it may send."""

    bound: mi.Float
    node: mi.UInt32


def choose_lights(
    lights: LightTree, visibility: mi.Float, patch: Patch, row: mi.UInt32, number: mi.UInt32, wanted: mi.UInt32
) -> ChosenLights:
    """Divide the lights into as many clusters as are wanted, always the one that may send most, as far as it is known to be seen;
    and draw some lights of each.

    Nothing that can send light to a point of the patch is left out: what is chosen stands for all lights, without bias.

    Parameters
    ----------
    visibility : Float
        The expected visibility of each cluster of lights, row by row (`visibility.LightGuide`).
    row : UInt32
        The row that tells of each patch.
    number : UInt32
        A running number of each patch, which its random numbers come from.
    wanted : UInt32
        Clusters, up to `MOST_LIGHTS`.

    Source: cuts as in WFABDG05, by number.
    """
    count = dr.width(number)
    begin = dr.prefix_sum(wanted)
    room = int(dr.sum(wanted)[0])
    packets = dr.empty(mi.UInt32, 2 * (DRAWS + 1) * room)
    zero = dr.opaque(mi.UInt32, 0, count)
    heap = dr.alloc_local(Cluster, MOST_LIGHTS)
    first = row * CLUSTERS
    dr.eval(first)
    heap, size, single = _divide(lights, lights.owner, visibility, patch, first, heap, wanted, zero)
    place, rays, known, node, whose = (dr.opaque(mi.UInt32, 0, room) for _ in range(5))
    entries = _unload(heap, size, single, wanted, begin, node, whose)
    dr.eval(entries, node, whose)
    _draw(lights, packets, place, _in_order(lights, node, whose, begin, wanted), whose, first, number)
    chosen = ChosenLights(begin, entries, packets, place, rays, known)
    dr.eval(chosen)
    return chosen


@dr.syntax
def _divide(lights: LightTree, owner, visibility, patch: Patch, first, heap, wanted, zero):
    """Divide clusters; returns the heap of them, their number, and that of single lights at the end of its memory."""
    heap[zero] = Cluster(mi.Float(HUGE) + mi.Float(zero), mi.UInt32(1) + zero)
    size, single = zero + 1, mi.UInt32(zero)
    while dr.hint((size > 0) & (size + single < wanted), label="pellucid choose"):
        left = 2 * heap[zero].node
        one = _expected(lights, owner, visibility, patch, first, left)
        other = _expected(lights, owner, visibility, patch, first, left + 1)
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


def _expected(lights: LightTree, owner, visibility, patch: Patch, first, node):
    """Bound what a cluster of lights may send to a patch, as far as it is known to be seen."""
    cluster = dr.gather(mi.UInt32, owner, node)
    known = cluster != NOBODY
    share = dr.gather(mi.Float, visibility, first + cluster, known)
    seen = dr.select(known, dr.fma(1 - UNSEEN, share, UNSEEN), 1)
    return seen * importance(lights, node, patch.centre, patch.axis, patch.radius, patch.cos_cone)


@dr.syntax
def _unload(heap, size, single, wanted, begin, node, whose):
    """Store the clusters of each patch by entry, and whose all of the entries are: returns the number of clusters."""
    patch, k = dr.arange(mi.UInt32, dr.width(size)), mi.UInt32(0)
    while dr.hint(k < wanted, label="pellucid unload"):
        there = k < size + single
        dr.scatter(node, heap[dr.select(k < size, k, MOST_LIGHTS - 1 - (k - size))].node, begin + k, there)
        dr.scatter(whose, patch, begin + k)
        k += 1
    return size + single


def _in_order(lights: LightTree, node: mi.UInt32, whose: mi.UInt32, begin: mi.UInt32, wanted: mi.UInt32) -> mi.UInt32:
    """Put the clusters of each patch in the order of the tree: those beside each other are seen alike, and rays that are dealt out
    evenly along them see about as much as is seen of all."""
    above = dr.lzcnt(node) - dr.lzcnt(lights.leaves_opaque)
    # By the first leaf; entries without a cluster stay behind the others. The rows of a table, one a patch, are sorted much faster
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


def _draw(lights: LightTree, packets, place, node, whose, first, number) -> None:
    """Draw lights of each cluster in proportion to their intensity, a lane a light: those of one cluster walk down the same tree,
    side by side. By entry are given the cluster (none: 0) and whose it is; by patch where its row begins, and its number."""
    lane = dr.arange(mi.UInt32, DRAWS * dr.width(node))
    entry, drawn = lane // DRAWS, lane % DRAWS
    node, patch = (dr.gather(mi.UInt32, by_entry, entry) for by_entry in (node, whose))
    first, number = (dr.gather(mi.UInt32, by_patch, patch) for by_patch in (first, number))
    there = node > 0
    u = mi.Float(((DRAWS * number + drawn) * GOLDEN + node * FRACTION) >> 8) * 2.0**-24
    light = draw(lights.strength, lights.leaves_opaque, node, u, there)
    leaf = light + lights.leaves_opaque
    strength, own = dr.gather(mi.Float, lights.strength, node, there), dr.gather(mi.Float, lights.strength, leaf, there)
    scale = dr.reinterpret_array(mi.UInt32, dr.select(own > 0, strength / own, 0))
    dr.scatter(packets, mi.Array2u(light, scale), (DRAWS + 1) * entry + 1 + drawn, there)
    # The guide's clusters are smaller than some that are chosen: one of the lights tells where to look.
    dr.scatter(place, first + dr.gather(mi.UInt32, lights.owner, leaf, there), entry, there & (drawn == DRAWS - 1))
