"""The copies of a prototype that are seen: what one call of the algorithm works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....gather.source import Source
from ..trees.sample_tree import Placement, SampleTree


@dataclass
class VisibleCopies:
    """The copies of a prototype that are seen, and how they are walked.

    Attributes
    ----------
    eta : float
        Relative index of refraction.
    copies : (k,) int
        Their numbers in ``placement``.
    mfp : float
        Mean free path [scene units].
    reflectance : float
        What a plane would give under an irradiance of 1: the total diffuse reflectance, as luminance.
    leniency : float
        The part of ``tolerance`` that is for dark media: they may be noisier, but their clusters may not be coarser.
    """

    samples: SampleTree
    placement: Placement
    source: Source
    eta: float
    copies: np.ndarray
    mfp: float
    reflectance: float
    leniency: float = 1.0
