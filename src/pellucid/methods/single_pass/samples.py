"""The samples of a prototype, and points on its copies."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ...effort import count
from ...model.profiles import ProfileTable
from ...scene.prototypes import Prototype
from ..preparation import LitBody, entering_factor, number_of_samples, sample_profile, spread_samples
from ..surface_samples import SpreadParameters
from .trees.sample_tree import Placement, SampleTree, build_placement, build_sample_tree


@dataclass
class EyePoints:
    """Points on the copies of one prototype, in its own space: positions and normals, which point outside, numbers of copies,
    and tolerances as of `contract.Points`."""

    p: mi.Point3f
    n: mi.Normal3f
    copy: mi.UInt32
    tolerance: mi.Float

    @classmethod
    def none(cls) -> EyePoints:
        """Give no points."""
        return cls(mi.Point3f([], [], []), mi.Normal3f([], [], []), mi.UInt32([]), mi.Float([]))


@dataclass
class SampledPrototype:
    """A prototype with its samples, their tree, and the profile of light that enters at one of them."""

    prototype: Prototype
    samples: SampleTree
    placement: Placement
    table: ProfileTable
    outside: int

    @property
    def eta(self) -> float:
        """Relative index of refraction."""
        return float(self.prototype.bodies[0].medium.eta)

    @property
    def copies(self) -> int:
        """Number of its copies."""
        return len(self.prototype.bodies)


def sample_prototype(prototype: Prototype, parameters: SpreadParameters, seed: int) -> SampledPrototype:
    """Spread the samples of a prototype and cluster them (AWB08 section 5.3)."""
    body, surface = prototype.bodies[0], prototype.surface
    number = number_of_samples(body, surface, parameters.sample_count, parameters.max_samples)
    samples = spread_samples(body, surface, number, parameters.sampling, seed)
    count("violations", samples.violations)
    lit: LitBody[None] = LitBody(body, samples)
    tree = build_sample_tree(samples, entering_factor(lit))
    count("samples", tree.count * len(prototype.bodies))
    placement = build_placement(np.stack(prototype.to_world))
    return SampledPrototype(prototype, tree, placement, sample_profile(lit, parameters.point_samples), samples.outside)
