"""Mesh files (PLY, OBJ, STL, glTF, OFF) become arrays: read, checked and repaired."""

from __future__ import annotations

import difflib
import io
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, warn
from .crease_normals import face_normals, smooth_normals
from .gltf import plain_gltf
from .looks import Look, Looks
from .obj import absolute_indices
from .repair import check, repair, weld
from .sources import Beside

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MESH_FORMATS = {".ply", ".obj", ".stl", ".gltf", ".glb", ".off"}

Y_UP = {".obj", ".gltf", ".glb"}
# In these formats texture coordinates begin at the lower edge of the picture, as trimesh delivers them, in Mitsuba at the upper.
UV_FROM_BELOW = {".obj", ".gltf", ".glb"}


class Model(NamedTuple):
    """A mesh as read from a file.

    ``normals`` and ``uv`` are None unless every part has them; ``colors``, linear RGB, unless any part has them. ``part``
    is the number of each face's look among ``looks``; by default all share one without a colour.
    """

    vertices: Array
    faces: Index
    normals: Array | None
    uv: Array | None
    colors: Array | None = None
    part: Index | None = None
    looks: tuple[Look, ...] = (Look(),)

    def parts(self) -> Iterator[tuple[Look, Model]]:
        """Give what belongs to each look as a model of its own."""
        for k, look in enumerate(self.looks):
            chosen = self.faces if self.part is None else self.faces[self.part == k]
            used, faces = np.unique(chosen, return_inverse=True)
            vertices, normals, uv, colors = (
                None if a is None else a[used] for a in (self.vertices, self.normals, self.uv, self.colors)
            )
            assert vertices is not None
            if len(faces):
                yield look, Model(vertices, faces.reshape(-1, 3), normals, uv, colors if look.by_vertex else None)


def read_mesh(path: Path) -> Model:
    """Read, check and repair a mesh; see `mesh_scene` for what is refused.

    Returns
    -------
    Model
        In the units and axes of the file, with normals: those of the file, else smooth ones.
    """
    model = _open(path)
    check(path.name, model.vertices, model.faces)
    used, faces = np.unique(model.faces, return_inverse=True)
    vertices, normals, uv, colors = (
        None if a is None else a[used] for a in (model.vertices, model.normals, model.uv, model.colors)
    )
    assert vertices is not None
    points = weld(vertices)
    faces, kept = repair(path.name, vertices, faces.reshape(-1, 3), points)
    part = None if model.part is None else model.part[kept]
    # Normals that are missing in places are of no use, as are those an exporter has filled with zeros.
    if normals is not None and np.all(np.abs(np.linalg.norm(normals, axis=1) - 1) < 0.1):
        geometric = face_normals(vertices[faces])[0]
        outwards = np.einsum("ij,ikj->", geometric, normals[faces]) > 0
        return Model(vertices, faces, normals if outwards else -normals, uv, colors, part, model.looks)
    source, faces, normals = smooth_normals(vertices, faces, points, uv)
    uv, colors = (None if a is None else a[source] for a in (uv, colors))
    return Model(vertices[source], faces, normals, uv, colors, part, model.looks)


def model_arrays(model: Model) -> tuple[Array, Index, Array | None, Array | None]:
    """Sort the arrays of a model as `mesh_from_arrays` takes them."""
    return model.vertices, model.faces, model.normals, model.uv


# ---------------------------------------------------------------------- from the file


def _open(path: Path) -> Model:
    """Read a file as it is, and tell in one line why that cannot be done."""
    suffix = path.suffix.lower()
    if suffix not in MESH_FORMATS:
        close = difflib.get_close_matches(suffix, sorted(MESH_FORMATS), n=1)
        hint = f"did you mean '{close[0]}'?" if close else "convert it to one of them."
        known = " ".join(sorted(MESH_FORMATS))
        raise SceneError(f"'{path}' has the format '{suffix}', which is not among {known}; {hint}")
    if not path.is_file():
        raise SceneError(f"There is no mesh file '{path}': check the path.")
    try:
        scene, looks, beside = _parse(path, suffix)
        model = _flatten(scene, suffix, looks)
    except SceneError:
        raise
    except Exception as error:  # whatever a broken file makes a parser stumble over
        raise SceneError(
            f"'{path}' cannot be read as {suffix[1:].upper()}: it is damaged or of another format; export it again."
        ) from error
    for name in dict.fromkeys(beside.missing):
        warn(f"'{path.name}' names '{name}', which cannot be read: what it says about colours is left out.")
    for look in model.looks:
        for what in look.ignored:
            warn(f"'{path.name}', material '{look.name}': {what} is not shown.")
    return model


def _parse(path: Path, suffix: str) -> tuple[Any, Looks, Beside]:
    """Let trimesh parse a file, after what it misreads has been rewritten."""
    if suffix in (".gltf", ".glb"):
        gltf = plain_gltf(path)
        return _load(io.BytesIO(gltf.header), "gltf", gltf.beside), Looks(gltf.materials), gltf.beside
    content, beside, looks, options = path.read_bytes(), Beside(path), Looks(), {}
    if suffix == ".obj":
        content = absolute_indices(content.decode("utf-8", "replace")).encode()
    elif suffix == ".ply":
        header = _ply_header(path, content)
        looks = Looks(is_linear=b"float red" in header)
        # trimesh loses the normals when it splits vertices at seams, which only coordinates given by face ask for.
        options["fix_texture"] = b"texcoord" in header
    return _load(io.BytesIO(content), suffix[1:], beside, **options), looks, beside


def _load(file: Any, kind: str, beside: Beside, **options: Any) -> Any:
    """Let trimesh parse a file, without a word."""
    import trimesh

    log, silent = logging.getLogger("trimesh"), logging.NullHandler()
    log.addHandler(silent)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            scene = trimesh.load(file, file_type=kind, resolver=beside, process=False, force="scene", **options)
            for mesh in scene.geometry.values():
                if getattr(mesh.visual, "kind", None) == "face":
                    mesh.unmerge_vertices()  # so that each vertex has the colour of its one face
            return scene
    finally:
        log.removeHandler(silent)


def _ply_header(path: Path, content: bytes) -> bytes:
    """Read the header of a PLY file.

    Raises
    ------
    SceneError
        When its faces are triangle strips.
    """
    header = content[: 1 << 16].split(b"end_header")[0]
    if b"element tristrips" in header:
        raise SceneError(
            f"'{path}' has its faces as triangle strips (tristrips), which are not read: convert them to triangles, for "
            "example by opening and exporting it in MeshLab."
        )
    return header


def _flatten(scene: Any, suffix: str, looks: Looks) -> Model:
    """Join all triangle meshes of a scene graph, each where its node puts it."""
    parts: list[Model] = []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if hasattr(mesh, "faces") and len(mesh.faces):
            parts.append(_part(mesh, np.asarray(matrix, float), suffix, looks))
    if not parts:
        return Model(np.empty((0, 3)), np.empty((0, 3), np.int64), None, None)
    first = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    normals = [part.normals for part in parts if part.normals is not None]
    seen = list({id(part.looks[0]): part.looks[0] for part in parts}.values())
    # Materials of which the file says nothing are all the same.
    number = {id(look): next((k for k, other in enumerate(seen) if _alike(look, other))) for look in seen}
    return Model(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, first, strict=True)]),
        np.concatenate(normals) if len(normals) == len(parts) else None,
        _joined([part.uv for part in parts], parts, 0.0),
        _joined([part.colors for part in parts], parts, 1.0),
        np.concatenate([np.full(len(part.faces), number[id(part.looks[0])]) for part in parts]),
        tuple(seen),
    )


def _alike(one: Look, other: Look) -> bool:
    """Tell whether two looks are one."""
    return one is other or not (one.is_coloured or other.is_coloured or one.inside or other.inside)


def _joined(arrays: list[Array | None], parts: list[Model], missing: float) -> Array | None:
    """Join what some of the parts have, with a value where they do not; None where none has it."""
    width = next((a.shape[1] for a in arrays if a is not None), None)
    if width is None:
        return None
    pairs = zip(arrays, parts, strict=True)
    return np.concatenate([np.full((len(part.vertices), width), missing) if a is None else a for a, part in pairs])


def _part(mesh: Any, matrix: Array, suffix: str, looks: Looks) -> Model:
    """Transform one mesh of a scene graph, and take the normals, texture coordinates and colours that its file has."""
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
    if uv is not None and (moved := looks.uv_transform(mesh)) is not None:
        uv = uv @ moved[:, :2].T + moved[:, 2]
    look, colors = looks.of(mesh)
    with np.errstate(invalid="ignore"):  # what is not finite is refused by its faces
        vertices = np.asarray(mesh.vertices, float) @ linear.T + matrix[:3, 3]
    return Model(vertices, faces[:, ::-1] if mirrored else faces, normals, uv, colors, looks=(look,))
