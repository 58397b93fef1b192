"""Pictures, colours and lights of a scene whose values are no finite numbers: nobody else would say a word about them."""

from __future__ import annotations

from typing import Any, NoReturn

import drjit as dr
import mitsuba as mi

from ..errors import SceneError

VALUES = ("data", "vertex_color", "value", "scale", "intensity", "radiance", "irradiance")
"""What Mitsuba calls the values of pictures, spectra and lights."""


def is_finite(value: Any) -> bool:
    """Tell whether all numbers of an array or a tensor are finite."""
    return bool(dr.all(dr.isfinite(getattr(value, "array", value)), axis=None))


def check_values(scene: mi.Scene) -> None:
    """Refuse a scene with a picture, colours of vertices, a light or a material whose values are not finite, whoever has loaded it.

    Raises
    ------
    SceneError
        With the name of the parameter.
    """
    for key, value in mi.traverse(scene).items():  # each object once, however many shapes share it
        if key.rpartition(".")[2] in VALUES and not is_finite(value):
            refuse_values(key)


def refuse_values(name: str) -> NoReturn:
    """Raise for one parameter."""
    raise SceneError(f"'{name}' has values that are NaN or infinite: repair them.")
