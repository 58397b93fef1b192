"""A capital after those of Cordoba: two wreaths of leaves around a bell, volutes at the corners, an impost block above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..shapes.lathe import Solid, joined, revolve, rounded

Array = NDArray[np.float64]

# Heights [m] from the top of the shaft.
BELL, ABACUS, IMPOST = 0.66, 0.78, 1.16
NECK = 0.25
BELL_PROFILE = (
    (0, 0), (NECK, 0), (NECK, 0), (0.275, 0.015), (0.275, 0.05), (0.245, 0.06), (0.245, 0.16), (0.255, 0.34),
    (0.285, 0.50), (0.35, 0.60), (0.40, 0.63), (0.40, BELL), (0.46, BELL + 0.01), (0.47, BELL + 0.06),
    (0.50, BELL + 0.07), (0.50, ABACUS), (0.50, ABACUS), (0, ABACUS),
)  # fmt: skip
IMPOST_PROFILE = (
    (0, ABACUS + 0.004), (0.40, ABACUS + 0.004), (0.40, ABACUS + 0.004), (0.405, 0.86), (0.44, 0.91), (0.445, 0.97),
    (0.48, 1.02), (0.49, 1.06), (0.505, 1.06), (0.505, IMPOST), (0.505, IMPOST), (0, IMPOST),
)  # fmt: skip
# A wreath: number of leaves, where the first stands [leaves], where they begin and end, and how far the tips lean out.
WREATHS = ((8, 0.0, 0.07, 0.32, 0.10), (8, 0.5, 0.16, 0.51, 0.13))


def square(angle: Array, power: float) -> Array:
    """Radius, over the angle, of a square with rounded corners and half side one."""
    return (np.abs(np.cos(angle)) ** power + np.abs(np.sin(angle)) ** power) ** (-1 / power)


def capital(segments: int) -> Solid:
    """Carve the capital and its impost: two closed solids in one mesh, about ``0.6 segments^2`` triangles."""
    bell = revolve(rounded(BELL_PROFILE, max(segments // 2, 40)), segments, _carve)
    block = revolve(rounded(IMPOST_PROFILE, max(segments // 8, 20)), max(segments // 2, 32), _impost)
    return joined([bell, block])


def _impost(angle: Array, rings: Array) -> Array:
    """Make the rings of the impost rounded squares."""
    return rings * np.array([1, 1, 0]) * square(angle, 14.0)[:, None] + rings * np.array([0, 0, 1])


def _carve(angle: Array, rings: Array) -> Array:
    """Displace the rings (k, m, 3) of the bell: leaves grow from it, the top goes over into the square abacus."""
    radius, z = np.hypot(rings[..., 0], rings[..., 1]), rings[..., 2]
    inner = np.clip(radius / 0.245, 0, 1) ** 4  # nothing is carved on the flat ends
    out = _volutes(angle, z)
    for count, shift, low, high, lean in WREATHS:
        out = np.maximum(out, lean * _leaf(angle * count / (2 * np.pi) + shift, (z - low) / (high - low)))
    t = np.clip((z - 0.58) / (BELL - 0.58), 0, 1)
    side = np.where(z > BELL, square(angle, 12.0) * (1 - 0.09 * np.cos(2 * angle) ** 8), 1.0)
    side = side + (t * (1 - (z > BELL))) * 0.10 * (square(angle, 6.0) - 1)
    grown = (radius * side + out * inner) / np.maximum(radius, 1e-9)
    return np.stack([rings[..., 0] * grown, rings[..., 1] * grown, z], -1)


def _leaf(place: Array, t: Array) -> Array:
    """Height of an acanthus leaf, 0 to 1, over the place across [leaves] and ``t`` along it: it swells towards a tip that leans out."""
    x = np.abs((place + 0.5) % 1 - 0.5) * 2.0
    x, t = np.broadcast_arrays(x, np.clip(t, -0.2, 1.4))
    lobe = np.abs(np.sin(np.pi * (4.0 * t - 0.9 * x + 0.15)))
    outline = (0.72 + 0.24 * lobe**0.6) * np.clip(1 - np.clip(t - 0.18, 0, 1) ** 2.4 / 0.62, 0, 1) ** 0.62
    inside = _smooth((outline - x) / 0.16)
    swell = 0.30 + 0.08 * t + 0.62 * np.clip((t - 0.30) / 0.65, 0, 1) ** 2
    rounding = 1 - 0.30 * np.clip(x / np.maximum(outline, 0.05), 0, 1) ** 2
    veins = 0.07 * np.cos(2 * np.pi * (4.0 * t - 0.9 * x + 0.15)) * np.clip(x / 0.25, 0, 1)
    rib = 0.09 * np.exp(-((x / 0.07) ** 2))
    return inside * np.clip(swell * rounding + veins + rib, 0, None) * _smooth((1.0 - t) / 0.06) * _smooth(t / 0.04)


def _smooth(t: Array) -> Array:
    """Go from 0 to 1 with level ends."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _volutes(angle: Array, z: Array) -> Array:
    """Height [m] of the scrolls under the four corners of the abacus, their stems, and a flower in the middle of each side."""
    corner = _from_quarter(angle, 0.5)
    x, y = corner / 0.30, (z - 0.575) / 0.085
    r = np.hypot(x, y)
    winding = 0.80 + 0.20 * np.cos(2 * np.pi * 1.9 * r + np.arctan2(y, x))
    scroll = 0.14 * _smooth((1 - r) / 0.45) * winding
    rise = np.clip((z - 0.40) / 0.175, 0, 1)
    stem = 0.05 * np.exp(-(((np.abs(corner) - 0.30 * (1 - rise)) / 0.07) ** 2)) * rise * _smooth((0.60 - z) / 0.05)
    side = _from_quarter(angle, 0.0)
    u, v = side / 0.15, (z - 0.70) / 0.065
    petals = _smooth((1 - np.hypot(u, v)) / 0.5) * (0.8 + 0.2 * np.cos(6 * np.arctan2(v, u)))
    return scroll + stem + 0.05 * petals


def _from_quarter(angle: Array, where: float) -> Array:
    """Angle [rad] from the nearest of four directions, the first of them at ``where`` quarters of a turn."""
    return ((angle / (np.pi / 2) - where + 0.5) % 1 - 0.5) * (np.pi / 2)
