"""The colours of the bust: skin with blush, freckles and lips, brows, lashes and hair, painted on a cylinder around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import zoom
from scipy.spatial import cKDTree

from .shape import EYE_X, LID_WIDTH, MOUTH_WIDTH, hair_distance, lid_line, mouth_line, strands

Floats = NDArray[np.floating]

# Reflectances, as red, green and blue.
SKIN, BLUSH, LID = (0.68, 0.50, 0.41), (0.62, 0.32, 0.26), (0.56, 0.36, 0.31)
LIP, FRECKLE = (0.50, 0.17, 0.155), (0.36, 0.20, 0.12)
BROW, LASH, HAIR, LIGHT_HAIR = (0.15, 0.09, 0.06), (0.06, 0.04, 0.03), (0.20, 0.095, 0.05), (0.46, 0.26, 0.14)

# The axis of the cylinder stands at x = 0, y = AXIS_Y; the picture begins and ends at the back of the head.
AXIS_Y = 20.0
ROWS, COLUMNS, COARSE = 768, 1024, 4


def cylinder_uv(vertices: Floats, faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
    """Texture coordinates around the cylinder; at the seam vertices are repeated.

    Returns
    -------
    source : (n,) int
        The vertex that each vertex repeats.
    uv : (n, 2) float
        u from the back over the right of the face, v from top to bottom.
    faces : (m, 3) int
        In terms of the new vertices.
    """
    x, y, z = vertices.T
    u = 0.5 + np.arctan2(x, AXIS_Y - y) / (2 * np.pi)
    v = (z.max() - z) / np.ptp(z)
    behind = (np.ptp(u[faces], axis=1) > 0.5)[:, None] & (u[faces] < 0.5)
    repeated, label = np.unique(faces[behind], return_inverse=True)
    faces = faces.copy()
    faces[behind] = len(vertices) + label
    source = np.concatenate([np.arange(len(vertices)), repeated])
    uv = np.stack([np.concatenate([u, u[repeated] + 1]), v[source]], -1)
    return source, uv, faces


def _positions(vertices: Floats) -> Floats:
    """The surface seen from outside the cylinder, (3, rows, columns) on a coarse grid of the picture."""
    x, y, z = vertices.T
    rows, columns = ROWS // COARSE, COLUMNS // COARSE
    angle = 2 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    height = z.max() - (np.arange(rows) + 0.5) / rows * np.ptp(z)
    angle, height = np.meshgrid(angle, height)
    tree = cKDTree(np.stack([80 * np.arctan2(x, AXIS_Y - y), z], -1))
    _, nearest = tree.query(np.stack([80 * angle, height], -1).reshape(-1, 2), k=6)
    radius = np.hypot(x, y - AXIS_Y)[nearest].max(-1).reshape(angle.shape)
    return np.stack([radius * np.sin(angle), AXIS_Y - radius * np.cos(angle), height]).astype(np.float32)


def _noise(rng: np.random.Generator, cells: tuple[int, int]) -> Floats:
    """Smooth noise of mean 0 and about unit size, (rows, columns)."""
    grid = rng.standard_normal(cells)
    return zoom(grid, (ROWS / cells[0], COLUMNS / cells[1]), order=1, grid_mode=True, mode="grid-wrap")


def _bump(x: Floats, centre: float, width: float, power: int = 2) -> Floats:
    """1 at the centre, falling to 1/e at a distance of ``width``."""
    return np.exp(-(np.abs((x - centre) / width) ** power))


def _step(x: Floats, width: float) -> Floats:
    """From 0 below zero to 1 above, over a ``width``."""
    return 1 / (1 + np.exp(np.clip(-x / width, -40, 40)))


def _freckles(rng: np.random.Generator, arc: Floats, z: Floats) -> Floats:
    """Spots over the nose and under the eyes, at a distance ``arc`` around the head."""
    where = np.stack([rng.normal(0, 30, 420), rng.normal(-26, 11, 420)], -1)
    spread, strength = rng.uniform(0.6, 1.3, 420), rng.uniform(0.3, 1.0, 420)
    near, index = cKDTree(where).query(np.stack([arc, z], -1).reshape(-1, 2), distance_upper_bound=4.0)
    index = np.minimum(index, len(where) - 1)
    return (strength[index] * np.exp(-((near / spread[index]) ** 2))).reshape(z.shape)


def bust_albedo(vertices: Floats) -> NDArray[np.float32]:
    """Paint the reflectance of the bust: (rows, columns, 3) linear RGB, for the coordinates of `cylinder_uv`."""
    rng = np.random.default_rng(20)
    coarse = _positions(vertices)
    hair, phase = hair_distance(coarse.reshape(3, -1)), strands(coarse.reshape(3, -1))
    layers = [*coarse, hair.reshape(coarse.shape[1:]), phase.reshape(coarse.shape[1:])]
    x, y, z, hair, phase = (zoom(layer, COARSE, order=1, grid_mode=True, mode="nearest") for layer in layers)
    m, front = np.abs(x), _step(-20 - y, 4)
    mottle = _noise(rng, (96, 128)) + 0.6 * _noise(rng, (384, 512))

    colour = np.tile(np.array(SKIN), (*x.shape, 1))
    colour *= (1 + 0.03 * mottle)[..., None]

    def paint(mask: Floats, value: tuple[float, float, float] | Floats) -> None:
        colour[:] += np.clip(mask, 0, 1)[..., None] * (np.asarray(value) - colour)

    paint(0.65 * front * _bump(m, 44, 20) * _bump(z, -34, 19), BLUSH)
    paint(0.5 * front * (_bump(x, 0, 11) * _bump(z, -42, 10) + 0.6 * _bump(x, 0, 16) * _bump(z, -100, 12)), BLUSH)
    paint(0.8 * _bump(m, 80, 9) * _bump(y, 18, 22) * _bump(z, -14, 30), BLUSH)
    paint(front * _freckles(rng, 105 * np.arctan2(x, AXIS_Y - y), z), FRECKLE)
    paint(0.7 * front * _bump(m, EYE_X, 17, 4) * _bump(z, -2, 12, 4), LID)
    paint(0.9 * front * _bump(m, EYE_X, LID_WIDTH, 8) * _bump(z - lid_line(m), -0.6, 1.3), LASH)

    arch = 18.5 + 4.5 * (1 - ((m - 30) / 24) ** 2)
    hairs = 0.75 + 0.35 * np.sin(1.9 * m + 0.9 * z + 2 * mottle)
    paint(front * hairs * _bump(m, 32, 20, 8) * _bump(z - arch, 0, 3.4 - 0.03 * m, 4), BROW)

    t = 1 - np.minimum((m / MOUTH_WIDTH) ** 2, 1)
    line = mouth_line(m)
    upper = line + 8.5 * t**0.7 - 1.6 * _bump(x, 0, 3)
    lips = _step(upper - z, 0.35) * _step(z - (line - 11.0 * t**0.5), 0.35) * (t > 0)
    paint(0.9 * front * lips, np.asarray(LIP) * (1 + 0.08 * np.sin(2.2 * m + mottle))[..., None])

    streak = 0.5 + 0.3 * np.sin(1.7 * phase + mottle) + 0.2 * np.cos(phase)
    paint(_step(2.5 - hair, 0.5), np.asarray(HAIR) + streak[..., None] * np.subtract(LIGHT_HAIR, HAIR))
    return np.clip(colour, 0.02, 0.95).astype(np.float32)
