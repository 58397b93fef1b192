"""Numbers that are none: a NaN or an infinite value in a scene is refused by the name that its author gave it."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SceneError

MAY_BE_INFINITE = {"far_clip"}


def check_description(state: Any) -> None:
    """Refuse a parsed scene with a parameter that is not finite.

    Parameters
    ----------
    state : mi.parser.ParserState

    Raises
    ------
    SceneError
        With the parameter, the plug-in and its place.
    """
    for node in state.nodes:
        for name, value in node.props.items():
            if name not in MAY_BE_INFINITE and (wrong := _fault(value)):
                _refuse(name, wrong, node.props.plugin_name(), mi.parser.file_location(state, node))


def check_dictionary(scene: dict[str, Any], path: str = "") -> None:
    """Refuse a scene dictionary with a parameter that is not finite.

    Raises
    ------
    SceneError
        With the parameter and where it is.
    """
    for name, value in scene.items():
        if isinstance(value, dict):
            check_dictionary(value, f"{path}{name}.")
        elif name not in MAY_BE_INFINITE and (wrong := _fault(value)):
            _refuse(name, wrong, str(scene.get("type", "rgb")), f"'{path}{name}'")


def _fault(value: Any) -> tuple[str, str] | None:
    """Say what is wrong with a parameter that is not finite, or with a transform that makes a plane or a line of everything; what to do."""
    value = value.matrix if "Transform" in type(value).__name__ else value
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return None  # text, a reference, an object
    if not np.isfinite(numbers).all():
        return "is NaN or infinite", "give a finite number"
    if numbers.shape == (4, 4) and np.linalg.det(numbers[:3, :3]) == 0:
        return "leaves nothing of an axis", "give no scale of 0"
    return None


def _refuse(name: str, fault: tuple[str, str], plugin: str, place: str) -> None:
    """Raise for one parameter."""
    wrong, remedy = fault
    raise SceneError(f"{name} of '{plugin}' {wrong}, at {place}: {remedy}.")
