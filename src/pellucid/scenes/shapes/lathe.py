"""Turned solids: closed surfaces of revolution, plain or carved, and blocks with rounded edges, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from ...scene.meshes.buffers import triangle_areas

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class Solid(NamedTuple):
    """A closed triangle mesh with smooth normals; ``uv`` only where it is to carry a picture, at the cost of a seam."""

    vertices: Array
    faces: Index
    normals: Array
    uv: Array | None = None

    @property
    def area(self) -> float:
        """The whole surface [scene units squared]."""
        return float(triangle_areas(self.vertices[self.faces]).sum())

    def moved(self, by: ArrayLike) -> Solid:
        """The same somewhere else."""
        return self._replace(vertices=self.vertices + np.asarray(by, float))


def rounded(points: Sequence[tuple[float, float]], count: int) -> Array:
    """Draw a curve with rounded corners inside a polygon, as (count, 2) points spaced about evenly.

    A quadratic B-spline: it stays within the polygon, touches the middle of each of its sides, and goes through a corner
    that is given twice.
    """
    control = np.asarray(points, float)
    knots = np.concatenate([[0, 0], np.arange(len(control) - 1), [len(control) - 2] * 2]).astype(float)
    curve = BSpline(knots, control, 2)
    dense = curve(np.linspace(0, len(control) - 2, 40 * len(control)))
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    at = np.linspace(0, length[-1], count)
    return np.stack([np.interp(at, length, dense[:, k]) for k in (0, 1)], -1)


def vertex_normals(vertices: Array, faces: Index) -> Array:
    """Average the normals of the faces around each vertex, weighted by area: (n, 3) unit vectors."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(cross[:, k], 3), minlength=len(vertices)) for k in range(3)], -1
    )
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def revolve(
    profile: Array, segments: int, carve: Callable[[Array, Array], Array] | None = None, with_uv: bool = False
) -> Solid:
    """Turn a profile around the z axis into a closed solid.

    Parameters
    ----------
    profile : (k, 2) float
        Radius and height, from the axis over the outside back to the axis, counter-clockwise (up on the outside).
    segments : int
        Around the axis; the triangles number ``2 (k - 2) segments``.
    carve : callable, optional
        Maps the angles (segments,) [rad] and the ring points (k - 2, segments, 3) to other points: flutes, leaves, squares.
    with_uv : bool
        Coordinates for a picture: u around, v along the profile. The mesh then has a seam of vertices that repeat.
    """
    profile = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    radius, height = profile[1:-1, :1], profile[1:-1, 1:]
    rings: Array = np.stack([radius * np.cos(angle), radius * np.sin(angle), height + 0.0 * angle], axis=-1)
    if carve is not None:
        rings = carve(angle, rings)
    poles = np.array([[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]])
    vertices = np.concatenate([rings.reshape(-1, 3), poles])
    index = np.arange(rings[..., 0].size).reshape(rings.shape[:2])
    faces = _ring_faces(index, np.roll(index, -1, 1), len(vertices) - 2, len(vertices) - 1)
    normals = vertex_normals(vertices, faces)
    if not with_uv:
        return Solid(vertices, faces, normals)
    closed = np.concatenate([index, index[:, :1]], 1)
    poles_at = len(vertices) - 2 + np.repeat([[0], [1]], segments + 1, 1)
    rows = np.concatenate([poles_at[:1], closed, poles_at[1:]])
    around, along = np.meshgrid(np.linspace(0, 1, segments + 1), np.linspace(0, 1, len(rows)))
    grid = np.arange(rows.size).reshape(rows.shape)
    quads = _ring_faces(grid[:, :-1], grid[:, 1:])
    # At the poles one of the two triangles of a quad has no area.
    flat = rows.ravel()[quads]
    keep = (flat[:, 0] != flat[:, 1]) & (flat[:, 1] != flat[:, 2]) & (flat[:, 2] != flat[:, 0])
    uv = np.stack([around.ravel(), along.ravel()], -1)
    return Solid(vertices[rows.ravel()], quads[keep], normals[rows.ravel()], uv)


def _ring_faces(here: Index, beside: Index, first: int | None = None, last: int | None = None) -> Index:
    """Join rings of vertices (k, m), each vertex to that ``beside`` it, and the outer rings to two poles."""
    a, b, c, d = here[:-1].ravel(), beside[:-1].ravel(), beside[1:].ravel(), here[1:].ravel()
    faces = [np.stack([a, b, c], -1), np.stack([a, c, d], -1)]
    if first is not None and last is not None:
        faces.append(np.stack([np.full_like(here[0], first), beside[0], here[0]], -1))
        faces.append(np.stack([np.full_like(here[0], last), here[-1], beside[-1]], -1))
    return np.concatenate(faces)


def rounded_block(half: ArrayLike, bevel: float, cells: Sequence[int], arc: int = 2) -> Solid:
    """A block around the origin with half extents ``half`` (3,), its edges rounded by radius ``bevel`` with ``arc`` cells."""
    size = np.asarray(half, float)
    lines = []
    for h, n in zip(size, cells, strict=True):
        turn = np.tan(np.linspace(-np.pi / 4, 0, arc + 1)[:-1])
        low = -h + bevel * (1 + turn)
        lines.append(np.concatenate([low, np.linspace(-h + bevel, h - bevel, n + 1), -low[::-1]]))
    corners, quads, first = [], [], 0
    for axis in range(3):
        u, v = lines[(axis + 1) % 3], lines[(axis + 2) % 3]
        for side in (-1.0, 1.0):
            face = np.empty((len(u), len(v), 3))
            face[..., axis] = side * size[axis]
            face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = np.meshgrid(u, v, indexing="ij")
            index = first + np.arange(face[..., 0].size).reshape(face.shape[:2])
            index = index if side > 0 else index[::-1]
            quads.append(_ring_faces(index.T[:, :-1], index.T[:, 1:]))
            corners.append(face.reshape(-1, 3))
            first += index.size
    points = np.concatenate(corners)
    # Faces share the points on their edges.
    _, keep, inverse = np.unique(np.round(points / size.max(), 9) + 0.0, axis=0, return_index=True, return_inverse=True)
    points = points[keep]
    core = np.clip(points, -(size - bevel), size - bevel)
    off = points - core
    length = np.linalg.norm(off, axis=1, keepdims=True)
    points = core + bevel * off / length
    return Solid(points, inverse.ravel()[np.concatenate(quads)], off / length)


def joined(solids: Sequence[Solid]) -> Solid:
    """Put several solids into one mesh."""
    first = np.cumsum([0, *(len(s.vertices) for s in solids[:-1])])
    return Solid(
        np.concatenate([s.vertices for s in solids]),
        np.concatenate([s.faces + f for s, f in zip(solids, first, strict=True)]),
        np.concatenate([s.normals for s in solids]),
        np.concatenate([s.uv for s in solids if s.uv is not None]) if solids[0].uv is not None else None,
    )


def bent(solid: Solid, bend: Callable[[Array], Array]) -> Solid:
    """Move the vertices of a solid by ``bend``, which keeps its orientation, and find its normals anew."""
    vertices = bend(solid.vertices)
    return Solid(vertices, solid.faces, vertex_normals(vertices, solid.faces), solid.uv)
