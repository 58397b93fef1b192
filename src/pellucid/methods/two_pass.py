"""``pellucid_two_pass``: irradiance at surface samples, then a hierarchical sum over their octree (JB02)."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..errors import PellucidError
from ..gather.gather import DEFAULT_MAX_ERROR, gather
from ..gather.octree import build_octree
from .contract import LitBody, TranslucentIntegrator
from .preparation import entering_power, sample_profile

INDIRECT_ERROR = 0.4
"""``max_error`` [sr] of what is seen only by way of another surface, unless the eye's is larger still."""


class TwoPassIntegrator(TranslucentIntegrator):
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
       - How surface samples are spread: ``repulsion``, ``poisson``, ``uniform``, or ``auto``: repulsion up to 300,000
         samples, poisson above. (Default: auto)
     * - sample_count, max_samples
       - |int|
       - Samples a body, 0 for one to every :math:`\pi` squared mean free paths; and the number that is refused. (Default: 0 and 20 million)
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
       - Extra channels: any of ``exitance, irradiance, single_scattering``. (Default: none)
     * - seed
       - |int|
       - Of the samples and their light; the same for all frames of an animation. (Default: 0)
    """

    def __init__(self, props):
        super().__init__(props)
        self.max_error = float(props.get("max_error", DEFAULT_MAX_ERROR))
        if not self.max_error >= 0:
            raise PellucidError(f"max_error is a solid angle [sr], at least 0; found {self.max_error:g}.")

    def build(self, lit: LitBody):
        """Build the octree of a body, or pour new light into the one it has."""
        power = entering_power(lit)
        if lit.state is not None:
            return lit.state[0].with_power(power), *lit.state[1:]
        # A profile that dies within a mean free path changes more across a cluster than a second order can follow.
        strictness = max(1.0, float(np.max(lit.body.medium.sigma_tr / lit.body.medium.sigma_t_prime)) ** 2)
        octree = build_octree(lit.samples.p, lit.samples.area, power)
        return octree, sample_profile(lit, self.point_samples), strictness

    def exitance(
        self, scene, lit: LitBody, p: mi.Point3f, n: mi.Normal3f | None, seed: int, coarse: bool
    ) -> mi.Color3f:
        """Sum JB02 eq. 13 over the clusters that eq. 12 accepts."""
        octree, table, strictness = lit.state
        max_error = self.max_error / strictness
        coarser = max(INDIRECT_ERROR / max_error, 1.0) if coarse and max_error > 0 else 1.0
        return mi.Color3f(gather(octree, table, p, max_error, coarser, scattered=coarse))
