"""From walks in spheres to beta, by which a curved surface changes the flat profile, as `pellucid.model.tabulated` reads it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from flat import ring_energy, stretched_edges
from walks import EDGES, ENDLESS, Array, Task, Walk

RADII = (4, 8, 16, 32)
ETA = (1.0, 1.3, 1.5, 2.0)
OCTAVE = np.arange(-3.0, 6.0)
PHOTONS = 1_000_000
FEWEST, NOISY, SYSTEMATIC = (
    6,
    0.2,
    0.015,
)  # rings in a band; noise that says nothing; error that no number of photons takes away
MOST = 5.0  # where hardly any light arrives the fit has no meaning
WHOLE = 1.5  # radii: what leaves further from where it entered has been around the sphere


def spheres(eta: float) -> list[Task]:
    """List the walks in spheres of all radii; isotropic scattering, since g changes beta by less than its error."""
    return [Task("sphere", radius, 0.0, eta, PHOTONS, 3, ENDLESS) for radius in RADII]


def beta(half_space: Walk, walks: Sequence[Walk], s: float) -> Array:
    """Fit beta in bands of an octave around `OCTAVE`, by least squares over the spheres; what nothing says is as beside it."""
    flat, _ = ring_energy(half_space, s)
    edges = stretched_edges(half_space, s)
    octave = np.log2(np.sqrt(edges[1:] * np.maximum(edges[:-1], 0.36 * edges[1])))
    found = np.array([_in_band(octave, centre, flat, edges, walks, s) for centre in OCTAVE])
    known = np.isfinite(found)
    return np.minimum(np.interp(OCTAVE, OCTAVE[known], found[known]), MOST)


def _in_band(octave: Array, centre: float, flat: Array, edges: Array, walks: Sequence[Walk], s: float) -> float:
    """Average ``log(sphere / flat) / mu`` over spheres, each weighted by its precision."""
    total = weights = 0.0
    for walk in walks:
        light, variance = ring_energy(walk, s)
        radius = walk.size * edges[-1] / EDGES[-1]
        band = (np.abs(octave - centre) <= 0.5) & (EDGES[1:] <= WHOLE * walk.size)
        noise = np.sqrt(variance[band].sum()) / max(light[band].sum(), 1e-300)
        if np.count_nonzero(band) < FEWEST or not noise < NOISY:
            continue
        mu = 2 ** ((octave[band] * flat[band]).sum() / flat[band].sum()) / (2 * radius)
        weight = mu * mu / (noise**2 + SYSTEMATIC**2)
        total += weight * np.log(light[band].sum() / flat[band].sum()) / mu
        weights += weight
    return total / weights if weights else np.nan
