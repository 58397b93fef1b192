"""The separate solids among the triangles of one mesh: what Mitsuba has merged because it shares a material is told apart again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from hashlib import blake2b
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .meshes.repair import agreeing_pieces

TOUCHING = 1e-6
"""Parts nearer to each other than this share of their common extent touch."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UPRIGHT = 1e-4
"""Cosine between two normals below which one tells nothing of the other."""

REMEMBERED = 256
"""Meshes that were asked about last, whose answers are kept."""

T = TypeVar("T")


def _by_contents(function: Callable[..., T]) -> Callable[..., T]:
    """Remember the results of a function by the contents of its arrays: whoever prepares a scene asks the same of its meshes again."""
    known: OrderedDict[bytes, T] = OrderedDict()

    @wraps(function)
    def remembered(*arrays: NDArray[Any]) -> T:
        digest = blake2b(digest_size=16)
        for array in arrays:
            digest.update(np.ascontiguousarray(array).data)
        key = digest.digest()
        if key not in known:
            known[key] = function(*arrays)
        known.move_to_end(key)
        while len(known) > REMEMBERED:
            known.popitem(last=False)
        return known[key]

    return remembered


@_by_contents
def separate_solids(vertices: Floats, faces: NDArray[np.uint32]) -> Ints:
    """Number the solids that triangles belong to.

    Closed parts that neither touch nor overlap are solids of their own. A shell inside another is a cavity, or something inside the
    material, and belongs to it. Parts that are not closed belong together, as nobody can tell what they enclose.

    Parameters
    ----------
    vertices : (v, 3) float
    faces : (t, 3) int

    Returns
    -------
    (t,) int
        From 0 on, in the order of the first triangle of each.
    """
    points, face = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    if _connected(len(points), face).max(initial=0) == 0:
        return np.zeros(len(face), np.int64)
    points, face = _welded(points, face)
    part = _connected(len(points), face)
    count = int(part.max(initial=0)) + 1
    closed = _closed(face, part, count)
    order = np.argsort(part, kind="stable")
    parts = np.split(face[order], np.cumsum(np.bincount(part))[:-1])
    is_open = np.flatnonzero(~closed)
    pairs = [(0, 0), *((int(is_open[0]), int(k)) for k in is_open)]
    pairs += [
        (a, b)
        for a, b in _boxes_meet(points, parts)
        if _joined(points, parts[a], parts[b], bool(closed[a] and closed[b]))
    ]
    one, other = np.array(pairs).T
    graph = coo_matrix((np.ones(len(pairs)), (one, other)), shape=(count, count))
    solid = connected_components(graph, directed=False)[1][part]
    _, first, number = np.unique(solid, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]


def _welded(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Join vertices at one position."""
    order = np.lexsort(vertices.T)
    new = np.any(np.diff(vertices[order], axis=0, prepend=np.nan), axis=1)
    number = np.empty(len(vertices), np.int64)
    number[order] = np.cumsum(new) - 1
    return vertices[order[new]], number[faces]


def _connected(count: int, face: Ints) -> Ints:
    """Number the connected parts of triangles, or of edges: ``(t,)``."""
    edges = np.concatenate([face[:, :2], face[:, -2:]])
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1][face[:, 0]]
    return np.unique(label, return_inverse=True)[1].reshape(-1)


@_by_contents
def repeated_faces(vertices: Floats, faces: NDArray[np.uint32]) -> int:
    """Count the triangles whose corners lie where those of one before do, in whatever order."""
    x, y, z = np.asarray(vertices, np.float32).view(np.uint32).T.astype(np.uint64)
    mixed = (
        (x * np.uint64(0x9E3779B97F4A7C15)) ^ (y * np.uint64(0xBF58476D1CE4E5B9)) ^ (z * np.uint64(0x94D049BB133111EB))
    )
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return len(faces) - len(np.unique(mixed[faces].sum(axis=1)))


@_by_contents
def faces_without_normals(vertices: Floats, faces: NDArray[np.uint32], normals: NDArray[np.float32]) -> int:
    """Count the triangles all of whose vertex normals are upright to their own: Mitsuba gives such ones where others cancel each other."""
    corners = vertices[faces]
    own = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    cosine = np.einsum("tik,tk->ti", normals[faces], own)
    area = np.linalg.norm(own, axis=1)
    return int(np.count_nonzero((np.abs(cosine).max(axis=1) < UPRIGHT * area) & (area > 0)))


@_by_contents
def hole_share(vertices: Floats, faces: NDArray[np.uint32]) -> float:
    """Measure what would close the holes of a surface, over its own area: the vector area of each loop of its border, added up.

    It is 0 for a closed surface, 1 for a flat one, a half for half a sphere.
    """
    face = np.asarray(faces, np.int64)
    if not len(face) or not len(_unpaired(face)[0]):  # most are closed without a look at positions
        return 0.0
    points, face = _welded(np.asarray(vertices, np.float64), face)
    start, end, surplus, _ = _unpaired(face)
    near = TOUCHING * np.ptp(points, axis=0).max()
    border = np.unique(np.stack([start, end]))
    pairs = border[cKDTree(points[border]).query_pairs(near, output_type="ndarray")]
    if len(pairs):  # borders that touch, but for rounding
        graph = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(points), len(points)))
        _, first, joined = np.unique(
            connected_components(graph, directed=False)[1], return_index=True, return_inverse=True
        )
        points, face = points[first], joined.reshape(-1)[face]
        start, end, surplus, _ = _unpaired(face)
    holes = surplus % 2 == 1  # an even surplus is a seam between triangles that are wound differently
    if not holes.any():
        return 0.0
    ends = np.stack([start[holes], end[holes]])
    loop = _connected(len(points), ends.T)
    a, b = points[ends] - points[ends[0]].mean(axis=0)
    across = np.stack([np.bincount(loop, x) for x in np.cross(a, b).T])
    area = np.linalg.norm(np.cross(*_edges(points, face)), axis=1).sum()
    return float(np.linalg.norm(across, axis=0).sum() / max(area, np.finfo(float).tiny))


@_by_contents
def turned_faces(vertices: Floats, faces: NDArray[np.uint32]) -> NDArray[np.bool_] | None:
    """Tell which triangles are wound against most of the surface that they are part of, ``(t,)``; None where neighbours agree."""
    face = np.asarray(faces, np.int64)
    if not len(face) or not len(_unpaired(face)[0]):
        return None
    points, face = _welded(np.asarray(vertices, np.float64), face)
    if not np.any(_unpaired(face)[2] % 2 == 0):
        return None
    edges = np.concatenate([face[:, [0, 1]], face[:, [1, 2]], face[:, [2, 0]]])
    low, high = np.sort(edges, axis=1).T
    order = np.argsort(low << 32 | high, kind="stable")
    _, first, uses = np.unique((low << 32 | high)[order], return_index=True, return_counts=True)
    one, other = order[first[uses == 2]], order[first[uses == 2] + 1]
    clash = (edges[one, 0] < edges[one, 1]) == (edges[other, 0] < edges[other, 1])
    piece, turned, _ = agreeing_pieces(len(face), one % len(face), other % len(face), clash)
    area = np.linalg.norm(np.cross(*_edges(points, face)), axis=1)
    most = np.bincount(piece, area * turned) > 0.5 * np.bincount(piece, area)
    return turned ^ most[piece]


def _unpaired(face: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """List the edges that are passed more often one way than the other: both ends in that way, how much more often, and a triangle."""
    edges = np.concatenate([face[:, [0, 1]], face[:, [1, 2]], face[:, [2, 0]]])
    low, high = np.sort(edges, axis=1).T
    key, forward = low << 32 | high, edges[:, 0] < edges[:, 1]
    if np.array_equal(np.sort(key[forward]), np.sort(key[~forward])):
        return (np.zeros(0, np.int64),) * 4
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    balance = np.bincount(index.reshape(-1), np.where(forward, 1, -1)).astype(np.int64)
    unpaired = np.flatnonzero(balance)
    first, balance = first[unpaired], balance[unpaired]
    start, end = np.where(balance > 0, (low[first], high[first]), (high[first], low[first]))
    return start, end, np.abs(balance), first % len(face)


def _closed(face: Ints, part: Ints, count: int) -> NDArray[np.bool_]:
    """Tell which parts have no border: every edge is passed as often one way as the other."""
    return np.bincount(part[_unpaired(face)[3]], minlength=count) == 0


def _boxes_meet(points: Floats, parts: list[Ints]) -> list[tuple[int, int]]:
    """List the pairs of parts whose boxes overlap or touch."""
    low = np.array([points[f].min(axis=(0, 1)) for f in parts])
    high = np.array([points[f].max(axis=(0, 1)) for f in parts])
    near = TOUCHING * np.ptp(points, axis=0).max()
    meet = (low[:, None] <= high[None] + near).all(axis=2) & (low[None] <= high[:, None] + near).all(axis=2)
    return [(int(a), int(b)) for a, b in np.argwhere(np.triu(meet, 1))]


def _joined(points: Floats, one: Ints, other: Ints, closed: bool) -> bool:
    """Tell whether two parts touch, overlap, or lie inside each other; parts that cannot be compared count as joined."""
    if not closed:
        return True
    if _inside(points[one[0, 0]], points[other]) or _inside(points[other[0, 0]], points[one]):
        return True
    gap = _gap(points, one, other)
    return gap is None or gap <= TOUCHING * np.ptp(points[np.concatenate([one, other])], axis=(0, 1)).max()


def _inside(point: Floats, corners: Floats) -> bool:
    """Tell whether a point lies inside a closed part, whichever way it is wound: by the winding number."""
    a, b, c = (corners - point).transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    solid_angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return abs(solid_angle.sum()) > 2 * np.pi


def _gap(points: Floats, one: Ints, other: Ints) -> float | None:
    """Measure the smallest distance between two closed parts; None where a part is no solid."""
    import manifold3d

    solids = []
    for face in (one, other):
        used, index = np.unique(face, return_inverse=True)
        corners = points[used] - points.mean(axis=0)
        if (
            np.einsum("ij,ij->", corners[index.reshape(-1, 3)[:, 0]], np.cross(*_edges(corners, index.reshape(-1, 3))))
            < 0
        ):
            index = index.reshape(-1, 3)[:, ::-1]
        mesh = manifold3d.Mesh64(corners, index.reshape(-1, 3).astype(np.uint64))
        solid = manifold3d.Manifold(mesh)
        if solid.status() != manifold3d.Error.NoError or solid.is_empty():
            return None
        solids.append(solid)
    return float(solids[0].min_gap(solids[1], float(np.ptp(points, axis=0).max())))


def _edges(corners: Floats, index: Ints) -> tuple[Floats, Floats]:
    """Give two edges of each triangle."""
    a, b, c = (corners[index[:, k]] for k in range(3))
    return b - a, c - a
