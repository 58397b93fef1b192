"""A capital after those of Cordoba: two wreaths of leaves around a bell, volutes at the corners, an impost block above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .kitchen_lathe import Solid, joined, revolve, rounded

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
# A wreath: number of leaves, where the first stands [leaves], where they begin and end, width, and how far the tip leans.
WREATHS = ((8, 0.0, 0.07, 0.33, 0.9, 0.095), (8, 0.5, 0.22, 0.53, 0.9, 0.115))


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
    out, down = np.zeros_like(z), np.zeros_like(z)
    for count, shift, low, high, width, lean in WREATHS:
        leaf, curl = _leaf(angle * count / (2 * np.pi) + shift, (z - low) / (high - low), width)
        out = np.maximum(out, lean * leaf)
        down = np.where(lean * leaf >= out, 0.05 * curl, down)
    volute, drop = _volutes(angle, z)
    out, down = np.maximum(out, volute), np.maximum(down, drop)
    t = np.clip((z - 0.58) / (BELL - 0.58), 0, 1)
    side = np.where(z > BELL, square(angle, 12.0) * (1 - 0.09 * np.cos(2 * angle) ** 8), 1.0)
    side = side + (t * (1 - (z > BELL))) * 0.10 * (square(angle, 6.0) - 1)
    grown = (radius * side + out * inner) / np.maximum(radius, 1e-9)
    return np.stack([rings[..., 0] * grown, rings[..., 1] * grown, z - down * inner], -1)


def _leaf(place: Array, t: Array, width: float) -> tuple[Array, Array]:
    """Height of an acanthus leaf, 0 to 1, over place across [leaves] and ``t`` along it; and how far its tip hangs over."""
    x = np.abs((place + 0.5) % 1 - 0.5) * 2 / width
    x, t = np.broadcast_arrays(x, np.clip(t, -0.2, 1.4))
    lobes = 0.80 + 0.20 * np.abs(np.cos(4.5 * np.pi * t - 1.6 * x))
    edge = lobes * np.sqrt(np.clip(1 - np.clip(t - 0.15, 0, 1) ** 3.2, 0, 1))
    inside = np.clip((edge - x) / 0.10, 0, 1)
    inside = inside * inside * (3 - 2 * inside)
    swell = 0.24 + 0.10 * t + 0.75 * np.clip((t - 0.35) / 0.6, 0, 1) ** 2.2
    end = np.clip((1.0 - t) / 0.07, 0, 1)
    rib = 0.10 * np.exp(-((x / 0.10) ** 2)) - 0.10 * np.abs(np.sin(np.pi * (2.2 * x / (1.05 - 0.6 * t) + 1.5 * t)))
    height = inside * np.clip(end * (swell + rib * (0.4 + 0.6 * t)), 0, None) * (t > 0)
    curl = inside * np.clip((t - 0.7) / 0.3, 0, 1) ** 2 * (t < 1.05)
    return height, curl


def _volutes(angle: Array, z: Array) -> tuple[Array, Array]:
    """Scrolls under the four corners of the abacus, and a small flower in the middle of each side."""
    corner = np.abs((angle / (np.pi / 2)) % 1 - 0.5) * (np.pi / 2)
    x, y = corner / 0.22, (z - 0.585) / 0.075
    r = np.hypot(x, y)
    disc = np.sqrt(np.clip(1 - r**2, 0, 1))
    spiral = 0.72 + 0.28 * np.cos(2 * np.pi * 2.2 * r + np.arctan2(y, x))
    stem = np.exp(-(((corner - 0.34 * np.clip((0.585 - z) / 0.12, 0, 1)) / 0.05) ** 2)) * np.clip(
        (z - 0.44) / 0.03, 0, 1
    )
    stem = stem * np.clip((0.585 - z) / 0.03, 0, 1)
    middle = np.abs((angle / (np.pi / 2) + 0.5) % 1 - 0.5) * (np.pi / 2)
    q = np.hypot(middle / 0.13, (z - 0.70) / 0.055)
    petals = np.clip(1 - q, 0, 1) ** 0.5 * (0.75 + 0.25 * np.cos(6 * np.arctan2((z - 0.70) / 0.055, middle / 0.13)))
    return 0.15 * disc * spiral + 0.05 * stem + 0.06 * petals, np.zeros_like(z)
