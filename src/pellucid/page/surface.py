"""The surface of a body for the page: its triangles, laid out in the unit square, and what light is there besides lamps."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ..errors import SceneError
from ..kernels.memory import columns
from ..kernels.sequences import GOLDEN
from ..methods.reflectance import filtered_texture
from ..model.fresnel import transmitted
from ..scene.atlas.layout import Atlas, build_atlas
from ..scene.atlas.texels import rasterise
from ..scene.bodies import Body
from ..scene.meshes.buffers import mesh_from_arrays
from ..scene.samples.draw import MeshPiece
from ..scene.samples.surface import outside_of

Array = NDArray[np.float64]

RESOLUTION = 512
"""Texels along each side of the atlas."""

DIRECTIONS = 512
"""From all around, in which a vertex may see the sky."""

COEFFICIENTS = 9
"""Spherical harmonics up to the second band."""

STEPS = 31
"""Of the openness, on either side of 0."""

RAYS_AT_ONCE = 1 << 22
MOST_CHECKED, MOST_CROSSED = 4096, 64
"""Triangles from which it is checked that they face outside, and others that are counted before each."""

INSIDE_OUT = 0.01
"""Of the area that may face inside: folds of scanned meshes."""

JPEG_QUALITY = 92


@dataclass
class PageSurface:
    """A body as t triangles.

    Attributes
    ----------
    corners, normals : (t, 3, 3) float64
        Counter-clockwise seen from outside [scene units], and unit normals that point there.
    uv : (t, 3, 2) float64
        Corners in the unit square.
    """

    corners: Array
    normals: Array
    uv: Array


def page_surface(body: Body) -> tuple[PageSurface, Atlas]:
    """Read the triangles of a body, and lay them out; those that are mirrored, or wound inwards, are turned.

    Raises
    ------
    SceneError
        When a shape of the body is no mesh, or its triangles do not tell what is inside.
    """
    atlas = build_atlas(body, RESOLUTION)
    corners, normals = np.empty((len(atlas.prim), 3, 3)), np.empty((len(atlas.prim), 3, 3))
    for k, piece in enumerate(atlas.surface.pieces):
        if not isinstance(piece, MeshPiece):
            kind = piece.shape.class_name()
            raise SceneError(
                f"The page shows meshes alone, and a shape of the body '{body.name}' is a {kind}: export it as a mesh."
            )
        rows = np.flatnonzero(atlas.piece == k)
        corners[rows], normals[rows] = _corners(piece, atlas.prim[rows])
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(facing, axis=1)
    facets = facing / np.maximum(doubled, 1e-300)[:, None]
    # Mirrors change which way a mesh is wound; normals are right.
    against = np.sum(normals * facets[:, None], axis=(1, 2)) < 0
    outside = outside_of(corners.mean(axis=1), np.where(against, -1, 1)[:, None] * facets, doubled / 2)
    wound = np.where((against ^ (outside == -1))[:, None], [2, 1, 0], [0, 1, 2])[..., None]
    surface = PageSurface(*(np.take_along_axis(each, wound, axis=1) for each in (corners, outside * normals, atlas.uv)))
    _check_inside(surface, body.name)
    return surface, atlas


def _check_inside(surface: PageSurface, name: str) -> None:
    """Check that no place outside is left more often than it is entered, counted along rays from in front of triangles."""
    scene = _scene_of(surface)
    a, b, c = surface.corners[:: max(1, len(surface.corners) // MOST_CHECKED)].transpose(1, 0, 2)
    facing = np.cross(b - a, c - a)
    area = np.linalg.norm(facing, axis=1)
    n = facing / np.maximum(area, 1e-300)[:, None]
    start = (a + b + c) / 3 + n * (1e-5 * float(np.ptp(surface.corners, axis=(0, 1)).max()))
    origin, direction = (columns(values.astype(np.float32)) for values in (start, n))
    ray = mi.Ray3f(mi.Point3f(*origin), mi.Vector3f(*direction))
    left, active = dr.zeros(mi.Float, len(n)), mi.Bool(area > 0)
    for _ in range(MOST_CROSSED):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        left += dr.select(active, dr.sign(dr.dot(ray.d, si.n)), 0)
        ray = si.spawn_ray(ray.d)
        if not dr.any(active):
            break
    wrong = left.numpy() < 0
    if np.sum(area[wrong]) > INSIDE_OUT * np.sum(area):
        raise SceneError(
            f"The triangles of '{name}' face both ways, so that its inside is not known: turn them, as trimesh.repair.fix_normals does, "
            "or look at it with 'pellucid view'."
        )


def _scene_of(surface: PageSurface) -> mi.Scene:
    """Put a surface alone into a scene."""
    count = len(surface.corners)
    mesh = mesh_from_arrays("body", surface.corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    return mi.load_dict({"type": "scene", "body": mesh}, optimize=False)


def _corners(piece: MeshPiece, prim: NDArray[np.int64]) -> tuple[Array, Array]:
    """Read the corners of triangles of a mesh, and the normals there, (t, 3, 3) both, in the space of the scene."""
    mesh, count = piece.mesh, len(prim)
    index = mi.UInt32(prim.astype(np.uint32))
    faces = mesh.face_indices(index)
    matrix = np.eye(4) if piece.to_world is None else piece.to_world
    corners = np.stack([mesh.vertex_position(faces[k]).numpy().T for k in range(3)], axis=1).astype(float)
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.maximum(np.linalg.norm(facets, axis=1, keepdims=True), 1e-300)
    if not mesh.has_vertex_normals() or mesh.has_face_normals():
        return corners, np.broadcast_to(facets[:, None], (count, 3, 3)).copy()
    normals = np.stack([mesh.vertex_normal(faces[k]).numpy().T for k in range(3)], axis=1) @ np.linalg.inv(
        matrix[:3, :3]
    )
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    side = np.sign(np.linalg.det(matrix[:3, :3])) * (-1 if mesh.has_flipped_normals() else 1)
    good = (length > 1e-12) & np.isfinite(length)
    return corners, np.where(good, side * normals / np.where(good, length, 1), facets[:, None])


def colour_picture(body: Body, atlas: Atlas) -> str | None:
    """Bake the reflectance of a textured body into a picture of its atlas: a JPEG in base64, sRGB; None without texture."""
    from PIL import Image

    if body.bsdf.texture is None:
        return None
    texels = rasterise(atlas)
    colour = np.clip(filtered_texture(body.bsdf.texture, body, texels.samples), 0, 1)
    picture = np.zeros((RESOLUTION**2, 3))
    picture[texels.texel] = np.where(
        colour <= 0.0031308, 12.92 * colour, 1.055 * np.maximum(colour, 1e-9) ** (1 / 2.4) - 0.055
    )
    covered = np.zeros(RESOLUTION**2, bool)
    covered[texels.texel] = True
    square = covered.reshape(RESOLUTION, RESOLUTION)
    rows, columns_ = distance_transform_edt(~square, return_distances=False, return_indices=True)
    filled = picture.reshape(RESOLUTION, RESOLUTION, 3)[rows, columns_]  # so that no border bleeds into a chart
    file = io.BytesIO()
    Image.fromarray((255 * filled + 0.5).astype(np.uint8)).save(file, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return base64.b64encode(file.getvalue()).decode()


def harmonics(d: Array) -> Array:
    """Evaluate the first nine real spherical harmonics in unit directions ``(k, 3)``: ``(k, 9)``."""
    x, y, z = d.T
    columns_ = (
        np.full_like(x, 0.282095),
        0.488603 * y,
        0.488603 * z,
        0.488603 * x,
        1.092548 * x * y,
        1.092548 * y * z,
        0.315392 * (3 * z * z - 1),
        1.092548 * x * z,
        0.546274 * (x * x - y * y),
    )
    return np.stack(columns_, axis=1)


def sphere_directions(count: int) -> Array:
    """Spread unit vectors evenly over all directions: ``(count, 3)``."""
    k = np.arange(count)
    z, turn = 1 - (2 * k + 1) / count, 2 * np.pi * GOLDEN * k
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def openness(surface: PageSurface, corner: NDArray[np.int64], eta: float) -> tuple[NDArray[np.int8], float]:
    """Measure how much of each spherical harmonic of a sky enters the body at its vertices, past its own shadow.

    Parameters
    ----------
    corner : (v,) int64
        A corner of each vertex, counted through all triangles.
    eta : float
        Relative index of refraction.

    Returns
    -------
    values : (9, v) int8
    scale : float
        The integral of a harmonic times visibility, cosine and Fresnel transmittance is a value times this.
    """
    scene = _scene_of(surface)
    p, n = (values.reshape(-1, 3)[corner] for values in (surface.corners, surface.normals))
    p = p + n * (2e-3 * float(np.ptp(surface.corners, axis=(0, 1)).max()))
    directions = sphere_directions(DIRECTIONS)
    weights = harmonics(directions) * (4 * np.pi / DIRECTIONS)
    result = np.zeros((len(p), COEFFICIENTS))
    step = max(1, RAYS_AT_ONCE // DIRECTIONS)
    for first in range(0, len(p), step):
        some = slice(first, first + step)
        result[some] = _entering(scene, p[some], n[some], directions, eta) @ weights
    scale = float(np.abs(result).max()) / STEPS or 1.0
    return np.rint(result / scale).T.astype(np.int8), scale


def _entering(scene: mi.Scene, p: Array, n: Array, directions: Array, eta: float) -> NDArray[np.float32]:
    """Evaluate cosine times transmittance where directions (d, 3) are free, for points (k, 3): ``(k, d)``."""
    lane = dr.arange(mi.UInt32, len(p) * len(directions))
    point, direction = lane // len(directions), lane % len(directions)
    d = dr.gather(mi.Vector3f, mi.Vector3f(*columns(directions.astype(np.float32))), direction)
    normal = dr.gather(mi.Normal3f, mi.Normal3f(*columns(n.astype(np.float32))), point)
    origin = dr.gather(mi.Point3f, mi.Point3f(*columns(p.astype(np.float32))), point)
    cosine = dr.dot(d, normal)
    hidden = scene.ray_test(mi.Ray3f(origin, d), cosine > 0)
    value = dr.select((cosine > 0) & ~hidden, cosine * transmitted(cosine, dr.opaque(mi.Float, eta)), 0)
    return value.numpy().reshape(len(p), len(directions))
