"""What stands on the kitchen table, turned and carved from marble; millimetres, each object on z = 0 around its axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..shapes.lathe import Solid, revolve, rounded, rounded_block

Array = NDArray[np.float64]
Polygon = Sequence[tuple[float, float]]


class Turned(NamedTuple):
    """Control polygon of a profile (radius, height) [mm], and how the solid is carved."""

    polygon: Polygon
    carve: Callable[[Array, Array], Array] | None = None


def _radial(rings: Array, factor: Array) -> Array:
    """Scale the distance of ring points from the axis."""
    return np.concatenate([rings[..., :2] * factor[..., None], rings[..., 2:]], -1)


def _twisted(angle: Array, rings: Array) -> Array:
    """Twist shallow flutes around a vase; its inside stays round."""
    z, radius = rings[..., 2], np.hypot(rings[..., 0], rings[..., 1])
    fade = np.clip((z - 30) / 40, 0, 1) * np.clip((236 - z) / 50, 0, 1) * np.clip((radius - 40) / 20, 0, 1)
    return _radial(rings, 1 + 0.045 * fade * np.cos(14 * angle + 0.016 * z))


def _lipped(angle: Array, rings: Array) -> Array:
    """Draw the rim of a jug out into a lip."""
    lip = np.clip((rings[..., 2] - 130) / 60, 0, 1) ** 2 * np.exp(
        -((((angle + np.pi) % (2 * np.pi) - np.pi) / 0.42) ** 2)
    )
    moved = _radial(rings, 1 + 0.42 * lip)
    moved[..., 2] += 14 * lip
    return moved


def _ribbed_fruit(angle: Array, rings: Array) -> Array:
    """Five faint swellings, as an apple has."""
    return _radial(rings, 1 + 0.02 * np.cos(5 * angle) * np.ones_like(rings[..., 2]))


def _reamed(angle: Array, rings: Array) -> Array:
    """Cut ten flutes into the cone of a lemon squeezer, and nothing into its dish."""
    z, radius = rings[..., 2], np.hypot(rings[..., 0], rings[..., 1])
    cone = np.clip((z - 14) / 8, 0, 1) * np.clip((74 - z) / 12, 0, 1) * np.clip((48 - radius) / 4, 0, 1)
    return _radial(rings, 1 - 0.16 * cone * (0.5 + 0.5 * np.cos(10 * angle)))


def _crowned(angle: Array, rings: Array) -> Array:
    """Notch the crown of a chess queen."""
    crown = np.clip((np.hypot(rings[..., 0], rings[..., 1]) - 16) / 4, 0, 1) * (np.abs(rings[..., 2] - 129) < 6)
    moved = rings.copy()
    moved[..., 2] += 3.0 * np.cos(8 * angle) * crown
    return moved


def _scalloped(angle: Array, rings: Array) -> Array:
    """Wave the rim of a cake stand."""
    rim = np.clip((np.hypot(rings[..., 0], rings[..., 1]) - 120) / 25, 0, 1)
    return _radial(rings, 1 + 0.018 * np.cos(32 * angle) * rim)


# fmt: off
OBJECTS: dict[str, Turned] = {
    "mortar": Turned(
        [(0, 0), (58, 0), (66, 0), (66, 12), (54, 20), (56, 34), (84, 44), (96, 92), (97, 120), (104, 122),
         (104, 132), (96, 134), (84, 132), (80, 96), (66, 52), (30, 36), (0, 36)]
    ),
    "pestle": Turned(
        [(0, 0), (18, 0), (27, 8), (26, 30), (15, 44), (11, 90), (10, 140), (13, 158), (19, 166), (19, 182),
         (10, 190), (0, 190)]
    ),
    "bowl": Turned(
        [(0, 0), (52, 0), (56, 0), (56, 12), (64, 16), (112, 26), (144, 62), (150, 82), (150, 87), (142, 87),
         (138, 72), (108, 36), (60, 26), (0, 26)]
    ),
    "vase": Turned(
        [(0, 0), (54, 0), (58, 0), (58, 14), (48, 20), (60, 50), (94, 120), (86, 200), (44, 238), (34, 270),
         (42, 296), (60, 312), (60, 318), (52, 317), (34, 298), (26, 272), (32, 240), (66, 200), (72, 130), (44, 60),
         (20, 26), (0, 26)],
        _twisted,
    ),
    "plate": Turned(
        [(0, 2), (70, 2), (72, 0), (80, 0), (82, 4), (100, 8), (130, 18), (135, 21), (134, 24), (128, 23), (98, 14),
         (84, 9), (0, 9)]
    ),
    "cup": Turned(
        [(0, 3), (22, 3), (23, 0), (30, 0), (30, 8), (40, 16), (48, 44), (50, 70), (52, 74), (50, 76), (47, 74),
         (44, 46), (36, 20), (20, 12), (0, 12)]
    ),
    "pin": Turned(
        [(0, -205), (10, -205), (16, -196), (17, -170), (11, -150), (12, -140), (14, -138), (28, -138), (31, -134),
         (31, -100), (31, 100), (31, 134), (28, 138), (14, 138), (12, 140), (11, 150), (17, 170), (16, 196),
         (10, 205), (0, 205)]
    ),
    "squeezer": Turned(
        [(0, 0), (62, 0), (70, 0), (74, 8), (82, 34), (84, 38), (80, 40), (76, 36), (66, 16), (50, 12), (42, 14),
         (38, 30), (24, 60), (8, 74), (0, 76)],
        _reamed,
    ),
    "jug": Turned(
        [(0, 0), (50, 0), (54, 0), (54, 10), (46, 16), (64, 40), (80, 90), (60, 140), (46, 168), (52, 196),
         (56, 204), (52, 206), (46, 196), (40, 168), (52, 140), (70, 90), (54, 42), (30, 22), (0, 22)],
        _lipped,
    ),
    "candlestick": Turned(
        [(0, 0), (52, 0), (56, 0), (56, 8), (46, 14), (40, 18), (20, 24), (12, 40), (24, 52), (24, 60), (12, 72),
         (10, 120), (12, 150), (22, 160), (22, 166), (14, 174), (18, 190), (34, 198), (36, 206), (24, 208),
         (14, 206), (13, 184), (0, 184)]
    ),
    "pawn": Turned(
        [(0, 0), (22, 0), (24, 0), (24, 6), (21, 10), (22, 14), (17, 18), (9, 30), (8, 44), (14, 48), (14, 51),
         (8, 53), (15, 60), (15, 72), (8, 78), (0, 78)]
    ),
    "queen": Turned(
        [(0, 0), (28, 0), (30, 0), (30, 8), (26, 12), (28, 18), (20, 22), (12, 44), (10, 84), (18, 90), (18, 94),
         (11, 97), (12, 106), (23, 126), (24, 130), (20, 130), (16, 126), (7, 128), (8, 134), (7, 142), (0, 143)],
        _crowned,
    ),
    "canister": Turned(
        [(0, 0), (70, 0), (76, 0), (76, 10), (74, 20), (74, 130), (76, 138), (72, 142), (80, 144), (80, 158),
         (70, 164), (30, 170), (12, 176), (12, 184), (20, 190), (18, 202), (0, 204)]
    ),
    "stand": Turned(
        [(0, 0), (60, 0), (66, 0), (66, 8), (40, 16), (18, 34), (14, 70), (24, 96), (60, 104), (142, 106),
         (150, 104), (152, 120), (148, 126), (144, 116), (100, 114), (0, 114)],
        _scalloped,
    ),
    "apple": Turned(
        [(0, 6), (6, 4), (16, 0), (34, 6), (46, 36), (42, 66), (24, 82), (10, 78), (4, 64), (0, 62)], _ribbed_fruit
    ),
    "pear": Turned(
        [(0, 4), (8, 2), (18, 0), (40, 10), (46, 44), (34, 76), (22, 98), (18, 116), (8, 122), (3, 116), (0, 114)]
    ),
}
# fmt: on


def make(name: str, segments: int) -> Solid:
    """Turn one of the `OBJECTS`; the triangles number about ``1.2 segments^2``."""
    polygon, carve = OBJECTS[name]
    return revolve(rounded(polygon, max(int(0.6 * segments), 30)), segments, carve)


def slab(segments: int) -> Solid:
    """A board to cut on."""
    n = max(segments // 8, 2)
    return rounded_block((190, 130, 10), 6, (2 * n, n, 2), 6)
