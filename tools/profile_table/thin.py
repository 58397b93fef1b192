"""From walks in slabs to the factor of thin parts, as `pellucid.model.tabulated` reads it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from flat import ring_energy
from walks import ENDLESS, Array, Task, Walk

from pellucid.model.profiles import TIGHTEST
from pellucid.model.tabulated import Curved

THICKNESS = (1, 2, 4, 8, 16, 32)
PHOTONS = 500_000
MOST = 1.2  # more than this is light that has passed a dark slab without being scattered
DARKEST = np.sqrt(3 * (1 - 1e-3))  # s of the reduced albedo 1e-3: what comes out of darker slabs has hardly scattered
RINGS = np.concatenate([[0.0], np.geomspace(1e-3, 1e4, 6000)])


def slabs(eta: float) -> list[Task]:
    """List the walks in slabs of all thicknesses; isotropic scattering."""
    return [Task("slab", thickness, 0.0, eta, PHOTONS, 7, ENDLESS) for thickness in THICKNESS]


def own_sum(thickness: float, s: float, eta: float) -> float:
    """Sum the curved profile over both faces of a slab: what an evenly lit one sends out where no factor corrects it."""
    x, area = 0.5 * (RINGS[1:] + RINGS[:-1]), np.pi * np.diff(RINGS**2)
    profile, across = Curved(), np.hypot(x, thickness)
    mu = np.minimum(thickness / across, across / (2 * TIGHTEST))
    near = profile.density(x, s, 0.0, eta)
    far = profile.density(across, s, 0.0, eta) * np.exp(profile.curve(across, s, 0.0, eta) * mu)
    return float(((near + far) * area).sum())


def own_sums(walks: Sequence[Walk], s: float) -> Array:
    """Divide that sum by what a half space sends out, for each slab."""
    s = min(s, DARKEST)
    return np.array([own_sum(walk.size, s, walk.eta) / Curved().total(s, 0.0, walk.eta) for walk in walks])


def factors(walks: Sequence[Walk], s: float) -> Array:
    """Divide the light that really comes out of each slab by that sum."""
    s = min(s, DARKEST)
    found = [sum(ring_energy(walk, s, face)[0].sum() for face in (0, 1)) if s > 0 else 1.0 for walk in walks]
    sums = [own_sum(walk.size, s, walk.eta) for walk in walks]
    return np.minimum(np.array(found) / np.array(sums), MOST)
