"""The marble teapot on a small table in a cathedral: the first scene of AWB08."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.lathe import revolve, rounded
from ..shapes.patterns import between, clouds, picture, wood
from ..stage import PictureSettings, Spec, lamp, material, start
from .mesh import teapot_mesh

Array = NDArray[np.float64]

# 173,671 samples of marble, as in figure 7 of AWB08, on the surface that `teapot.DEFAULT_SIZE` gives 150,000.
TABLE_SIZE = 218.83

# The cathedral is turned by this angle [degrees], so that a window stands on either side of the teapot.
TURN = 16.0

# The profile of the table top, as radius and height [sizes of the teapot]; it lies below z = 0.
TOP = ((0, -0.13), (0.70, -0.13), (0.82, -0.125), (0.84, -0.085), (0.86, -0.075), (0.90, -0.07), (0.915, -0.03))
EDGE = ((0.905, -0.004), (0.88, 0.0), (0.86, 0.0), (0.4, 0.0), (0.0, 0.0))
LEG = (
    (0, -2.4),
    (0.1, -2.4),
    (0.13, -1.6),
    (0.07, -1.2),
    (0.12, -0.9),
    (0.08, -0.5),
    (0.17, -0.3),
    (0.12, -0.13),
    (0, -0.13),
)


def teapot_table(
    settings: PictureSettings, bsdf: Spec | None = None, size: float = TABLE_SIZE, detail: int = 16
) -> Spec:
    """A teapot of marble, 173,671 irradiance samples, on a round table: an area light, and a cathedral all around.

    Parameters
    ----------
    bsdf : dict, optional
        Another material.
    size : float
        Distance from the spout to the back of the handle [mm]; everything else grows with it.
    detail : int
        Segments along every edge of a patch of the teapot: 16 gives 16,702 triangles.
    """
    import mitsuba as mi

    target = (0.03 * size, 0.0, 0.235 * size)
    scene = start(settings, (-0.62 * size, -2.25 * size, 0.53 * size), target, 32.0, "x")
    vertices, normals, faces = teapot_mesh(size, detail)
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "marble", "alpha": 0.06})
    scene["teapot"] = mesh_from_arrays("teapot", vertices, faces, normals, bsdf=bsdf)
    boards = picture(wood((0.10, 0.035, 0.014), (0.36, 0.17, 0.075), 3, 5))
    polish = {"type": "roughplastic", "diffuse_reflectance": boards, "alpha": 0.12, "nonlinear": True}
    top = revolve(rounded(TOP + EDGE, 72), 96)
    across = top.vertices[:, :2] @ np.array([[0.9, 0.44], [-0.44, 0.9]]) * 0.5 + 0.5
    scene["table"] = mesh_from_arrays("table", top.vertices * size, top.faces, top.normals, across, polish)
    leg = revolve(rounded(LEG, 72), 32, with_uv=True)
    scene["leg"] = mesh_from_arrays("leg", leg.vertices * size, leg.faces, leg.normals, leg.uv, polish)
    scene["key"] = lamp(np.multiply(size, (-2.1, 1.35, 1.75)), np.multiply(size, (0, 0, 0.2)), 1.0 * size, (48, 39, 28))
    scene["cathedral"] = {
        "type": "envmap",
        "bitmap": mi.Bitmap(cathedral().astype(np.float32)),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90).rotate([0, 1, 0], TURN),
    }
    return scene


def cathedral(rows: int = 512) -> Array:
    """Radiance of the inside of a cathedral, (rows, 2 rows, 3), by latitude and longitude: stone, glass and candles."""
    h, w = rows, 2 * rows
    up = np.deg2rad(90 - 180 * (np.arange(h) + 0.5) / h)[:, None] * np.ones(w)
    around = 2 * np.pi * (np.arange(w) + 0.5)[None] / w * np.ones((h, 1))
    light = _stone(up, around)
    light = _windows(light, up, around)
    light = _rose(light, up, around)
    light = _candles(light, up, around)
    # Glare: what shines lights the dust around it.
    veil = gaussian_filter(light, (rows / 40, rows / 40, 0), mode=("nearest", "wrap", "nearest"))
    return 0.94 * gaussian_filter(light, (rows / 400, rows / 400, 0), mode=("nearest", "wrap", "nearest")) + 0.06 * veil


def _stone(up: Array, around: Array) -> Array:
    """Piers between twelve bays, a ribbed vault above, a floor that mirrors the windows faintly."""
    bay = np.abs((around * 12 / (2 * np.pi)) % 1 - 0.5) * 2
    noise = clouds(up.shape, 11, 1.4)
    pier = np.clip((bay - 0.62) / 0.1, 0, 1) * (0.6 + 0.4 * np.cos(bay * 42))
    wall = 0.030 + 0.045 * pier + 0.006 * noise
    ribs = np.exp(-(((bay - np.clip((up - 0.75) / 0.7, 0, 1)) / 0.07) ** 2))
    vault = 0.035 + 0.05 * ribs * np.cos(up) + 0.006 * noise
    floor = 0.03 + 0.06 * np.exp(-((up + 0.25) ** 2) / 0.05) * (1 - 0.7 * bay) + 0.004 * noise
    t = np.clip((up - 0.78) / 0.06, 0, 1)
    stone = np.where(up < -0.12, floor, (1 - t) * wall + t * vault)
    return stone[..., None] * np.array([1.0, 0.78, 0.56])


def _windows(light: Array, up: Array, around: Array) -> Array:
    """Two lancets a bay with pointed heads: warm daylight, and every third bay of coloured glass."""
    place = around * 12 / (2 * np.pi)
    bay, x = np.floor(place).astype(int), (place % 1 - 0.5) * 2
    x = np.abs(np.abs(x) - 0.26) / 0.2
    head = 0.50 - 0.14 * (1 - np.sqrt(np.clip(1 - x * x, 0, 1)))
    inside = (x < 1) & (up > -0.045) & (up < head)
    lead = (np.abs((up * 70) % 1 - 0.5) < 0.43) & (np.abs((place * 24) % 1 - 0.5) < 0.43)
    glass = np.array([[0.9, 0.12, 0.06], [0.08, 0.22, 0.9], [1.0, 0.66, 0.15], [0.10, 0.30, 0.75], [0.9, 0.45, 0.10]])
    pane = glass[
        np.random.default_rng(5).integers(0, len(glass), (48, 288))[
            np.clip((up * 70 + 5).astype(int), 0, 47), (place * 24).astype(int)
        ]
    ]
    coloured = (bay % 3 == 0)[..., None]
    bright = (0.8 + 9.0 * np.cos(0.5 * (around - 2.6)) ** 8)[..., None]
    day = np.where(coloured, 0.8 * pane, np.array([1.0, 0.83, 0.6])) * bright
    return np.where((inside & lead)[..., None], day, light)


def _rose(light: Array, up: Array, around: Array) -> Array:
    """A rose window high above one end, twelve petals of blue and red around a golden eye."""
    dx, dy = (around - 4.2) * np.cos(0.6), up - 0.66
    r, angle = np.hypot(dx, dy) / 0.26, np.arctan2(dy, dx)
    petal = np.cos(12 * angle) * 0.5 + 0.5
    colour = between(petal, (1.0, 0.16, 0.1), (0.15, 0.32, 1.0))
    colour = np.where((r < 0.3)[..., None], np.array([1.0, 0.8, 0.35]), colour)
    inside = (r < 1) & (np.abs(r - 0.33) > 0.04) & (np.abs(r - 0.68) > 0.03) & (np.abs(np.sin(6 * angle)) > 0.12)
    return np.where(inside[..., None], 3.0 * colour, light)


def _candles(light: Array, up: Array, around: Array) -> Array:
    """Rows of small flames."""
    x = (around * 42 / (2 * np.pi)) % 1 - 0.5
    flame = np.exp(-((x / 0.045) ** 2) - ((up + 0.115 + 0.02 * np.sin(3 * around)) / 0.011) ** 2)
    return light + flame[..., None] * np.array([26.0, 13.0, 4.0])
