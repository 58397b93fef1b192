"""Mesh files (PLY, OBJ, STL, glTF, OFF) become arrays: read, checked and repaired."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from .crease_normals import face_normals, smooth_normals
from .repair import check, repair, weld

Array = NDArray[np.float64]

MESH_FORMATS = {".ply", ".obj", ".stl", ".gltf", ".glb", ".off"}

Y_UP = {".obj", ".gltf", ".glb"}
# In these formats texture coordinates begin at the lower edge of the picture, as trimesh delivers them, in Mitsuba at the upper.
UV_FROM_BELOW = {".obj", ".gltf", ".glb"}


class Model(NamedTuple):
    """A mesh as read from a file: ``normals`` and ``uv`` are None unless every part has them."""

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array | None
    uv: Array | None


def read_mesh(path: Path) -> Model:
    """Read, check and repair a mesh; see `mesh_scene` for what is refused.

    Returns
    -------
    Model
        In the units and axes of the file, with normals: those of the file, else smooth ones.
    """
    model = _flatten(_open(path), path.suffix.lower())
    check(path.name, model.vertices, model.faces)
    used, faces = np.unique(model.faces, return_inverse=True)
    vertices, normals, uv = (None if a is None else a[used] for a in (model.vertices, model.normals, model.uv))
    assert vertices is not None
    points = weld(vertices)
    faces = repair(path.name, vertices, faces.reshape(-1, 3), points)
    # Normals that are missing in places are of no use, as are those an exporter has filled with zeros.
    if normals is not None and np.all(np.abs(np.linalg.norm(normals, axis=1) - 1) < 0.1):
        geometric = face_normals(vertices[faces])[0]
        outwards = np.einsum("ij,ikj->", geometric, normals[faces]) > 0
        return Model(vertices, faces, normals if outwards else -normals, uv)
    source, faces, normals = smooth_normals(vertices, faces, points, uv)
    return Model(vertices[source], faces, normals, None if uv is None else uv[source])


def model_arrays(model: Model) -> tuple[Array, NDArray[np.int64], Array | None, Array | None]:
    """Sort the arrays of a model as `mesh_from_arrays` takes them."""
    return model.vertices, model.faces, model.normals, model.uv


def _open(path: Path) -> Any:
    """Let trimesh read a file, and tell in one line why it cannot."""
    import trimesh

    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        close = difflib.get_close_matches(suffix, sorted(MESH_FORMATS), n=1)
        hint = f"did you mean '{close[0]}'?" if close else "convert it to one of them."
        known = " ".join(sorted(MESH_FORMATS))
        raise SceneError(f"'{path}' has the format '{suffix}', which is not among {known}; {hint}")
    if not path.is_file():
        raise SceneError(f"There is no mesh file '{path}': check the path.")
    options = {}
    if suffix == ".ply":
        # trimesh loses the normals when it splits vertices at seams, which only coordinates given by face ask for.
        with path.open("rb") as file:
            options["fix_texture"] = b"texcoord" in file.read(4096).split(b"end_header")[0]
    try:
        return trimesh.load(str(path), process=False, force="scene", **options)
    except Exception as error:  # whatever a broken file makes a parser stumble over
        cause = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"'{path}' cannot be read as {suffix[1:].upper()}: {cause[:200]}") from error


def _flatten(scene: Any, suffix: str) -> Model:
    """Join all triangle meshes of a scene graph, each where its node puts it."""
    parts: list[Model] = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if hasattr(mesh, "faces") and len(mesh.faces):
            parts.append(_part(mesh, np.asarray(matrix, float), suffix))
    if not parts:
        return Model(np.empty((0, 3)), np.empty((0, 3), np.int64), None, None)
    first = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    normals = [part.normals for part in parts if part.normals is not None]
    uv = [part.uv for part in parts if part.uv is not None]
    return Model(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, first, strict=True)]),
        np.concatenate(normals) if len(normals) == len(parts) else None,
        np.concatenate(uv) if len(uv) == len(parts) else None,
    )


def _part(mesh: Any, matrix: Array, suffix: str) -> Model:
    """Transform one mesh of a scene graph, and take the normals and texture coordinates that its file has."""
    linear = matrix[:3, :3]
    faces = np.asarray(mesh.faces, np.int64)
    mirrored = np.linalg.det(linear) < 0
    normals = None
    # trimesh computes normals on demand; those that are there already came from the file.
    if "vertex_normals" in mesh._cache:
        normals = np.asarray(mesh.vertex_normals, float) @ np.linalg.pinv(linear)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1)
    uv = getattr(mesh.visual, "uv", None)
    uv = None if uv is None or np.shape(uv) != (len(mesh.vertices), 2) else np.array(uv, float)
    if uv is not None and suffix in UV_FROM_BELOW:
        uv[:, 1] = 1 - uv[:, 1]
    vertices = np.asarray(mesh.vertices, float) @ linear.T + matrix[:3, 3]
    return Model(vertices, faces[:, ::-1] if mirrored else faces, normals, uv)
