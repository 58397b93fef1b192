"""Virtual point lights for opaque surfaces: on translucent bodies, only what the surface reflects.

The light that bodies send from inside reaches opaque surfaces by paths, and must not be counted a second time.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.memory import columns, rows
from ...light.points.records import LightSamples
from ...model.fresnel import external_diffuse_transmittance
from ..preparation import LitScene

BEHIND = 1e-3
"""Share of the size of a scene within which the surface of a virtual light lies behind it."""


def without_light_from_inside(scene: mi.Scene, state: LitScene, lights: LightSamples) -> LightSamples:
    """Multiply the virtual lights on translucent bodies by the share of their light that the surface reflects.

    While bodies act as diffuse ones (`Role.DIFFUSE`), their virtual lights send both what the surface reflects and what comes from inside.
    """
    virtual = np.flatnonzero(lights.indirect)
    if not len(virtual):
        return lights
    p, n = (columns(values[virtual]) for values in (lights.p, lights.n))
    ray = mi.Ray3f(mi.Point3f(*p), -mi.Vector3f(*n))
    ray.maxt = BEHIND * float(np.linalg.norm(scene.bbox().extents()))
    si = scene.ray_intersect(ray)
    body = state.lookup.body_index(si, si.is_valid())
    passes = mi.Float([0.0, *(external_diffuse_transmittance(lit.body.medium.eta) for lit in state.bodies)])
    bsdf, inside = si.bsdf(), body != 0
    all_of_it = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, dr.sign(si.wi.z)), inside) * dr.pi
    from_inside = bsdf.eval_diffuse_reflectance(si, inside) * dr.gather(mi.Float, passes, body)
    share = dr.select(inside & (all_of_it > 0), dr.clip(1 - from_inside / all_of_it, 0, 1), 1)
    intensity = lights.intensity.copy()
    intensity[virtual] *= rows(share)
    return replace(lights, intensity=intensity)
