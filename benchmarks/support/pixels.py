"""Pixels that show nothing but one translucent body, and the points that they show."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

Array = np.ndarray
ERODED = 3
JUMP = 6.0


def see(scene: Any, sensor: Any, lookup: Any, x: Array, y: Array) -> tuple[Array, Array]:
    """Trace rays through positions on the film [pixels]: the points seen ``(n, 3)``, and which lie on a body ``(n,) bool``."""
    import mitsuba as mi

    width, height = sensor.film().size()
    place = mi.Point2f(np.float32(x) / width, np.float32(y) / height)
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    body = lookup.body_index(si, si.is_valid())
    return si.p.numpy().T, (si.is_valid() & (body != 0)).numpy()


def body_mask(scene: Any, sensor: Any, lookup: Any, eroded: int = 0) -> Array:
    """Tell which pixels show a translucent body in their middle, ``(h, w) bool``; away from its outline when eroded."""
    width, height = sensor.film().size()
    y, x = np.mgrid[:height, :width] + 0.5
    mask = see(scene, sensor, lookup, x.ravel(), y.ravel())[1].reshape(height, width)
    return binary_erosion(mask, iterations=eroded) if eroded else mask


def covered_pixels(scene: Any, sensor: Any, lookup: Any, count: int, grid: int = 4) -> tuple[Array, Array, Array]:
    """Choose pixels inside the outline of a body, and a grid of points in each.

    Pixels in which the surface jumps (the spout before the body) are left out, as those on the outline are.

    Returns
    -------
    rows, columns : (k,) int
        Of at most ``count`` pixels.
    points : (k, grid * grid, 3) float
        What is seen through a regular grid of places in each pixel.
    """
    rows, columns = np.nonzero(body_mask(scene, sensor, lookup, ERODED))
    chosen = np.sort(np.random.default_rng(1).permutation(len(rows))[:count])
    rows, columns = rows[chosen], columns[chosen]
    offsets = (np.arange(grid) + 0.5) / grid
    x = columns[:, None, None] + offsets[None, None, :] + 0 * offsets[None, :, None]
    y = rows[:, None, None] + offsets[None, :, None] + 0 * offsets[None, None, :]
    points, on_body = see(scene, sensor, lookup, x.ravel(), y.ravel())
    points, on_body = points.reshape(len(rows), -1, 3), on_body.reshape(len(rows), -1)
    extent = np.linalg.norm(np.ptp(points, axis=1), axis=-1)
    keep = on_body.all(axis=1) & (extent < JUMP * np.median(extent))
    return rows[keep], columns[keep], points[keep]
