"""The single pass on wide hardware: light is measured only where it is seen, and as well as it is seen.

Four kernels take the place of the paper's queue of triples, and none of them waits for another lane:

1. *touch*: every eye point walks the tree of irradiance samples by the profile alone, and marks the clusters of its cut;
2. *measure*: the light that enters at members of the marked clusters, by a few shadow rays each;
3. *gather*: every eye point sums its clusters, and the difference of two halves of the rays tells how far off it is;
4. *demand*: eye points that are further off than was asked ask more of their clusters, each by its share of the sum.

Steps 2 to 4 repeat until no eye point asks. A cluster traces as many rays as the most demanding eye point wants, and all of
them serve every eye point: nothing is computed twice, and there is nothing to cache.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..progress import chunks, steps
from .device import Source
from .draw import draw
from .light_guide import LightGuide, build_guide
from .light_tree import LightTree, luminance
from .sample_tree import SAMPLE_PACKETS, Placement, SampleTree
from .sampled_cut import sampled_cut
from .walk import walk

RECEIVERS_AT_ONCE = 1 << 18
MOST_RAYS = 32
"""Rays of one receiver: a cluster that wants more has its light measured at several members, or anew."""

R2 = 2447445414
"""Multiples of this fraction of 2^32 fill the unit interval evenly, also beside those of `sampled_cut.FRACTION`."""

REGION, AROUND_LEVELS = 128, 4
"""Clusters to a region that learns which lights it sees, and levels of the tree to the larger region around it."""

MOST_ROUNDS = 5
"""After so many rounds only stragglers still ask, a few in ten thousand."""

MOST_MORE = 8
"""Eye points ask for at most so many times as many rays as they had: the first estimates of their errors are rough."""

NEIGHBOURS = 5
"""Neighbouring eye points by which the error of one is judged: one difference alone may be small by chance."""


@dataclass
class AdaptiveSettings:
    """How far the measuring goes.

    Attributes
    ----------
    max_error : float
        Relative error of the exitance that is asked for: two standard deviations of what is left to chance.
    first_rays : int
        Rays an eye point begins with, shared with its neighbours.
    most_rays : int
        Rays at which an eye point stops asking.
    """

    max_error: float = 0.02
    first_rays: int = 64
    most_rays: int = 8192


@dataclass
class Cut:
    """The copies of a prototype that are seen, and how they are walked: ``copies (k,)`` are their numbers in ``placement``."""

    samples: SampleTree
    placement: Placement
    source: Source
    eta: float
    copies: np.ndarray


@dataclass
class Clusters:
    """The clusters that are seen: slot by slot, in the order of the tree.

    ``slots`` maps a copy's node to its slot; ``rays`` counts the rays of a slot, and ``first`` and ``second`` sum the light
    that two halves of them found, each times the rays. ``region`` numbers the region of the surface that a slot lies in.
    """

    slots: mi.UInt32
    node: mi.UInt32
    copy: mi.UInt32
    rays: mi.UInt32
    first: mi.Color3f
    second: mi.Color3f
    region: mi.UInt32

    def light(self) -> mi.Float:
        """Lay out a packet a slot: mean irradiance, and half the difference of the luminance of the two halves."""
        half = 0.5 * dr.rcp(mi.Float(dr.maximum(self.rays, 1)))
        mean = (self.first + self.second) * half
        difference = (luminance(self.first) - luminance(self.second)) * half
        light = dr.zeros(mi.Float, 4 * dr.width(self.node))
        dr.scatter(light, mi.Array4f(mean.x, mean.y, mean.z, difference), dr.arange(mi.UInt32, dr.width(self.node)))
        return light


@dataclass
class Effort:
    """What was spent: rays, clusters that were lit, terms of all sums, and eye points that asked, round by round."""

    shadow_rays: int = 0
    clusters: int = 0
    links: int = 0
    rounds: list[int] = field(default_factory=list)


@dataclass
class Sums:
    """The exitance of eye points, half the difference of two halves of it, the sum of the profile alone, and its terms."""

    exitance: mi.Color3f
    difference: mi.Float
    profile: mi.Float
    terms: mi.UInt32


def adaptive_exitance(
    scene: mi.Scene,
    cut: Cut,
    lights: LightTree,
    p: mi.Point3f,
    copy: mi.UInt32,
    tolerance: mi.Float,
    settings: AdaptiveSettings,
) -> tuple[mi.Color3f, Effort]:
    """Compute the radiant exitance of eye points on the copies of one prototype.

    Parameters
    ----------
    p : Point3f
        Eye points in the space of the prototype; neighbours in the array should be neighbours in space.
    copy : UInt32
        For each of them which of the k copies of ``cut`` it lies on.
    tolerance : Float
        For each of them what multiplies ``max_error``.
    """
    effort = Effort()
    dr.eval(p, copy, tolerance)
    clusters = _touch(cut, p, copy)
    guide = _guide(cut, lights, clusters)
    effort.clusters = dr.width(clusters.node)
    sums = _gather(cut, clusters, dr.full(mi.Float, 1, 4 * effort.clusters), p, copy)
    wanted = settings.first_rays / tolerance
    asking = dr.arange(mi.UInt32, dr.width(p))
    while dr.width(asking) and len(effort.rounds) < MOST_ROUNDS:
        effort.rounds.append(dr.width(asking))
        demand = _demand(cut, clusters, sums, wanted, p, copy, asking)
        effort.shadow_rays += _measure(scene, cut, lights, guide, clusters, demand)
        sums = _gather(cut, clusters, clusters.light(), p, copy)
        wanted, asking = _ask(sums, wanted, tolerance, settings)
    effort.links = int(sums.terms.numpy().sum(dtype=np.int64))
    return sums.exitance, effort


# ------------------------------------------------------------------ the four kernels


def _touch(cut: Cut, p: mi.Point3f, copy: mi.UInt32) -> Clusters:
    """Mark the clusters of all cuts, and give each a slot."""
    nodes = 2 * cut.samples.leaves
    marks = dr.zeros(mi.UInt32, nodes * len(cut.copies))
    offset = copy * dr.opaque(mi.UInt32, nodes)

    def visit(state, node, weight, accepted):
        dr.scatter(marks, mi.UInt32(1), offset + node, accepted)
        return state

    walk(cut.samples, cut.source, p, (), visit)
    dr.eval(marks)
    place = dr.compress(marks != 0)
    count = dr.width(place)
    dr.scatter(marks, dr.arange(mi.UInt32, count), place)
    numbers = mi.UInt32(cut.copies.astype(np.uint32))
    clusters = Clusters(
        slots=marks,
        node=place % dr.opaque(mi.UInt32, nodes),
        copy=dr.gather(mi.UInt32, numbers, place // dr.opaque(mi.UInt32, nodes)),
        rays=dr.zeros(mi.UInt32, count),
        first=dr.zeros(mi.Color3f, count),
        second=dr.zeros(mi.Color3f, count),
        region=mi.UInt32(0),
    )
    dr.eval(clusters)
    return clusters


def _guide(cut: Cut, lights: LightTree, clusters: Clusters) -> LightGuide:
    """Join clusters that lie in one part of the tree to regions, and those to larger ones."""
    node, copy = clusters.node.numpy(), clusters.copy.numpy().astype(np.int64)
    level = np.floor(np.log2(node)).astype(np.int64)
    per_cluster = len(cut.copies) * cut.samples.leaves / len(node)  # leaves to a cluster that is seen
    top = max(cut.samples.depth - int(np.log2(REGION * max(per_cluster, 1))), 0)
    region = copy << 32 | node >> np.maximum(level - top, 0)
    keys, number = np.unique(region, return_inverse=True)
    clusters.region = mi.UInt32(number.astype(np.uint32))
    around = keys >> 32 << 32 | (keys & 0xFFFFFFFF) >> AROUND_LEVELS
    return build_guide(lights, np.unique(around, return_inverse=True)[1])


def _measure(
    scene: mi.Scene, cut: Cut, lights: LightTree, guide: LightGuide, clusters: Clusters, demand: mi.Float
) -> int:
    """Trace the rays that are missing; returns how many were traced."""
    receivers, each = _share_out(demand.numpy(), clusters.rays.numpy().astype(np.int64))
    slot = np.repeat(np.arange(len(receivers), dtype=np.uint32), receivers)
    before, traced = int(clusters.rays.numpy().sum(dtype=np.int64)) % 2**32, 0
    if len(slot) == 0:
        return 0
    found = [dr.empty(mi.Color3f, len(slot)) for _ in range(2)]
    for first, size in steps("irradiance", chunks(len(slot), RECEIVERS_AT_ONCE), "receivers"):
        here = mi.UInt32(slot[first : first + size])
        rays = mi.UInt32(each[slot[first : first + size]].astype(np.uint32))
        # In memory of Dr.Jit's own: kernels are compiled anew for arrays of another alignment.
        nothing = dr.opaque(mi.UInt32, 0)
        here, rays = here + nothing, rays + nothing
        dr.eval(here, rays)
        estimate = _light(scene, cut, lights, guide, clusters, here, rays, before + first)
        index = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
        for target, value in zip(found, (estimate.first, estimate.second), strict=True):
            dr.scatter(target, value * mi.Float(rays), index)
        traced += int(estimate.traced.numpy().sum(dtype=np.int64))
    end = np.cumsum(receivers)
    start, count = (mi.UInt32(a.astype(np.uint32)) for a in (end - receivers, receivers))
    _add(clusters, found, start, count, mi.UInt32((receivers * each).astype(np.uint32)))
    guide.learn()
    return traced


def _share_out(demand: np.ndarray, have: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn rays that are wanted into receivers a slot, and the rays of each, an even number.

    Every slot gets its own rays, however few: light lent by neighbours that were measured more densely, because it is dark
    there, makes the edges of shadows too dark.
    """
    missing = np.maximum(2 * np.ceil(demand / 2).astype(np.int64) - have, 0)
    receivers = -(-missing // MOST_RAYS)
    return receivers, 2 * -(-missing // np.maximum(2 * receivers, 1))


def _light(
    scene,
    cut: Cut,
    lights: LightTree,
    guide: LightGuide,
    clusters: Clusters,
    slot: mi.UInt32,
    rays: mi.UInt32,
    number: int,
):
    """Measure the light that enters at a member of each cluster in ``slot``, times the texture there."""
    index = dr.arange(mi.UInt32, dr.width(slot)) + dr.opaque(mi.UInt32, number % 2**32)
    v = mi.Float((index * mi.UInt32(R2)) >> 8) * 2.0**-24
    node, leaves = dr.gather(mi.UInt32, clusters.node, slot), dr.opaque(mi.UInt32, cut.samples.leaves)
    leaf = draw(cut.samples.strength, leaves, node, v)
    si = cut.samples.receiver(leaf, cut.placement, dr.gather(mi.UInt32, clusters.copy, slot))
    estimate = sampled_cut(
        scene, si, dr.opaque(mi.Float, cut.eta), lights, guide, dr.gather(mi.UInt32, clusters.region, slot), rays, index
    )
    packet = dr.gather(mi.Array4f, cut.samples.samples, leaf * SAMPLE_PACKETS + 4)
    colour = mi.Color3f(packet[0], packet[1], packet[2])
    estimate.first *= colour
    estimate.second *= colour
    dr.eval(estimate, guide.tried, guide.seen)
    return estimate


@dr.syntax
def _add(clusters: Clusters, found: list[mi.Color3f], start: mi.UInt32, count: mi.UInt32, rays: mi.UInt32) -> None:
    """Add what receivers found to their slots, each by a lane of its own: in the same order whatever the machine."""
    first, second = mi.Color3f(clusters.first), mi.Color3f(clusters.second)
    k = dr.zeros(mi.UInt32, dr.width(start))
    while dr.hint(k < count, label="pellucid add"):
        first += dr.gather(mi.Color3f, found[0], start + k)
        second += dr.gather(mi.Color3f, found[1], start + k)
        k += 1
    clusters.first, clusters.second, clusters.rays = first, second, clusters.rays + rays
    dr.eval(clusters)


def _gather(cut: Cut, clusters: Clusters, light: mi.Float, p: mi.Point3f, copy: mi.UInt32) -> Sums:
    """Sum the light of the clusters of every cut (AWB08 eq. 8-9, with the inner sum over lights done)."""
    offset = copy * dr.opaque(mi.UInt32, 2 * cut.samples.leaves)
    count = dr.width(p)

    def visit(sums, node, weight, accepted):
        slot = dr.gather(mi.UInt32, clusters.slots, offset + node, accepted)
        found = dr.gather(mi.Array4f, light, slot, accepted)
        bright = luminance(weight)
        return Sums(
            dr.fma(weight, mi.Color3f(found[0], found[1], found[2]), sums.exitance),
            dr.fma(bright, found[3], sums.difference),
            sums.profile + bright,
            sums.terms + dr.select(accepted, mi.UInt32(1), 0),
        )

    start = Sums(
        dr.zeros(mi.Color3f, count), dr.zeros(mi.Float, count), dr.zeros(mi.Float, count), dr.zeros(mi.UInt32, count)
    )
    sums = walk(cut.samples, cut.source, p, start, visit)
    dr.eval(sums)
    return sums


def _demand(cut: Cut, clusters: Clusters, sums: Sums, wanted, p, copy, asking: mi.UInt32) -> mi.Float:
    """Share the rays that eye points want among their clusters, and keep the largest share of each.

    Shares go by the profile alone: by the light that was found until now, clusters that by chance found too little would
    get fewer rays and keep their error, and those that found too much would lose it: a bias of a per cent.
    """
    demand = dr.zeros(mi.Float, dr.width(clusters.node))
    offset = dr.gather(mi.UInt32, copy, asking) * dr.opaque(mi.UInt32, 2 * cut.samples.leaves)
    per_weight = dr.gather(mi.Float, wanted, asking) / dr.gather(mi.Float, sums.profile, asking)

    def visit(state, node, weight, accepted):
        slot = dr.gather(mi.UInt32, clusters.slots, offset + node, accepted)
        dr.scatter_reduce(dr.ReduceOp.Max, demand, per_weight * luminance(weight), slot, accepted)
        return state

    walk(cut.samples, cut.source, dr.gather(mi.Point3f, p, asking), (), visit)
    dr.eval(demand)
    return demand


def _ask(sums: Sums, wanted: mi.Float, tolerance: mi.Float, settings: AdaptiveSettings) -> tuple[mi.Float, mi.UInt32]:
    """Find the eye points whose halves differ by too much, and how many rays they want next."""
    error = sums.difference / dr.maximum(luminance(sums.exitance), 1e-30)
    dr.eval(error)
    count = dr.width(error)
    index = dr.arange(mi.Int32, count)
    total: Any = 0
    for k in range(-(NEIGHBOURS // 2), NEIGHBOURS // 2 + 1):
        total += dr.square(dr.gather(mi.Float, error, dr.clip(index + k, 0, dr.opaque(mi.Int32, count) - 1)))
    excess = dr.sqrt(total / NEIGHBOURS) * (2 / settings.max_error) / tolerance
    asks = (excess > 1) & (wanted < settings.most_rays)
    more = dr.clip(dr.square(excess), 2, MOST_MORE)
    wanted = dr.select(asks, dr.minimum(wanted * more, settings.most_rays), wanted)
    dr.eval(wanted, asks)
    return wanted, dr.compress(asks)
