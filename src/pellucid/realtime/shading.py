"""From exitance to radiance, and all that is not translucent: opaque surfaces, the sky, highlights."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import upload
from ..kernels.sequences import r2_points
from ..light.direct import FEW_EMITTERS, sample_emitters
from .gbuffer import FIRST_BODY, NOTHING, OPAQUE, GBuffer, lanes_where
from .lights import Lamp
from .live_body import LEAVE_STEPS, LiveBody
from .tone import tone_map

FACING = 0.04
"""Reflectance of a body that is looked at straight on."""

FAINTEST = 1 / 256
"""Highlights fainter than this are not worth a shadow ray."""


def leave_table(bodies: list[LiveBody]) -> mi.Float:
    """Put the tables of ``F_t(omega_out) / (pi T_d)`` of all bodies behind each other."""
    return upload(np.concatenate([body.leave_table() for body in bodies]))


def translucent(gbuffer: GBuffer, exitance: mi.Color3f, table: mi.Float) -> mi.Color3f:
    """Turn exitance into radiance: ``L = F_t(omega_out) / (pi T_d) B``, zero where there is no body.

    Source: CLHHC08 eq. 11. As printed T_d is missing; with it L integrates back to B.
    """
    body = gbuffer.kind >= FIRST_BODY
    place = dr.clip(-dr.dot(gbuffer.n, gbuffer.ray.d), 0, 1) * LEAVE_STEPS
    step = dr.minimum(mi.UInt32(place), LEAVE_STEPS - 1)
    first = (gbuffer.kind - FIRST_BODY) * (LEAVE_STEPS + 1) + step
    leave = dr.lerp(
        dr.gather(mi.Float, table, first, body), dr.gather(mi.Float, table, first + 1, body), place - mi.Float(step)
    )
    return dr.select(body, exitance * leave, 0)


def surroundings(scene: mi.Scene, gbuffer: GBuffer, turn: int) -> mi.Color3f:
    """See opaque surfaces in direct light, emitters, and the sky.

    An emitter with an extent is sampled at one place a pixel, another one at each ``turn``.
    """
    result = mi.Color3f(0)
    environment = scene.environment()
    if environment is not None:
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(gbuffer.kind))
        si.wi = -gbuffer.ray.d
        nothing = gbuffer.kind == NOTHING
        result = dr.select(nothing, environment.eval(si, nothing), 0)
    if gbuffer.hit is None:
        return result
    result += dr.zeros(mi.Color3f, dr.width(gbuffer.kind))
    dr.eval(result)
    index = lanes_where(gbuffer.kind == OPAQUE)
    if dr.width(index):
        dr.scatter(result, _direct(scene, gbuffer, index, turn), index)
    return result


def _direct(scene: mi.Scene, gbuffer: GBuffer, index: mi.UInt32, turn: int) -> mi.Color3f:
    """Reflect direct light off opaque surfaces, by the BSDF of each, and add what they emit."""
    ray, hit = dr.gather(mi.Ray3f, gbuffer.ray, index), dr.gather(mi.PreliminaryIntersection3f, gbuffer.hit, index)
    si = hit.compute_surface_interaction(ray)
    radiance = si.emitter(scene).eval(si)
    for ds, emitted, _ in sample_emitters(scene, si, r2_points(index, turn)):
        radiance += si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), ds.pdf > 0) * dr.select(
            ds.pdf > 0, emitted, 0
        )
    return radiance


def highlights(
    scene: mi.Scene,
    gbuffer: GBuffer,
    lamps: list[Lamp],
    strength: mi.Float,
    shininess: mi.Float,
    average: mi.Float,
    exposure: mi.Float,
) -> mi.Color3f:
    """Mirror the lamps and the sky in translucent bodies: what is added to their colour after tone mapping.

    ``(r . v)^s`` times the colour of a white surface that faces the lamp, where the lamp is not in shadow; an area light
    is mirrored as one point of it. The sky is mirrored as if nothing stood before it, at grazing angles all of it: there
    no light comes from inside, and without the sky the outline would be black.

    Source: CLHHC08 section 3 (Phong's model); Schlick 1994 (the sky).
    """
    result = mi.Color3f(0)
    body = gbuffer.kind >= FIRST_BODY
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(gbuffer.kind))
    si.p, si.n, si.t = gbuffer.p, gbuffer.n, 0
    mirrored = dr.fma(gbuffer.n, -2 * dr.dot(gbuffer.n, gbuffer.ray.d), gbuffer.ray.d)
    if (environment := scene.environment()) is not None:
        si.wi = -mirrored
        grazing = 1 - dr.clip(-dr.dot(gbuffer.n, gbuffer.ray.d), 0, 1)
        reflectance = strength * dr.fma(1 - FACING, dr.square(dr.square(grazing)) * grazing, FACING)
        sky = tone_map(environment.eval(si, body), average, exposure)
        result += dr.select(body, sky * reflectance, 0)
    for lamp in [lamp for lamp in lamps if lamp.is_delta or lamp.kind == "area"][:FEW_EMITTERS]:
        ds, emitted = lamp.emitter.sample_direction(si, mi.Point2f(0.5), body)
        lobe = strength * dr.power(dr.maximum(dr.dot(mirrored, ds.d), 0), shininess)
        bright = body & (ds.pdf > 0) & (lobe > FAINTEST) & (dr.dot(gbuffer.n, ds.d) > 0)
        hidden = scene.ray_test(si.spawn_ray_to(ds.p), True, bright)
        white = tone_map(mi.Color3f(emitted) * dr.inv_pi, average, exposure)
        result += dr.select(bright & ~hidden, white * lobe, 0)
    return result
