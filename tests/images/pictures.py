"""Small pictures of every built-in scene by every method, what is kept of them, and how two are compared.

A picture has six channels: the radiance, and the exitance that the eye sees first (the aov ``exitance``), in which a wrong
sum over the samples shows without the noise of what surrounds the body. Each is compared as it is (24 by 18 pixels), in blocks
of 6 by 6 pixels, and as a whole: the pixels show what is in the wrong place, the larger blocks what is too bright or too dark.
All are of the dipole.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import stats

import pellucid
from pellucid.scenes.builtin import build, builtin_names
from pellucid.scenes.models import scene as models
from support.scenes import with_dipoles

WIDTH, HEIGHT = 24, 18
BLOCKS = {"pixels": (1, 1), "blocks": (6, 6), "whole": (HEIGHT, WIDTH)}
"""Rows and columns of the blocks whose means are compared."""

SIGNIFICANCE = 0.01
"""Chance that a picture is refused although nothing is wrong with it, for each of the three sizes of blocks."""

SURFACE = {"sample_count": 600, "irradiance_paths": 32}
TEXTURE = {"sample_count": 600, "resolution": 64, "irradiance_paths": 16}
POINTS = {"sample_count": 600, "direct": 256, "indirect": 1024}
FEW_POINTS = {"sample_count": 300, "direct": 256, "indirect": 512}
METHODS: dict[str, dict[str, Any]] = {
    "two_pass": SURFACE,
    "exact": SURFACE,
    "sampled": {"spp": 64},
    "texture_space": TEXTURE,
    "texture_space hybrid": TEXTURE | {"hybrid": True},
    "single_pass": POINTS,
    "single_pass cut": FEW_POINTS | {"mode": "cut", "max_cut": 16384, "max_error": 0.005},
}
COARSE: dict[str, dict[str, Any]] = {
    "teapot": {"detail": 4},
    "teapot_env": {"detail": 4},
    "bust": {"edge": 16.0},
    "teapot_table": {"detail": 6, "size": 50.0},
    "kitchen": {"detail": 24, "samples": 5e3},
    "mezquita": {"detail": 56, "samples": 5e3, "bays": (1, 1)},
}
MAPPED = ("mezquita", *models.MODELS)
"""Scenes with a light that the hybrid method can map; elsewhere its pictures are those of the samples alone."""

LEFT_OUT = (
    *("pestle", "vase", "plate", "cup_1", "cup_2", "pin", "squeezer", "jug", "pear", "stand", "canister"),
    *("bowl", "candlestick", "queen", "pawn", "apple"),
)
"""What the kitchen stands without."""

FEWER_CELLS = 3
"""The models are meshed with cells so many times larger, and a tenth of the triangles is kept."""


def cases() -> list[tuple[str, str]]:
    """Pair the scenes with the methods: all with all, but for the six heads, which differ in shape alone."""
    pairs = [(scene, method) for scene in builtin_names() for method in METHODS]
    pairs = [(s, m) for s, m in pairs if s in MAPPED or m != "texture_space hybrid"]
    return [(s, m) for s, m in pairs if s not in models.SHAPES or m in ("two_pass", "texture_space hybrid")]


def load(name: str) -> mi.Scene:
    """Build a scene at its coarsest.

    Of the kitchen's 34 bodies three are left, one of them an instance: most methods take a second or two for each.
    """
    if name in models.SHAPES:
        fine = models.SHAPES[name]
        models.SHAPES[name] = fine._replace(edge=FEWER_CELLS * fine.edge, triangles=fine.triangles // 10)
        try:
            return pellucid.load_scene(with_dipoles(build(name, resolution=(WIDTH, HEIGHT))))
        finally:
            models.SHAPES[name] = fine
    content = build(name, resolution=(WIDTH, HEIGHT), **COARSE.get(name, {}))
    if name == "mezquita":  # its own camera sees none of the marble of a single bay
        content["sensor"]["to_world"] = mi.ScalarTransform4f().look_at([3.0, 1.6, 2.0], [5.2, 0.7, 3.9], [0, 0, 1])
    content = {key: value for key, value in content.items() if not key.startswith(LEFT_OUT)}
    return pellucid.load_scene(with_dipoles(content))


def render(scene: mi.Scene, method: str, seed: int) -> np.ndarray:
    """Render one picture: ``(18, 24, 6) float``. Samples, their light and the paths all follow from the seed."""
    settings = dict(METHODS[method])
    spp = settings.pop("spp", 16)
    plugin = {"type": f"pellucid_{method.split()[0]}", "seed": seed, "aovs": "exitance", **settings}
    return np.array(mi.render(scene, integrator=mi.load_dict(plugin), seed=seed, spp=spp), dtype=float)


def block_means(pictures: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average pictures ``(..., 18, 24, 6)`` over blocks of so many rows and columns."""
    rows, columns = size
    blocks = pictures.reshape(*pictures.shape[:-3], HEIGHT // rows, rows, WIDTH // columns, columns, 6)
    return blocks.mean(axis=(-4, -2))


def spread(mean: np.ndarray, deviation: np.ndarray, count: int) -> np.ndarray:
    """Tell how far a picture may be from the mean of ``count`` others: one standard deviation of that difference.

    Half a per cent is the least: what rounding and the digits that are stored may change is no difference.
    """
    least = (
        5e-3 * np.abs(mean) + 1e-3 * np.abs(mean).mean(axis=tuple(range(mean.ndim - 1)), keepdims=mean.ndim > 0) + 1e-7
    )
    return np.maximum(deviation, least) * np.sqrt(1 + 1 / count)


def p_values(picture: np.ndarray, mean: np.ndarray, deviation: np.ndarray, count: int) -> np.ndarray:
    """Tell how probable so large a difference is, for each number, if the picture has the mean of the reference.

    Student's t test of one picture against ``count`` others, of which the mean and the standard deviation are known.
    """
    return 2 * stats.t.sf(np.abs(picture - mean) / spread(mean, deviation, count), count - 1)


REFERENCES = Path(__file__).with_name("references.npz")


def write_references(references: dict[tuple[str, str], dict[str, Any]], count: int) -> None:
    """Store the mean and the standard deviation of every picture, in blocks of every size, and from how many pictures."""
    names = sorted(references)
    arrays = {size: np.array([references[name][size] for name in names], np.float16) for size in BLOCKS}
    np.savez_compressed(REFERENCES, names=np.array(names), count=count, **arrays)


def read_references() -> dict[tuple[str, str], dict[str, Any]]:
    """Read what `write_references` has stored: by scene and method, by size of blocks, mean and standard deviation."""
    if not REFERENCES.exists():
        return {}
    with np.load(REFERENCES) as stored:
        arrays = {size: stored[size].astype(float) for size in BLOCKS}
        return {(s, m): {size: arrays[size][k] for size in BLOCKS} for k, (s, m) in enumerate(stored["names"].tolist())}


def reference_count() -> int:
    """Read how many pictures a reference was made from."""
    with np.load(REFERENCES) as stored:
        return int(stored["count"])
