"""The samples of a prototype, and points on its copies."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ...effort import count
from ...model.profiles import ProfileTable
from ...scene.prototypes import Prototype
from ...scene.samples.surface import check_sample_count, default_sample_count, sample_surface
from ..preparation import LitBody, sample_profile, textured
from ..surface_samples import SpreadParameters
from .trees.sample_tree import Placement, SampleTree, build_placement, build_sample_tree


@dataclass
class EyePoints:
    """Points on the copies of one prototype, in its own space: positions, numbers of copies, and tolerances as of `contract.Points`."""

    p: mi.Point3f
    copy: mi.UInt32
    tolerance: mi.Float

    @classmethod
    def none(cls) -> EyePoints:
        """Give no points."""
        return cls(mi.Point3f([], [], []), mi.UInt32([]), mi.Float([]))


@dataclass
class SampledPrototype:
    """A prototype with its samples, their tree, and the profile of light that enters at one of them."""

    prototype: Prototype
    samples: SampleTree
    placement: Placement
    table: ProfileTable

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
    mfp = float(np.min(body.medium.mfp))
    number = parameters.sample_count or default_sample_count(surface.area, mfp)
    limits = {"name": body.name, "extent": surface.extent, "mfp": mfp, "scale": body.bsdf.scale}
    check_sample_count(number, parameters.max_samples, **limits)
    method = "poisson" if parameters.sampling == "auto" else parameters.sampling
    samples = sample_surface(surface, number, method, seed, mfp)
    count("violations", samples.violations)
    lit: LitBody[None] = LitBody(body, samples)
    tree = build_sample_tree(samples, textured(lit))
    count("samples", tree.count * len(prototype.bodies))
    placement = build_placement(np.stack(prototype.to_world))
    return SampledPrototype(prototype, tree, placement, sample_profile(lit, parameters.point_samples))
