"""The single pass on wide hardware: light is measured only where it is seen, and as well as it is seen.

Four kernels take the place of the paper's queue of triples, and none of them waits for another lane:

1. *touch*: every eye point walks the tree of irradiance samples by the profile alone, and marks the clusters of its cut;
2. *measure*: shadow rays, each from a member of a marked cluster to a light drawn from the light tree;
3. *gather*: every eye point sums its clusters, and four partial sums, from every fourth ray, tell how far off it is;
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

from ..light.light_samples import transmitted, visible
from ..model.profiles import ProfileTable
from .device import Source
from .light_guide import LightGuide, build_guide, sample_guided
from .light_tree import LUMINANCE, ONE_MINUS_EPSILON, LightTree
from .sample_tree import SAMPLE_PACKETS, Placement, SampleTree
from .walk import walk

GROUPS = 4
RAYS_AT_ONCE = 1 << 22
REGION, REGION_POINTS = 64, 16
"""Clusters to a region that learns which lights it sees, and points by which it begins."""

R2 = (3242174889, 2447445414)
"""Multiples of these fractions of 2^32 fill the unit square evenly: 1/g and 1/g^2, g^3 = g + 1 (M. Roberts, 2018)."""


@dataclass
class AdaptiveSettings:
    """How far the measuring goes.

    Attributes
    ----------
    max_error : float
        Largest relative error of the exitance that is asked for; about two standard deviations are held below it.
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

    ``slots`` maps a copy's node to its slot; ``rays`` counts the rays of a slot, ``total`` sums what they found, and
    ``groups`` the luminance of every fourth of them.
    """

    slots: mi.UInt32
    node: mi.UInt32
    copy: mi.UInt32
    rays: mi.UInt32
    total: mi.Color3f
    groups: mi.Array4f
    region: mi.UInt32

    def light(self) -> mi.Float:
        """Lay out mean irradiance: two packets a slot, colours, and the estimates of the four groups."""
        count = dr.width(self.node)
        light = dr.zeros(mi.Float, 8 * count)
        per_ray = dr.rcp(mi.Float(dr.maximum(self.rays, 1)))
        slot = dr.arange(mi.UInt32, count) * 2
        mean = self.total * per_ray
        dr.scatter(light, mi.Array4f(mean.x, mean.y, mean.z, 0), slot)
        dr.scatter(light, self.groups * (GROUPS * per_ray), slot + 1)
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
    """The exitance of eye points: its colours, luminance by group, the sum of the profile alone, and its terms."""

    exitance: mi.Color3f
    groups: mi.Array4f
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
    dr.eval(p, copy)
    clusters = _touch(cut, p, copy)
    guide = _guide(cut, lights, clusters)
    effort.clusters = dr.width(clusters.node)
    sums = _gather(cut, clusters, dr.full(mi.Float, 1, 8 * effort.clusters), p, copy)
    wanted = settings.first_rays / tolerance
    asking = dr.arange(mi.UInt32, dr.width(p))
    while dr.width(asking):
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
        total=dr.zeros(mi.Color3f, count),
        groups=dr.zeros(mi.Array4f, count),
        region=mi.UInt32(0),
    )
    dr.eval(clusters)
    return clusters


def _guide(cut: Cut, lights: LightTree, clusters: Clusters) -> LightGuide:
    """Join clusters that lie in one part of the tree to regions, and begin a guide with a few points of each."""
    node, copy = clusters.node.numpy(), clusters.copy.numpy()
    level = np.floor(np.log2(node)).astype(np.int64)
    seen = len(np.unique(copy)) * cut.samples.leaves / max(len(node), 1)  # leaves to a cluster that is seen
    top = max(cut.samples.depth - int(np.log2(REGION * max(seen, 1))), 0)
    region = node >> np.maximum(level - top, 0)
    keys, number = np.unique(copy.astype(np.int64) * 2 * cut.samples.leaves + region, return_inverse=True)
    clusters.region = mi.UInt32(number.astype(np.uint32))
    copies_of_region, nodes_of_region = keys // (2 * cut.samples.leaves), keys % (2 * cut.samples.leaves)
    _, around = np.unique(copies_of_region * 2 * cut.samples.leaves + (nodes_of_region >> 4), return_inverse=True)
    points = np.repeat(keys, REGION_POINTS)
    v = (np.arange(len(points)) % REGION_POINTS + 0.5) / REGION_POINTS
    leaf = _member(cut.samples, mi.UInt32((points % (2 * cut.samples.leaves)).astype(np.uint32)), mi.Float(v))
    copies = mi.UInt32((points // (2 * cut.samples.leaves)).astype(np.uint32))
    si = cut.samples.receiver(leaf, cut.placement, copies)
    dr.eval(si)
    return build_guide(lights, si.p, si.sh_frame.n, REGION_POINTS, around)


def _measure(scene: mi.Scene, cut: Cut, lights: LightTree, guide: LightGuide, clusters: Clusters, demand: mi.Float) -> int:
    """Trace the rays that are missing in each slot; returns how many were traced."""
    have = clusters.rays.numpy().astype(np.int64)
    missing = np.maximum(np.ceil(demand.numpy()).astype(np.int64) - have, 0)
    end = np.cumsum(missing)
    traced, first, before = 0, 0, 0
    while before < (end[-1] if len(end) else 0):
        last = max(int(np.searchsorted(end, before + RAYS_AT_ONCE, side="right")), first + 1)
        ray_slot = mi.UInt32(np.repeat(np.arange(first, last, dtype=np.uint32), missing[first:last]))
        value, count = _rays(scene, cut, lights, guide, clusters, ray_slot, before + int(have.sum()))
        starts = mi.UInt32((end[first:last] - missing[first:last] - before).astype(np.uint32))
        _add(clusters, value, first, starts, mi.UInt32(missing[first:last].astype(np.uint32)))
        traced += count
        first, before = last, int(end[last - 1])
    guide.learn()
    return traced


def _rays(scene, cut: Cut, lights: LightTree, guide: LightGuide, clusters: Clusters, slot: mi.UInt32, number: int):
    """Trace one ray for each entry of ``slot``: the light that enters at a member of the cluster; and count them."""
    index = dr.arange(mi.UInt32, dr.width(slot)) + dr.opaque(mi.UInt32, number % 2**32)
    u, v = (mi.Float((index * mi.UInt32(step)) >> 8) * 2.0**-24 for step in R2)
    copy = dr.gather(mi.UInt32, clusters.copy, slot)
    leaf = _member(cut.samples, dr.gather(mi.UInt32, clusters.node, slot), v)
    si = cut.samples.receiver(leaf, cut.placement, copy)
    n = si.sh_frame.n
    light, weight, entry = sample_guided(guide, lights, dr.gather(mi.UInt32, clusters.region, slot), si.p, n, u)
    direction, distance, irradiance = lights.lights.arriving(light, si.p, n, weight > 0)
    lit = dr.any(irradiance > 0)
    seen = visible(scene, si, direction, distance, lit)
    dr.scatter_add(guide.tried, mi.UInt32(1), entry, lit)
    dr.scatter_add(guide.seen, mi.UInt32(1), entry, seen)
    packet = dr.gather(mi.Array4f, cut.samples.samples, leaf * SAMPLE_PACKETS + 4)
    factor = weight * transmitted(dr.dot(direction, n), dr.opaque(mi.Float, cut.eta))
    value = dr.select(seen, irradiance * factor * mi.Color3f(packet[0], packet[1], packet[2]), 0)
    traced = dr.count(lit)
    dr.eval(value, traced, guide.tried, guide.seen)
    return value, int(traced[0])


@dr.syntax
def _member(samples: SampleTree, node: mi.UInt32, v: mi.Float) -> mi.UInt32:
    """Draw a sample of a cluster in proportion to its area."""
    leaves = dr.opaque(mi.UInt32, samples.leaves)
    node, v = mi.UInt32(node), mi.Float(v)
    total = dr.gather(mi.Float, samples.strength, node)
    while dr.hint(node < leaves, label="pellucid member"):
        node = node << 1
        left = dr.gather(mi.Float, samples.strength, node)
        share = left / total
        is_right = v >= share
        v = dr.select(is_right, (v - share) / (1 - share), v / share)
        v = dr.clip(v, 0, ONE_MINUS_EPSILON)
        node = dr.select(is_right, node + 1, node)
        total = dr.select(is_right, total - left, left)
    return node - leaves


@dr.syntax
def _add(clusters: Clusters, value: mi.Color3f, first: int, start: mi.UInt32, count: mi.UInt32) -> None:
    """Add rays to the sums of consecutive slots, each by a lane of its own: in the same order whatever the machine."""
    slot = dr.arange(mi.UInt32, dr.width(start)) + dr.opaque(mi.UInt32, first)
    rays = dr.gather(mi.UInt32, clusters.rays, slot)
    total = dr.gather(mi.Color3f, clusters.total, slot)
    groups = dr.gather(mi.Array4f, clusters.groups, slot)
    k = dr.zeros(mi.UInt32, dr.width(start))
    while dr.hint(k < count, label="pellucid add"):
        found = dr.gather(mi.Color3f, value, start + k)
        total += found
        # Every fourth ray of the whole list is of one group: a group is spread over clusters as evenly as all are.
        groups += dr.select(mi.Array4u(0, 1, 2, 3) == ((start + k) & 3), _luminance(found), 0)
        k += 1
    dr.scatter(clusters.rays, rays + count, slot)
    dr.scatter(clusters.total, total, slot)
    dr.scatter(clusters.groups, groups, slot)
    dr.eval(clusters)


def _gather(cut: Cut, clusters: Clusters, light: mi.Float, p: mi.Point3f, copy: mi.UInt32) -> Sums:
    """Sum the light of the clusters of every cut (AWB08 eq. 8-9, with the inner sum over lights done)."""
    offset = copy * dr.opaque(mi.UInt32, 2 * cut.samples.leaves)
    count = dr.width(p)

    def visit(sums, node, weight, accepted):
        slot = dr.gather(mi.UInt32, clusters.slots, offset + node, accepted)
        mean = dr.gather(mi.Array4f, light, 2 * slot, accepted)
        groups = dr.gather(mi.Array4f, light, 2 * slot + 1, accepted)
        bright = _luminance(weight)
        exitance = dr.fma(weight, mi.Color3f(mean[0], mean[1], mean[2]), sums.exitance)
        return Sums(exitance, dr.fma(groups, bright, sums.groups), sums.profile + bright, sums.terms + dr.select(accepted, mi.UInt32(1), 0))

    start = Sums(dr.zeros(mi.Color3f, count), dr.zeros(mi.Array4f, count), dr.zeros(mi.Float, count), dr.zeros(mi.UInt32, count))
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
        dr.scatter_reduce(dr.ReduceOp.Max, demand, per_weight * _luminance(weight), slot, accepted)
        return state

    walk(cut.samples, cut.source, dr.gather(mi.Point3f, p, asking), (), visit)
    dr.eval(demand)
    return demand


def _ask(sums: Sums, wanted: mi.Float, tolerance: mi.Float, settings: AdaptiveSettings) -> tuple[mi.Float, mi.UInt32]:
    """Find the eye points whose groups differ by too much, and how many rays they want next."""
    mean = dr.sum(sums.groups) / GROUPS
    away = sums.groups - mean
    variance = dr.sum(away * away) / (GROUPS * (GROUPS - 1)) / dr.square(dr.maximum(mean, 1e-30))
    dr.eval(variance)
    # Four groups are few; neighbours on the surface are as uncertain.
    count = dr.width(variance)
    index = dr.arange(mi.Int32, count)
    around = sum(dr.gather(mi.Float, variance, dr.clip(index + k, 0, count - 1)) for k in (-2, -1, 0, 1, 2)) / 5
    excess = dr.sqrt(dr.maximum(around, variance / 3)) * (2 / (settings.max_error * tolerance))
    asks = (excess > 1) & (wanted < settings.most_rays)
    more = dr.clip(dr.power(excess, 1.5), 1.2, 4)
    wanted = dr.select(asks, dr.minimum(wanted * more, settings.most_rays), wanted)
    dr.eval(wanted, asks)
    return wanted, dr.compress(asks)


def _luminance(colour: Any) -> Any:
    """Weigh red, green and blue."""
    red, green, blue = (float(w) for w in LUMINANCE)
    return red * colour.x + green * colour.y + blue * colour.z
