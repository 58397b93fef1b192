"""Materials of other formats in scenes: found, and written as the translucent materials that they stand for.

`principled` materials with subsurface scattering, and the names of material files (.mtlx) as a ``material``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SceneError
from . import principled
from .materialx import file_and_name, material_of_file

TRANSLUCENT = "pellucid_translucent"
OF_FILE = ("radius", "unit")
"""Parameters beside a ``material`` that is a file."""


def converted(bsdf: dict[str, Any]) -> dict[str, Any]:
    """Write a material as a translucent one, if it is of another format; else return it as it is.

    Parameters
    ----------
    bsdf : dict
        For ``mi.load_dict``.

    Raises
    ------
    SceneError
        For a material that cannot be converted.
    """
    if not _is_foreign(str(bsdf.get("type", "")), bsdf):
        return {name: value for name, value in bsdf.items() if not _means_nothing(bsdf, name)}
    new = _translated({name: _plain(value) for name, value in bsdf.items() if name not in ("type", "id")})
    kept = {"id": bsdf["id"]} if "id" in bsdf else {}
    return {"type": TRANSLUCENT} | kept | {name: _spec(value) for name, value in new.items()}


def convert_dictionary(scene: dict[str, Any]) -> dict[str, Any]:
    """Copy a scene dictionary, with the materials of other formats converted."""
    return converted({name: convert_dictionary(v) if isinstance(v, dict) else v for name, v in scene.items()})


def convert_nodes(state: Any) -> None:
    """Convert the materials of other formats in a parsed scene.

    Parameters
    ----------
    state : mi.parser.ParserState
        Changed in place. Nothing is looked at in the nodes that are not converted: what is read counts as used.
    """
    for props in [node.props for node in state.nodes if node.type == mi.ObjectType.BSDF]:
        if not _is_foreign(props.plugin_name(), props):
            for name in [name for name in principled.BLENDERS if _means_nothing(props, name)]:
                del props[name]
            continue
        values = dict(props.items())
        new = _translated({name: _plain(value) for name, value in values.items()})
        for name in values:
            del props[name]
        props.set_plugin_name(TRANSLUCENT)
        for name, value in new.items():
            props[name] = mi.ScalarColor3f(*value) if isinstance(value, np.ndarray) else value


def _means_nothing(values: Any, name: str) -> bool:
    """Tell whether a material has a parameter of subsurface scattering, but a weight of 0 for it."""
    return name in values and name in principled.BLENDERS and principled.WEIGHT in values


def _is_foreign(plugin: str, values: Any) -> bool:
    """Tell whether a material is one to convert.

    Raises
    ------
    SceneError
        For parameters that belong to a material file, without one.
    """
    if plugin == "principled":
        return principled.WEIGHT in values and values[principled.WEIGHT] != 0
    if plugin != TRANSLUCENT:
        return False
    if "material" in values and file_and_name(str(values["material"])) is not None:
        return True
    for name in OF_FILE:
        if name in values:
            raise SceneError(f"{name} belongs to a material file: give its name as material (file.mtlx).")
    return False


def _translated(values: dict[str, Any]) -> dict[str, Any]:
    """Find the parameters of the translucent material that a foreign one stands for."""
    found = file_and_name(str(values.get("material", "")))
    if found is None:
        return principled.translucent(values)
    file = Path(str(mi.file_resolver().resolve(found[0])))
    unit = float(values.get("unit", values.get("scale", 1.0)))
    read = material_of_file(file, found[1], str(values.get("radius", "mfp")), unit)
    own = {name: value for name, value in values.items() if name not in ("material", *OF_FILE)}
    return {name: _plain(value) for name, value in read.items() if name != "type"} | own


def _plain(value: Any) -> Any:
    """Read the numbers of a colour however it is written, ``(3,) float``; anything else stays what it is."""
    if isinstance(value, dict) and value.get("type") in ("rgb", "spectrum", "uniform"):
        inner = value.get("value")
        value = [inner] if isinstance(inner, (int, float)) else inner if isinstance(inner, (list, tuple)) else value
    if getattr(value, "is_uniform", lambda: False)():  # <spectrum value="0.3"/> of a scene file
        value = value.values
    if isinstance(value, (list, tuple, mi.ScalarColor3f, mi.ScalarColor3d)) and np.size(value) in (1, 3):
        return np.broadcast_to(np.array(value, float).ravel(), 3)
    return value


def _spec(value: Any) -> Any:
    """Write a colour for ``mi.load_dict``."""
    return {"type": "rgb", "value": value.tolist()} if isinstance(value, np.ndarray) else value
