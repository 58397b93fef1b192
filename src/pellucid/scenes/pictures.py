"""The pictures that a scene names: those that are damaged, cut off or not finite are refused by their names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SceneError
from ..scene.finite import is_finite, refuse_values

PICTURES = ("bitmap", "envmap")
JPEG_STARTS, SCAN_STARTS, JPEG_ENDS = b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"


def may_load_in_parallel(files: Iterable[str]) -> bool:
    """Tell whether Mitsuba may make the objects of a scene in several threads at a time.

    Where one of them reads an OpenEXR picture that is damaged, itself in several threads, that ends the process.
    """
    return not any(Path(file).suffix.lower() == ".exr" for file in files)


def check_whole(files: Iterable[str]) -> None:
    """Refuse JPEG pictures that are cut off: whoever reads them makes up the rest, and says so in words of its own.

    Raises
    ------
    SceneError
        With the name of the file.
    """
    for file in files:
        if not Path(file).is_file():
            continue  # whoever needs it tells
        content = Path(file).read_bytes()
        if content.startswith(JPEG_STARTS) and content.rfind(JPEG_ENDS) < content.rfind(SCAN_STARTS):
            raise SceneError(f"'{file}' ends too early: it is cut off.")


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
