"""What a profile of a flat half space has to answer; lengths in reduced mean free paths ``1 / sigma_t'``.

The absorption of a channel is given by ``s = sqrt(3 (1 - a')) = sqrt(3 sigma_a / sigma_t')``, from 0 (none) to the root of 3 (nothing
scatters): it keeps its digits where the reduced albedo a' is near one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_ABSORBING = np.sqrt(3.0)


class FlatProfile(ABC):
    """How light spreads that enters a flat half space at a point, from all directions alike."""

    name: ClassVar[str]
    even_within: ClassVar[float]
    """Distance up to which the profile is nearly even: tables resolve it from there on."""
    overlap: ClassVar[float]
    """Radius of the soft disc over which the light of a surface sample enters, in that of the disc of its area: what left the least error
    on half-lit spheres and beside shadows, for all materials. Wider discs show samples less, and blur the edges of shadows more."""
    is_curved: ClassVar[bool] = False
    """Whether the profile knows of curved surfaces and thin parts."""
    known: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({})
    """Bounds of what the profile knows, by ``g`` and ``eta``; beyond them it is what it is there."""

    @abstractmethod
    def total(self, s: float, g: float, eta: float) -> float:
        """Return the fraction of the entering flux that comes back: the profile's integral over the plane."""

    @abstractmethod
    def decay(self, s: float, g: float) -> float:
        """Return ``sigma_tr / sigma_t'``: far away the profile falls as ``exp(-sigma_tr r)``."""

    @abstractmethod
    def density(self, x: Array, s: float, g: float, eta: float) -> Array:
        """Evaluate the exitance per unit of entering flux at distances ``x (...)``, in units of ``sigma_t'^2``."""

    def curve(self, x: Array, s: float, g: float, eta: float) -> Array:
        """Evaluate beta at distances ``x (...)``; zero where the profile knows of no curve.

        Where the surface curves the profile is ``R(x) exp(beta mu)``, mu the cosine between the normal where light leaves and the way
        there from where it enters.
        """
        return np.zeros_like(x)

    def thin(self, own: Array, white: Array, s: float, eta: float) -> Array:
        """Evaluate what light that enters is multiplied by; 1 where the profile knows of no thickness.

        ``own`` is the profile summed over the body, over the total reflectance; ``white`` the sum without absorption, which should be 1.
        """
        return np.ones_like(own)

    @final
    def s_of_total(self, reflectance: float, g: float, eta: float) -> float:
        """Invert `total`, which falls from 1 at ``s = 0`` to 0, by bisection to the last bit."""
        low, high = 0.0, float(MOST_ABSORBING)
        for _ in range(80):  # the bracket halves relative to the root of 3: s of 1e-8 still has 15 digits
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.total(middle, g, eta) > reflectance else (low, middle)
        return 0.5 * (low + high)
