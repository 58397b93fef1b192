"""Smooth vertex normals for a mesh that has none: smooth across shallow edges, split at sharp ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CREASE_ANGLE = 40.0
"""Faces that meet under a larger angle between their normals [degrees] are shaded apart: below the 45 of a chamfer."""


def face_normals(corners: Array) -> tuple[Array, Array]:
    """Find the unit normals (m, 3) and the areas (m,) of the triangles ``corners`` (m, 3, 3); no area, no normal."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0, length, 1)[:, None], 0.5 * length


def smooth_normals(
    vertices: Array, faces: Index, points: Index, uv: Array | None = None, crease_angle: float = CREASE_ANGLE
) -> tuple[Index, Index, Array]:
    """Give every corner of every face a normal: the mean over the faces around its point that no crease separates.

    Parameters
    ----------
    vertices : (n, 3) float
        Positions.
    faces : (m, 3) int
        Vertex indices.
    points : (n,) int
        Vertices of one position share a number: vertices may be apart although the surface is not (STL, texture seams).
    uv : (n, 2) float, optional
        Texture coordinates: where they differ, vertices stay apart although they share a normal.
    crease_angle : float
        Largest angle between the normals of neighbouring faces that is smoothed away [degrees].

    Returns
    -------
    source : (k,) int
        The vertex of the input that each vertex of the result repeats.
    faces : (m, 3) int
        The same faces over the vertices of the result.
    normals : (k, 3) float
        Unit normals; a face weighs as much as the angle it has at the vertex.
    """
    corners = vertices[faces]
    normals, _ = face_normals(corners)
    group = _smooth_groups(points[faces], normals, crease_angle)
    weighted = normals[:, None, :] * _corner_angles(corners)[..., None]
    total: Array = np.stack([np.bincount(group, weighted[..., k].ravel()) for k in range(3)], -1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 1e-12, total / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
    kinds = points if uv is None else np.unique(np.column_stack([points, uv]), axis=0, return_inverse=True)[1].ravel()
    key = group * len(vertices) + kinds[faces.ravel()]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    return faces.ravel()[first], inverse.reshape(-1, 3).astype(np.int64), total[group[first]]


def _smooth_groups(faces: Index, normals: Array, crease_angle: float) -> Index:
    """Number the corners (3 m,) so that those with one normal are equal: joined over every shallow edge at their point."""
    corner = np.arange(faces.size).reshape(-1, 3)
    start, end = faces, np.roll(faces, -1, axis=1)
    low, high = np.minimum(start, end).ravel(), np.maximum(start, end).ravel()
    at_start, at_end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    # The corner of each half edge at the lower, and at the higher numbered of its two points.
    at_low = np.where(start.ravel() == low, at_start, at_end)
    at_high = np.where(start.ravel() == low, at_end, at_start)
    order = np.lexsort((high, low))
    a, b = order[:-1], order[1:]
    cosine = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3])
    shallow = (low[a] == low[b]) & (high[a] == high[b]) & (cosine > np.cos(np.deg2rad(crease_angle)))
    a, b = a[shallow], b[shallow]
    rows, columns = np.concatenate([at_low[a], at_high[a]]), np.concatenate([at_low[b], at_high[b]])
    graph = coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(faces.size, faces.size))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _corner_angles(corners: Array) -> Array:
    """Measure the angle (m, 3) of every triangle at each corner [rad]."""
    onward, back = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    return np.arctan2(np.linalg.norm(np.cross(onward, back), axis=-1), np.sum(onward * back, -1))
