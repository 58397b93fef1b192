"""Lamps nearer to a body than its samples are to each other: rays from the lamp carry what samples would miss of their light."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.gather import gather
from ..gather.octree import Octree, build_octree
from ..kernels.even_sampler import EvenSampler
from ..kernels.memory import lanes_where, opaque, rows
from ..light.entering import entering_share
from ..light.lamps import CloseLamps, bodies_along, distances_of_boxes, lamp_places
from ..light.places import places_on
from ..light.transport import opacity
from ..model.profiles import ProfileTable
from .contract import Points
from .preparation import LitBody, LitScene
from .thin import warn_of_thin_parts

RAYS = 1 << 15
"""From each lamp."""


@dataclass
class CloseLight:
    """The power that rays from lamps carry into a body, in an octree; and the profile of light that enters at points."""

    octree: Octree
    profile: ProfileTable

    def exitance(self, p: mi.Point3f, n: mi.Normal3f, stretch: mi.Color3f | None) -> mi.Color3f:
        """Sum what it adds to the exitance at points, whose normals point outside."""
        return mi.Color3f(gather(self.octree, self.profile, p, n=n, stretch=stretch))


def close_light(scene: mi.Scene, state: LitScene, number: int, close: CloseLamps | None) -> CloseLight | None:
    """Shoot rays from close lamps at a body, each with its part of their light; None where they do not meet it.

    The power of a ray is lost neither to the distance of samples nor to the square of that of the lamp. Of that, rays keep what samples
    do not get (`CloseLamps`).

    Parameters
    ----------
    number : int
        Which of the bodies.
    """
    if close is None:
        return None
    body = state.bodies[number].body
    found: list[list[np.ndarray]] = []
    emitters = close.emitters(scene)
    near = distances_of_boxes(emitters, [body])[:, 0] <= close.reach
    for emitter in np.array(emitters, object)[near]:
        ray, power, area, angle = rays_from(emitter)
        si = scene.ray_intersect(ray)
        met = si.is_valid() & (state.lookup.body_index(si) == dr.opaque(mi.UInt32, number + 1)) & (si.t < close.reach)
        if body.side == 0:
            met &= ~_from_inside(scene, ray, state, number)
        power *= entering_share(ray.d, si, met, state.lookup, body) * close.by_rays(si.t)
        if state.lookup.has_holes:
            power *= opacity(si, met)
        area += angle / RAYS * dr.square(si.t)
        index = lanes_where(met & (dr.max(power) > 0))
        if dr.width(index):
            picked = (dr.gather(type(v), v, index) for v in (si.p, area, power))
            found.append([rows(v) if dr.size_v(v) == 3 else v.numpy() for v in picked])
    if not found:
        return None
    warn_of_thin_parts(body, "The light of lamps close by")
    p, area, power = (np.concatenate(values) for values in zip(*found, strict=True))
    return CloseLight(build_octree(p, area, power), ProfileTable.from_medium(body.medium))


def add_close_light(exitance: mi.Color3f, points: Points, body: int, lit: LitBody, outside: int) -> None:
    """Add what rays carry into one body, of the number ``body`` among ``points``, to the exitance of all points."""
    index = lanes_where(points.body == body)
    if dr.width(index):
        p, n = dr.gather(mi.Point3f, points.p, index), dr.gather(mi.Normal3f, points.n, index)
        value = lit.close.exitance(p, n * dr.opaque(mi.Float, outside), points.stretch_on(lit.body, index))
        dr.scatter(exitance, dr.gather(mi.Color3f, exitance, index) + value, index)


def rays_from(emitter: mi.Emitter) -> tuple[mi.Ray3f, mi.Color3f, mi.Float, float]:
    """Shoot rays from a point lamp, a spot or an area light, in all directions.

    Returns
    -------
    ray : Ray3f
    power : Color3f
        Of each [W].
    area : Float
        Their width where they begin, an area.
    angle : float
        The solid angle that all of them fill, projected where density falls with the cosine.
    """
    sampler = EvenSampler.from_indices(dr.arange(mi.UInt32, RAYS), 0)
    if emitter.get_shape() is not None:
        si, area = places_on([emitter], RAYS, 0)
        ray = si.spawn_ray(si.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d())))
        return ray, mi.Color3f(emitter.eval(si)) * (np.pi * area), area, np.pi
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    it = dr.zeros(mi.SurfaceInteraction3f, RAYS)
    at = opaque(mi.Point3f, lamp_places([emitter])[0])
    it.p = at + direction * (1 + dr.max(dr.abs(at)))  # far enough that the difference of positions keeps its digits
    ds, arriving = emitter.sample_direction(it, mi.Point2f(0.5))
    intensity = mi.Color3f(arriving) * dr.square(ds.dist)
    return (
        mi.Ray3f(at + dr.zeros(mi.Point3f, RAYS), direction),
        intensity * (4 * np.pi / RAYS),
        dr.zeros(mi.Float, RAYS),
        4 * np.pi,
    )


def _from_inside(scene: mi.Scene, ray: mi.Ray3f, state: LitScene, number: int) -> mi.Bool:
    """Tell which rays begin inside a closed body: those that cross its surface once more on their way out than in."""
    crossings = (bodies_along(scene, ray, state.lookup) == number + 1).sum(axis=0)
    return mi.Bool(crossings % 2 == 1)
