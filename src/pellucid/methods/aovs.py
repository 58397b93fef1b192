"""Extra channels of the picture: what is seen first, and its exitance, irradiance and single scattering if it is translucent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ..errors import PellucidError, did_you_mean
from ..kernels.memory import columns, rows
from ..light.irradiance import path_radiance
from ..light.transport import Limits, Start, Translucency, mis_weight
from ..model.single_scattering import brdf as single_scattering_brdf
from .preparation import LitScene

OF_BODIES = ("exitance", "irradiance", "single_scattering")
COMPONENTS = {**dict.fromkeys(OF_BODIES, "RGB"), "albedo": "RGB", "normal": "XYZ", "depth": "Z"}
NAMES = tuple(COMPONENTS)


def parse(text: str) -> list[str]:
    """Read a comma-separated list of channel names."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in NAMES:
            raise PellucidError(f"aovs knows {', '.join(NAMES)}; found '{name}'{did_you_mean(name, NAMES)}.")
    return names


def channel_names(names: Iterable[str]) -> list[str]:
    """Name the numbers of channels, as in ``normal.X``."""
    return [f"{name}.{component}" for name in names for component in COMPONENTS[name]]


@dataclass
class FirstPoints:
    """What the camera sees at once, by path: the number of the body from 1 on, 0 for none, and its exitance there."""

    body: mi.UInt32
    exitance: mi.Color3f


def evaluate(
    names: list[str],
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.RayDifferential3f,
    lit: LitScene,
    first: FirstPoints,
    limits: Limits,
    translucency: Translucency,
) -> list:
    """Evaluate the channels that were asked for: 0 where the camera sees nothing, or nothing translucent if they belong to that."""
    if not names:
        return []
    si = scene.ray_intersect(ray)
    channels: list = []
    for name in names:
        if name == "exitance":
            value = first.exitance
        elif name == "irradiance":
            value = _irradiance(lit, si, first.body)
        elif name == "single_scattering":
            value = _single_scattering(scene, sampler, lit, si, first.body, limits, translucency)
        else:
            value = {"albedo": _albedo(si, first.body), "normal": si.sh_frame.n, "depth": mi.Color3f(si.t)}[name]
        seen = first.body != 0 if name in OF_BODIES else si.is_valid()
        channels += list(dr.select(seen, mi.Color3f(value), 0))[: len(COMPONENTS[name])]
    return channels


def _albedo(si, first_body) -> mi.Color3f:
    """Evaluate the diffuse reflectance; what only mirrors or refracts shows other things unchanged, as if it were white."""
    bsdf, lobes = si.bsdf(), mi.BSDFFlags
    diffuse = mi.has_flag(bsdf.flags(), lobes.DiffuseReflection) | mi.has_flag(bsdf.flags(), lobes.DiffuseTransmission)
    reflectance = mi.Color3f(bsdf.eval_diffuse_reflectance(si, si.is_valid()))
    return dr.clip(dr.select(diffuse | (first_body != 0), reflectance, 1), 0, 1)


def _irradiance(lit_scene: LitScene, si, first_body) -> mi.Color3f:
    """Look up the irradiance of the surface sample nearest to each point."""
    bodies = first_body.numpy()
    points = rows(si.p)
    value = np.zeros_like(points)
    for k, lit in enumerate(lit_scene.bodies):
        here = bodies == k + 1
        if lit.irradiance is not None and here.any():
            nearest = cKDTree(lit.samples.p).query(points[here], workers=-1)[1]
            value[here] = lit.irradiance.total[nearest]
    return mi.Color3f(*columns(value))


def _single_scattering(
    scene, sampler, lit_scene: LitScene, si, first_body, limits: Limits, translucency: Translucency
) -> mi.Color3f:
    """Estimate the radiance that was scattered once, by emitter sampling and one cosine-distributed path."""
    total = mi.Color3f(0)
    for k, lit in enumerate(lit_scene.bodies):
        if not lit.body.bsdf.single_scattering:
            continue
        here = first_body == k + 1
        wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        upper = dr.sign(si.wi.z)

        def lobe(wo, medium=lit.body.medium, wi=wi, upper=upper):
            return mi.Color3f(
                single_scattering_brdf(medium, wi, mi.Vector3f(wo.x, wo.y, dr.maximum(upper * wo.z, 1e-4)))
            )

        ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(), True, here)
        wo = si.to_local(ds.d)
        cosine = dr.maximum(upper * wo.z, 0)
        weight = dr.select(ds.delta, 1, mis_weight(ds.pdf, cosine * dr.inv_pi))
        value = dr.select(here & (ds.pdf > 0), lobe(wo) * emitted * (cosine * weight), 0)

        wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        pdf = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        wo.z *= upper
        start = Start.surface(si, wo, pdf)
        value += dr.pi * lobe(wo) * path_radiance(scene, sampler, start, limits, translucency, here)
        total += dr.select(here, value, 0)
    return total
