"""Four ways to sum over (eye point, irradiance sample, light sample), all over the same samples, lights and trees."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar, final

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...effort import count
from ...errors import warn
from ...gather.gather import gather, gather_all
from ...gather.octree import Octree, build_octree
from ...kernels.memory import rows, upload
from ...light.points.discretise import irradiance_of_all
from ...light.points.records import LightSamples
from ...model.medium import Medium
from ...progress import chunks, steps
from .adaptive.algorithm import AdaptiveSettings, Covering, MeasuredLight, measure_light
from .adaptive.copies import Copies
from .adaptive.traversal import footprint, walk_source
from .paper.cache import LinkCache
from .paper.light_cut import DEFAULT_MAX_CUT, light_cuts
from .paper.tables import CutTables
from .paper.triple_cut import CutParameters, triple_cut
from .samples import EyePoints, SampledPrototype
from .trees.light_tree import LUMINANCE, LightTree, build_light_tree

MOST_NODES = 1 << 27
"""Nodes of copies that are measured together: 17 bytes each."""

EYES_AT_ONCE = 1 << 14
"""Eye points of one launch of the triple cut: 16 kB of local memory each, and progress."""

RECEIVERS_AT_ONCE = 1 << 16

CUT_ERROR = 0.1
"""Solid angle [sr] under which clusters may stand for their samples, in the adaptive mode and in the reference. With 0.3 the
adaptive mode, whose clusters are weighed by area because their light is not known yet, is off by 2 % where sunlight ends abruptly."""

NEGLIGIBLE = 3e-4
"""Share of an eye point's light below which a cluster is not divided for it, whatever its solid angle."""

EYES_PER_SAMPLE = 4
"""Eye points for each sample of a small body that decide how well its light is measured."""

MANY_FULL = 0.05
"""Share of eye points with full cuts that is warned of."""

Prepared = TypeVar("Prepared")


@dataclass
class Mode(ABC, Generic[Prepared]):
    """What is prepared of each prototype, and how the exitance is summed from that."""

    def cluster(self, lights: LightSamples) -> LightTree:
        """Cluster the lights of a scene."""
        return build_light_tree(lights)

    @abstractmethod
    def prepare(
        self, scene: mi.Scene, lights: LightTree, body: SampledPrototype, eyes: EyePoints, covering: Covering
    ) -> Prepared:
        """Prepare a prototype for the eye points of a view, of which there may be none; ``covering`` is for what they do not see."""

    @abstractmethod
    def exitance(
        self, scene: mi.Scene, lights: LightTree, body: SampledPrototype, prepared: Prepared, points: EyePoints
    ) -> mi.Color3f:
        """Evaluate the exitance at points on the copies of a prototype."""


@final
@dataclass
class Adaptive(Mode[list[MeasuredLight]]):
    """Measure the light of the clusters that are seen, as well as they are seen (`adaptive.algorithm`)."""

    settings: AdaptiveSettings
    least_reflectance: float
    """Of darker media errors are as large as if they reflected so much (luminance)."""

    def prepare(self, scene, lights, body, eyes, covering) -> list[MeasuredLight]:
        """Measure the light of all copies, as many at once as memory allows."""
        samples, medium = body.samples, body.prototype.bodies[0].medium
        source = walk_source(samples, body.table, CUT_ERROR, NEGLIGIBLE)
        mfp, own = float(np.max(medium.mfp)), reflectance(medium)
        at_once = _copies_at_once(body)
        found = []
        for first in range(0, body.copies, at_once):
            numbers = np.arange(first, min(first + at_once, body.copies))
            copies = Copies(
                samples,
                body.placement,
                source,
                numbers,
                body.eta,
                mfp,
                own,
                max(own, self.least_reflectance),
                footprint(body.table),
            )
            some, _ = _on_copies(eyes, first, at_once)
            some = enough_eyes(some, samples.count * len(numbers))
            found.append(measure_light(scene, copies, lights, some, covering, self.settings))
        return found

    def exitance(self, scene, lights, body, prepared, points) -> mi.Color3f:
        """Sum the light that was measured."""
        at_once, exitance = _copies_at_once(body), dr.zeros(mi.Color3f, dr.width(points.p))
        for k, light in enumerate(prepared):
            some, index = _on_copies(points, k * at_once, at_once)
            if dr.width(index):
                dr.scatter(exitance, light.gather(some), index)
        return exitance


def reflectance(medium: Medium) -> float:
    """Evaluate the total diffuse reflectance, as luminance."""
    return float(medium.total_diffuse_reflectance @ LUMINANCE)


def _copies_at_once(body: SampledPrototype) -> int:
    """Tell how many copies are measured together."""
    return max(MOST_NODES // (2 * body.samples.leaves), 1)


def _on_copies(points: EyePoints, first: int, number: int) -> tuple[EyePoints, mi.UInt32]:
    """Select the points on some of the copies, counted from the first of these: they, and their numbers among all."""
    copy = points.copy.numpy()
    if len(copy) == 0:
        return points, points.copy
    index = upload(np.flatnonzero((copy >= first) & (copy < first + number)).astype(np.uint32))
    some = dr.gather(EyePoints, points, index)
    some.copy -= dr.opaque(mi.UInt32, first)
    dr.eval(some)
    return some, index


def enough_eyes(eyes: EyePoints, samples: int) -> EyePoints:
    """Take every second, third, ... of the eye points, so that `EYES_PER_SAMPLE` are left for each sample: what more of them see is
    measured anyway."""
    step = dr.width(eyes.p) // (EYES_PER_SAMPLE * samples)
    if step < 2:
        return eyes
    some = dr.gather(EyePoints, eyes, upload(np.arange(0, dr.width(eyes.p), step, dtype=np.uint32)))
    dr.eval(some)
    return some


@final
@dataclass
class TripleCuts(Mode[CutTables]):
    """Refine a cut of triples for every eye point, as the paper does (AWB08 section 4)."""

    parameters: CutParameters
    clamp: float
    """How many times farther away virtual lights stop growing brighter."""
    seed: int
    cache: LinkCache
    keys: int = 0
    told: bool = False
    """Whether it was warned of full cuts."""

    def cluster(self, lights: LightSamples) -> LightTree:
        """Cluster lights by place alone: bounds near a cluster depend on its size most of all."""
        near2 = np.where(lights.indirect, lights.near2 * self.clamp**2, lights.near2)
        return build_light_tree(replace(lights, near2=near2.astype(np.float32)), turn=0.0)

    def prepare(self, scene, lights, body, eyes, covering) -> CutTables:
        """Choose representatives. Which keys its links have in the cache changes nothing that is found there."""
        tables = CutTables.build(body.samples, lights, body.table, self.seed, self.keys)
        self.keys += tables.keys(body.copies)
        return tables

    def exitance(self, scene, lights, body, prepared, points) -> mi.Color3f:
        """Refine cuts, some thousand eye points at once."""
        exitance = dr.zeros(mi.Color3f, dr.width(points.p))
        for first, size in steps("triple cuts", chunks(dr.width(points.p), EYES_AT_ONCE), "eye points"):
            index = dr.arange(mi.UInt32, size) + first
            some = dr.gather(EyePoints, points, index)
            cuts = triple_cut(
                scene, prepared, body.placement, body.eta, some.p, some.copy, self.parameters, self.cache, some.n
            )
            dr.scatter(exitance, cuts.exitance, index)
            count("shadow rays", cuts.shadow_rays)
            count("links", cuts.cut_size)
            count("irradiance links", cuts.links)
            count("cache hits", cuts.cache_hits)
            full = int(dr.count(cuts.full)[0])
            count("full cuts", full)
            if full > MANY_FULL * size and not self.told:
                self.told = True
                warn(
                    f"Many cuts are full, of {full} of {size} eye points: their error may be larger than max_error. Raise max_cut, "
                    f"now {self.parameters.max_cut} (16384 at most), or max_error, or use the mode 'adaptive'."
                )
        return exitance


@dataclass
class LitCopies:
    """The octree of a prototype, where sums are hierarchical; and the power ``(n, 3)`` that enters at the samples of each copy."""

    octree: Octree | None
    power: dict[int, NDArray[np.float32]] = field(default_factory=dict)


@dataclass
class AllSamples(Mode[LitCopies]):
    """Light all samples of the copies that are asked for, each copy once, and sum."""

    @abstractmethod
    def entering(self, scene: mi.Scene, lights: LightTree, eta: float, si: mi.SurfaceInteraction3f) -> mi.Color3f:
        """Evaluate the light that enters at samples."""

    @abstractmethod
    def sum_up(self, body: SampledPrototype, prepared: LitCopies, power: NDArray, points: EyePoints) -> mi.Color3f:
        """Sum over the samples of one copy."""

    def exitance(self, scene, lights, body, prepared, points) -> mi.Color3f:
        """Sum copy by copy."""
        exitance, copies = dr.zeros(mi.Color3f, dr.width(points.p)), points.copy.numpy()
        for copy in np.unique(copies).tolist():
            if copy not in prepared.power:
                prepared.power[copy] = self._light(scene, lights, body, copy)
            index = upload(np.flatnonzero(copies == copy).astype(np.uint32))
            some = dr.gather(EyePoints, points, index)
            dr.scatter(exitance, self.sum_up(body, prepared, prepared.power[copy], some), index)
        return exitance

    def _light(self, scene: mi.Scene, lights: LightTree, body: SampledPrototype, copy: int) -> NDArray[np.float32]:
        """Evaluate the power that enters at all samples of one copy: ``(n, 3)``."""
        samples = body.samples
        power = np.empty((samples.count, 3), np.float32)
        for first, size in steps("irradiance", chunks(samples.count, RECEIVERS_AT_ONCE), "samples"):
            leaf = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
            si = samples.receiver(leaf, body.placement, dr.full(mi.UInt32, copy, size))
            dr.eval(si)
            power[first : first + size] = rows(self.entering(scene, lights, body.eta, si))
        count("receivers", samples.count)
        return power * samples.area[:, None] * samples.colour


@final
@dataclass
class TwoPass(AllSamples):
    """Light every sample by Lightcuts, then gather: the paper's reference (AWB08 section 4.2.3)."""

    max_error: float
    seed: int

    def prepare(self, scene, lights, body, eyes, covering) -> LitCopies:
        """Build an octree."""
        samples = body.samples
        return LitCopies(build_octree(samples.p, samples.area, np.zeros_like(samples.p)))

    def entering(self, scene, lights, eta, si) -> mi.Color3f:
        """Evaluate light cuts."""
        cuts = light_cuts(scene, si, eta, lights, self.max_error, DEFAULT_MAX_CUT, self.seed)
        count("shadow rays", cuts.shadow_rays)
        return cuts.entering

    def sum_up(self, body, prepared, power, points) -> mi.Color3f:
        """Sum over clusters of samples."""
        return mi.Color3f(*gather(prepared.octree.with_power(power), body.table, points.p, CUT_ERROR, n=points.n))


@final
@dataclass
class Exact(AllSamples):
    """Sum over all triples (AWB08 eq. 7): the twin of the other modes, for small sets."""

    def prepare(self, scene, lights, body, eyes, covering) -> LitCopies:
        """Begin without any light."""
        return LitCopies(None)

    def entering(self, scene, lights, eta, si) -> mi.Color3f:
        """Trace a ray from every sample to every light."""
        count("shadow rays", dr.width(si.p) * lights.count)
        return irradiance_of_all(scene, lights.lights, lights.leaves, si, eta)[1]

    def sum_up(self, body, prepared, power, points) -> mi.Color3f:
        """Sum over all samples."""
        return mi.Color3f(*gather_all(body.samples.p, power, body.table, points.p, points.n))


MODES = ("adaptive", "cut", "two_pass", "exact")
