"""Arrays become a Mitsuba mesh: the only place that writes mesh buffers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import mitsuba as mi

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

    Returns
    -------
    mi.Mesh
        To be put into a dictionary for ``mi.load_dict``; it belongs to the variant active now.
    """
    import mitsuba as mi

    positions, triangles = np.asarray(vertices), np.asarray(faces)
    properties = mi.Properties()
    if bsdf is not None:
        properties["mesh_bsdf"] = mi.load_dict(bsdf, optimize=False) if isinstance(bsdf, dict) else bsdf
    mesh = mi.Mesh(
        name,
        len(positions),
        len(triangles),
        props=properties,
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=uv is not None,
    )
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
