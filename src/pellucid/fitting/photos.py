"""Photographs as the fit wants them: linear radiance, and which pixels count."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from ..errors import PellucidError
from ..scene.bodies import Body, build_lookup

Picture = NDArray[np.float64]
EDGE = 2
"""Pixels at the rim of a mask that are left out: there background and surface mix."""


def read_photo(photo: Any, linearise: bool) -> Picture:
    """Read a picture in linear radiance: ``(h, w, 3) float``; an array is taken as it is.

    Raises
    ------
    PellucidError
        For a file that cannot be read, and for one of 8 bits that is not to be linearised.
    """
    if not isinstance(photo, (str, Path)):
        return np.asarray(photo, float)[:, :, :3]
    try:
        bitmap = mi.Bitmap(str(photo))
    except RuntimeError as error:
        raise PellucidError(f"The photo '{photo}' cannot be read: {str(error).splitlines()[0]}") from error
    if bitmap.component_format() == mi.Struct.Type.UInt8 and not linearise:
        raise PellucidError(
            f"The photo '{photo}' has 8 bits a channel, curved as screens want it: a camera has changed its colours as well. Give "
            "linear pictures (.exr), or say linearise to undo the curve of sRGB alone."
        )
    if bitmap.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
        bitmap = bitmap.split()[0][1]  # the picture itself comes before its layers
    linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    return np.array(linear, float)


def read_mask(mask: Any) -> NDArray[np.bool_]:
    """Read a mask, ``(h, w)``: true where a picture is brighter than half."""
    if isinstance(mask, (str, Path)):
        mask = np.array(mi.Bitmap(str(mask)).convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False))
    return np.asarray(mask, float).reshape(np.shape(mask)[:2]) > 0.5


def seen_by(scene: mi.Scene, sensor: mi.Sensor, body: Body) -> tuple[NDArray[np.bool_], float]:
    """Find the pixels of a camera whose middle shows a body, ``(h, w)``, the rim left out; and how wide they are there [scene units]."""
    width, height = (int(n) for n in sensor.film().crop_size())
    x, y = dr.meshgrid(dr.arange(mi.Float, width), dr.arange(mi.Float, height))
    on_film = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
    ray, _ = sensor.sample_ray(0.0, 0.5, on_film, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    mask = np.array(build_lookup(scene, [body]).body_index(si, si.is_valid()).numpy() != 0).reshape(height, width)
    p = np.stack([c.numpy() for c in si.p], axis=-1).reshape(height, width, 3)
    both = mask[:, 1:] & mask[:, :-1]
    steps = np.linalg.norm(np.diff(p, axis=1), axis=-1)[both]
    return erode(mask), float(np.median(steps)) if both.any() else 0.0


def erode(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Leave out the rim of a mask; beyond the picture it goes on."""
    return np.asarray(binary_erosion(mask, iterations=EDGE, border_value=1), bool)
