"""The light that enters a body along rays from a lamp, and what of it shadow maps find."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels.memory import opaque
from ..model.fresnel import transmitted
from ..scene.bodies import Body, Lookup
from .direct import irradiance_from

STEEPEST_FACET = 4.0
"""Bound on the factor by which the smooth surface that a facet stands for is lit more than the facet itself."""


def entering_along(
    scene: mi.Scene,
    emitter: mi.Emitter,
    direction: mi.Vector3f,
    si: mi.SurfaceInteraction3f,
    met: mi.Bool,
    lookup: Lookup,
    body: Body,
    extent: Any,
    parallel: Any = False,
) -> mi.Color3f:
    """Evaluate the power that rays of light carry into a body where they meet it: of solid angles ``extent``, or areas if ``parallel``."""
    ds, arriving = emitter.sample_direction(si, mi.Point2f(0.5), met)
    intensity = mi.Color3f(arriving) * dr.select(parallel, 1, dr.square(ds.dist))
    return intensity * extent * entering_share(direction, si, met, lookup, body)


def entering_share(
    direction: mi.Vector3f, si: mi.SurfaceInteraction3f, met: mi.Bool, lookup: Lookup, body: Body
) -> mi.Color3f:
    """Evaluate the share of what rays carry that enters a body where they meet it."""
    facet = -dr.dot(direction, si.n)
    smooth = -dr.dot(direction, lookup.shading_normal(si, met)) * dr.sign(facet)
    excess = dr.clip(smooth / dr.maximum(dr.abs(facet), 1e-6), 0, STEEPEST_FACET)
    eta = dr.opaque(mi.Float, body.medium.eta)
    return entering_colour(body, si, met) * (excess * transmitted(smooth, eta))


def entering_as_mapped(scene: mi.Scene, emitter: mi.Emitter, si: mi.SurfaceInteraction3f, eta: Any) -> mi.Color3f:
    """Evaluate the irradiance that enters at points of facets as a shadow map finds it: less than the smooth surface gets there.

    At the terminator of a coarse mesh the smooth surface is lit where its facet turns away from the light, or lies behind another one.

    Parameters
    ----------
    si : SurfaceInteraction3f
        Points of facets; ``n`` is the normal of the facet, ``sh_frame.n`` that of the smooth surface.
    """
    ds, _ = emitter.sample_direction(si, mi.Point2f(0.5))
    facet, smooth = dr.dot(ds.d, si.n), dr.dot(ds.d, si.sh_frame.n)
    share = dr.clip(STEEPEST_FACET * facet / dr.maximum(smooth, 1e-6), 0, 1)
    return irradiance_from(scene, emitter, si, eta, mi.Point2f(0.5))[1] * share


def entering_colour(body: Body, si: mi.SurfaceInteraction3f, active: Any) -> mi.Color3f:
    """Evaluate the factor that a texture of the reflectance puts on entering light: the texture over its mean, or 1."""
    if body.bsdf.texture is None:
        return mi.Color3f(1)
    mean = opaque(mi.Color3f, body.medium.total_diffuse_reflectance)
    return mi.Color3f(body.bsdf.texture.eval(si, active)) / mean
