"""A block under half a sky, with a black wall on it: a place where a medium can be measured, and rendered as a volume without much noise.

Lengths are diffuse mean free paths of the channel whose light spreads farthest. The wall is the edge of a shadow: half of the sky shines on
one side of it, hardly any of it on the other. Every path out of the block meets the sky often, so that volumetric path tracing converges.
Pixels count where the top is as flat as the profile of a half space asks for.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from pellucid.model.medium import Medium

HALF, DEPTH, SEEN, WALL = 6.0, 5.0, 3.5, 3.0
"""Half the width of the block, its depth, half the width of what counts, and the height of the wall."""

VIEWS = ((0.0, 50.0), (180.0, 50.0), (90.0, 62.0), (130.0, 55.0))
"""Azimuth from the bright side, and elevation, of every camera [degrees]."""


def block_spec(shape: dict[str, Any], size: int) -> dict[str, Any]:
    """Describe the scene.

    Parameters
    ----------
    shape : dict
        BSDF of the block, and the medium inside if it is a volume.
    size : int
        Width and height of the pictures [pixels].
    """
    T = mi.ScalarTransform4f
    black = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    to_block = T().translate([0, 0, -DEPTH / 2]).scale([HALF, HALF, DEPTH / 2])
    to_wall = T().translate([0, 0, WALL / 2]).rotate([0, 1, 0], 90).scale([WALL / 2, HALF, 1])
    cameras = {f"view_{k}": _camera(*view, size) for k, view in enumerate(VIEWS)}
    return {
        "type": "scene",
        "integrator": {"type": "pellucid_two_pass"},
        "block": {"type": "cube", "to_world": to_block, **shape},
        "wall": {"type": "rectangle", "to_world": to_wall, "bsdf": black},
        "sky": {"type": "envmap", "bitmap": _half_sky(), "to_world": T().rotate([1, 0, 0], 90)},
        **cameras,
    }


def counted(scene: mi.Scene, view: int) -> np.ndarray:
    """Find the pixels of a view whose middle shows the inner part of the top: ``(h, w) float``, 1 there."""
    sensor = scene.sensors()[view]
    size = int(sensor.film().crop_size()[0])
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    at = mi.Point2f((x.ravel() / size).astype(np.float32), (y.ravel() / size).astype(np.float32))
    ray, _ = sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    p = np.stack([c.numpy() for c in si.p], axis=-1)
    top = si.is_valid().numpy() & (np.abs(p[:, 2]) < 1e-3) & (np.abs(p[:, :2]).max(axis=1) < SEEN)
    return top.reshape(size, size).astype(float)


def in_units(medium: Medium) -> tuple[Medium, float]:
    """Express a medium in its longest diffuse mean free path; also return how many millimetres that is."""
    length = float(medium.dmfp.max())
    return medium.scaled(length), length


def _half_sky() -> mi.Bitmap:
    """Draw a sky that is bright on one side and above."""
    pixels = np.zeros((32, 64, 3), np.float32)
    pixels[:16, :32] = 1
    return mi.Bitmap(pixels)


def _camera(azimuth: float, elevation: float, size: int) -> dict[str, Any]:
    a, e = np.radians([azimuth, elevation])
    origin = 30 * np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    return {
        "type": "perspective",
        "fov": 17,
        "to_world": mi.ScalarTransform4f().look_at(origin.tolist(), [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent"},
    }
