"""The image-space baseline: light gathered around each pixel from what the camera sees of a body.

What the camera does not see gives no light: bodies lit from behind stay dark, and rims that turn away are not bright
enough. It is here to be compared with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..gather.source import Source, make_source
from ..kernels.memory import upload
from ..kernels.sequences import GOLDEN, r2_points
from ..light.direct import direct_irradiance, receivers
from ..light.entering import entering_colour
from ..methods.contract import key_of_positions
from ..methods.texture_space.hybrid import RESOLUTION, filter_maps, plane_density
from ..methods.texture_space.shadow_map import TranslucentShadowMap, look, store
from ..model.medium import Medium
from ..model.profiles import ProfileTable
from ..scene.bodies import Body, Lookup

CELLS = 2048
"""Annuli with equal light, from which places around a point are drawn."""

GRAZING = 0.02
"""Smallest cosine by which the area of a pixel on the surface is divided."""


def see_from_camera(
    scene: mi.Scene,
    eye: ArrayLike,
    centre: ArrayLike,
    radius: float,
    lookup: Lookup,
    number: int,
    body: Body,
    resolution: int = RESOLUTION,
) -> TranslucentShadowMap:
    """Render the light that enters a body as the camera sees it: irradiance times the area of surface behind each pixel.

    What `shadow_map.shadow_map` is to a light this is to the camera, so that `hybrid.filter_maps` sums both. The
    picture is square and shows the whole body, also where it reaches beyond the camera's own.

    Parameters
    ----------
    eye : (3,) float
        Where the camera stands.
    centre, radius
        A ball around the body.
    lookup, number
        Tell the body ``bodies[number]`` from whatever else may stand before it.

    Source: MKBVR03.
    """
    camera = look(centre, radius, resolution, eye=eye)
    ray, extent = camera.rays()
    si = scene.ray_intersect(ray)
    met = si.is_valid() & (lookup.body_index(si) == dr.opaque(mi.UInt32, number + 1))
    cosine = -dr.dot(ray.d, si.n)
    area = extent * dr.square(si.t) / dr.maximum(dr.abs(cosine), GRAZING)
    place = r2_points(dr.arange(mi.UInt32, resolution * resolution), 0)
    seen = receivers(si.p, mi.Normal3f(dr.mulsign(lookup.shading_normal(si, met), cosine)))
    _, entering = direct_irradiance(scene, seen, dr.opaque(mi.Float, body.medium.eta), place, met)
    return store(camera, si, entering * area * entering_colour(body, si, met), met)


class SeenLight:
    """The light of one body in camera of the camera, from frame to frame.

    Parameters
    ----------
    body, number, lookup, centre, radius
        As for `see_from_camera`.

    Source: MKBVR03.
    """

    def __init__(self, body: Body, number: int, lookup: Lookup, centre: ArrayLike, radius: float):
        self.body, self.number, self.lookup, self.centre, self.radius = body, number, lookup, centre, radius
        self.key: tuple[Medium, int] | None = None
        self.map: TranslucentShadowMap
        self.samples: PixelSamples

    def update(self, scene: mi.Scene, eye: ArrayLike, count: int) -> None:
        """Look from ``eye``, and choose about ``count`` samples a pixel for the medium that the body has now."""
        self.map = see_from_camera(scene, eye, self.centre, self.radius, self.lookup, self.number, self.body)
        if (key := (self.body.medium, count)) != self.key:
            self.key, self.samples = key, pixel_samples(self.body.medium, count)

    def exitance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """Sum the exitance at points of the body, whose normals point outside."""
        return filter_maps([self.map], self.samples, p, n)


@dataclass
class PixelSamples:
    """Places around a point by importance sampling of all of R_d over a plane, drawn anew for every point.

    Attributes
    ----------
    source : Source
        One record for each of `CELLS` annuli with equal light: the squares of its radii [scene units squared], and the area that a
        place in it stands for; and the profile.
    count : int
        Places around a point.

    Source: MKBVR03.
    """

    source: Source
    count: int

    def around(self, p: Any) -> Callable[[Any], tuple[Any, Any, Any]]:
        """Make what tells of the place of a number its two offsets from each of some points, and its area."""
        first, turn = (mi.Float(key_of_positions(p, seed)) * 2.0**-32 for seed in (0, 1))
        dr.eval(first, turn)
        step = dr.opaque(mi.Float, CELLS / self.count)

        def place(k: Any) -> tuple[Any, Any, Any]:
            u = (mi.Float(k) + first) * step
            cell = dr.minimum(mi.UInt32(u), CELLS - 1)
            record = dr.gather(mi.Array4f, self.source.records, cell)
            r = dr.sqrt(dr.lerp(record[0], record[1], u - mi.Float(cell)))
            sine, cosine = dr.sincos(dr.two_pi * dr.fma(mi.Float(k), GOLDEN, turn))
            return r * cosine, r * sine, record[2]

        return place


def pixel_samples(medium: Medium, count: int) -> PixelSamples:
    """Tabulate the annuli from which ``count`` places around each point are drawn."""
    r, share, _ = plane_density(medium)
    square = np.interp(np.linspace(0, 1, CELLS + 1), share, r * r)
    records = np.zeros((CELLS, 4), np.float32)
    records[:, 0], records[:, 1] = square[:-1], square[1:]
    records[:, 2] = np.pi * np.diff(square) * CELLS / count
    return PixelSamples(make_source(upload(records), count, ProfileTable.from_medium(medium), mi.Float), count)
