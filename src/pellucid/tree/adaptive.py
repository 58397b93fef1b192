"""The single pass on wide hardware: light is measured only where it is seen, and as well as it is seen.

Wide kernels take the place of the paper's queue of triples, and none of their lanes waits for another:

1. *touch*: every eye point walks the tree of irradiance samples by the profile alone, and marks the clusters it asks for;
2. *learn*: a few shadow rays from some of them tell which lights each region of the surface sees, and about how bright it is;
3. *concern*: every eye point tells its clusters how much their errors matter to it;
4. *measure*: the light that enters at a member of each cluster, by rays that are dealt out by concern and by doubt;
5. *gather*: every eye point sums its clusters.

Nothing is measured twice, and there is nothing to cache.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..memory import rows, upload
from ..progress import steps
from .chosen_lights import MOST_LIGHTS, NOBODY, ChosenLights, bound_patches, choose_lights
from .device import Source
from .draw import draw
from .frontier import Frontier, find_frontier
from .light_guide import LightGuide, build_guide
from .light_tree import LUMINANCE, LightTree, luminance
from .sample_tree import Placement, SampleTree
from .sampled_cut import Receiver, sampled_cut
from .walk import walk

PATCH, PATCHES_AT_ONCE = 96, 256
"""Clusters to a patch that lights are chosen for, at most; and patches of one launch: what is known of their lights takes memory,
which takes longer to get than to use."""

FINEST = 0.1
"""Area of the smallest clusters, as a share of the squared distance between eye points."""

ISOLATED = 16.0
"""Mean free paths: eye points further from each other ask for clusters as if they were so far apart."""

DIM = 0.05
"""Share of the mean exitance below which errors stop to be relative: what is next to black would take most of the rays."""

REGION = 256
"""Clusters to a region that learns which lights it sees: some patches."""

LEARN = 16
"""One cluster in so many learns for the others, and those of a region share their lights."""

LEAST_RAYS = 2
FEW_LIGHTS, LEAST_LIGHTS, LIGHTS_WANTED, LIGHTS_POWER = 1024, 384, 1000.0, 1 / 5
"""Lights that are weighed to learn; at least; and where a single ray would do if all light was in doubt. As the
noise they leave falls with the power 2.5 of their number, that grows with the fifth root of the accuracy asked for."""

PARTS = (slice(0, None, 8), slice(4, None, 8), slice(2, None, 4), slice(1, None, 2))
"""Clusters are measured in parts, so that the later ones profit from what the rays of the earlier ones taught."""

ALIKE = 4
"""Eye points beside each other that are taken to be as bright, when it comes to which errors they allow."""

DEVIATIONS = 2.0
"""Standard deviations that the largest error stands for: nineteen of twenty errors are smaller."""

ENDLESS = 1e30
"""Rays for a doubt of 1 where nothing is allowed to be wrong: in the dark."""

UNIT = 2.0**40
"""What the largest concern of one eye point is counted as, in whole numbers."""

STILL_IN_DOUBT, FIRST_GUESS = 0.3, 0.02
"""Share of the doubt about all light that is left once regions have learnt, as far as one can tell beforehand; and how much this
guess counts beside what is measured, as a share of all clusters."""

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
    first_rays: int = 32
    most_rays: int = 8192


@dataclass
class Cut:
    """The copies of a prototype that are seen, and how they are walked.

    Attributes
    ----------
    eta : float
        Relative index of refraction.
    copies : (k,) int
        Their numbers in ``placement``.
    mfp : float
        Mean free path [scene units].
    leniency : float
        The part of ``tolerance`` that is for dark media: they may be noisier, but their clusters may not be coarser.
    """

    samples: SampleTree
    placement: Placement
    source: Source
    eta: float
    copies: np.ndarray
    mfp: float
    leniency: float = 1.0


@dataclass
class Effort:
    """What was spent: rays, clusters that were lit, terms of all sums."""

    shadow_rays: int = 0
    clusters: int = 0
    links: int = 0


@dataclass
class Eyes:
    """Eye points in the space of the prototype: copies among those that are seen, what multiplies the solid angle of
    clusters, and the level of the smallest that they ask for."""

    p: mi.Point3f
    copy: mi.UInt32
    coarser: mi.Float
    finest: mi.UInt32


@dataclass
class Touched:
    """What a first walk finds: nodes that are asked for; by eye point the sum of the profile, its terms, and the nearest node."""

    asked: mi.UInt32
    profile: mi.Float
    terms: mi.UInt32
    nearest: mi.UInt32


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
        Eye points in the space of the prototype. Neighbours in the array should be neighbours in space, of one copy, and those
        of which less is asked beside each other.
    copy : UInt32
        For each of them which of the k copies of ``cut`` it lies on.
    tolerance : Float
        For each of them what multiplies ``max_error``, and the solid angle of clusters.
    """
    coarser = tolerance / dr.opaque(mi.Float, cut.leniency)
    eyes = Eyes(p, copy, coarser, _finest(cut, p, copy, coarser))
    dr.eval(tolerance)
    dr.eval(eyes)
    touched = _touch(cut, eyes)
    frontier = find_frontier(cut.samples, touched.asked, len(cut.copies))
    meter = Meter(scene, cut, lights, frontier, _members(cut, eyes, touched, frontier), settings.most_rays)

    rough, doubt = meter.learn(settings.first_rays)
    bright = _brightness(cut, eyes, frontier, rough)
    dim = DIM * float(np.mean(bright.numpy(), dtype=float))
    allowed = (
        dr.opaque(mi.Float, settings.max_error / DEVIATIONS) * tolerance * dr.maximum(bright, dr.opaque(mi.Float, dim))
    )
    concern = frontier.share_concern(_concern(cut, eyes, frontier, touched.profile, allowed))
    light = meter.measure(np.sqrt(concern), dr.width(p), rough @ LUMINANCE, doubt)
    exitance = _gather(cut, eyes, frontier, light)
    terms = int(touched.terms.numpy().sum(dtype=np.int64))
    return exitance, Effort(meter.shadow_rays, len(frontier.node), terms)


# ------------------------------------------------------------------ eye points ask


def _finest(cut: Cut, p: mi.Point3f, copy: mi.UInt32, coarser: mi.Float) -> mi.UInt32:
    """Choose the smallest clusters of each eye point, by the distance to the nearest of its neighbours in the order: their level.

    Those that may be coarser are no neighbours of those that may not.
    """
    last, lane = dr.opaque(mi.Int32, dr.width(p) - 1), dr.arange(mi.Int32, dr.width(p))
    others = [dr.clip(lane + step, 0, last) for step in (-4, -3, -2, -1, 1, 2, 3, 4)]
    group = 2 * copy + dr.select(coarser > 1, mi.UInt32(1), 0)
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
    share = nearest * dr.square(coarser) * dr.opaque(mi.Float, FINEST / cut.samples.tree.strength[1])
    return mi.UInt32(dr.clip(dr.ceil(-dr.log2(share)), 0, 31))


def _asks_for(cut: Cut, eyes: Eyes) -> Any:
    """Make the function that tells which cluster, counted over all copies, has its light measured for a node of the cut."""
    offset = eyes.copy * dr.opaque(mi.UInt32, 2 * cut.samples.leaves)

    def asks_for(node):
        level = 31 - dr.lzcnt(node)
        return offset + (node >> (dr.maximum(level, eyes.finest) - eyes.finest))

    return asks_for


def _touch(cut: Cut, eyes: Eyes) -> Touched:
    """Mark the clusters that eye points ask for."""
    asked = dr.opaque(mi.UInt32, 0, 2 * cut.samples.leaves * len(cut.copies))
    asks_for, count = _asks_for(cut, eyes), dr.width(eyes.p)

    def visit(state, node, weight, r2, accepted):
        profile, terms, nearest, distance = state
        dr.scatter(asked, mi.UInt32(1), asks_for(node), accepted)
        nearer = accepted & (r2 < distance)
        return (
            profile + luminance(weight),
            terms + dr.select(accepted, mi.UInt32(1), 0),
            dr.select(nearer, node, nearest),
            dr.select(nearer, r2, distance),
        )

    start = (
        dr.zeros(mi.Float, count),
        dr.zeros(mi.UInt32, count),
        dr.full(mi.UInt32, 1, count),
        dr.full(mi.Float, dr.inf, count),
    )
    profile, terms, nearest, _ = walk(cut.source, eyes.p, start, visit, eyes.coarser)
    dr.eval(asked, profile, terms, nearest)
    return Touched(asked, profile, terms, nearest)


def _members(cut: Cut, eyes: Eyes, touched: Touched, frontier: Frontier) -> NDArray[np.uint32]:
    """Choose the sample of each cluster where its light is measured: the nearest to an eye point, or else one at random.

    Eye points of which more is asked come before those of which less is.
    """
    u = (np.arange(len(frontier.node), dtype=np.uint32) * np.uint32(R2) >> 8) * 2.0**-24
    columns = upload(frontier.node.astype(np.uint32), mi.UInt32), upload(u.astype(np.float32), mi.Float)
    member = draw(cut.samples.strength, dr.opaque(mi.UInt32, cut.samples.leaves), *columns).numpy()
    nearest, copy, coarse = touched.nearest.numpy(), eyes.copy.numpy(), eyes.coarser.numpy() > 1
    for some in (coarse, ~coarse):  # of those that share a cluster the last one counts
        member[frontier.find(copy[some], nearest[some], cut.samples)] = cut.samples.members(nearest[some])[0]
    return member


def _concern(cut: Cut, eyes: Eyes, frontier: Frontier, profile: mi.Float, allowed: mi.Float) -> NDArray[np.float64]:
    """Sum up how much the error of each slot matters ``(m,)``: over eye points, the squares of its weight over what they allow.

    If n_c rays leave the variance v_c / n_c in a cluster that matters by D_c, then the sum of v_c D_c / n_c is that of the
    squared errors of all eye points, each over what is allowed there. So many rays leave least if n_c goes with sqrt(v_c D_c).
    """
    share = dr.rcp(dr.maximum(allowed, 1e-30))
    largest = float(dr.max(profile * share)[0])
    share /= dr.opaque(mi.Float, max(largest, 1e-30))
    concern = dr.opaque(mi.UInt64, 0, len(frontier.area))
    asks_for, count = _asks_for(cut, eyes), dr.width(eyes.p)
    dr.eval(share)

    def add(slot, weight, active):
        # Whole numbers, whose sum does not hang on the order. Direct: other modes have kernels for each number of slots.
        value = mi.UInt64(dr.square(weight * share) * UNIT)
        dr.scatter_add(concern, value, slot, active & (slot != NOBODY), mode=dr.ReduceMode.Direct)

    def visit(state, node, weight, r2, accepted):
        # Nodes of one slot follow each other: their weights add up.
        before, held = state
        slot = dr.gather(mi.UInt32, frontier.slots, asks_for(node), accepted)
        another = accepted & (slot != before)
        add(before, held, another)
        held = dr.select(accepted, luminance(weight) + dr.select(another, 0, held), held)
        return dr.select(accepted, slot, before), held

    start = dr.full(mi.UInt32, NOBODY, count), dr.zeros(mi.Float, count)
    last, held = walk(cut.source, eyes.p, start, visit, eyes.coarser)
    dr.eval(last, held, concern)
    add(last, held, dr.full(mi.Bool, True, count))
    return concern.numpy() * (largest**2 / UNIT)


def _gather(cut: Cut, eyes: Eyes, frontier: Frontier, light: NDArray) -> mi.Color3f:
    """Sum the light of the clusters of every cut (AWB08 eq. 8-9, with the inner sum over lights done)."""
    packets, asks_for = frontier.mean_light(light), _asks_for(cut, eyes)

    def visit(total, node, weight, r2, accepted):
        slot = dr.gather(mi.UInt32, frontier.slots, asks_for(node), accepted)
        found = dr.gather(mi.Array4f, packets, slot, accepted)
        return dr.fma(weight, mi.Color3f(found[0], found[1], found[2]), total)

    total = walk(cut.source, eyes.p, dr.zeros(mi.Color3f, dr.width(eyes.p)), visit, eyes.coarser)
    dr.eval(total)
    return total


def _brightness(cut: Cut, eyes: Eyes, frontier: Frontier, rough: NDArray) -> mi.Float:
    """Tell about how bright eye points will be: one of a few stands for those behind it."""
    few = dr.opaque(mi.UInt32, ALIKE)
    chosen = dr.gather(Eyes, eyes, dr.arange(mi.UInt32, -(-dr.width(eyes.p) // ALIKE)) * few)
    dr.eval(chosen)
    bright = luminance(_gather(cut, chosen, frontier, rough))
    dr.eval(bright)
    return dr.gather(mi.Float, bright, dr.arange(mi.UInt32, dr.width(eyes.p)) // few)


# ------------------------------------------------------------------ light is measured


class Meter:
    """Measures the light that enters at one member of each cluster, and learns from the rays what is seen from where."""

    def __init__(
        self, scene, cut: Cut, lights: LightTree, frontier: Frontier, member: NDArray[np.uint32], most_rays: int
    ) -> None:
        self.scene, self.cut, self.lights = scene, cut, lights
        self.most_rays, self.eta = dr.opaque(mi.UInt32, most_rays), dr.opaque(mi.Float, cut.eta)
        self.count = len(member)
        self.member = upload(member, mi.UInt32)
        self.node = upload(frontier.node.astype(np.uint32), mi.UInt32)
        self.copy = upload(cut.copies[frontier.copy].astype(np.uint32), mi.UInt32)
        self.patch, self.region = (frontier.groups(cut.samples, most) for most in (PATCH, REGION))
        self.guide: LightGuide = build_guide(lights, int(self.region[-1]) + 1)
        self.shadow_rays = 0

    def learn(self, rays: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Measure some clusters roughly: irradiance ``(f, 3)`` and doubt ``(f,)`` of all, those of the others being their
        neighbours'."""
        place = np.arange(self.count) - np.searchsorted(self.region, self.region)
        every = np.flatnonzero(place % LEARN == 0)
        regions, light, doubt = (
            self.region[every],
            np.empty((len(every), 3), np.float32),
            np.empty(len(every), np.float32),
        )
        least = dr.opaque(mi.UInt32, rays)
        for first, size in steps("visibility", _chunks(regions), "clusters"):
            here = slice(first, first + size)
            number, patch = every[here], regions[here]
            names = np.arange(patch[0], patch[-1] + 1)
            region = upload(names.astype(np.uint32), mi.UInt32)
            chosen = self._choose(number, patch, region, np.full(len(names), FEW_LIGHTS))
            self.guide.inform(chosen)
            light[here], doubt[here] = self._trace(number, patch - patch[0], chosen, np.zeros(size), least, least)
            self.guide.count(chosen)
        self.guide.learn()
        nearest = np.cumsum(place % LEARN == 0) - 1
        return light[nearest], doubt[nearest]

    def measure(self, concern: NDArray, points: int, rough: NDArray, doubt: NDArray) -> NDArray[np.float32]:
        """Measure all clusters, such that the error is what is allowed in the mean over the eye points: ``(f, 3)``.

        Parameters
        ----------
        concern : (f,) float
            How much errors matter: n rays for a doubt of t leave t^2 concern^2 / n, in squares of what is allowed.
        points : int
            Number of the eye points.
        rough, doubt : (f,) float
            Irradiance in luminance as far as it is known, and how much of it was in doubt when nothing was known.
        """
        patches, light = self.patch, np.zeros((self.count, 3), np.float32)
        # With n = k t concern rays, errors sum up to those of all eye points if k is the sum of t concern over their number. Of
        # the doubt there was when nothing was known, a part is left: the clusters measured before tell how much.
        unknown = doubt * concern
        per_point, guess = unknown.sum() / points, FIRST_GUESS * unknown.sum()
        left, before = STILL_IN_DOUBT * guess, max(guess, 1e-30)
        accuracy = np.abs(rough) * concern * (STILL_IN_DOUBT * per_point)
        wanted = LIGHTS_WANTED * (np.bincount(patches, accuracy) / np.bincount(patches)) ** LIGHTS_POWER
        wanted = np.clip(wanted, LEAST_LIGHTS, MOST_LIGHTS) // 32 * 32
        least = dr.opaque(mi.UInt32, LEAST_RAYS)
        for first, size in steps("irradiance", _chunks(patches), "clusters"):
            number, patch = np.arange(first, first + size), patches[first : first + size]
            names = np.arange(patch[0], patch[-1] + 1)
            owner = self.region[first + np.searchsorted(patch, names)]
            region = upload(owner.astype(np.uint32), mi.UInt32)
            chosen = self._choose(number, patch, region, wanted[names])
            for part in PARTS:
                some, here = number[part], patch[part] - patch[0]
                if not len(some):
                    continue
                self.guide.inform(chosen)
                demand = np.minimum(per_point * left / before * concern[some], ENDLESS)
                light[some], found = self._trace(some, here, chosen, demand, least, self.most_rays)
                left, before = left + (found * concern[some]).sum(), before + unknown[some].sum()
                self.guide.count(chosen)
                self.guide.learn(owner[0], owner[-1] + 1)
        return light

    def _receivers(self, number: NDArray) -> tuple[mi.UInt32, mi.SurfaceInteraction3f]:
        """Describe the places where the light of clusters is measured."""
        index = upload(number.astype(np.uint32), mi.UInt32)
        leaf, copy = dr.gather(mi.UInt32, self.member, index), dr.gather(mi.UInt32, self.copy, index)
        si = self.cut.samples.receiver(leaf, self.cut.placement, copy)
        dr.eval(si)
        return index, si

    def _choose(self, number: NDArray, patch: NDArray, region: mi.UInt32, wanted: NDArray) -> ChosenLights:
        """Choose the lights of the patches that some clusters lie in."""
        _, si = self._receivers(number)
        bounds = bound_patches(rows(si.p), rows(si.sh_frame.n), patch - patch[0])
        name = upload(np.arange(patch[0], patch[-1] + 1, dtype=np.uint32), mi.UInt32)
        asked = upload(wanted.astype(np.uint32), mi.UInt32)
        return choose_lights(self.lights, self.guide, bounds, region, name, asked)

    def _trace(
        self, number: NDArray, patch: NDArray, chosen: ChosenLights, demand, least, most
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Trace the rays of some clusters: the light that enters at a member, times the mean of the texture; and what was in
        doubt."""
        index, si = self._receivers(number)
        place = upload(patch.astype(np.uint32), mi.UInt32)
        wanted = upload(demand.astype(np.float32), mi.Float)
        receiver = Receiver(si, self.eta, place, index)
        found = sampled_cut(self.scene, self.lights, chosen, receiver, wanted, least, most)
        dr.eval(found, chosen.rays)
        self.shadow_rays += int(found.traced.numpy().sum(dtype=np.int64))
        light, colours = found.light, self.cut.samples.colours
        if colours is not None:
            packet = dr.gather(mi.Array4f, colours, dr.gather(mi.UInt32, self.node, index))
            light *= mi.Color3f(packet[0], packet[1], packet[2])
        return rows(light), found.doubt.numpy()


def _chunks(patch: NDArray) -> list[int]:
    """Cut clusters into chunks of whole patches, at most `PATCHES_AT_ONCE`: their sizes."""
    ends = np.searchsorted(
        patch, np.arange(patch[0] + PATCHES_AT_ONCE, patch[-1] + PATCHES_AT_ONCE + 1, PATCHES_AT_ONCE)
    )
    return np.diff([0, *ends]).tolist()
