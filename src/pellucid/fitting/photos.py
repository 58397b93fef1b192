"""Photographs as the fit wants them: linear radiance, and which pixels count."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, uniform_filter

from ..errors import PellucidError, first_cause
from ..scene.bodies import Body, build_lookup
from ..scenes.pictures import check_whole

Picture = NDArray[np.float64]
EDGE = 2
"""Pixels at the rim of a mask that are left out: there background and surface mix."""

LEAST_NOISE, FLOOR = 0.01, 0.002
"""Standard deviation of a pixel at least, of the mean of its neighbours and of the mean of the photo: models are not better."""

QUANTILE = 0.9
SIGMA_PER_QUANTILE = 1 / (1.6449 * np.sqrt(1 + 1 / 8))
"""Standard deviation of a normal variable over this quantile of its absolute difference to the mean of eight others."""

CLASSES, PER_CLASS = 8, 100
"""Number of classes of brightness in which noise is measured, and least number of pixels in each, if there are as many."""


def read_photo(photo: Any, linearise: bool) -> Picture:
    """Read a picture in linear radiance: ``(h, w, 3) float``; an array is taken as it is.

    Raises
    ------
    PellucidError
        For a file that cannot be read, and for one of 8 bits that is not to be linearised.
    """
    if not isinstance(photo, (str, Path)):
        return np.asarray(photo, float)[:, :, :3]
    bitmap = _read("photo", photo)
    if bitmap.component_format() == mi.Struct.Type.UInt8 and not linearise:
        raise PellucidError(
            f"The photo '{photo}' has 8 bits a channel, curved as screens want it: a camera has changed its colours as well. Give "
            "linear pictures (.exr), or say linearise to undo the curve of sRGB alone."
        )
    if bitmap.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
        bitmap = bitmap.split()[0][1]  # the picture itself comes before its layers
    linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    return np.array(linear, float)


def _read(what: str, file: str | Path) -> mi.Bitmap:
    """Read a picture.

    Raises
    ------
    PellucidError
        For a file that cannot be read.
    """
    try:
        check_whole([str(file)])
        return mi.Bitmap(str(file))
    except RuntimeError as error:
        raise PellucidError(f"The {what} '{file}' cannot be read: {first_cause(str(error))}") from error


def read_mask(mask: Any) -> NDArray[np.bool_]:
    """Read a mask, ``(h, w)``: true where a picture is brighter than half."""
    if isinstance(mask, (str, Path)):
        bitmap = _read("mask", mask).convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False)
        mask = np.array(bitmap)
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


def deviation(photo: Picture, mask: NDArray[np.bool_]) -> Picture:
    """Estimate the standard deviation of pixels of a photo, ``(h, w, 3)``, by how they differ from the mean of their neighbours in a mask.

    Pixels of a channel that are about equally bright have the same; what a pixel itself happens to be does not change it. Where few photons
    arrive most pixels are darker than their mean and some much brighter: the quantile of nine tenths tells of those as well.
    """
    if not mask.any():
        return np.ones_like(photo)
    inside = np.repeat(mask[:, :, None], 3, axis=2).astype(float)
    total, count = (9 * uniform_filter(x * inside, (3, 3, 1), mode="constant") - x * inside for x in (photo, inside))
    mean = np.where(count > 0.5, total / np.maximum(count, 0.5), photo)
    found = np.empty_like(photo)
    for c in range(3):
        here, expected = photo[mask, c], mean[mask, c]
        classes = np.array_split(np.argsort(expected), min(CLASSES, max(1, len(here) // PER_CLASS)))
        noise = [SIGMA_PER_QUANTILE * np.quantile(np.abs(here - expected)[k], QUANTILE) for k in classes]
        measured = np.interp(mean[:, :, c], [np.median(expected[k]) for k in classes], noise)
        found[:, :, c] = np.hypot(np.maximum(measured, LEAST_NOISE * mean[:, :, c]), FLOOR * here.mean())
    return found


def erode(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Leave out the rim of a mask; beyond the picture it goes on."""
    return np.asarray(binary_erosion(mask, iterations=EDGE, border_value=1), bool)
