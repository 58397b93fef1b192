"""Mesh buffers become arrays, and arrays become meshes: the only place that reads or writes the buffers of Mitsuba's meshes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ...errors import SceneError

_recorded: ContextVar[list[tuple[Any, dict]] | None] = ContextVar("pellucid_recorded_materials", default=None)


@contextmanager
def recorded_materials() -> Iterator[list[tuple[Any, dict]]]:
    """Collect the meshes made inside and the descriptions of their materials, which Mitsuba does not give back."""
    record: list[tuple[Any, dict]] = []
    token = _recorded.set(record)
    try:
        yield record
    finally:
        _recorded.reset(token)


def mesh_from_arrays(
    name: str,
    vertices: ArrayLike,
    faces: ArrayLike,
    normals: ArrayLike | None = None,
    uv: ArrayLike | None = None,
    bsdf: mi.BSDF | dict | None = None,
    colors: ArrayLike | None = None,
) -> mi.Mesh:
    """Make a Mitsuba mesh that lives in memory only.

    Parameters
    ----------
    name : str
        Shown by Mitsuba in its messages; the identifier in a scene is the key of the scene dictionary.
    vertices : (n, 3) float
        Positions [scene units].
    faces : (m, 3) int
        Vertex indices, counter-clockwise seen from outside.
    normals : (n, 3) float, optional
        Unit normals for smooth shading. Without them the faces are shaded flat.
    uv : (n, 2) float, optional
        Texture coordinates.
    bsdf : mi.BSDF or dict, optional
        The material, an object or what ``mi.load_dict`` turns into one. Mitsuba's default is a grey diffuse one.
    colors : (n, 3) float, optional
        Linear RGB, for a texture of the type ``mesh_attribute`` with the name ``vertex_color``.

    Returns
    -------
    mi.Mesh
        To be put into a dictionary for ``mi.load_dict``; it belongs to the variant active now.
    """
    positions, triangles = np.asarray(vertices), np.asarray(faces)
    properties = mi.Properties()
    if bsdf is not None:
        properties["mesh_bsdf"] = mi.load_dict(bsdf, parallel=False, optimize=False) if isinstance(bsdf, dict) else bsdf
    mesh = mi.Mesh(
        name,
        len(positions),
        len(triangles),
        props=properties,
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
    )
    if colors is not None:
        mesh.add_attribute("vertex_color", 3, np.ascontiguousarray(colors, np.float32).ravel())
    buffers = mi.traverse(mesh)
    float_type, index_type = type(buffers["vertex_positions"]), type(buffers["faces"])
    buffers["vertex_positions"] = float_type(np.ascontiguousarray(positions, np.float32).ravel())
    buffers["faces"] = index_type(np.ascontiguousarray(triangles, np.uint32).ravel())
    if normals is not None:
        buffers["vertex_normals"] = float_type(np.ascontiguousarray(normals, np.float32).ravel())
    if uv is not None:
        buffers["vertex_texcoords"] = float_type(np.ascontiguousarray(uv, np.float32).ravel())
    buffers.update()
    record = _recorded.get()
    if record is not None and isinstance(bsdf, dict):
        record.append((mesh, bsdf))
    return mesh


def mesh_buffers(mesh: mi.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Copy the vertices, (v, 3) float64, and the faces, (t, 3) uint32, of a mesh."""
    vertices = np.array(mesh.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
    faces = np.array(mesh.faces_buffer(), dtype=np.uint32).reshape(-1, 3)
    return vertices, faces


def triangle_corners(mesh: mi.Mesh, to_world: np.ndarray | None = None) -> np.ndarray:
    """Return the three corners of every triangle after the transform.

    Returns
    -------
    (t, 3, 3) float64
        Triangle, corner, coordinate.

    Raises
    ------
    SceneError
        When the mesh has no faces, or a face uses a vertex that is not finite.
    """
    vertices, faces = mesh_buffers(mesh)
    if len(faces) == 0:
        raise SceneError(f"mesh '{mesh.id()}' has no faces: give a mesh with at least one triangle.")
    if to_world is not None:
        vertices = vertices @ to_world[:3, :3].T + to_world[:3, 3]
    corners = vertices[faces]
    bad = int(np.count_nonzero(~np.isfinite(corners).all(axis=(1, 2))))
    if bad:
        raise SceneError(
            f"mesh '{mesh.id()}' has {bad} of {len(faces)} faces with NaN or infinite vertices: repair the mesh."
        )
    return corners


def triangle_areas(corners: np.ndarray) -> np.ndarray:
    """Return the area of every triangle, (t,) float64, of ``corners`` (t, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.linalg.norm(normal, axis=1)


def mesh_interaction(mesh: mi.Mesh, prim_index: mi.UInt32, prim_uv: mi.Point2f) -> mi.SurfaceInteraction3f:
    """Describe points of a mesh given by triangle and barycentric coordinates, as a ray that meets them would."""
    hit = dr.zeros(mi.PreliminaryIntersection3f, dr.width(prim_index))
    hit.t = 0
    hit.prim_index = prim_index
    hit.prim_uv = prim_uv
    hit.shape = mi.ShapePtr(mesh)
    return mesh.compute_surface_interaction(dr.zeros(mi.Ray3f, dr.width(prim_index)), hit, mi.RayFlags.All)


def smooth_positions(
    mesh: mi.Mesh, prim_index: mi.UInt32, prim_uv: mi.Point2f, to_world: np.ndarray | None, outwards: mi.Normal3f
) -> mi.Point3f:
    """Lift points of a mesh to the smooth surface that its vertex normals describe.

    Each point is projected onto the tangent planes of the three vertices, where it lies below them, and the three
    offsets are blended by the barycentric coordinates: p + sum_i b_i max(0, (v_i - p) . n_i) n_i. A shadow ray that
    starts there is not cut off by the facets of a coarse mesh.

    Parameters
    ----------
    mesh
        The mesh, in its own space.
    prim_index
        (n,) triangle of each point.
    prim_uv
        (n,) barycentric coordinates of the second and third vertex.
    to_world
        (4, 4) float, applied to vertices and normals before the lift.
    outwards
        (n,) normals of the faces that point out of the body: those of vertices may point inwards, and the lift goes outwards all the same.

    Returns
    -------
    (n,) mi.Point3f
        The lifted points after the transform; the points themselves on a mesh without vertex normals.

    Source
    ------
    J. Hanika, *Hacking the shadow terminator*, Ray Tracing Gems II (2021), chapter 4.
    """
    transform = affine(to_world)
    corner = mesh.face_indices(prim_index)
    vertex = [transform @ mesh.vertex_position(corner[k]) for k in range(3)]
    weight = [1 - prim_uv.x - prim_uv.y, prim_uv.x, prim_uv.y]
    p = mi.Point3f(vertex[0] * weight[0] + vertex[1] * weight[1] + vertex[2] * weight[2])
    if not mesh.has_vertex_normals() or mesh.has_face_normals():
        return p
    normal = [dr.normalize(transform @ mi.Normal3f(mesh.vertex_normal(corner[k]))) for k in range(3)]
    sign = dr.sign(dr.dot(normal[0] + normal[1] + normal[2], outwards))
    lifted = mi.Point3f(p)
    for v, b, vertex_normal in zip(vertex, weight, normal, strict=True):
        n = sign * vertex_normal
        # A degenerate vertex normal (zero, NaN) must not move the point.
        depth = dr.maximum(dr.dot(v - p, n), 0)
        lifted += dr.select(depth > 0, b * depth * n, 0)
    return lifted


def affine(to_world: np.ndarray | None) -> mi.AffineTransform4f:
    """Make a transform for use in kernels from a (4, 4) matrix; None is the identity."""
    if to_world is None:
        return mi.AffineTransform4f()
    transform = mi.AffineTransform4f(mi.ScalarTransform4f(to_world.tolist()))
    dr.make_opaque(transform)  # no part of the kernels: they serve all instances
    return transform


def transformed_mesh(mesh: mi.Mesh, to_world: np.ndarray) -> mi.Mesh:
    """Copy the triangles of a mesh, transformed, as a bare mesh for ray tracing: the same faces in the same order."""
    vertices, faces = mesh_buffers(mesh)
    return mesh_from_arrays(f"{mesh.id()}_moved", vertices @ to_world[:3, :3].T + to_world[:3, 3], faces)


def part_of_mesh(mesh: mi.Mesh, chosen: np.ndarray) -> mi.Mesh:
    """Make a mesh of some triangles of another, ``chosen (t,) bool``, with all that is known at their vertices and its material."""
    source = mi.traverse(mesh)
    used, faces = np.unique(np.array(source["faces"]).reshape(-1, 3)[chosen], return_inverse=True)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mesh.bsdf()
    properties["face_normals"], properties["flip_normals"] = mesh.has_face_normals(), mesh.has_flipped_normals()
    part = mi.Mesh(
        mesh.id(),
        len(used),
        int(chosen.sum()),
        props=properties,
        has_vertex_normals=mesh.has_vertex_normals(),
        has_vertex_texcoords=mesh.has_vertex_texcoords(),
    )
    for name in source.keys():  # noqa: SIM118
        rows = {"vertex": used, "face": np.flatnonzero(chosen)}.get(name.split("_")[0])
        if rows is not None and name.split("_")[1:2] not in (["positions"], ["normals"], ["texcoords"]):
            width = len(source[name]) // (mesh.vertex_count() if name.startswith("vertex") else mesh.face_count())
            part.add_attribute(name, width, np.array(source[name]).reshape(-1, width)[rows].ravel())
    target = mi.traverse(part)
    for name, width in (("vertex_positions", 3), ("vertex_normals", 3), ("vertex_texcoords", 2)):
        if name in target and len(source[name]):
            target[name] = type(target[name])(np.array(source[name]).reshape(-1, width)[used].ravel())
    target["faces"] = type(target["faces"])(faces.reshape(-1).astype(np.uint32))
    target.update()
    return part
