"""Seven closed meshes, each alone in the dark under one lamp: stand-ins for the models of table 2 of CLHHC08."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.decimate import decimate
from ..shapes.distance import Floats
from ..shapes.level_set import Distance, Ints, surface_mesh
from ..stage import PictureSettings, Spec, Vector, material, rgb, start
from .figures import longneck, wanderer
from .heads import antique_head, horned_head, philosopher, relief_head

FOV = 20.0
FILLED = 0.86

LAMP_HEIGHT = 32.0
"""Of the lamp over the horizon, seen from the model [degrees]."""

LAMP_DISTANCE, IRRADIANCE = 4.0, 3.2
"""From the lamp to the middle of the model, in radii of the model, and what it sends there."""


class Shape(NamedTuple):
    """A signed distance, the box around its surface, the cells it is meshed with [mm], and the triangles that are kept."""

    distance: Distance
    low: Vector
    high: Vector
    edge: float
    triangles: int


SHAPES = {
    "horned_head": Shape(horned_head, (-130, -150, -120), (130, 145, 190), 2.9, 2072),
    "relief_head": Shape(relief_head, (-95, -130, -190), (95, 125, 140), 3.6, 8924),
    "philosopher": Shape(philosopher, (-160, -135, -290), (160, 140, 135), 4.6, 9950),
    "longneck": Shape(longneck, (-310, -80, -105), (250, 80, 265), 3.9, 7684),
    "antique_head": Shape(antique_head, (-105, -130, -185), (105, 155, 140), 3.55, 10000),
    "wanderer": Shape(wanderer, (-125, -130, -130), (125, 120, 220), 3.8, 10000),
}


def shape_mesh(shape: Shape) -> tuple[Floats, Floats, Ints]:
    """Mesh a distance: the largest piece of its surface, finely, and then with as few triangles as are wanted.

    Returns
    -------
    vertices, normals : (n, 3) float
    faces : (m, 3) int
        Closed, counter-clockwise seen from outside.
    """
    low, high = (np.asarray(corner, float) for corner in (shape.low, shape.high))
    vertices, normals, faces = surface_mesh(shape.distance, low, high, shape.edge)
    source, faces = decimate(vertices, _largest_piece(faces), shape.triangles)
    vertices, normals = vertices[source], normals[source]
    # In grooves narrower than a triangle the normal of the distance may look away from the faces.
    of_faces = _mean_normals(vertices, faces)
    aligned = (normals * of_faces).sum(1, keepdims=True) > 0.6
    return vertices, np.where(aligned, normals, of_faces), faces


def _largest_piece(faces: Ints) -> Ints:
    """Keep the connected piece with the most triangles."""
    n = int(faces.max()) + 1
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    _, piece = connected_components(csr_matrix((np.ones(len(edges)), tuple(edges.T)), (n, n)), directed=False)
    of_face = piece[faces[:, 0]]
    return faces[of_face == np.bincount(of_face).argmax()]


def _mean_normals(vertices: Floats, faces: Ints) -> Floats:
    """Unit normals at the vertices (n, 3): the mean over the triangles there, by area."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a).repeat(3, 0)
    total = np.stack([np.bincount(faces.ravel(), normal[:, k], len(vertices)) for k in range(3)], 1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def sphere_mesh(stacks: int = 85) -> tuple[Floats, Floats, Ints]:
    """Mesh a sphere of radius 1 with twice as many slices as stacks, ``4 stacks (stacks - 1)`` triangles: 28560."""
    slices = 2 * stacks
    polar = np.pi * np.arange(1, stacks)[:, None] / stacks
    azimuth = 2 * np.pi * np.arange(slices) / slices
    ring = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)), -1
    )
    points = np.concatenate([[[0, 0, 1]], ring.reshape(-1, 3), [[0, 0, -1]]])
    k = np.arange(slices)
    following = (k + 1) % slices
    top, bottom = np.zeros_like(k), np.full_like(k, len(points) - 1)
    row = 1 + slices * np.arange(stacks - 2)[:, None]
    a, b = row + k, row + following
    faces = [
        np.stack([top, 1 + k, 1 + following], -1),
        np.stack([a, a + slices, b + slices], -1).reshape(-1, 3),
        np.stack([a, b + slices, b], -1).reshape(-1, 3),
        np.stack([bottom, bottom - slices + following, bottom - slices + k], -1),
    ]
    return points, points, np.concatenate(faces)


def model(
    name: str, settings: PictureSettings, bsdf: Spec | None = None, size: float = 10.0, light_angle: float = 60.0
) -> Spec:
    """A closed mesh in the dark, under one small lamp: the setting of all figures of CLHHC08.

    Parameters
    ----------
    name : str
        A key of `SHAPES`, or 'sphere'.
    size : float
        Longest extent [mm].
    light_angle : float
        Where the lamp stands, around the vertical, counted from the camera counter-clockwise as seen from above [degrees]: 0
        is above the camera, 90 to the right, 180 behind the model.
    """
    vertices, normals, faces = sphere_mesh() if name == "sphere" else shape_mesh(SHAPES[name])
    low, high = vertices.min(0), vertices.max(0)
    placed = (vertices - (low + high) / 2) * (size / np.ptp(vertices, axis=0).max())
    origin, radius = _camera(placed, CAMERA[name])
    scene = start(settings, origin, (0, 0, 0), FOV)
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "marble", "alpha": 0.3})
    scene[name] = mesh_from_arrays(name, placed, faces, normals, bsdf=bsdf)
    around = np.arctan2(origin[1], origin[0]) + np.deg2rad(light_angle)
    up, reach = np.deg2rad(LAMP_HEIGHT), LAMP_DISTANCE * radius
    place = reach * np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    scene["key"] = {"type": "point", "position": place.tolist(), "intensity": rgb(IRRADIANCE * reach**2)}
    return scene


CAMERA = dict.fromkeys(SHAPES, (35.0, 8.0)) | {"sphere": (0.0, 0.0), "longneck": (12.0, 8.0)}
"""Where the camera stands: around the vertical, from -y towards +x, and over the horizon [degrees]."""


def _camera(points: Floats, direction: tuple[float, float]) -> tuple[Floats, float]:
    """Find where a camera that looks at the origin sees all of the points, and their largest distance from there."""
    around, up = np.deg2rad(direction)
    ahead = np.array([np.sin(around) * np.cos(up), -np.cos(around) * np.cos(up), np.sin(up)])
    right = np.array([np.cos(around), np.sin(around), 0.0])
    nearer = points @ ahead
    aside = np.maximum(np.abs(points @ right), np.abs(points @ np.cross(ahead, right)))
    distance = (nearer + aside / (FILLED * np.tan(np.deg2rad(FOV / 2)))).max()
    return distance * ahead, float(np.linalg.norm(points, axis=1).max())


MODELS = {name: partial(model, name) for name in ("sphere", *SHAPES)}
"""Builders by name."""
