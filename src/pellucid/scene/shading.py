"""Shading normals as the materials of a scene turn them: by ``bumpmap`` and ``normalmap``, inside each other and other wrappers."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi

from ..errors import SceneError

ASIDE = 0.1
"""The sine of the angle between the two directions that a normal is found by."""


def asks_for_normal(ctx: mi.BSDFContext) -> bool:
    """Tell whether an evaluation asks for no lobe at all: it gets the shading normal that the wrappers have made."""
    return int(ctx.type_mask) == 0


def projections(wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Color3f:
    """Answer for a shading normal, the z axis of the frame of two directions: its cosines with them, and its share of their cross product.

    All three are the same in every frame, whatever coordinates a wrapper has given its own in: ``bumpmap`` those of the frame before,
    ``normalmap`` those of the scene.
    """
    return mi.Color3f(wi.z, wo.z, dr.cross(wi, wo).z)


def turned_normal(bsdf: Any, si: mi.SurfaceInteraction3f, active: Any = True) -> mi.Normal3f:
    """Evaluate the shading normal that a material, ``BSDF`` or ``BSDFPtr``, makes of ``si.sh_frame``, on the same side of the surface.

    A wrapper evaluates what it holds in a frame of its own; `translucent.TranslucentBSDF` answers with what that makes of two directions
    (`projections`). Where a normal map turns the normal by more than 90 degrees, or a mask leaves nothing, it is as it was.
    """
    ctx = mi.BSDFContext()
    ctx.type_mask = 0
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, 1)
    # Nearly upright: of what lies below a turned surface wrappers say nothing.
    aside = mi.Vector3f(ASIDE, 0, math.sqrt(1 - ASIDE**2))
    try:
        along = bsdf.eval(ctx, upright, aside, active)
    except RuntimeError as error:
        if "eval_1_grad" not in str(error):
            raise
        raise SceneError(
            "The texture of a 'bumpmap' has no gradient in Mitsuba: use a 'bitmap', or a 'normalmap'."
        ) from error
    n = mi.Vector3f((along[1] - aside.z * along[0]) / ASIDE, along[2] / ASIDE, along[0])
    length = dr.norm(n)  # a mask multiplies by its opacity
    return mi.Normal3f(dr.select(length > 0, si.to_world(n / length), si.sh_frame.n))
