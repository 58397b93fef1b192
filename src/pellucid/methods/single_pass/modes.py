"""Four ways to sum over (eye point, irradiance sample, light sample), all over the same samples, lights and trees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ...gather.gather import gather, gather_all
from ...gather.octree import Octree, build_octree
from ...light.points.discretise import irradiance_of_all
from ...progress import chunks, steps
from .adaptive.algorithm import AdaptiveSettings, adaptive_exitance
from .adaptive.copies import VisibleCopies
from .adaptive.traversal import walk_source
from .paper.cache import FormFactorCache
from .paper.light_cut import light_cuts
from .paper.tables import CutTables
from .paper.triple_cut import CutParameters, triple_cut
from .state import LitPrototype, SinglePassScene
from .trees.light_tree import LUMINANCE

MOST_NODES = 1 << 27
"""Nodes of visible copies that are marked at once: 17 bytes each."""

EYES_AT_ONCE = 1 << 14
"""Eye points of one launch of the triple cut: 16 kB of local memory each, and progress."""

RECEIVERS_AT_ONCE = 1 << 16

CUT_ERROR = 0.1
"""Solid angle [sr] under which clusters may stand for their samples, in the adaptive mode and in the reference. With 0.3 the
adaptive mode, whose clusters are weighed by area because their light is not known yet, is off by 2 % where sunlight ends abruptly."""


NEGLIGIBLE = 3e-4
"""Share of an eye point's light below which a cluster is not divided for it, whatever its solid angle."""


@dataclass
class ModeSettings:
    """The parameters of the plug-in that modes read."""

    max_error: float
    first_rays: int
    most_rays: int
    cut: CutParameters
    max_light_cut: int
    cache_entries: int
    seed: int


@dataclass
class EyePoints:
    """Eye points on the copies of one prototype, in its own space, neighbours beside each other.

    ``tolerance`` multiplies the error that is asked for: above 1 where a point is seen only by way of another surface.
    """

    p: mi.Point3f
    copy: mi.UInt32
    tolerance: mi.Float


Mode = Callable[[mi.Scene, SinglePassScene, LitPrototype, EyePoints, ModeSettings], mi.Color3f]


def adaptive(scene, state: SinglePassScene, lit: LitPrototype, eyes: EyePoints, settings: ModeSettings) -> mi.Color3f:
    """Measure the light of the clusters that are seen, as well as they are seen (`tree.adaptive`)."""
    if "walk" not in lit.state:
        lit.state["walk"] = walk_source(lit.samples, lit.table, CUT_ERROR, NEGLIGIBLE)
    asked = AdaptiveSettings(settings.max_error, settings.first_rays, settings.most_rays)
    medium, leniency = lit.prototype.bodies[0].medium, state.leniency(lit)
    mfp, reflectance = float(np.max(medium.mfp)), float(medium.total_diffuse_reflectance @ LUMINANCE)
    copies = eyes.copy.numpy()
    per_launch = max(MOST_NODES // (2 * lit.samples.leaves), 1)
    seen = np.unique(copies)
    exitance = dr.zeros(mi.Color3f, len(copies))
    for first in range(0, len(seen), per_launch):
        here = seen[first : first + per_launch]
        index = mi.UInt32(np.flatnonzero(np.isin(copies, here)).astype(np.uint32))
        compact = np.searchsorted(here, copies[index.numpy()]).astype(np.uint32)
        cut = VisibleCopies(lit.samples, lit.placement, lit.state["walk"], lit.eta, here, mfp, reflectance, leniency)
        p, tolerance = dr.gather(mi.Point3f, eyes.p, index), dr.gather(mi.Float, eyes.tolerance, index)
        value, spent = adaptive_exitance(scene, cut, state.lights, p, mi.UInt32(compact), tolerance, asked)
        dr.scatter(exitance, value, index)
        state.effort.shadow_rays += spent.shadow_rays
        state.effort.receivers += spent.clusters
        state.effort.links += spent.links
    return exitance


def cut(scene, state: SinglePassScene, lit: LitPrototype, eyes: EyePoints, settings: ModeSettings) -> mi.Color3f:
    """Refine a cut of triples for every eye point, as the paper does (AWB08 section 4)."""
    cache = state.shared.setdefault("cache", FormFactorCache(settings.cache_entries))
    if "tables" not in lit.state:
        first_key = state.shared.setdefault("keys", 0)
        tables = CutTables.build(lit.samples, state.lights, lit.table, settings.seed, first_key)
        state.shared["keys"] += tables.keys(len(lit.prototype.bodies))
        lit.state["tables"] = tables
    count = dr.width(eyes.p)
    exitance = dr.zeros(mi.Color3f, count)
    for first, size in steps("triple cuts", chunks(count, EYES_AT_ONCE), "eye points"):
        index = dr.arange(mi.UInt32, size) + first
        p, copy = dr.gather(mi.Point3f, eyes.p, index), dr.gather(mi.UInt32, eyes.copy, index)
        cuts = triple_cut(scene, lit.state["tables"], lit.placement, lit.eta, p, copy, settings.cut, cache)
        dr.scatter(exitance, cuts.exitance, index)
        state.effort.shadow_rays += _total(cuts.shadow_rays)
        state.effort.links += _total(cuts.cut_size)
        state.effort.cache_hits += _total(cuts.cache_hits)
        state.effort.full_cuts += int(dr.count(cuts.full)[0])
    return exitance


def two_pass(scene, state: SinglePassScene, lit: LitPrototype, eyes: EyePoints, settings: ModeSettings) -> mi.Color3f:
    """Light every sample of a copy that is seen by Lightcuts, then gather: the paper's reference (AWB08 section 4.2.3)."""

    def light(si):
        cuts = light_cuts(scene, si, lit.eta, state.lights, settings.max_error, settings.max_light_cut, settings.seed)
        state.effort.shadow_rays += _total(cuts.shadow_rays)
        return cuts.entering

    if "octree" not in lit.state:
        samples = lit.samples
        lit.state["octree"] = build_octree(samples.p, samples.area, np.zeros_like(samples.p))

    def sum_up(power, p):
        octree: Octree = lit.state["octree"].with_power(power)
        return gather(octree, lit.table, p, CUT_ERROR)

    return _copy_by_copy(state, lit, eyes, light, sum_up)


def exact(scene, state: SinglePassScene, lit: LitPrototype, eyes: EyePoints, settings: ModeSettings) -> mi.Color3f:
    """Sum over all triples (AWB08 eq. 7): the twin of the other modes, for small sets."""
    lights = state.lights

    def light(si):
        state.effort.shadow_rays += dr.width(si.p) * lights.count
        return irradiance_of_all(scene, lights.lights, lights.leaves, si, lit.eta)[1]

    def sum_up(power, p):
        return gather_all(lit.samples.p, power, lit.table, p)

    return _copy_by_copy(state, lit, eyes, light, sum_up)


MODES: dict[str, Mode] = {"adaptive": adaptive, "cut": cut, "two_pass": two_pass, "exact": exact}


def _copy_by_copy(state: SinglePassScene, lit: LitPrototype, eyes: EyePoints, light, sum_up) -> mi.Color3f:
    """Light all samples of each copy that is seen, once, and sum at its eye points."""
    samples, copies = lit.samples, eyes.copy.numpy()
    exitance = dr.zeros(mi.Color3f, len(copies))
    powers = lit.state.setdefault("powers", {})
    for copy in np.unique(copies).tolist():
        if copy not in powers:
            powers[copy] = np.empty((samples.count, 3), np.float32)
            for first, size in steps("irradiance", chunks(samples.count, RECEIVERS_AT_ONCE), "samples"):
                leaf = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
                si = samples.receiver(leaf, lit.placement, dr.full(mi.UInt32, copy, size))
                dr.eval(si)
                powers[copy][first : first + size] = light(si).numpy().T
            powers[copy] *= samples.area[:, None] * samples.colour
            state.effort.receivers += samples.count
        index = mi.UInt32(np.flatnonzero(copies == copy).astype(np.uint32))
        value = mi.Color3f(*sum_up(powers[copy], dr.gather(mi.Point3f, eyes.p, index)))
        dr.scatter(exitance, value, index)
    return exitance


def _total(counts: mi.UInt32) -> int:
    """Sum counts of all lanes."""
    return int(counts.numpy().sum(dtype=np.int64))
