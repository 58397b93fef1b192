"""``pellucid_two_pass``: irradiance at surface samples, then a hierarchical sum over their octree (JB02)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.derivatives import TreeDerivatives
from ..gather.gather import DEFAULT_MAX_ERROR, gather
from ..gather.octree import Octree, build_octree
from ..model.profiles import ProfileTable
from ..model.slopes import log_slopes
from .parameters import parameter
from .preparation import LitBody, entering_power, sample_profile
from .surface_samples import SpreadSamplesMethod

INDIRECT_ERROR = 0.4
"""``max_error`` [sr] of what is seen only by way of another surface, unless the eye's is larger still."""


class TwoPassBody(NamedTuple):
    """The octree of a body, the profile, and how many times smaller ``max_error`` must be for its medium."""

    octree: Octree
    profile: ProfileTable
    strictness: float


@final
@dataclass
class TwoPass(SpreadSamplesMethod[TwoPassBody]):
    r"""
    .. _integrator-pellucid_two_pass:

    Two-pass hierarchical method (:monosp:`pellucid_two_pass`)
    ----------------------------------------------------------

    .. pluginparameters::

     * - max_error
       - |float|
       - Largest solid angle [sr] under which a cluster of samples may stand for its members; 0 sums over every sample.
         Media whose diffuse light dies within a mean free path (ketchup) are held to less. (Default: 0.1)
     * - sampling
       - |string|
       - How surface samples are spread: ``relaxed`` (darts that are pushed apart a little), ``repulsion``, ``poisson``, ``uniform``, or
         ``auto``, which is ``relaxed``. (Default: auto)
     * - sample_count, max_samples
       - |int|
       - Samples a body, 0 for one to every :math:`\pi` squared mean free paths, 5,000 at least; and the number that is refused.
         (Default: 0 and 20 million)
     * - point_samples
       - |bool|
       - Let the light of a sample enter at a point, as in the paper, instead of over the disc around it. (Default: no)
     * - irradiance_paths, irradiance_depth
       - |int|
       - Light paths a sample, 0 to share 2.4 million among all samples of the scene, 16 to 256 each; and their depth as in
         ``max_depth``. (Default: 0, and ``max_depth``)
     * - translucent_passes
       - |int|
       - Extra passes in which translucent bodies light each other with their exitance instead of a diffuse approximation. (Default: 0)
     * - max_depth, rr_depth, hide_emitters
       - |int|, |int|, |bool|
       - As in Mitsuba's ``path``. (Default: 6, 5, no)
     * - aovs
       - |string|
       - Extra channels: any of ``exitance, irradiance, single_scattering`` of bodies, and ``albedo, normal, depth`` of all that is
         seen. (Default: none)
     * - seed
       - |int|
       - Of the samples and their light; the same for all frames of an animation. (Default: 0)
    """

    name = "two_pass"
    stretches = True
    max_error: float = parameter(DEFAULT_MAX_ERROR, "a solid angle [sr]", at_least=0)

    def build(self, lit: LitBody[TwoPassBody]) -> TwoPassBody:
        """Build the octree of a body, or give the one it has other power."""
        power = entering_power(lit)
        if lit.state is not None:
            return lit.state._replace(octree=lit.state.octree.with_power(power))
        # A profile that dies within a mean free path changes more across a cluster than a second order can follow.
        strictness = max(1.0, float(np.max(lit.body.medium.s)) ** 2)
        octree = build_octree(lit.samples.p, lit.samples.area, power)
        return TwoPassBody(octree, sample_profile(lit, self.point_samples), strictness)

    def sum_up(
        self, lit: LitBody[TwoPassBody], p: mi.Point3f, n: mi.Normal3f, indirectly: bool, stretch: Any = None
    ) -> mi.Color3f:
        """Sum JB02 eq. 13 over the clusters that eq. 12 accepts."""
        octree, profile, _ = lit.state
        max_error, coarser = self._errors(lit, indirectly)
        return mi.Color3f(gather(octree, profile, p, max_error, coarser, scattered=indirectly, n=n, stretch=stretch))

    def derivatives(self, lit: LitBody[TwoPassBody], names: list[str], indirectly: bool) -> TreeDerivatives:
        """Differentiate the sum over the same clusters."""
        octree, profile, _ = lit.state
        slopes = [log_slopes(lit.body.medium, profile, name) for name in names]
        return TreeDerivatives(octree, profile, slopes, *self._errors(lit, indirectly), dr.detached_t(mi.Float))

    def _errors(self, lit: LitBody[TwoPassBody], indirectly: bool) -> tuple[float, float]:
        """Give the ``max_error`` of a body, and how many times larger it is for what is seen by way of another surface."""
        max_error = self.max_error / lit.state.strictness
        return max_error, max(INDIRECT_ERROR / max_error, 1.0) if indirectly and max_error > 0 else 1.0
