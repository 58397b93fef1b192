"""Places on the shapes of area lights."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import upload
from ..kernels.sequences import hammersley_set


def places_on(emitters: list[mi.Emitter], count: int, seed: int) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """Spread places over the shapes of area lights, where their textures are bright; with the part of the surface that each stands for.

    They come light by light, ``count`` of each.
    """
    lane = dr.arange(mi.UInt32, count * len(emitters))
    emitter = dr.gather(mi.EmitterPtr, mi.EmitterPtr(emitters), lane // count)
    u = dr.gather(mi.Point2f, mi.Point2f(*hammersley_set(mi.Float, count, seed)), lane % count)
    ps, _ = emitter.sample_position(0.0, u)
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(lane))
    si.p, si.n, si.uv, si.wi = ps.p, _normals(emitters, emitter, ps, lane // count), ps.uv, mi.Vector3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    return si, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0) / dr.opaque(mi.Float, count)


def _normals(
    emitters: list[mi.Emitter], emitter: mi.EmitterPtr, ps: mi.PositionSample3f, number: mi.UInt32
) -> mi.Normal3f:
    """Give the normals of places: of a turned sphere Mitsuba turns the places that it draws, and forgets their normals."""
    spheres = [int(one.get_shape().class_name() == "Sphere") for one in emitters]
    if not any(spheres):
        return ps.n
    is_sphere = dr.gather(mi.UInt32, upload(np.array(spheres, np.uint32)), number) == 1
    hit = dr.zeros(mi.PreliminaryIntersection3f, dr.width(number))
    hit.shape, hit.t = emitter.get_shape(), 0
    there = hit.shape.compute_surface_interaction(mi.Ray3f(ps.p, mi.Vector3f(0, 0, 1)), hit, mi.RayFlags.All, is_sphere)
    return dr.select(is_sphere, there.n, ps.n)
