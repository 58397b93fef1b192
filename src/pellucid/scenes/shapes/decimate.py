"""Fewer triangles on a closed mesh: edges collapse where the surface is flat, many at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

Floats = NDArray[np.floating]
Ints = NDArray[np.int64]

EVENNESS = 2e-3
"""What the length of an edge counts beside the distance from the planes: flat places keep triangles of even size."""

TURN, SLIVER = 0.3, 0.08
"""A collapse may turn no triangle by more than this cosine, and make none whose area over its longest side squared is less."""

SWEEPS = 4


def decimate(vertices: Floats, faces: Ints, count: int) -> tuple[Ints, Ints]:
    """Collapse edges of a closed mesh until it has ``count`` triangles.

    One end of an edge moves into the other, so every vertex that is left is one of the old, with its normal. The edge that
    goes is the one that leaves the planes of the old triangles least. Edges collapse together when no ends of theirs
    are neighbours: then neither changes what the other was judged by.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
        Closed and consistently wound.
    count : int
        Triangles wanted; even, as it is for every closed mesh.

    Returns
    -------
    source : (k,) int
        The old vertices that are left.
    faces : (count, 3) int
        Into ``source``. More than ``count`` where no edge can go without folding the surface.

    Source
    ------
    M. Garland, P. Heckbert, *Surface simplification using quadric error metrics*, SIGGRAPH 1997.
    """
    faces = np.asarray(faces)
    quadrics = _quadrics(vertices, faces)
    while len(faces) > count:
        gone, kept = _collapses(vertices, faces, quadrics, (len(faces) - count) // 2)
        if not len(gone):
            break
        into = np.arange(len(vertices))
        into[gone] = kept
        quadrics[kept] += quadrics[gone]
        faces = into[faces]
        faces = faces[(faces != np.roll(faces, 1, 1)).all(1)]
    source, faces = np.unique(faces, return_inverse=True)
    return source, faces.reshape(-1, 3)


def _quadrics(vertices: Floats, faces: Ints) -> Floats:
    """Sum for each vertex the squared distance from the planes of its triangles, by area: (n, 4, 4)."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(area, 1e-300)
    plane = np.concatenate([normal, -(normal * a).sum(1, keepdims=True)], 1)
    outer = (area[:, None] * plane[:, :, None] * plane[:, None, :]).reshape(-1, 16)
    corner = csr_matrix((np.ones(faces.size), (faces.ravel(), np.arange(faces.size) // 3)), (len(vertices), len(faces)))
    return (corner @ outer).reshape(-1, 4, 4)


def _collapses(vertices: Floats, faces: Ints, quadrics: Floats, most: int) -> tuple[Ints, Ints]:
    """Choose edges that may collapse together: the vertices that go, and where each goes to."""
    half = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = half[half[:, 0] < half[:, 1]]
    ends = np.concatenate([edges, edges[:, ::-1]])
    homogeneous = np.concatenate([vertices, np.ones((len(vertices), 1))], 1)
    gone, kept = ends.T
    target = homogeneous[kept]
    total = quadrics[gone] + quadrics[kept]
    weight = np.trace(total[:, :3, :3], axis1=1, axis2=2)
    length = ((vertices[gone] - vertices[kept]) ** 2).sum(1)
    cost = np.einsum("ni,nij,nj->n", target, total, target) + EVENNESS * weight * length
    reverse = cost[len(edges) :] < cost[: len(edges)]
    order = np.argsort(cost.reshape(2, -1).min(0), kind="stable")[: max(len(edges) // 2, 64)]
    pairs = np.where(reverse[:, None], edges[:, ::-1], edges)[order]
    pairs = pairs[_stays_closed(pairs, half, len(vertices))]
    pairs = pairs[_stays_smooth(pairs, vertices, faces)]
    return tuple(_apart(pairs, half, len(vertices))[:most].T)


def _stays_closed(pairs: Ints, half: Ints, n: int) -> NDArray[np.bool_]:
    """Tell for which edges both ends have two neighbours in common, no more: else two sheets would touch.

    What has three neighbours at both ends is a tetrahedron.
    """
    adjacent = csr_matrix((np.ones(len(half), np.int8), tuple(half.T)), (n, n))
    common = np.asarray(adjacent[pairs[:, 0]].multiply(adjacent[pairs[:, 1]]).sum(1)).ravel()
    degree = np.bincount(half[:, 0], minlength=n)
    return (common == 2) & (degree[pairs].sum(1) > 6)


def _stays_smooth(pairs: Ints, vertices: Floats, faces: Ints) -> NDArray[np.bool_]:
    """Tell which collapses neither turn a triangle far nor leave a sliver."""
    by_corner = np.argsort(faces.ravel(), kind="stable")
    degree = np.bincount(faces.ravel(), minlength=len(vertices))
    first = np.cumsum(degree) - degree
    gone, kept = pairs.T
    owner = np.repeat(np.arange(len(pairs)), degree[gone])
    local = np.arange(len(owner)) - np.repeat(np.cumsum(degree[gone]) - degree[gone], degree[gone])
    around = faces[by_corner[first[gone][owner] + local] // 3]
    stays = (around != kept[owner][:, None]).all(1)
    around, owner = around[stays], owner[stays]
    moved = np.where(around == gone[owner][:, None], kept[owner][:, None], around)
    before, after = (np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (vertices[around], vertices[moved]))
    size = np.linalg.norm(after, axis=1)
    corners = vertices[moved]
    longest = ((corners - np.roll(corners, 1, 1)) ** 2).sum(2).max(1)
    bad = (before * after).sum(1) < TURN * size * np.linalg.norm(before, axis=1)
    return np.bincount(owner, bad | (size < 2 * SLIVER * longest), len(pairs)) == 0


def _apart(pairs: Ints, half: Ints, n: int) -> Ints:
    """Choose pairs, the first ones first, of which no ends are neighbours of another's."""
    chosen = np.empty(0, int)
    rank = np.arange(len(pairs))
    blocked = np.zeros(n, bool)
    for _ in range(SWEEPS):
        rank = rank[~blocked[pairs[rank]].any(1)]
        best = np.full(n, len(pairs))
        np.minimum.at(best, pairs[rank].ravel(), np.repeat(rank, 2))
        nearby = best.copy()
        np.minimum.at(nearby, half[:, 0], best[half[:, 1]])
        won = rank[(nearby[pairs[rank]] == rank[:, None]).all(1)]
        chosen = np.concatenate([chosen, won])
        taken = np.zeros(n, bool)
        taken[pairs[won]] = True
        blocked |= taken
        blocked[half[taken[half[:, 0]], 1]] = True
    return pairs[np.sort(chosen)]
