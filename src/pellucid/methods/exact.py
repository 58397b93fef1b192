"""``pellucid_exact``: the sum over all samples at every point, the twin that the other methods are measured against."""

from __future__ import annotations

import mitsuba as mi

from ..gather.gather import gather_all
from .contract import LitBody, TranslucentIntegrator
from .preparation import entering_power, sample_profile


class ExactIntegrator(TranslucentIntegrator):
    r"""
    .. _integrator-pellucid_exact:

    Sum over all samples (:monosp:`pellucid_exact`)
    -----------------------------------------------

    The parameters of :ref:`pellucid_two_pass <integrator-pellucid_two_pass>` without ``max_error``. Slow: its time is the
    product of picture points and samples.
    """

    def build(self, lit: LitBody):
        """Keep positions and entering power."""
        return lit.samples.p, entering_power(lit), sample_profile(lit, self.point_samples)

    def exitance(
        self, scene, lit: LitBody, p: mi.Point3f, n: mi.Normal3f | None, seed: int, coarse: bool
    ) -> mi.Color3f:
        """Sum JB02 eq. 13 over all samples of the body."""
        points, power, table = lit.state
        return mi.Color3f(gather_all(points, power, table, p))
