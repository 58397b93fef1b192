"""One bay of an arcade: two arches above each other, of brick and of marble in turn, and the masonry between and above."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..shapes.boxes import box
from ..shapes.lathe import Solid, bent, joined, revolve, rounded, rounded_block
from .capital import IMPOST

Array = NDArray[np.float64]

# [m]; y runs along the arcade, the column stands at y = 0 and the arches reach to the next.
BAY = 3.0
SHAFT_LOW, SHAFT_HIGH = 0.30, 2.62
CEILING = 9.0


class Arch(NamedTuple):
    """A ring of voussoirs: height of its middle, radii, depth, angle below the horizontal [rad], number (odd)."""

    z: float
    inner: float
    outer: float
    depth: float
    below: float
    number: int


LOWER = Arch(4.15, 1.13, 1.49, 0.50, 0.30, 19)
UPPER = Arch(6.45, 1.12, 1.48, 0.62, 0.0, 17)
PIER = 0.36
JOINT = 0.012


def voussoirs(arch: Arch, first: int, cells: int) -> Solid:
    """Every other voussoir from the ``first`` on: closed wedges with rounded edges, in one mesh."""
    step = (np.pi + 2 * arch.below) / arch.number
    middle = 0.5 * (arch.inner + arch.outer)
    half = (0.5 * arch.depth, 0.5 * step * middle - 0.5 * JOINT, 0.5 * (arch.outer - arch.inner))
    block = rounded_block(half, 0.016, (2 * cells, cells, cells))

    def wedge(number: int):
        angle = -arch.below + (number + 0.5) * step

        def bend(p: Array) -> Array:
            a = angle + p[:, 1] / middle
            r = middle + p[:, 2]
            return np.stack([p[:, 0], 0.5 * BAY - r * np.cos(a), arch.z + r * np.sin(a)], -1)

        return bend

    return joined([bent(block, wedge(k)) for k in range(first, arch.number, 2)])


def _cut_wall(arch: Arch, radius: float, depth: float, top: float, bottom: float) -> tuple[Array, Array]:
    """A wall over one bay, from ``bottom`` to ``top``, without the disc of ``radius`` around the middle of an arch."""
    a = np.linspace(-arch.below, np.pi + arch.below, 49)
    arc = np.stack([0.5 * BAY - radius * np.cos(a), arch.z + radius * np.sin(a)], -1)
    left, right = [[0.0, bottom], [arc[0, 0], bottom]], [[arc[-1, 0], bottom], [BAY, bottom]]
    low = np.concatenate([left, arc, right])
    high = np.stack([np.clip(low[:, 0], 0, BAY), np.full(len(low), top)], -1)
    n = len(low)
    sides = [np.column_stack([np.full(n, x), edge]) for x in (0.5 * depth, -0.5 * depth) for edge in (low, high)]
    k = np.arange(n - 1)
    quads = [
        np.stack([k, k + 1, k + 1 + n, k + n], -1),  # front
        np.stack([k + 2 * n, k + 3 * n, k + 1 + 3 * n, k + 1 + 2 * n], -1),  # back
        np.stack([k, k + 2 * n, k + 1 + 2 * n, k + 1], -1),  # soffit
    ]
    faces = np.concatenate(quads)
    return np.concatenate(sides), np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def masonry() -> tuple[Array, Array]:
    """The pier over a column and the wall over the upper arch, flat: vertices and faces."""
    pier = box((-0.2, -PIER, SHAFT_HIGH + IMPOST - 0.02), (0.2, PIER, UPPER.z - 0.25))
    corbel = box((-0.29, -PIER - 0.03, UPPER.z - 0.30), (0.29, PIER + 0.03, UPPER.z + 0.02))
    wall = _cut_wall(UPPER, UPPER.outer - 0.1, UPPER.depth - 0.06, CEILING, UPPER.z)
    # The mortar behind the joints of the voussoirs.
    rings = [_mortar(LOWER), _mortar(UPPER)]
    parts = [pier, corbel, wall, *rings]
    first = np.cumsum([0, *(len(v) for v, _ in parts[:-1])])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [f + n for (_, f), n in zip(parts, first, strict=True)]
    )


def _mortar(arch: Arch) -> tuple[Array, Array]:
    """A ring somewhat thinner than the voussoirs, inside them, that closes their joints."""
    a = np.linspace(-arch.below, np.pi + arch.below, 65)
    section = [
        (x, r)
        for x, r in (
            (-0.5 * arch.depth + 0.02, arch.inner + 0.02),
            (0.5 * arch.depth - 0.02, arch.inner + 0.02),
            (0.5 * arch.depth - 0.02, arch.outer - 0.02),
            (-0.5 * arch.depth + 0.02, arch.outer - 0.02),
        )
    ]
    vertices = np.concatenate(
        [np.stack([np.full_like(a, x), 0.5 * BAY - r * np.cos(a), arch.z + r * np.sin(a)], -1) for x, r in section]
    )
    k, n = np.arange(len(a) - 1), len(a)
    faces = []
    for s in range(4):
        p, q = k + s * n, k + (s + 1) % 4 * n
        faces += [np.stack([p, p + 1, q + 1], -1), np.stack([p, q + 1, q], -1)]
    return vertices, np.concatenate(faces)


def shaft(segments: int) -> Solid:
    """The column below the capital: a slender shaft that swells a little, a ring at both ends; for a picture around it."""
    points = (
        (0, SHAFT_LOW), (0.255, SHAFT_LOW), (0.255, SHAFT_LOW), (0.265, SHAFT_LOW + 0.05), (0.235, SHAFT_LOW + 0.07),
        (0.235, 1.1), (0.225, 2.0), (0.212, SHAFT_HIGH - 0.08), (0.235, SHAFT_HIGH - 0.06), (0.235, SHAFT_HIGH - 0.01),
        (0.22, SHAFT_HIGH + 0.003), (0.22, SHAFT_HIGH + 0.003), (0, SHAFT_HIGH + 0.003),
    )  # fmt: skip
    return revolve(rounded(points, 40), segments, with_uv=True)


def foot(segments: int) -> Solid:
    """The base of a column: two tori and a groove between them on a square plinth."""
    points = (
        (0, 0), (0.34, 0), (0.34, 0), (0.40, 0.11), (0.36, 0.135), (0.40, 0.17), (0.36, 0.205), (0.30, 0.205),
        (0.28, 0.235), (0.33, 0.26), (0.30, SHAFT_LOW + 0.005), (0.26, SHAFT_LOW + 0.005), (0, SHAFT_LOW + 0.005),
    )  # fmt: skip
    return joined(
        [
            revolve(rounded(points, 48), segments),
            rounded_block((0.4, 0.4, 0.07), 0.015, (1, 1, 1)).moved((0, 0, 0.05)),
        ]
    )
