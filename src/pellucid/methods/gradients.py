"""Refuse scenes whose parameters ask for gradients: none flow through the methods yet."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..errors import PellucidError


def refuse_gradients(scene: mi.Scene) -> None:
    """Check that no parameter of a scene has gradients enabled, also within ``dr.suspend_grad``, as ``mi.render`` calls.

    Raises
    ------
    PellucidError
        When one has, with its name and what to do.
    """
    with dr.resume_grad():
        names = [name for name, value in mi.traverse(scene).items() if dr.grad_enabled(value)]
    if names:
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        raise PellucidError(
            f"No gradients flow through pellucid yet, and the parameter '{names[0]}'{more} asks for them: "
            "call dr.disable_grad on it and update the scene, or use Mitsuba's 'prbvolpath'."
        )
