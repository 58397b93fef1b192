"""Bare meshes (PLY, OBJ, STL, glTF, OFF) become scenes: the mesh on a table, lit from behind and the side."""

from __future__ import annotations

import difflib
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import PellucidWarning, SceneError
from .builtin.stage import Spec, View, environment_light, start, studio
from .crease_normals import face_normals, smooth_normals
from .mesh_arrays import mesh_from_arrays
from .mesh_repair import check, repair, weld

Array = NDArray[np.float64]

MESH_FORMATS = {".ply", ".obj", ".stl", ".gltf", ".glb", ".off"}

Y_UP = {".obj", ".gltf", ".glb"}
# In these formats texture coordinates begin at the lower edge of the picture, as trimesh delivers them, in Mitsuba at the upper.
UV_FROM_BELOW = {".obj", ".gltf", ".glb"}

# A mesh whose units were taken for millimetres and that is smaller than this [mm] was most likely made in metres.
SUSPICIOUS_EXTENT = 5.0

# The camera looks from the front, the left and somewhat above.
CAMERA_DIRECTION = (-0.42, -0.84, 0.36)
FOV = 22.0
FILLED = 0.88


class Model(NamedTuple):
    """A mesh as read from a file: ``normals`` and ``uv`` are None unless every part has them."""

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array | None
    uv: Array | None


def mesh_scene(
    path: str | Path,
    bsdf: Spec | None = None,
    size: float | None = None,
    up: str | None = None,
    resolution: tuple[int, int] = (1024, 768),
    spp: int = 4,
    camera_angle: float = 0.0,
    integrator: Spec | None = None,
    environment: str | Path | None = None,
) -> Spec:
    """Put a mesh file on a table under a key lamp and a soft fill, with a camera that frames it.

    Parameters
    ----------
    path : str or Path
        PLY, OBJ, STL, glTF, GLB or OFF. The parts of a scene graph become one body.
    bsdf : dict, optional
        The material; by default marble.
    size : float, optional
        Longest extent of the mesh [mm]; by default the units of the file are taken for millimetres.
    up : 'y' or 'z', optional
        The axis that points up; by default y in glTF and OBJ files, z in others.
    resolution, spp, camera_angle, integrator
        As in `View`.
    environment : str or Path, optional
        A latitude-longitude picture (``.exr``, ``.hdr``) that lights the scene in place of the lamps.

    Returns
    -------
    dict
        For ``mi.load_dict`` (with ``optimize=False``).

    Raises
    ------
    SceneError
        For a file that is missing, of an unknown format or unreadable, and for a mesh without a surface.
    """
    path = Path(path)
    if up not in (None, "y", "z"):
        raise SceneError(f"up is the axis that points up, 'y' or 'z'; found '{up}'.")
    if size is not None and not 0 < size < np.inf:
        raise SceneError(f"size is the longest extent of the mesh [mm], above 0; found {size:g}.")
    model = read_mesh(path)
    z_up = up == "z" or (up is None and path.suffix.lower() not in Y_UP)
    model = _place(path.name, model, size, z_up)
    view = View(resolution, spp, camera_angle, *([integrator] if integrator else []))
    body = mesh_from_arrays(path.stem, *model_arrays(model), bsdf=bsdf or {"type": "pellucid_translucent"})
    return _stage(view, model.vertices, body, environment)


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


def _place(name: str, model: Model, size: float | None, z_up: bool) -> Model:
    """Turn z upwards, scale to ``size`` and stand the mesh on the middle of the table."""
    vertices, normals = model.vertices, model.normals
    if not z_up:
        turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
        vertices, normals = vertices @ turn.T, None if normals is None else normals @ turn.T
    extent = float(np.ptp(vertices, axis=0).max())
    if size is None and extent < SUSPICIOUS_EXTENT:
        warnings.warn(
            f"'{name}' is {extent:.3g} mm across, its units taken for millimetres: give size, its longest extent [mm], "
            "if that is too small.",
            PellucidWarning,
            stacklevel=4,
        )
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    foot = np.array([*(low + high)[:2] / 2, low[2]])
    return model._replace(vertices=(vertices - foot) * ((size or extent) / extent), normals=normals)


def _stage(view: View, vertices: Array, body: Any, environment: str | Path | None) -> Spec:
    """Put a body that stands on z = 0 under lamps, or into an environment, before a camera."""
    target, origin = frame(vertices)
    scene = start(view, origin, target, FOV)
    scene["body"] = body
    if environment is not None:
        scene["sky"] = environment_light(environment)
        return scene
    return scene | studio(target, 2 * float(np.linalg.norm(vertices - target, axis=1).max()))


def frame(vertices: Array) -> tuple[Array, Array]:
    """Find where the camera looks to and where it stands, so that the mesh fills the picture from every ``camera_angle``.

    Parameters
    ----------
    vertices : (n, 3) float
        Around the vertical axis through the origin.

    Returns
    -------
    target, origin : (3,) float
        For a square of `FOV` degrees within the picture.
    """
    # The solid that the mesh sweeps out when it turns: a stack of rings.
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    level = np.linspace(low, high, 33)
    ring = np.clip(((vertices[:, 2] - low) / max(high - low, 1e-300) * 32).round(), 0, 32).astype(int)
    radius = np.zeros(33)
    np.maximum.at(radius, ring, np.hypot(vertices[:, 0], vertices[:, 1]))
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)[:, None]
    swept = np.stack(
        np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(level, (48, 33))), -1
    ).reshape(-1, 3)

    ahead = np.array(CAMERA_DIRECTION) / np.linalg.norm(CAMERA_DIRECTION)
    right = np.cross((0, 0, 1), ahead)
    right /= np.linalg.norm(right)
    upward = np.cross(ahead, right)
    slope = FILLED * np.tan(np.deg2rad(FOV / 2))
    target, distance = np.array([0, 0, (low + high) / 2]), 0.0
    for _ in range(8):  # where the middle of the picture is depends on the distance and this on the middle
        q = swept - target
        across, along, nearer = np.abs(q @ right), q @ upward, q @ ahead
        distance = float(np.max(np.maximum(across, np.abs(along)) / slope + nearer))
        seen = along / (distance - nearer)
        target = target + np.array((0, 0, 0.5 * (seen.max() + seen.min()) * distance / upward[2]))
    return target, target + distance * ahead
