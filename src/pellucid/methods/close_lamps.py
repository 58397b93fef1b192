"""Lamps nearer to a body than its samples are to each other: rays from the lamp carry their light, samples do without it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.gather import gather
from ..gather.octree import Octree, build_octree
from ..kernels.memory import lanes_where, rows
from ..kernels.sequences import hammersley_set
from ..light.entering import entering_along
from ..light.lamps import CloseLamps
from ..light.transport import opacity
from ..model.profiles import ProfileTable
from .preparation import LitScene

RAYS = 1 << 14
"""From each lamp, in all directions."""


@dataclass
class CloseLight:
    """The power that rays from lamps carry into a body, in an octree; and the profile of light that enters at points."""

    octree: Octree
    profile: ProfileTable

    def exitance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """Sum what it adds to the exitance at points, whose normals point outside."""
        return mi.Color3f(gather(self.octree, self.profile, p, n=n))


def close_light(scene: mi.Scene, state: LitScene, number: int, close: CloseLamps) -> CloseLight | None:
    """Shoot rays from close lamps at a body, each with its part of their light; None where they do not meet it.

    What a ray carries is its solid angle times the intensity there and the transmittance of its direction: light is lost neither to the
    distance of samples nor to the square of that of the lamp.

    Parameters
    ----------
    number : int
        Which of the bodies.
    """
    body = state.bodies[number].body
    found: list[list[np.ndarray]] = []
    for at, emitter in zip(close.positions, close.emitters, strict=True):
        direction = mi.warp.square_to_uniform_sphere(mi.Point2f(*hammersley_set(mi.Float, RAYS, 0)))
        ray = mi.Ray3f(mi.Point3f(*at.tolist()) + dr.zeros(mi.Point3f, RAYS), direction)
        si = scene.ray_intersect(ray)
        met = si.is_valid() & (state.lookup.body_index(si) == dr.opaque(mi.UInt32, number + 1)) & (si.t < close.reach)
        power = entering_along(
            scene, emitter, ray.d, si, met, state.lookup, body, dr.opaque(mi.Float, 4 * np.pi / RAYS)
        )
        if state.lookup.has_holes:
            power *= opacity(si, met)
        area = 4 * np.pi / RAYS * dr.square(si.t) / dr.maximum(dr.abs(dr.dot(ray.d, si.n)), 1e-3)
        index = lanes_where(met & (dr.max(power) > 0))
        if dr.width(index):
            picked = (dr.gather(type(v), v, index) for v in (si.p, mi.Float(area), mi.Color3f(power)))
            found.append([rows(v) if dr.size_v(v) == 3 else v.numpy() for v in picked])
    if not found:
        return None
    p, area, power = (np.concatenate(values) for values in zip(*found, strict=True))
    return CloseLight(build_octree(p, area, power), ProfileTable.from_medium(body.medium))
