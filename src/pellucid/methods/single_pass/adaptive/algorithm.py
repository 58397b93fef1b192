"""The single pass on wide hardware: light is measured only where it is seen, and as well as it is seen.

Wide kernels take the place of the paper's queue of triples, and none of their lanes waits for another:

1. *touch*: every eye point walks the tree of irradiance samples by the profile alone, and tells the clusters it asks for how much
   their errors matter to it;
2. *learn*: a few shadow rays from some of them tell which lights each patch of the surface sees, and about how bright it is;
3. *measure*: the light that enters at a member of each cluster, by rays that are dealt out by concern and by doubt;
4. *gather*: every eye point sums its clusters.

Nothing is measured twice, and there is nothing to cache.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....kernels.memory import upload
from ..trees.descent import draw
from ..trees.light_tree import LUMINANCE, NOBODY, LightTree, luminance
from .allocation import Meter
from .copies import VisibleCopies
from .cut import Frontier, find_frontier
from .traversal import walk

FINEST = 0.06
"""Area of the smallest clusters, as a share of the squared distance between eye points."""

ISOLATED = 16.0
"""Mean free paths: eye points further from each other ask for clusters as if they were so far apart."""

DIM, GLARE = 0.3, 0.8
"""Shares of the mean exitance between which errors are relative. What is darker would take most of the rays, next to what outshines
it; and where it is brighter, light is seldom in doubt, and its errors weigh most in the picture."""

ALIKE = 16
"""One eye point in so many tells how bright the surface is around it, when it comes to which errors are allowed."""

LARGER, LARGEST = 0.5, 16.0
"""Share of the tolerance by which solid angles of clusters grow where other surfaces show eye points, and how much at most."""

WIDER, WIDEST = 0.25, 4.0
"""The same for the width of the smallest clusters. Their light is measured at one place of each, and what is wrong with that no ray
mends."""

DEVIATIONS = 1.52
"""Standard deviations that the largest error stands for: 87 of 100 errors are smaller."""

LITTLE = 1e-3
"""Share of what a plane would give that is no concern of an eye point: squared it is next to nothing, and there are many."""

UNIT = 2.0**40
"""What the concern of an eye point that sees nothing but one cluster is counted as, in whole numbers."""

R2 = 2447445414
"""Multiples of this fraction of 2^32 fill the unit interval evenly, also beside those of `chosen_lights.FRACTION`."""


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
class Effort:
    """What was spent: rays, clusters that were lit, terms of all sums."""

    shadow_rays: int = 0
    clusters: int = 0
    links: int = 0


@dataclass
class Eyes:
    """Eye points in the space of the prototype: copies among those that are seen, what multiplies the solid angle of clusters, the
    level of the smallest that they ask for, and what multiplies the error that is allowed."""

    p: mi.Point3f
    copy: mi.UInt32
    coarser: mi.Float
    finest: mi.UInt32
    tolerance: mi.Float

    @property
    def coarse(self) -> mi.Bool:
        """Whether clusters may be larger for them than for what is in plain view."""
        return self.coarser > 1


@dataclass
class Touched:
    """What a first walk finds: by node of every copy how much its errors matter, times `UNIT`, and not zero where it is asked for;
    by eye point its terms, and the nearest node."""

    concern: mi.UInt64
    terms: mi.UInt32
    nearest: mi.UInt32


def adaptive_exitance(
    scene: mi.Scene,
    cut: VisibleCopies,
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
        Eye points in the space of the prototype. Neighbours in the array should be neighbours in space, of one copy, and those
        of which less is asked beside each other.
    copy : UInt32
        For each of them which of the k copies of ``cut`` it lies on.
    tolerance : Float
        For each of them what multiplies ``max_error``: ``cut.leniency`` times 1, or times more where other surfaces show them.
        Clusters grow with the latter, up to a point.
    """
    asked = tolerance / dr.opaque(mi.Float, cut.leniency)
    indirect = asked > 1.5  # or else it is 1, give or take the rounding
    coarser, wider = dr.clip(LARGER * asked, 1, LARGEST), dr.clip(WIDER * asked, 1, WIDEST)
    eyes = Eyes(p, copy, coarser, _finest(cut, p, copy, indirect, wider), tolerance)
    dr.eval(eyes)
    touched = _touch(cut, eyes)
    frontier = find_frontier(cut.samples, touched.concern, len(cut.copies))
    meter = Meter(scene, cut, lights, frontier, _members(cut, eyes, touched, frontier), settings.most_rays)

    rough, doubt = meter.learn(settings.first_rays)
    deviation = settings.max_error / DEVIATIONS * _brightness(cut, eyes, touched, frontier, rough)
    weight = cut.reflectance * np.sqrt(frontier.share_concern(frontier.by_slot(touched.concern) / UNIT))
    concern = weight / np.maximum(deviation, 1e-30)
    light = meter.measure(concern, dr.width(p), rough @ LUMINANCE, doubt)
    exitance = _gather(cut, eyes, frontier, light)
    terms = int(touched.terms.numpy().sum(dtype=np.int64))
    return exitance, Effort(meter.shadow_rays, len(frontier.node), terms)


# ------------------------------------------------------------------ eye points ask


def _finest(cut: VisibleCopies, p: mi.Point3f, copy: mi.UInt32, indirect: mi.Bool, wider: mi.Float) -> mi.UInt32:
    """Choose the smallest clusters of each eye point, by the distance to the nearest of its neighbours in the order: their level.

    Those that other surfaces show are no neighbours of those in plain view.
    """
    last, lane = dr.opaque(mi.Int32, dr.width(p) - 1), dr.arange(mi.Int32, dr.width(p))
    others = [dr.clip(lane + step, 0, last) for step in (-4, -3, -2, -1, 1, 2, 3, 4)]
    group = 2 * copy + mi.UInt32(indirect)
    same = [dr.gather(mi.UInt32, group, other) == group for other in others]
    nearest = dr.full(mi.Float, np.square(ISOLATED * cut.mfp), dr.width(p))
    dr.make_opaque(nearest)
    for other, counts in zip(others, same, strict=True):
        d2 = dr.squared_norm(dr.gather(mi.Point3f, p, other) - p)
        nearest = dr.minimum(nearest, dr.select(counts & (d2 > 0), d2, dr.inf))
    dr.eval(nearest)
    # Where the order jumps, the nearest may not be among them: but no point is twice as lonely as those around it.
    alone = nearest
    for other, counts in zip(others, same, strict=True):
        nearest = dr.minimum(nearest, dr.select(counts, 4 * dr.gather(mi.Float, alone, other), dr.inf))
    share = nearest * dr.square(wider) * dr.opaque(mi.Float, FINEST / cut.samples.tree.strength[1])
    return mi.UInt32(dr.clip(dr.ceil(-dr.log2(share)), 0, 31))


def _ask(cut: VisibleCopies, eyes: Eyes) -> tuple[mi.UInt32, mi.UInt32]:
    """Give what `_asked` reads, by eye point."""
    return eyes.copy * dr.opaque(mi.UInt32, 2 * cut.samples.leaves), eyes.finest


def _asked(ask: Any, node: mi.UInt32) -> mi.UInt32:
    """Tell which cluster, counted over all copies, has its light measured for a node of a cut."""
    offset, finest = ask
    level = 31 - dr.lzcnt(node)
    return offset + (node >> (dr.maximum(level, finest) - finest))


def _touch(cut: VisibleCopies, eyes: Eyes) -> Touched:
    """Sum up how much errors of the clusters that eye points ask for matter: over eye points, the squares of their weights over the
    tolerance.

    If n_c rays leave the variance v_c / n_c in a cluster that matters by D_c, then the sum of v_c D_c / n_c is that of the
    squared errors of all eye points, each over what is allowed there. So many rays leave least if n_c goes with sqrt(v_c D_c).
    """
    concern = dr.opaque(mi.UInt64, 0, 2 * cut.samples.leaves * len(cut.copies))
    unit = np.sqrt(UNIT) / cut.reflectance
    scale, little = dr.opaque(mi.Float, unit) / eyes.tolerance, dr.opaque(mi.Float, LITTLE * cut.reflectance)
    dr.eval(scale)

    def mark(cluster, weight, scale, active):
        # Whole numbers, whose sum does not hang on the order.
        return cluster, mi.UInt64(dr.select(weight > little, dr.square(weight * scale), 0)) + 1, active

    def add(marks):
        # Neighbours mostly mark one cluster at a time: added up first, they take one write.
        first, value, active = marks[0]
        for cluster, more, there in marks[1:]:
            same = there & active & (cluster == first)
            value = dr.select(same, value + more, value)
            put(cluster, more, there & ~same)
        put(first, value, active)

    def put(cluster, value, active):
        # Direct: other modes have kernels for each number of clusters.
        dr.scatter_add(concern, value, cluster, active, mode=dr.ReduceMode.Direct)

    def visit(state, own, node, weight, r2, accepted):
        # Nodes of one cluster follow each other: their weights add up.
        (before, held, terms, nearest, distance), (ask, scale) = state, own
        cluster = _asked(ask, node)
        another = accepted & (cluster != before)
        marked = mark(before, held, scale, another & (before != NOBODY))
        held = dr.select(accepted, luminance(weight) + dr.select(another, 0, held), held)
        nearer = accepted & (r2 < distance)
        state = (
            dr.select(accepted, cluster, before),
            held,
            terms + dr.select(accepted, mi.UInt32(1), 0),
            dr.select(nearer, node, nearest),
            dr.select(nearer, r2, distance),
        )
        return state, marked

    start = mi.UInt32(NOBODY), mi.Float(0), mi.UInt32(0), mi.UInt32(1), mi.Float(dr.inf)
    last, held, terms, nearest, _ = walk(cut.source, eyes.p, start, visit, eyes.coarser, (_ask(cut, eyes), scale), add)
    dr.eval(last, held, terms, nearest, concern)
    put(*mark(last, held, scale, last != NOBODY))
    dr.eval(concern)
    return Touched(concern, terms, nearest)


def _members(cut: VisibleCopies, eyes: Eyes, touched: Touched, frontier: Frontier) -> NDArray[np.uint32]:
    """Choose the sample of each cluster where its light is measured: the nearest to an eye point, or else one at random.

    Eye points of which more is asked come before those of which less is.
    """
    u = (np.arange(len(frontier.node), dtype=np.uint32) * np.uint32(R2) >> 8) * 2.0**-24
    columns = upload(frontier.node.astype(np.uint32), mi.UInt32), upload(u.astype(np.float32), mi.Float)
    member = draw(cut.samples.strength, dr.opaque(mi.UInt32, cut.samples.leaves), *columns).numpy()
    nearest, copy, coarse = touched.nearest.numpy(), eyes.copy.numpy(), eyes.coarse.numpy()
    for some in (coarse, ~coarse):  # of those that share a cluster the last one counts
        member[frontier.find(copy[some], nearest[some], cut.samples)] = cut.samples.members(nearest[some])[0]
    return member


def _gather(cut: VisibleCopies, eyes: Eyes, frontier: Frontier, light: NDArray) -> mi.Color3f:
    """Sum the light of the clusters of every cut (AWB08 eq. 8-9, with the inner sum over lights done)."""
    packets = frontier.mean_light(light)

    def visit(total, ask, node, weight, r2, accepted):
        slot = dr.gather(mi.UInt32, frontier.slots, _asked(ask, node), accepted)
        found = dr.gather(mi.Array4f, packets, slot, accepted)
        return dr.fma(weight, mi.Color3f(found[0], found[1], found[2]), total)

    total = walk(cut.source, eyes.p, mi.Color3f(0), visit, eyes.coarser, _ask(cut, eyes))
    dr.eval(total)
    return total


def _brightness(
    cut: VisibleCopies, eyes: Eyes, touched: Touched, frontier: Frontier, rough: NDArray
) -> NDArray[np.float64]:
    """Tell about how bright eye points around each leaf will be ``(f,)``, within the range in which errors are relative: some
    eye points tell for the leaves they lie on, and these for those beside them."""
    index = dr.arange(mi.UInt32, -(-dr.width(eyes.p) // ALIKE)) * dr.opaque(mi.UInt32, ALIKE)
    few: Eyes = dr.gather(Eyes, eyes, index)
    dr.eval(few)
    bright = luminance(_gather(cut, few, frontier, rough)).numpy().astype(float)
    leaf = frontier.find(few.copy.numpy(), touched.nearest.numpy()[::ALIKE], cut.samples)
    order = np.argsort(leaf, kind="stable")
    leaf, first = np.unique(leaf[order], return_index=True)
    known = np.add.reduceat(bright[order], first) / np.diff(first, append=len(bright))
    known = np.clip(known, *(share * bright.mean() for share in (DIM, GLARE)))
    halfway = (leaf[1:] + leaf[:-1]) // 2 + 1
    return np.repeat(known, np.diff(halfway, prepend=0, append=len(frontier.node)))
