"""The dipole of the diffusion approximation: the profile of the papers."""

from __future__ import annotations

import numpy as np

from .flat_profile import Array, FlatProfile
from .fresnel import boundary_mismatch


class Dipole(FlatProfile):
    """A source below the surface and a virtual one above it, which stands for the boundary.

    Source
    ------
    JB02 eqs. 8 to 11 and 15.
    """

    name = "dipole"
    even_within = 1.0  # the depth of the real source
    overlap = 1.8

    def total(self, s: float, g: float, eta: float) -> float:
        """Evaluate JB02 eq. 15, ``R_d = a'/2 (1 + exp(-4/3 A s)) exp(-s)``."""
        return float((0.5 - s * s / 6) * (1 + np.exp(-4 / 3 * boundary_mismatch(eta) * s)) * np.exp(-s))

    def decay(self, s: float, g: float) -> float:
        """Evaluate ``sigma_tr = sqrt(3 sigma_a sigma_t')``. JB02 eq. 11."""
        return s

    def density(self, x: Array, s: float, g: float, eta: float) -> Array:
        """Evaluate ``a' / (4 pi) sum_{r,v} z (1 + s d) exp(-s d) / d^3``. JB02 eqs. 8 to 10."""
        total = np.zeros_like(x)
        for depth in (1.0, 1 + 4 / 3 * boundary_mismatch(eta)):
            d = np.sqrt(x * x + depth * depth)
            total += depth * (s + 1 / d) * np.exp(-s * d) / (d * d)
        return (1 - s * s / 3) / (4 * np.pi) * total
