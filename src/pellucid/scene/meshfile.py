"""Bare meshes (PLY, OBJ, STL, glTF/GLB, OFF) on a table under a lamp."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import EnvironmentProblem, PellucidWarning, SceneError, did_you_mean
from .builtin.stage import Spec, View, start, studio
from .mesh_arrays import mesh_from_arrays
from .mesh_repair import Floats, MeshArrays, check_mesh

# The axis that points up in files of each kind: glTF says so, OBJ by custom; printers and scanners write the others.
MESH_FORMATS = {".ply": "z", ".obj": "y", ".stl": "z", ".gltf": "y", ".glb": "y", ".off": "z"}

# Sizes [mm] between which a mesh without a given size is taken to be in millimetres.
PLAUSIBLE_EXTENT = (2.0, 5000.0)

# From the middle of the object to the camera: from the front, a little to the left and above.
VIEW_DIRECTION = np.array([-0.45, -1.0, 0.42]) / np.linalg.norm([-0.45, -1.0, 0.42])
FIELD_OF_VIEW = 24.0
MARGIN = 0.86


def load_mesh(path: str | Path) -> MeshArrays:
    """Read a mesh file and check it; the bodies of a scene graph become one, each where the graph puts it.

    Raises
    ------
    SceneError
        For a missing file, an unknown format, a damaged file, and for what `check_mesh` refuses.
    EnvironmentProblem
        When the reader needs a package that is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_FORMATS:
        hint = did_you_mean(path.suffix.lower(), MESH_FORMATS)
        raise SceneError(f"'{path.name}' is no mesh that can be read ({' '.join(sorted(MESH_FORMATS))}){hint}")
    if not path.is_file():
        raise SceneError(f"There is no mesh file '{path}': check the path.")
    parts = _read(path)
    if not parts:
        raise SceneError(f"{path.name}: it has no faces: give a mesh with triangles.")
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets[:-1], strict=True)])
    vertices = np.concatenate([part.vertices for part in parts])
    normals = _joined([part.normals for part in parts])
    return check_mesh(vertices, faces, normals, _joined([part.uv for part in parts]), path.name)


def _read(path: Path) -> list[MeshArrays]:
    """Read the parts of a file, transformed, through trimesh."""
    import trimesh

    try:
        scene = trimesh.load_scene(path, process=False, maintain_order=True)
    except ImportError as error:
        raise EnvironmentProblem(f"Reading '{path.name}' needs the package '{error.name}': install it.") from error
    except Exception as error:  # the readers raise whatever their parsers do on a damaged file
        cause = (str(error) or type(error).__name__).splitlines()[0]
        raise SceneError(f"{path.name}: the file is damaged or not what its name says ({cause}).") from error
    parts = []
    for node in scene.graph.nodes_geometry:
        to_world, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            parts.append(_part(geometry, to_world))
    return parts


def _part(geometry: Any, to_world: Floats) -> MeshArrays:
    """Take the arrays of one geometry, transformed; normals only if the file had them."""
    linear = to_world[:3, :3]
    mirrored = np.linalg.det(linear) < 0
    faces = np.asarray(geometry.faces)
    normals = geometry.vertex_normals if "vertex_normals" in geometry._cache.cache else None
    return MeshArrays(
        np.asarray(geometry.vertices) @ linear.T + to_world[:3, 3],
        faces[:, ::-1] if mirrored else faces,
        None if normals is None else np.asarray(normals) @ np.linalg.pinv(linear),
        getattr(geometry.visual, "uv", None),
    )


def _joined(values: list[Floats | None]) -> Floats | None:
    """Concatenate an attribute that all parts have; None if one lacks it."""
    present = [value for value in values if value is not None]
    return np.concatenate(present) if len(present) == len(values) else None


def placed(mesh: MeshArrays, size: float | None, up: str, name: str = "mesh") -> MeshArrays:
    """Turn a mesh upright, scale its longest extent to ``size`` [mm] and stand it on z = 0 above the origin.

    Raises
    ------
    SceneError
        For a size that is not positive, or an axis other than y and z.

    Warns
    -----
    PellucidWarning
        When no size is given and the file's numbers cannot well be millimetres.
    """
    if up not in ("y", "z"):
        raise SceneError(f"up is 'y' or 'z', the axis of the mesh that points upwards; found '{up}'.")
    if size is not None and not 0 < size < np.inf:
        raise SceneError(f"size is the longest extent of the mesh [mm] and must be positive; found {size:g}.")
    # From y-up to z-up, the front (+z) turns to the camera (-y).
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]] if up == "y" else np.eye(3), float)
    vertices = mesh.vertices @ turn.T
    low, high = vertices.min(0), vertices.max(0)
    extent = (high - low).max()
    if size is None and not PLAUSIBLE_EXTENT[0] <= extent <= PLAUSIBLE_EXTENT[1]:
        warnings.warn(
            f"{name}: without a size its longest extent, {extent:.4g}, is read as millimetres; give the size you mean",
            PellucidWarning,
            stacklevel=3,
        )
    scale = 1.0 if size is None else size / extent
    foot = np.array([*(low + high)[:2] / 2, low[2]])
    return MeshArrays(
        (vertices - foot) * scale, mesh.faces, None if mesh.normals is None else mesh.normals @ turn.T, mesh.uv
    )


def camera_position(vertices: Floats, target: Floats, resolution: tuple[int, int]) -> Floats:
    """Find how far back along the three-quarter view the camera must stand to see every vertex, with a margin: (3,)."""
    right = np.cross(-VIEW_DIRECTION, [0, 0, 1])
    right /= np.linalg.norm(right)
    above = np.cross(right, -VIEW_DIRECTION)
    offset = vertices - target
    tangent = MARGIN * np.tan(np.deg2rad(FIELD_OF_VIEW / 2)) * np.array(resolution) / min(resolution)
    sideways = np.abs(offset @ np.stack([right, above], -1)) / tangent
    return target + VIEW_DIRECTION * (sideways.max(1) + offset @ VIEW_DIRECTION).max()


def mesh_scene(
    path: str | Path,
    bsdf: Spec | None = None,
    size: float | None = None,
    up: str | None = None,
    **parameters: Any,
) -> Spec:
    """Describe a scene with a mesh on a table, lit from behind and the side, for ``mi.load_dict``.

    Parameters
    ----------
    path : str or Path
        A file in one of `MESH_FORMATS`.
    bsdf : dict, optional
        The material. Default: marble.
    size : float, optional
        Longest extent [mm]. Default: the numbers of the file are millimetres.
    up : str, optional
        The axis of the file that points upwards, ``"y"`` or ``"z"``. Default: by the format.
    parameters
        The fields of `View`.

    Raises
    ------
    SceneError
        For a file that cannot be read or rendered, see `load_mesh`, and for a parameter that does not exist.
    """
    path = Path(path)
    unknown = set(parameters) - set(View.__dataclass_fields__)
    if unknown:
        known = ", ".join(["bsdf", "size", "up", *View.__dataclass_fields__])
        raise SceneError(f"A scene with a mesh has no parameter '{min(unknown)}': it takes {known}.")
    view = View(**parameters)
    mesh = load_mesh(path)
    mesh = placed(mesh, size, up or MESH_FORMATS[path.suffix.lower()], path.name)
    target = np.array([0, 0, mesh.vertices[:, 2].max() / 2])
    scene = start(view, camera_position(mesh.vertices, target, view.resolution), target, FIELD_OF_VIEW)
    bsdf = bsdf or {"type": "pellucid_translucent", "material": "marble"}
    scene["mesh"] = mesh_from_arrays(path.stem, mesh.vertices, mesh.faces, mesh.normals, mesh.uv, bsdf)
    reach = 2 * float(np.linalg.norm(mesh.vertices - target, axis=1).max())
    return scene | studio(target, reach)
