"""Checks and repairs of a mesh from a file, each announced in one line."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from ..errors import PellucidWarning, SceneError
from .crease_normals import face_normals

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Positions nearer than this part of the extent are one point; triangles flatter than its square have no area.
WELD = 1e-7


def weld(vertices: Array) -> Index:
    """Number the positions: (n,) int, equal where two of the ``vertices`` (n, 3) coincide."""
    extent = float(np.ptp(vertices, axis=0).max()) or 1.0
    grid = np.round((vertices - vertices.min(axis=0)) / (WELD * extent)).astype(np.int64)
    return np.unique(grid, axis=0, return_inverse=True)[1].ravel()


def check(name: str, vertices: Array, faces: Index) -> None:
    """Refuse what cannot be rendered.

    Raises
    ------
    SceneError
        For a mesh without faces, with faces whose vertices are missing or not finite, or without any area.
    """
    if len(faces) == 0:
        raise SceneError(f"'{name}' has no faces: export it as a triangle mesh, not as points or lines.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(f"'{name}' has faces that use a vertex beyond its {len(vertices)}: export it again.")
    bad = int(np.count_nonzero(~np.isfinite(vertices[faces]).all(axis=(1, 2))))
    if bad:
        raise SceneError(f"'{name}' has {bad} of {len(faces)} faces with NaN or infinite vertices: repair the mesh.")
    extent = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()
    if not np.any(face_normals(vertices[faces])[1] > (WELD * extent) ** 2):
        raise SceneError(f"'{name}' has no area: all of its {len(faces)} faces are points or lines.")


def repair(name: str, vertices: Array, faces: Index, points: Index) -> Index:
    """Drop faces that are there twice or have no area, and turn a solid that is inside out; warn of what was found.

    Parameters
    ----------
    vertices : (n, 3) float
        Positions.
    faces : (m, 3) int
        Vertex indices.
    points : (n,) int
        From `weld`.

    Returns
    -------
    (k, 3) int
        The faces that are left, counter-clockwise seen from outside if the mesh is a solid.
    """
    _, first = np.unique(np.sort(points[faces], axis=1), axis=0, return_index=True)
    if len(first) < len(faces):
        _warn(f"'{name}': {len(faces) - len(first)} of {len(faces)} faces are there twice; the copies are dropped.")
        faces = faces[np.sort(first)]
    closed = _is_closed(name, points[faces])
    corners = vertices[faces]
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    flat = face_normals(corners)[1] <= (WELD * extent) ** 2
    if flat.any():
        _warn(f"'{name}': {np.count_nonzero(flat)} of {len(faces)} faces have no area; they are dropped.")
        faces = faces[~flat]
    if closed and _volume(vertices[faces]) < 0:
        _warn(f"'{name}' is inside out (its volume is negative); the winding of all its faces is turned.")
        faces = faces[:, ::-1]
    return faces


def _is_closed(name: str, faces: Index) -> bool:
    """Tell whether the faces (over welded points) bound a solid, and say what happens if they do not."""
    # Faces collapsed to a line or a point touch no edge but their own.
    sound = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    start, end = faces[sound].ravel(), np.roll(faces[sound], -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(faces.max()) + 1) + np.maximum(start, end)
    _, edge, uses = np.unique(key, return_inverse=True, return_counts=True)
    balance = np.bincount(edge, np.where(start < end, 1, -1))
    borders, clashes = int(np.count_nonzero(uses % 2)), int(np.count_nonzero((balance != 0) & (uses % 2 == 0)))
    if borders:
        _warn(
            f"'{name}' is open: {borders} edges have a face on one side only. Light works, but it has no inside: a surface "
            "that is clearly open counts as a thin sheet lit from both sides; close the holes if it is meant to be solid."
        )
    if clashes:
        _warn(
            f"'{name}': at {clashes} edges one face points outwards and its neighbour inwards; "
            "parts of it may stay dark: make the winding consistent."
        )
    return borders == 0 and clashes == 0


def _volume(corners: Array) -> float:
    """Measure the signed volume inside the closed triangles (m, 3, 3)."""
    p = corners - corners.mean(axis=(0, 1))
    return float(np.einsum("ij,ij->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6)


def _warn(text: str) -> None:
    """Warn whoever asked for the scene."""
    warnings.warn(text, PellucidWarning, stacklevel=5)
