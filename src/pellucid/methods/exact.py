"""``pellucid_exact``: the sum over all samples at every point, the twin that the other methods are measured against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.derivatives import SampleDerivatives
from ..gather.gather import gather_all
from ..gather.source import sample_source
from ..model.profiles import ProfileTable
from ..model.slopes import log_slopes
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

    def derivatives(self, lit: LitBody[ExactBody], names: list[str], indirectly: bool) -> SampleDerivatives:
        """Differentiate the sum over all samples."""
        slopes = [log_slopes(lit.body.medium, lit.state.profile, name) for name in names]
        return SampleDerivatives(sample_source(*lit.state, dr.detached_t(mi.Float)), slopes)
