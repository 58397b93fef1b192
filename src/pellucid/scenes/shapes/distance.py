"""Signed distances [mm] of a few solids at points (3, n), negative inside, and how solids join: what shapes are modelled with."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Floats = NDArray[np.floating]
Point = Sequence[float] | NDArray[np.floating]

# Half width of the strip where left and right go over into each other.
SEAM = np.float32(3.0)


def union(a: Floats, b: Floats, k: float) -> Floats:
    """Union of two distances with a fillet about ``k`` [mm] wide, whose curvature begins and ends gently."""
    h = np.maximum(1 - np.abs(a - b) / np.float32(1.5 * k), 0)
    return np.minimum(a, b) - h * h * h * np.float32(k / 4)


def cut(a: Floats, b: Floats, k: float) -> Floats:
    """What is left of ``a`` without ``b``, with a rounded edge."""
    return -union(-a, b, k)


def column(values: Point) -> Floats:
    """Three numbers as (3, 1), in the precision of the points."""
    return np.array(values, np.float32)[:, None]


def ellipsoid(p: Floats, centre: Point, radii: Point) -> Floats:
    """Distance to an ellipsoid, of first order."""
    scale = column(radii)
    q = (p - column(centre)) / scale
    k0 = np.sqrt((q * q).sum(0))
    q /= scale
    return k0 * (k0 - 1) / np.maximum(np.sqrt((q * q).sum(0)), 1e-6)


def capsule(p: Floats, a: Point, b: Point, ra: float, rb: float) -> Floats:
    """Distance to a rod from ``a`` to ``b`` whose radius changes from ``ra`` to ``rb``."""
    axis = column(np.subtract(b, a))
    q = p - column(a)
    t = np.clip((axis * q).sum(0) / (axis**2).sum(), 0, 1)
    q -= t * axis
    return np.sqrt((q * q).sum(0)) - (ra + (rb - ra) * t)


def tube(p: Floats, path: Sequence[Point], radii: Sequence[float]) -> Floats:
    """Distance to a bent rod along a smooth curve through the points of a path, with the radii there."""
    t = np.linspace(0, len(path) - 1, 4 * (len(path) - 1) + 1)
    centres, widths = (CubicSpline(np.arange(len(path)), np.asarray(v, float))(t) for v in (path, radii))
    rods = (capsule(p, *ends) for ends in zip(centres, centres[1:], widths, widths[1:], strict=False))
    return reduce(lambda a, b: union(a, b, 1.0), rods)


def disc(p: Floats, centre: Point, radius: float, height: float, k: float) -> Floats:
    """Distance to an upright cylinder with an edge rounded by ``k``."""
    x, y, z = p - column(centre)
    return -union(np.float32(radius) - np.hypot(x, y), np.float32(height / 2) - np.abs(z), k)


def about(p: Floats, centre: Point, angle: float, axis: int = 2) -> Floats:
    """Coordinates about a centre that are turned by ``angle`` [rad] around one of the axes."""
    q = p - column(centre)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    q[i], q[j] = c * q[i] + s * q[j], c * q[j] - s * q[i]
    return q


def mirrored(p: Floats) -> Floats:
    """Points with |x|, rounded where the halves meet, for what is there on both sides."""
    return np.stack([np.sqrt(p[0] ** 2 + SEAM**2), p[1], p[2]])


def weathering(p: Floats, length: float, seed: int) -> Floats:
    """Uneven waves about ``length`` [mm] long and of deviation 1, (n,)."""
    rng = np.random.default_rng(seed)
    wave = rng.normal(0, 2 * np.pi / length / np.sqrt(3), (16, 3)).astype(np.float32)
    phase = rng.uniform(0, 2 * np.pi, 16).astype(np.float32)
    return np.cos(wave @ p + phase[:, None]).sum(0) / np.float32(np.sqrt(8))
