"""Numbers that are none: a NaN or an infinite value in a scene is refused by the name that its author gave it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SceneError
from ..scene.finite import is_finite, refuse_values

MAY_BE_INFINITE = {"far_clip"}
PICTURES = ("bitmap", "envmap")


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


def check_pictures(scene: mi.Scene, files: Iterable[str]) -> None:
    """Refuse a loaded scene with a picture or a mesh whose values are not finite.

    Parameters
    ----------
    scene : mi.Scene
    files : iterable of str
        The pictures it was loaded from; they are read again only to name the one at fault.

    Raises
    ------
    SceneError
        With the name of the file, or of the parameter.
    """
    for name, value in mi.traverse(scene).items():
        if name.endswith((".data", ".vertex_color")) and not is_finite(value):
            check_files(files)
            refuse_values(name)


def check_files(files: Iterable[str]) -> None:
    """Refuse the first picture with pixels that are not finite.

    Raises
    ------
    SceneError
        With the name of the file.
    """
    for file in files:
        try:
            pixels = np.asarray(mi.Bitmap(file), float)
        except RuntimeError as error:
            if Path(file).is_file() and Path(file).name not in str(error):
                raise SceneError(
                    f"'{file}' cannot be read as a picture: it is damaged, or a file of another kind."
                ) from error
            continue  # it is not there, or cut off, which whoever needs it tells
        bad = int(np.count_nonzero(~np.isfinite(pixels).all(axis=-1)))
        if bad:
            raise SceneError(f"'{file}' has {bad} pixels that are NaN or infinite: repair the picture.")


def picture_files(state: Any) -> Iterator[str]:
    """List the pictures that a parsed scene names, as they can be opened."""
    for node in state.nodes:
        if node.props.plugin_name() in PICTURES and isinstance(node.props.get("filename", None), str):
            yield str(mi.file_resolver().resolve(node.props["filename"]))


def picture_files_of(scene: dict[str, Any]) -> Iterator[str]:
    """List the pictures that a scene dictionary names."""
    for value in scene.values():
        if isinstance(value, dict):
            yield from picture_files_of(value)
    if scene.get("type") in PICTURES and isinstance(scene.get("filename"), str):
        yield str(mi.file_resolver().resolve(scene["filename"]))


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
