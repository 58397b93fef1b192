"""A bare mesh becomes a scene: on a table, lit from behind and the side."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..scene.meshes.buffers import mesh_from_arrays
from ..scene.meshes.files import Y_UP, Array, Model, model_arrays, read_mesh
from .mesh_material import coloured, picture_needs_uv
from .stage import PictureSettings, Spec, environment_light, start, studio

# Millimetres to one unit of a file, where its format says so; of the others the units are taken for millimetres.
UNITS = {".gltf": 1000.0, ".glb": 1000.0}

# The camera looks from the front, the left and somewhat above.
CAMERA_DIRECTION = (-0.42, -0.84, 0.36)


FOV = 22.0


FILLED = 0.88


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
        PLY, OBJ, STL, glTF, GLB or OFF. All parts of one material become one body.
    bsdf : dict, optional
        The material. Where it names no colour, that of the file is the reflectance, with the mean free path of the
        material, or 1 mm. By default the medium that a glTF file describes (its lengths are scaled with the mesh), or marble for
        a file without colours.
    size : float, optional
        Longest extent of the mesh [mm]; by default glTF files are in metres, as their format says, others in millimetres.
    up : 'y' or 'z', optional
        The axis that points up; by default y in glTF and OBJ files, z in others.
    resolution, spp, camera_angle, integrator
        As in `PictureSettings`.
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
    if size is not None and not 1e-9 <= size <= 1e12:  # beyond, areas in single precision are 0 or infinite
        raise SceneError(f"size is the longest extent of the mesh [mm], from 1e-9 to 1e12; found {size:g}.")
    model = read_mesh(path)
    picture_needs_uv(path.name, bsdf or {}, model.uv is not None)
    z_up = up == "z" or (up is None and path.suffix.lower() not in Y_UP)
    unit = size / float(np.ptp(model.vertices, axis=0).max()) if size else UNITS.get(path.suffix.lower(), 1.0)
    model = _place(model, unit, z_up)
    settings = PictureSettings(resolution, spp, camera_angle, *([integrator] if integrator else []))
    scene = _stage(settings, model.vertices, environment)
    for k, (look, part) in enumerate(model.parts()):
        material = coloured(path.name, look, bsdf or {"type": "pellucid_translucent"}, unit)
        key = f"body_{k}" if k else "body"
        scene[key] = mesh_from_arrays(path.stem, *model_arrays(part), bsdf=material, colors=part.colors)
    return scene


def _place(model: Model, unit: float, z_up: bool) -> Model:
    """Turn z upwards, scale from a ``unit`` to millimetres, and stand the mesh on the middle of the table."""
    vertices, normals = model.vertices, model.normals
    if not z_up:
        turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float)
        vertices, normals = vertices @ turn.T, None if normals is None else normals @ turn.T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    foot = np.array([*(low + high)[:2] / 2, low[2]])
    return model._replace(vertices=(vertices - foot) * unit, normals=normals)


def _stage(settings: PictureSettings, vertices: Array, environment: str | Path | None) -> Spec:
    """Set lamps, or an environment, and a camera for a body that stands on z = 0."""
    target, origin = frame(vertices)
    scene = start(settings, origin, target, FOV)
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
