"""Shading normals as the materials of a scene turn them: by ``bumpmap`` and ``normalmap``, inside each other and other wrappers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..errors import SceneError


def asks_for_normal(ctx: mi.BSDFContext) -> bool:
    """Tell whether an evaluation asks for no lobe at all: it gets the shading normal that the wrappers have made."""
    return int(ctx.type_mask) == 0


def turned_normal(bsdf: Any, si: mi.SurfaceInteraction3f, active: Any = True) -> mi.Normal3f:
    """Evaluate the shading normal that a material, ``BSDF`` or ``BSDFPtr``, makes of ``si.sh_frame``, on the same side of the surface.

    A wrapper evaluates what it holds in a frame of its own; `translucent.TranslucentBSDF` answers with the normal of that frame. Where a
    normal map turns it by more than 90 degrees, or a mask leaves nothing, the normal is as it was.
    """
    ctx = mi.BSDFContext()
    ctx.type_mask = 0
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, 1)
    try:
        n = mi.Vector3f(bsdf.eval(ctx, upright, mi.Vector3f(0, 0, 1), active))
    except RuntimeError as error:
        if "eval_1_grad" not in str(error):
            raise
        raise SceneError(
            "The texture of a 'bumpmap' has no gradient in Mitsuba: use a 'bitmap', or a 'normalmap'."
        ) from error
    length = dr.norm(n)  # a mask multiplies by its opacity
    return mi.Normal3f(dr.select(length > 0, n / length, si.sh_frame.n))
