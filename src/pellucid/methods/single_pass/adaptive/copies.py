"""Copies of a prototype, as the adaptive mode works on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....gather.source import Source
from ..trees.sample_tree import Placement, SampleTree


@dataclass
class Copies:
    """Copies of a prototype whose light is measured together, and how they are walked.

    Attributes
    ----------
    numbers : (k,) int
        Their numbers in ``placement``.
    eta : float
        Relative index of refraction.
    mfp : float
        Mean free path [scene units].
    reflectance : float
        What a plane would give under an irradiance of 1: the total diffuse reflectance, as luminance.
    exposure : float
        The same for a body that is not darker than the darkest to whose own light errors are relative.
    footprint : float
        Area over which a point averages light [scene units squared].
    """

    samples: SampleTree
    placement: Placement
    source: Source
    numbers: np.ndarray
    eta: float
    mfp: float
    reflectance: float
    exposure: float
    footprint: float
