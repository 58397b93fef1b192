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
            if name not in MAY_BE_INFINITE and not _is_finite(value):
                _refuse(name, node.props.plugin_name(), mi.parser.file_location(state, node))


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
        elif name not in MAY_BE_INFINITE and not _is_finite(value):
            _refuse(name, str(scene.get("type", "rgb")), f"'{path}{name}'")


def _is_finite(value: Any) -> bool:
    """Tell whether a parameter is made of finite numbers, or of no numbers at all."""
    value = value.matrix if "Transform" in type(value).__name__ else value
    try:
        return bool(np.isfinite(np.asarray(value, float)).all())
    except (TypeError, ValueError):
        return True  # text, a reference, an object


def _refuse(name: str, plugin: str, place: str) -> None:
    """Raise for one parameter."""
    raise SceneError(f"{name} of '{plugin}' is NaN or infinite, at {place}: give a finite number.")
