"""The single pass on wide hardware: light is measured only where it is seen, and as well as it is seen.

Wide kernels take the place of the paper's queue of triples, and none of their lanes waits for another. For a view:

1. *importance pass*: every eye point walks the tree of irradiance samples by the profile alone, and adds up how much errors in the
   light of the clusters of its cut matter to it. The finest of all these clusters, and a coarse covering of what no eye point sees, are
   the cut whose light is measured;
2. *learn*: a few shadow rays from some of its clusters tell which lights each receiver group sees, and about how bright it is;
3. *measure*: the light that enters at a member of each cluster, by rays that are allocated by importance and standard deviation.

Afterwards *gather* sums, for any point, the light of the clusters of its own cut. What a point finds depends on no other.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....effort import count
from ....kernels.memory import upload
from ..samples import EyePoints
from ..trees.descent import draw
from ..trees.light_tree import LUMINANCE, NOBODY, LightTree, luminance
from .allocation import Measurement
from .copies import Copies
from .cut import Cut, find_cut
from .traversal import walk

FINEST = 0.06
"""Area of the smallest clusters, as a share of the squared distance between eye points."""

ISOLATED = 16.0
"""Mean free paths: eye points further from each other ask for clusters as if they were so far apart."""

DIM, GLARE = 0.3, 0.8
"""Shares of the mean exitance between which errors are relative. What is darker would take most of the rays, next to what outshines
it; and where it is brighter, light is seldom uncertain, and its errors weigh most in the picture."""

ALIKE = 16
"""One eye point in so many tells how bright the surface is around it, when it comes to which errors are allowed."""

LARGER, LARGEST = 0.5, 16.0
"""Share of the tolerance by which solid angles of clusters grow where other surfaces show points, and how much at most."""

WIDER, WIDEST = 0.25, 4.0
"""The same for the width of the smallest clusters. Their light is measured at one place of each, and what is wrong with that no ray
mends."""

DEVIATIONS = 1.52
"""Standard deviations that the largest error stands for: 87 of 100 errors are smaller."""

LITTLE = 1e-3
"""Weights below this share of a plane's have no importance: squared they are next to nothing, and there are many."""

ONE = 2.0**40
"""The importance of a cluster for an eye point that sees nothing else, in whole numbers, whose sum does not depend on the order."""

PLASTIC = 2447445414
"""Multiples of this fraction of 2^32 fill the unit interval evenly, also beside those of `candidates.FRACTION`."""


@dataclass
class AdaptiveSettings:
    """How far the measuring goes.

    Attributes
    ----------
    max_error : float
        Relative error of the exitance that rays may leave: `DEVIATIONS` standard deviations, in the mean over all eye points.
    first_rays : int
        Shadow rays of each cluster that learns.
    most_rays : int
        Most shadow rays of a cluster.
    """

    max_error: float = 0.02
    first_rays: int = 16
    most_rays: int = 8192


@dataclass
class Covering:
    """Clusters that are measured though no eye point asks for them: all nodes of one level of the tree of each copy.

    Each counts as much as an eye point in its middle whose error may be ``tolerance`` times as large.
    """

    level: int
    tolerance: float


@dataclass
class MeasuredLight:
    """The light of the clusters of a cut and of the nodes above them (`Cut.slots`, `Cut.mean_light`)."""

    copies: Copies
    slots: mi.UInt32
    mean: mi.Float

    def gather(self, points: EyePoints) -> mi.Color3f:
        """Sum the light of the clusters of the cut of each point (AWB08 eq. 8-9, with the inner sum over lights done)."""
        first = points.copy * dr.opaque(mi.UInt32, 2 * self.copies.samples.leaves)
        dr.eval(first)

        def visit(state, node, weight, r2, accepted):
            total, terms = state
            slot = dr.gather(mi.UInt32, self.slots, first + node, accepted)
            light = dr.gather(mi.Array4f, self.mean, slot, accepted)
            total = dr.fma(weight, mi.Color3f(light[0], light[1], light[2]), total)
            return total, terms + dr.select(accepted, mi.UInt32(1), 0)

        nothing = mi.Color3f(0), mi.UInt32(0)
        total, terms = walk(self.copies.source, points.p, nothing, visit, _coarser(points.tolerance), points.n)
        count("links", terms)
        return total


def measure_light(
    scene: mi.Scene,
    copies: Copies,
    lights: LightTree,
    eyes: EyePoints,
    covering: Covering,
    settings: AdaptiveSettings,
) -> MeasuredLight:
    """Measure the light of the surface of some copies, as well as eye points see it.

    Parameters
    ----------
    eyes : EyePoints
        The points of a view, or none. Neighbours in the array should be neighbours in space, of one copy, and those that are seen
        directly beside each other.
    """
    samples = copies.samples
    importance, nearest = _importance(copies, eyes, covering)
    cut = find_cut(samples, importance, len(copies.numbers))
    weight = copies.reflectance * np.sqrt(cut.share_importance(importance) / ONE)
    eye_cluster = cut.find(eyes.copy.numpy(), nearest, samples)
    member = _members(copies, cut, eyes, eye_cluster, nearest)
    del importance
    measurement = Measurement(scene, copies, lights, cut, member, settings.most_rays)
    irradiance, deviation = measurement.learn(settings.first_rays)
    allowed = settings.max_error / DEVIATIONS * _brightness(copies, cut, eyes, eye_cluster, irradiance)
    points = dr.width(eyes.p) or len(copies.numbers) << min(covering.level, samples.depth)
    light = measurement.measure(weight / np.maximum(allowed, 1e-30), points, irradiance @ LUMINANCE, deviation)
    count("receivers", len(cut.node))
    return MeasuredLight(copies, cut.slots, cut.mean_light(light))


def _coarser(tolerance: mi.Float) -> mi.Float:
    """Tell what multiplies the solid angle under which clusters may stand for their members."""
    return dr.clip(LARGER * tolerance, 1, LARGEST)


# ------------------------------------------------------------------ importance


def _importance(copies: Copies, eyes: EyePoints, covering: Covering) -> tuple[mi.UInt64, NDArray[np.uint32]]:
    """Sum up how much errors in the light of clusters matter: over eye points, the squares of their weights over the tolerances.

    Weights are shares of what a plane would give. Returns the sums by node of every copy, times `ONE`, not zero where somebody asks for
    the node; and the nearest node of each eye point.
    """
    importance = dr.opaque(mi.UInt64, 0, 2 * copies.samples.leaves * len(copies.numbers))
    if dr.width(eyes.p) == 0:
        _cover(importance, copies, covering)
        return importance, np.zeros(0, np.uint32)
    finest = _finest_level(copies, eyes)
    first = eyes.copy * dr.opaque(mi.UInt32, 2 * copies.samples.leaves)
    scale = dr.opaque(mi.Float, np.sqrt(ONE) / copies.reflectance) / eyes.tolerance
    little = dr.opaque(mi.Float, LITTLE * copies.reflectance)
    dr.eval(finest, first, scale)

    def add(cluster, weight, active):
        value = mi.UInt64(dr.select(weight > little, dr.square(weight * scale), 0)) + 1
        # Direct: other modes have kernels for each number of clusters.
        dr.scatter_add(importance, value, cluster, active, mode=dr.ReduceMode.Direct)

    def visit(state, node, weight, r2, accepted):
        # Nodes below the finest level follow each other in the walk: the weights of one cluster are added up first.
        before, held, nearest, distance = state
        level = 31 - dr.lzcnt(node)
        cluster = first + (node >> (dr.maximum(level, finest) - finest))
        another = accepted & (cluster != before)
        add(before, held, another & (before != NOBODY))
        held = dr.select(accepted, luminance(weight) + dr.select(another, 0, held), held)
        nearer = accepted & (r2 < distance)
        before, nearest = dr.select(accepted, cluster, before), dr.select(nearer, node, nearest)
        return before, held, nearest, dr.select(nearer, r2, distance)

    start = mi.UInt32(NOBODY), mi.Float(0), mi.UInt32(1), mi.Float(dr.inf)
    last, held, nearest, _ = walk(copies.source, eyes.p, start, visit, _coarser(eyes.tolerance), eyes.n)
    dr.eval(last, held, nearest, importance)
    add(last, held, last != NOBODY)
    dr.eval(importance)
    _cover(importance, copies, covering)
    return importance, nearest.numpy()


def _cover(importance: mi.UInt64, copies: Copies, covering: Covering) -> None:
    """Add the importance of a covering.

    Were there eye points on an endless plane, one to every area A of a cluster, the squares of their weights would sum up to A over the
    footprint where that is much larger, and to 1 where it is much smaller.
    """
    samples = copies.samples
    level = min(covering.level, samples.depth)
    node = np.arange(1 << level, 2 << level)
    area = samples.tree.strength[node]
    value = ONE / covering.tolerance**2 * area / (area + copies.footprint) + 1
    node, value = node[area > 0], value[area > 0]
    every = np.arange(len(copies.numbers))[:, None] * (2 * samples.leaves) + node
    index = upload(every.astype(np.uint32).ravel(), mi.UInt32)
    added = upload(np.tile(value.astype(np.uint64), len(copies.numbers)), mi.UInt64)
    before = dr.gather(mi.UInt64, importance, index) + added
    dr.eval(before)
    dr.scatter(importance, before, index)
    dr.eval(importance)


def _finest_level(copies: Copies, eyes: EyePoints) -> mi.UInt32:
    """Choose the level of the smallest clusters of each eye point by the distance to the nearest of its neighbours in the array.

    Points that other surfaces show are no neighbours of those that are seen directly.
    """
    p, indirect = eyes.p, eyes.tolerance > 1
    last, lane = dr.opaque(mi.Int32, dr.width(p) - 1), dr.arange(mi.Int32, dr.width(p))
    others = [dr.clip(lane + step, 0, last) for step in (-4, -3, -2, -1, 1, 2, 3, 4)]
    kind = 2 * eyes.copy + mi.UInt32(indirect)
    same = [dr.gather(mi.UInt32, kind, other) == kind for other in others]
    nearest = dr.full(mi.Float, np.square(ISOLATED * copies.mfp), dr.width(p))
    dr.make_opaque(nearest)
    for other, counts in zip(others, same, strict=True):
        d2 = dr.squared_norm(dr.gather(mi.Point3f, p, other) - p)
        nearest = dr.minimum(nearest, dr.select(counts & (d2 > 0), d2, dr.inf))
    dr.eval(nearest)
    # Where the order jumps, the nearest may not be among them: but no point is twice as isolated as those around it.
    alone = nearest
    for other, counts in zip(others, same, strict=True):
        nearest = dr.minimum(nearest, dr.select(counts, 4 * dr.gather(mi.Float, alone, other), dr.inf))
    wider = dr.clip(WIDER * eyes.tolerance, 1, WIDEST)
    share = nearest * dr.square(wider) * dr.opaque(mi.Float, FINEST / copies.samples.tree.strength[1])
    return mi.UInt32(dr.clip(dr.ceil(-dr.log2(share)), 0, 31))


# ------------------------------------------------------------------ clusters


def _members(copies: Copies, cut: Cut, eyes: EyePoints, eye_cluster: NDArray, nearest: NDArray) -> NDArray[np.uint32]:
    """Choose the sample of each cluster where its light is measured: the nearest to an eye point, or else one at random.

    Eye points that are seen directly come before others.
    """
    samples = copies.samples
    u = (np.arange(len(cut.node), dtype=np.uint32) * np.uint32(PLASTIC) >> 8) * 2.0**-24
    columns = upload(cut.node.astype(np.uint32), mi.UInt32), upload(u.astype(np.float32), mi.Float)
    member = draw(samples.strength, dr.opaque(mi.UInt32, samples.leaves), *columns).numpy()
    indirect = eyes.tolerance.numpy() > 1
    for some in (indirect, ~indirect):  # of those that share a cluster the last one counts
        member[eye_cluster[some]] = samples.members(nearest[some])[0]
    return member


def _brightness(
    copies: Copies, cut: Cut, eyes: EyePoints, eye_cluster: NDArray, irradiance: NDArray
) -> NDArray[np.float64]:
    """Tell about how bright the points are that see each cluster ``(f,)``, within the range in which errors are relative.

    Some eye points tell for the clusters they lie on, and these for those beside them; where there are none, clusters are as bright as
    planes.
    """
    exposure = copies.exposure / copies.reflectance
    if len(eye_cluster) == 0:
        bright = copies.reflectance * (irradiance @ LUMINANCE).astype(np.float64)
        return exposure * np.clip(bright, DIM * bright.mean(), GLARE * bright.mean())
    some = np.arange(0, len(eye_cluster), ALIKE)
    few = dr.gather(EyePoints, eyes, upload(some.astype(np.uint32), mi.UInt32))
    bright = luminance(MeasuredLight(copies, cut.slots, cut.mean_light(irradiance)).gather(few)).numpy().astype(float)
    cluster, which = np.unique(eye_cluster[some], return_inverse=True)
    known = np.bincount(which, bright) / np.bincount(which)
    known = exposure * np.clip(known, DIM * bright.mean(), GLARE * bright.mean())
    halfway = (cluster[1:] + cluster[:-1]) // 2 + 1
    return np.repeat(known, np.diff(halfway, prepend=0, append=len(cut.node)))
