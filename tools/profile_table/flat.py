"""From walks in a half space to the smooth y of the flat profile, as `pellucid.model.tabulated` reads it."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from walks import EDGES, LAST_ORDER, Array, Walk

from pellucid.model.tabulated import KNOTS, decay, shape, spline_knots, unreduced

LEAST, NOISY = 1e-7, 0.15  # of the light, and relative noise: rings with less or more say nothing
FLATTEST, TRUSTED = 0.1, 0.002  # roughness allowed to y between knots; no ring counts as known better than this


def ring_energy(walk: Walk, s: float, face: int = 0) -> tuple[Array, Array]:
    """Give the light in each ring per unit of entering flux, and its variance, for ``s = sqrt(3 (1 - a'))``: ``(RINGS,)``."""
    albedo = unreduced(s, walk.g)
    power = np.exp(walk.order * np.log(albedo))
    late = _late(walk, albedo) if walk.shape == "half_space" else np.zeros(len(EDGES) - 1)
    return walk.found[face] @ power + late, walk.squares[face] @ power**2 + (0.003 * late) ** 2


def _late(walk: Walk, albedo: float, nodes: int = 400) -> Array:
    """Spread the light that was left after the last order as diffusion does: orders fall as ``n^-3/2``, variances grow as ``2 n / 3``."""
    order = LAST_ORDER / (1 - walk.g) / ((np.arange(nodes) + 0.5) / nodes) ** 2
    variance = 2 * order * (1 - walk.g) / 3
    within = 1 - np.exp(-(EDGES[:, None] ** 2) / (2 * variance))
    return np.diff(within @ (walk.left / nodes * np.exp(order * np.log(albedo))))


def stretched_edges(walk: Walk, s: float) -> Array:
    """Give the bounds of the rings in reduced mean free paths of the medium that absorbs."""
    return EDGES * (1 - walk.g * unreduced(s, walk.g)) / (1 - walk.g)


def total(walk: Walk, s: float) -> float:
    """Sum the light that comes back; all of it without absorption."""
    return float(ring_energy(walk, s)[0].sum()) if s > 0 else 1.0


def fit(walk: Walk, s: float) -> Array:
    """Fit y to the light in rings, by least squares weighted by its noise: coefficients ``(len(KNOTS) + 2,)`` of a cubic spline."""
    energy, variance = ring_energy(walk, s)
    edges = stretched_edges(walk, s)
    node, weight = np.polynomial.legendre.leggauss(6)
    x = 0.5 * (edges[1:] + edges[:-1])[:, None] + 0.5 * np.diff(edges)[:, None] * node
    bare = (shape(x, decay(s, walk.g)) * 2 * np.pi * x * weight).sum(axis=1) * 0.5 * np.diff(edges)
    seen = (energy > LEAST * energy.sum()) & (bare > 1e-300)
    seen[seen] = np.sqrt(variance[seen]) < NOISY * energy[seen]
    y = np.log(energy[seen] / bare[seen])
    centre = np.log2(np.sqrt(edges[1:] * np.maximum(edges[:-1], 0.36 * edges[1] ** 2 / edges[1:])))[seen]
    rows = BSpline.design_matrix(np.clip(centre, KNOTS[0], KNOTS[-1]), spline_knots(), 3).toarray()
    trust = 1 / np.maximum(np.sqrt(variance[seen]) / energy[seen], TRUSTED)
    rough = np.diff(np.eye(rows.shape[1]), 2, axis=0) / FLATTEST
    left = np.vstack([rows * trust[:, None], rough])
    return np.linalg.lstsq(left, np.concatenate([y * trust, np.zeros(len(rough))]), rcond=None)[0]


def noise(walk: Walk, s: float, rings: int = 4) -> float:
    """Expect the L1 difference to the truth that the photons leave, over the reflectance, in half octaves of distance."""
    energy, variance = ring_energy(walk, s)
    parts = np.add.reduceat(variance, np.arange(0, len(variance), rings))
    return float(np.sqrt(2 / np.pi) * np.sqrt(parts).sum() / energy.sum())
