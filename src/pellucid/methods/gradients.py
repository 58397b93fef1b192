"""Which gradients flow through the methods, and which are refused."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..errors import PellucidError
from .contract import Method

SMOOTH = int(mi.ParamFlags.NonDifferentiable) | int(mi.ParamFlags.Discontinuous)


def enabled_gradients(scene: mi.Scene) -> list[str]:
    """Name the parameters of a scene that have gradients enabled, also within ``dr.suspend_grad``, as ``mi.render`` calls."""
    with dr.resume_grad():
        return [name for name, value in mi.traverse(scene).items() if dr.grad_enabled(value)]


def check_gradients(scene: mi.Scene, method: Method) -> None:
    """Refuse the gradients that do not flow.

    Raises
    ------
    PellucidError
        For a parameter of a shape, a camera or what a picture does not depend on smoothly, and for a method without gradients; with its
        name and what to do.
    """
    names = enabled_gradients(scene)
    if not names:
        return
    if not method.has_gradients:
        settings = " and ".join(_in_the_way(method))
        remedy = (
            f"leave {settings} out" if settings else "use pellucid_two_pass, pellucid_texture_space or pellucid_exact"
        )
        raise PellucidError(
            f"No gradients flow through pellucid_{method.name}{settings and f' with {settings}'}, and the parameter '{names[0]}' asks for "
            f"them: {remedy}, or call dr.disable_grad on it and update the scene."
        )
    with dr.resume_grad():
        params = mi.traverse(scene)
        for name in names:
            node, flags = params.properties[name][2:4]
            if isinstance(node, (mi.Shape, mi.Sensor, mi.Film)) or int(flags) & SMOOTH:
                raise PellucidError(
                    f"No gradients flow through pellucid to '{name}': those of media, colours, textures and lights do, those of shapes, "
                    "cameras, roughness and textures of dmfp do not; call dr.disable_grad on it and update the scene, or use Mitsuba's "
                    "'prbvolpath'."
                )


def _in_the_way(method: Method) -> list[str]:
    """Name the settings without which a method would have gradients."""
    found = [name for name in ("translucent_passes", "hybrid") if getattr(method, name, False)]
    return found if method.with_parameters(**dict.fromkeys(found, False)).has_gradients else []
