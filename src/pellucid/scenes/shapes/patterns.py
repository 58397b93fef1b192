"""Pictures for surfaces, computed: clouds of noise, wood, stone and tiles, all of which repeat without a seam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..stage import Spec

Array = NDArray[np.float64]


def clouds(shape: tuple[int, int], seed: int, roughness: float = 1.8, stretch: float = 1.0) -> Array:
    """Periodic noise of unit variance whose amplitude falls as frequency^-roughness; ``stretch`` draws it out along rows."""
    rng = np.random.default_rng(seed)
    fy, fx = np.fft.fftfreq(shape[0])[:, None] * shape[0], np.fft.rfftfreq(shape[1])[None] * shape[1]
    frequency = np.hypot(fy, fx * stretch)
    frequency[0, 0] = np.inf
    phase = np.exp(2j * np.pi * rng.random(frequency.shape))
    noise = np.fft.irfft2(phase * frequency**-roughness, s=shape)
    return noise / noise.std()


def between(t: Array, dark: ArrayLike, bright: ArrayLike) -> Array:
    """Mix two colours by ``t`` (h, w) in [0, 1] into a picture (h, w, 3)."""
    t = np.clip(t, 0, 1)[..., None]
    return (1 - t) * np.asarray(dark, float) + t * np.asarray(bright, float)


def picture(values: Array, repeats: tuple[float, float] = (1.0, 1.0)) -> Spec:
    """A texture from reflectances (h, w, 3), repeated that often over the unit square of the coordinates."""
    import mitsuba as mi

    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.clip(values, 0.004, 0.95).astype(np.float32)),
        "raw": True,
        "to_uv": mi.ScalarTransform3f().scale([repeats[0], repeats[1]]),
    }


def wood(dark: ArrayLike, bright: ArrayLike, seed: int, planks: int = 4, resolution: int = 512) -> Array:
    """Planks along the rows, each with growth rings cut lengthwise, fibres and a shade of its own."""
    shape = (resolution, resolution)
    rng = np.random.default_rng(seed)
    v = (np.arange(resolution) + 0.5)[:, None] / resolution * np.ones(resolution)
    plank = np.floor(v * planks).astype(int)
    place = v * planks - plank
    warp = clouds(shape, seed + 1, 2.4, 5.0)
    rings = (place + rng.uniform(0, 9, planks)[plank]) * 7 + 1.3 * warp
    saw = rings - np.floor(rings)
    grain = 0.55 * saw**3 + 0.25 * (clouds(shape, seed + 2, 0.9, 24.0) * 0.3 + 0.5)
    shade = rng.uniform(-0.12, 0.12, planks)[plank]
    seam = 1 - 0.75 * np.exp(-((np.minimum(place, 1 - place) / 0.012) ** 2))
    return between(1 - grain - shade, dark, bright) * seam[..., None]


def stone(dark: ArrayLike, bright: ArrayLike, seed: int, veins: float = 0.0, resolution: int = 512) -> Array:
    """Mottled stone, with dark veins (positive) or bright ones (negative) where a noise passes through zero."""
    shape = (resolution, resolution)
    mottle = 0.5 + 0.18 * clouds(shape, seed, 1.3) + 0.1 * clouds(shape, seed + 1, 0.6)
    vein = np.exp(-np.abs(clouds(shape, seed + 2, 1.9)) / 0.06) + 0.6 * np.exp(
        -np.abs(clouds(shape, seed + 3, 1.7)) / 0.04
    )
    return between(mottle - veins * vein, dark, bright)


def tiled(surface: Array, tiles: Sequence[int], joint: ArrayLike, width: float, seed: int, spread: float) -> Array:
    """Cut a picture into (rows, columns) tiles of slightly different shade, with joints ``width`` wide in parts of a tile."""
    h, w = surface.shape[:2]
    rows, columns = tiles
    y, x = np.mgrid[0:h, 0:w] + 0.5
    v, u = y / h * rows, x / w * columns
    shade = 1 + spread * np.random.default_rng(seed).uniform(-1, 1, (rows, columns))
    near = np.minimum.reduce([u % 1, 1 - u % 1, (v % 1) * 1.0, 1 - v % 1])
    inside = np.clip((near - width / 2) / (0.25 * width), 0, 1)[..., None]
    return inside * surface * shade[v.astype(int), u.astype(int)][..., None] + (1 - inside) * np.asarray(joint, float)
