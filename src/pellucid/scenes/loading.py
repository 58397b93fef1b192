"""The one place that loads scenes: files of Mitsuba, bare meshes, the built-in scenes, dictionaries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi

from ..errors import EnvironmentProblem, SceneError, did_you_mean, first_cause
from ..scene.meshes.files import MESH_FORMATS
from .builtin import build, builtin_names
from .foreign import convert_dictionary, converted
from .mesh_scene import mesh_scene
from .numbers import check_dictionary
from .pictures import check_files, check_pictures, check_whole, may_load_in_parallel, picture_files_of
from .scene_file import load_scene_file


def load_scene(
    source: str | Path | dict[str, Any], parameters: dict[str, str] | None = None, **options: Any
) -> mi.Scene:
    """Load a scene with every shape kept apart, as the translucent bodies need it, and materials of other formats converted.

    Parameters
    ----------
    source : str, Path or dict
        A Mitsuba scene (``.xml``; of Mitsuba 0.x if its translucent shapes are dipoles), a mesh (PLY, OBJ, STL, glTF/GLB,
        OFF), the name of a built-in scene, or a scene dictionary.
    parameters : dict
        Values for the ``$names`` in a scene file.
    options
        Passed to the built-in scene or the mesh scene: ``bsdf``, ``size``, ``resolution``, ``spp``, ...

    Raises
    ------
    SceneError
        When there is no such scene, or Mitsuba cannot read it.
    EnvironmentProblem
        When no variant is active.
    """
    if mi.variant() is None:
        raise EnvironmentProblem("No Mitsuba variant is active: call mitsuba.set_variant('llvm_ad_rgb') first.")
    try:
        if isinstance(source, dict):
            return _load_dict(source)
        path = Path(source)
        if path.suffix.lower() == ".xml":
            return load_scene_file(path, parameters or {})
        return _load_dict(scene_dict(source, **options))
    except RuntimeError as error:
        raise SceneError(first_cause(str(error))) from error
    except UnicodeDecodeError as error:  # Mitsuba quotes a line of a damaged file, which Python cannot read as text
        raise SceneError(first_cause(error.object.decode(errors="backslashreplace"))) from error


def scene_dict(source: str | Path, **options: Any) -> dict[str, Any]:
    """Describe a built-in scene or a bare mesh as a scene dictionary.

    Raises
    ------
    SceneError
        For a name that is neither, with the nearest known one.
    """
    if options.get("bsdf") is not None:
        options["bsdf"] = converted(options["bsdf"])
        if isinstance(options["bsdf"], dict):
            check_whole(picture_files_of(options["bsdf"]))
    if str(source) in builtin_names():
        return build(str(source), **options)
    path = Path(source)
    if path.suffix.lower() in MESH_FORMATS:
        return mesh_scene(path, **options)
    known = ", ".join(builtin_names())
    hint = did_you_mean(str(source), builtin_names())
    raise SceneError(
        f"'{source}' is no scene file (.xml), no mesh ({' '.join(sorted(MESH_FORMATS))}) and no built-in scene ({known}){hint}"
    )


def _load_dict(spec: dict[str, Any]) -> mi.Scene:
    """Load a scene dictionary."""
    check_dictionary(spec)
    spec = convert_dictionary(spec)
    files = list(picture_files_of(spec))
    check_whole(files)
    try:
        scene = mi.load_dict(spec, parallel=may_load_in_parallel(files), optimize=False)
    except RuntimeError:
        check_files(files)  # a material may have stumbled over a picture without naming it
        raise
    if isinstance(scene, mi.Scene):
        check_pictures(scene, files)
    return scene
