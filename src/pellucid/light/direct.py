"""Light that comes straight from emitters: one sampled direction and one shadow ray for each of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from ..model.fresnel import transmitted

FEW_EMITTERS = 4
"""So many emitters are all sampled by every path: choosing one of them would be most of the noise."""


def receivers(p: mi.Point3f, n: mi.Normal3f, sh_n: mi.Normal3f | None = None) -> mi.SurfaceInteraction3f:
    """Make points that light falls on; rays leave them on the side of ``n``, and cosines are those to ``sh_n``, or to ``n``."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(p))
    si.p, si.n, si.t = p, n, 0
    si.sh_frame = mi.Frame3f(mi.Vector3f(n if sh_n is None else sh_n))
    return si


def sample_emitters(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, sample: mi.Point2f, active: Any = True, differentiated: bool = False
) -> Iterator[tuple[mi.DirectionSample3f, mi.Color3f, mi.Float]]:
    """Sample every emitter where there are few of them, else one; ``differentiated``, with gradients of what they send.

    Yields
    ------
    direction : DirectionSample3f
    radiance : Color3f
        What arrives from there over its density; zero in shadow.
    density : Float
        That multiple importance sampling compares with that of a path: it includes the choice of the emitter.
    """
    emitters = scene.emitters()
    if len(emitters) > FEW_EMITTERS:
        ds, emitted = scene.sample_emitter_direction(si, sample, True, active)
        if differentiated:
            emitted = _with_gradient(emitted, ds, scene.eval_emitter_direction(si, ds, active))
        yield ds, emitted, ds.pdf
        return
    for k, emitter in enumerate(emitters):
        ds, emitted = emitter.sample_direction(si, sample, active)
        if differentiated:
            emitted = _with_gradient(emitted, ds, emitter.eval_direction(si, ds, active))
        hidden = scene.ray_test(si.spawn_ray_to(ds.p), active & (ds.pdf > 0))
        yield ds, dr.select(hidden | ~(ds.pdf > 0), 0, emitted), ds.pdf * scene.pdf_emitter(k)


def _with_gradient(emitted: mi.Color3f, ds: mi.DirectionSample3f, radiance: mi.Color3f) -> mi.Color3f:
    """Give what a direction carries, over its density, the gradient of the radiance from there; the density has none."""
    pdf = dr.detach(ds.pdf)
    return dr.replace_grad(emitted, dr.select(pdf > 0, radiance / pdf, 0))


def irradiance_from(
    scene: mi.Scene, emitter: mi.Emitter, si: mi.SurfaceInteraction3f, eta: Any, sample: mi.Point2f, active: Any = True
) -> tuple[mi.Color3f, mi.Color3f]:
    """Estimate the irradiance of points by one emitter, from one direction each, and the part of it that enters.

    Points that face away from the emitter cost no shadow ray.

    Parameters
    ----------
    si : SurfaceInteraction3f
        Points; ``p``, ``n`` and ``sh_frame.n`` are read.
    eta : float or Float
        Relative index of refraction behind the surface.
    sample : Point2f
        Where on the emitter; no matter for a point, a spot or a directional light.

    Returns
    -------
    falling, entering : Color3f
        The exact Fresnel transmittance of the direction lies between them.
    """
    ds, emitted = emitter.sample_direction(si, sample, active)
    cosine = dr.dot(ds.d, si.sh_frame.n)
    lit = active & (ds.pdf > 0) & (cosine > 0)
    hidden = scene.ray_test(si.spawn_ray_to(ds.p), True, lit)
    falling = dr.select(lit & ~hidden, emitted * cosine, 0)
    return falling, dr.select(lit, falling * transmitted(cosine, eta), 0)


def direct_irradiance(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, eta: Any, sample: mi.Point2f, active: Any = True
) -> tuple[mi.Color3f, mi.Color3f]:
    """Sum `irradiance_from` over all emitters of a scene; its parameters, and what it returns."""
    falling, entering = mi.Color3f(0), mi.Color3f(0)
    for emitter in scene.emitters():
        of_one = irradiance_from(scene, emitter, si, eta, sample, active)
        falling += of_one[0]
        entering += of_one[1]
    return falling, entering
