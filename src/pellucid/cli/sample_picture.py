"""Pictures of surface samples: where they lie, and how much light falls on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SceneError

SUPERSAMPLING = 3
MAX_DOT = 2.5  # radius [pixels]
BACKGROUND, DOT = 0.02, (0.75, 0.05, 0.02)


@dataclass
class FirstHits:
    """What the camera sees through a grid of points on the film: ``(h, w, ...)``."""

    position: np.ndarray
    facing: np.ndarray
    """Cosine between normal and view, 0 where there is nothing."""
    body: np.ndarray
    """0 for no body, k + 1 for body k."""


def look(scene: Any, sensor: Any, lookup: Any) -> FirstHits:
    """Trace one ray through the centre of every cell of a grid finer than the pixels."""
    import drjit as dr
    import mitsuba as mi

    width, height = (int(n) * SUPERSAMPLING for n in sensor.film().crop_size())
    x, y = dr.meshgrid(dr.arange(mi.Float, width), dr.arange(mi.Float, height))
    film_position = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
    ray, _ = sensor.sample_ray(0.0, 0.5, film_position, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    facing = dr.select(si.is_valid(), dr.abs(dr.dot(si.n, ray.d)), 0)
    body = lookup.body_index(si, si.is_valid())
    body = dr.select(si.is_valid(), body, 0)
    shape = (height, width)
    return FirstHits(si.p.numpy().T.reshape(*shape, 3), facing.numpy().reshape(shape), body.numpy().reshape(shape))


def project(scene: Any, sensor: Any, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find where points appear on the film [pixels], ``(n, 2) float``, and which of them are seen, ``(n,) bool``.

    Raises
    ------
    SceneError
        For a camera that Mitsuba cannot project through, such as an orthographic one.
    """
    import drjit as dr
    import mitsuba as mi

    target = dr.zeros(mi.SurfaceInteraction3f, len(points))
    target.p = mi.Point3f(np.ascontiguousarray(points.T, np.float32))
    try:
        ds, weight = sensor.sample_direction(target, mi.Point2f(0.5))
    except RuntimeError:
        raise SceneError(
            f"Samples cannot be drawn through a {sensor.class_name()}: use a perspective camera."
        ) from None
    inside = (ds.pdf > 0) & (dr.max(weight) > 0)
    # A sample is seen when nothing lies clearly before it; the tolerance lets facets of a curved body pass.
    reach = dr.norm(target.p - ds.p)
    ray = mi.Ray3f(ds.p, (target.p - ds.p) / reach)
    hidden = scene.ray_test(mi.Ray3f(ray, reach * (1 - 1e-3)), inside)
    return ds.uv.numpy().T, (inside & ~hidden).numpy()


def dot_picture(scene: Any, sensor: Any, hits: FirstHits, bodies: list[Any]) -> np.ndarray:
    """Draw a dot at every visible sample over the shaded bodies: ``(h, w, 3) float``."""
    grey = np.where(hits.body > 0, 0.15 + 0.65 * hits.facing, BACKGROUND + 0.1 * hits.facing)
    picture = np.repeat(grey[..., None], 3, axis=-1)
    for number, lit in enumerate(bodies, 1):
        uv, seen = project(scene, sensor, lit.samples.p)
        area = np.count_nonzero(hits.body == number) / SUPERSAMPLING**2
        spacing = math.sqrt(area / max(1, int(np.count_nonzero(seen))))
        _scatter_dots(picture, uv[seen] * SUPERSAMPLING, SUPERSAMPLING * min(MAX_DOT, 0.3 * spacing))
    return _shrink(picture)


def _scatter_dots(picture: np.ndarray, centres: np.ndarray, radius: float) -> None:
    """Paint discs: every centre meets every offset of a disc at once."""
    reach = int(np.ceil(radius))
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    within = dx**2 + dy**2 <= max(radius, 0.5) ** 2
    x = np.floor(centres[:, 0]).astype(int)[:, None] + dx[within]
    y = np.floor(centres[:, 1]).astype(int)[:, None] + dy[within]
    height, width, _ = picture.shape
    keep = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    picture[y[keep], x[keep]] = DOT


def irradiance_picture(hits: FirstHits, bodies: list[Any]) -> np.ndarray:
    """Colour every visible point by the irradiance of the sample nearest to it: ``(h, w, 3) float``.

    The brightest (2 %) come out white.
    """
    picture = np.repeat((BACKGROUND + 0.1 * hits.facing)[..., None], 3, axis=-1)
    light = np.zeros_like(picture)
    for number, lit in enumerate(bodies, 1):
        here = hits.body == number
        _, nearest = cKDTree(lit.samples.p).query(hits.position[here], workers=-1)
        light[here] = lit.irradiance.total[nearest]
    seen = hits.body > 0
    white = float(np.quantile(light[seen].max(axis=-1), 0.98)) if seen.any() else 0.0
    picture[seen] = np.minimum(light[seen] / (white or 1.0), 1)
    return _shrink(picture)


def _shrink(picture: np.ndarray) -> np.ndarray:
    """Average the cells of every pixel."""
    height, width, _ = picture.shape
    s = SUPERSAMPLING
    return picture.reshape(height // s, s, width // s, s, 3).mean(axis=(1, 3))
