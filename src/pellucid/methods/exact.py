"""``pellucid_exact``: the sum over all samples at every point, the twin that the other methods are measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.derivatives import DirectDerivatives
from ..gather.gather import gather_all
from ..model.profiles import ProfileTable
from .preparation import LitBody, entering_power, sample_profile
from .surface_samples import SpreadSamplesMethod


class ExactBody(NamedTuple):
    """Positions of samples ``(n, 3)``, the power that enters there ``(n, 3)``, and the profile."""

    p: np.ndarray
    power: np.ndarray
    profile: ProfileTable


@final
@dataclass
class Exact(SpreadSamplesMethod[ExactBody]):
    r"""
    .. _integrator-pellucid_exact:

    Sum over all samples (:monosp:`pellucid_exact`)
    -----------------------------------------------

    The parameters of :ref:`pellucid_two_pass <integrator-pellucid_two_pass>` without ``max_error``. Slow: its time is the
    product of picture points and samples.
    """

    name = "exact"
    stretches = True
    is_reference = True

    def build(self, lit: LitBody[ExactBody]) -> ExactBody:
        """Keep positions and entering power."""
        return ExactBody(lit.samples.p, entering_power(lit), sample_profile(lit, self.point_samples))

    def sum_up(
        self, lit: LitBody[ExactBody], p: mi.Point3f, n: mi.Normal3f, indirectly: bool, stretch: Any = None
    ) -> mi.Color3f:
        """Sum JB02 eq. 13 over all samples of the body."""
        return mi.Color3f(gather_all(*lit.state, p, n, stretch))

    def derivatives(self, lit: LitBody[ExactBody], slopes: list[np.ndarray], indirectly: bool) -> DirectDerivatives:
        """Differentiate the sum over all samples."""
        return DirectDerivatives(*lit.state, slopes, dr.detached_t(mi.Float))
