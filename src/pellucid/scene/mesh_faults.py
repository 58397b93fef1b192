"""Faults of meshes with which a picture cannot be right."""

from __future__ import annotations

import numpy as np

from ..errors import SceneError, warn
from .bodies import Body
from .meshes.buffers import mesh_buffers
from .solids import faces_without_normals, repeated_faces


def check_meshes(bodies: list[Body]) -> None:
    """Warn of faces that are there twice.

    Raises
    ------
    SceneError
        For faces whose vertex normals have cancelled each other.
    """
    meshes = {id(part.shape): (body, part.shape) for body in bodies for part in body.parts if part.shape.is_mesh()}
    for body, mesh in meshes.values():
        vertices, faces = mesh_buffers(mesh)
        lost = 0
        if mesh.has_vertex_normals():
            lost = faces_without_normals(vertices, faces, np.array(mesh.vertex_normals_buffer()).reshape(-1, 3))
        if lost:
            raise SceneError(
                f"The body '{body.name}' has {lost} faces whose vertex normals lie in the face, as they do where faces back to back share "
                "their corners: set face_normals, or give the mesh thickness."
            )
        twice = repeated_faces(vertices, faces)
        if twice:
            warn(
                f"The body '{body.name}' has {twice} of {len(faces)} faces twice: what enters there counts twice, and the body is too "
                "bright. Remove the copies."
            )
