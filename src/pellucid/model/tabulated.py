"""The profile that photons have: a table over absorption, g and eta, interpolated."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import eigh_tridiagonal

from .flat_profile import MOST_ABSORBING, Array, FlatProfile

FLAT, CURVES, THIN = (Path(__file__).with_name(f"{kind}_profiles.npz") for kind in ("flat", "curved", "thin"))

KNOTS = np.arange(-6.0, 10.0)
"""Of the spline y, in octaves of distance; beyond both ends y is even."""

NEAREST = 0.004
"""Nearer than this [reduced mean free paths] the profile, which grows as 1 / r, is its mean."""

MOMENTS = 400  # of the radiance over the angle, which hold the decay to single precision in all media of the table
LEAST_ALBEDO = 1e-4  # reduced; below, R / a' and the shape of R are what they are there


class Table(NamedTuple):
    """Nodes of the table, and what stands there.

    Attributes
    ----------
    g, eta, s, s_total : (m,), (n,), (k,) and (l,) float
        Nodes; those of s are finer for the total.
    y : (m, n, k, len(KNOTS) + 2) float32
        Coefficients of the spline, for a profile that integrates to 1.
    log_total : (m, n, l) float32
        ``log(R / a')`` of the total reflectance R.
    """

    g: Array
    eta: Array
    s: Array
    s_total: Array
    y: Array
    log_total: Array


class CurveTable(NamedTuple):
    """Nodes of the table of beta, and its values: ``eta (n,)``, ``s (k,)``, ``octave (d,)`` of the distance, ``beta (n, k, d)``."""

    eta: Array
    s: Array
    octave: Array
    beta: Array


class ThinTable(NamedTuple):
    """Nodes of the table of thin parts: ``eta (n,)``, ``s (k,)``; for slabs of t thicknesses ``own (n, k, t)``, the curved profile
    summed over both sides, 1 on a half space, and ``factor (n, k, t)``, the light that really comes out over that sum."""

    eta: Array
    s: Array
    own: Array
    factor: Array


class Tabulated(FlatProfile):
    """The light of photons in a half space, of all orders of scattering.

    ``R(x) = exp(y) (1 + k x) exp(-k x) / (x (1 + x)^2)``, x the distance and k the decay of the medium. The shape has what is known of
    R: ``1 / x`` of light that scattered once, ``x^-3`` of diffusion, and how it dies. What is left, y, is a smooth function of the
    logarithm of x and of s, g and eta: cubic splines in all of them.

    Source
    ------
    Photons traced by tools/profile_table; media scatter by Henyey and Greenstein's phase function and have a smooth boundary.
    """

    name = "tabulated"
    even_within = 1 / 32
    overlap = 2.75
    known = MappingProxyType({"g": (-0.5, 0.95), "eta": (1.0, 2.0)})

    def total(self, s: float, g: float, eta: float) -> float:
        """Interpolate the total reflectance."""
        return float(np.exp(_splines(g, eta)[1](s)) * (1 - s * s / 3))

    def decay(self, s: float, g: float) -> float:
        """Solve for the slowest decay of light in the medium, see `decay`."""
        return decay(s, g)

    def density(self, x: Array, s: float, g: float, eta: float) -> Array:
        """Interpolate the profile."""
        return evaluate(_coefficients(s, g, eta), np.where(x < NEAREST, NEAREST / 2, x), decay(s, g))


class Curved(Tabulated):
    """The same light on the curve and in thin parts of a body.

    Flat and thick, it is `Tabulated`.
    """

    name = "curved"
    is_curved = True

    def curve(self, x: Array, s: float, g: float, eta: float) -> Array:
        """Interpolate beta, which was measured on spheres: there mu is ``x / 2`` over the radius."""
        table = read_curves()
        octave = np.log2(np.maximum(x, NEAREST))
        return np.interp(octave, table.octave, _curves(eta)(min(s, float(table.s[-1]))))

    def thin(self, own: Array, white: Array, s: float, eta: float) -> Array:
        """Interpolate the factor measured on slabs, not below ``1 / white``, that without absorption; 1 where ``white`` is below 1."""
        return np.where(white < 1, 1.0, np.interp(own, *_thin(s, eta)).clip(1 / white))


@lru_cache(maxsize=64)
def _thin(s: float, eta: float) -> tuple[Array, Array]:
    """Interpolate the sums, ascending from 1, and the factors that belong to them."""
    table = read_thin()
    eta, s = np.clip(eta, table.eta[0], table.eta[-1]), min(s, float(table.s[-1]))
    own, factor = (CubicSpline(table.s, CubicSpline(table.eta, v)(eta))(s) for v in (table.own, table.factor))
    order = np.argsort(own)
    return np.append(1.0, np.maximum(own[order], 1.0)), np.append(1.0, factor[order])


def shape(x: Array, k: float) -> Array:
    """Evaluate ``(1 + k x) exp(-k x) / (x (1 + x)^2)``."""
    return (1 + k * x) * np.exp(-k * x) / (x * (1 + x) ** 2)


def spline_knots() -> Array:
    """Repeat the first and the last knot, as a cubic spline wants it."""
    return np.concatenate([[KNOTS[0]] * 3, KNOTS, [KNOTS[-1]] * 3])


def evaluate(coefficients: Array, x: Array, k: float) -> Array:
    """Evaluate a profile by the coefficients of its y."""
    octave = np.clip(np.log2(x), KNOTS[0], KNOTS[-1])
    return np.exp(BSpline(spline_knots(), coefficients, 3)(octave)) * shape(x, k)


def unreduced(s: float, g: float) -> float:
    """Give the albedo ``sigma_s / sigma_t`` that belongs to s."""
    albedo_prime = _albedo_prime(s)
    return albedo_prime / (albedo_prime + (1 - g) * s * s / 3)


def _albedo_prime(s: float) -> float:
    return max(1 - s * s / 3, LEAST_ALBEDO)


@lru_cache(maxsize=4096)
def decay(s: float, g: float) -> float:
    """Find how fast light dies far from where it entered, in units of sigma_t'; diffusion has s instead.

    ``l phi_(l-1) + (l + 1) phi_(l+1) = (2 l + 1) (1 - a g^l) phi_l / k`` are the moments of a radiance that falls as ``exp(-k z)``,
    lengths in mean free paths ``1 / sigma_t``: the largest ``1 / k`` is an eigenvalue of a symmetric matrix.

    Source
    ------
    K. M. Case and P. F. Zweifel, Linear Transport Theory, 1967, chapter 4.
    """
    if s == 0:
        return 0.0
    albedo = unreduced(s, g)
    order = np.arange(MOMENTS)
    lost = np.where(
        order == 0, (1 - g) * s * s / 3 / (_albedo_prime(s) + (1 - g) * s * s / 3), 1 - albedo * np.power(g, order)
    )
    weight = (2 * order + 1) * lost
    beside = (order[:-1] + 1) / np.sqrt(weight[:-1] * weight[1:])
    last = (MOMENTS - 1, MOMENTS - 1)
    slowest = eigh_tridiagonal(np.zeros(MOMENTS), beside, eigvals_only=True, select="i", select_range=last)[0]
    return float(1 / slowest / (1 - g * albedo))


@lru_cache(maxsize=1)
def read_table() -> Table:
    """Read the file of the package."""
    with np.load(FLAT) as file:
        return Table(*(file[name].astype(np.float64) for name in Table._fields))


@lru_cache(maxsize=1)
def read_curves() -> CurveTable:
    """Read the file of the package."""
    with np.load(CURVES) as file:
        return CurveTable(*(file[name].astype(np.float64) for name in CurveTable._fields))


@lru_cache(maxsize=1)
def read_thin() -> ThinTable:
    """Read the file of the package."""
    with np.load(THIN) as file:
        return ThinTable(*(file[name].astype(np.float64) for name in ThinTable._fields))


@lru_cache(maxsize=64)
def _curves(eta: float) -> CubicSpline:
    """Interpolate beta in eta: splines over s of its values at all distances."""
    table = read_curves()
    return CubicSpline(table.s, CubicSpline(table.eta, table.beta)(np.clip(eta, table.eta[0], table.eta[-1])))


@lru_cache(maxsize=64)
def _splines(g: float, eta: float) -> tuple[CubicSpline, CubicSpline]:
    """Interpolate the table in g and eta: splines over s of the coefficients of y, and of the logarithm of the total."""
    table = read_table()
    g, eta = np.clip(g, table.g[0], table.g[-1]), np.clip(eta, table.eta[0], table.eta[-1])
    y, total = (CubicSpline(table.eta, CubicSpline(table.g, v)(g))(eta) for v in (table.y, table.log_total))
    return CubicSpline(table.s, y), CubicSpline(table.s_total, total)


@lru_cache(maxsize=1024)
def _coefficients(s: float, g: float, eta: float) -> Array:
    """Interpolate the coefficients of y and scale them so that the profile integrates to the total."""
    shapes, log_total = _splines(g, eta)
    y = shapes(min(s, float(MOST_ABSORBING)))
    return y + log_total(s) + np.log(max(1 - s * s / 3, 1e-15)) - np.log(integral(y, decay(s, g)))


def integral(coefficients: Array, k: float) -> float:
    """Integrate a profile over the plane; beyond the last ring it falls as ``x^-3``, or faster."""
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 2400)])
    x = 0.5 * (edges[1:] + edges[:-1])
    rings = evaluate(coefficients, x, k) * np.pi * np.diff(edges**2)
    beyond = 2 * np.pi * np.exp(coefficients[-1]) / edges[-1] if k == 0 else 0.0
    return float(rings.sum() + beyond)
