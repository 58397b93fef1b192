"""Checks and repairs of a mesh from a file, each announced in one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import SceneError, warn
from .crease_normals import face_normals

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Positions nearer than this part of the extent are one point; triangles flatter than its square have no area.
WELD = 1e-7
# Vertices farther from the middle than so many times the usual distance are a fault of the file; fewer times, suspicious.
OUTLIER, FAR = 1e4, 200.0


def weld(vertices: Array) -> Index:
    """Number the positions: (n,) int, equal where two of the ``vertices`` (n, 3) coincide."""
    extent = float(np.ptp(vertices, axis=0).max()) or 1.0
    x, y, z = np.round((vertices - vertices.min(axis=0)) / (WELD * extent)).astype(np.int64).T
    # Whole numbers below 1e7, so that two of them make one key: several times faster than to sort rows.
    _, column = np.unique(x << 24 | y, return_inverse=True)
    return np.unique(column << 24 | z, return_inverse=True)[1]


def check(name: str, vertices: Array, faces: Index) -> None:
    """Refuse what cannot be rendered.

    Raises
    ------
    SceneError
        For a mesh without faces, with faces whose vertices are missing, not finite or lost far away, or without any area.
    """
    if len(faces) == 0:
        raise SceneError(f"'{name}' has no faces: export it as a triangle mesh, not as points or lines.")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(f"'{name}' has faces that use a vertex beyond its {len(vertices)}: export it again.")
    bad = int(np.count_nonzero(~np.isfinite(vertices[faces]).all(axis=(1, 2))))
    if bad:
        raise SceneError(f"'{name}' has {bad} of {len(faces)} faces with NaN or infinite vertices: repair the mesh.")
    _check_outliers(name, vertices, np.unique(faces))
    extent = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()
    if not np.any(face_normals(vertices[faces])[1] > (WELD * extent) ** 2):
        raise SceneError(f"'{name}' has no area: all of its {len(faces)} faces are points or lines.")


def _check_outliers(name: str, vertices: Array, used: Index) -> None:
    """Refuse a mesh with a vertex so far away that the rest is a speck, and point out one that makes it small."""
    with np.errstate(over="ignore"):
        distance = np.linalg.norm(vertices[used] - np.median(vertices[used], axis=0), axis=1)
    usual, worst = float(np.median(distance)), int(np.argmax(distance))
    if distance[worst] <= FAR * usual or usual == 0:
        return
    place = ", ".join(f"{x:.3g}" for x in vertices[used[worst]])
    far = int(np.count_nonzero(distance > FAR * usual))
    text = (
        f"'{name}': {far} of {len(used)} vertices lie far from the others, number {used[worst]} at ({place}), "
        f"{distance[worst] / usual:.2g} times as far from the middle as is usual"
    )
    if distance[worst] > OUTLIER * usual:
        raise SceneError(f"{text}: remove them, the rest would be too small to see.")
    warn(f"{text}; if that is a fault of the file, the mesh is shown too small.")


def repair(name: str, vertices: Array, faces: Index, points: Index) -> tuple[Index, Index]:
    """Drop faces that are there twice or have no area, and turn those that face inwards; warn of what was found.

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
    faces : (k, 3) int
        The faces that are left, counter-clockwise seen from outside if the mesh is a solid.
    kept : (k,) int
        Which of the faces given they are.
    """
    kept = np.arange(len(faces))
    _, first = np.unique(np.sort(points[faces], axis=1), axis=0, return_index=True)
    if len(first) < len(faces):
        warn(f"'{name}': {len(faces) - len(first)} of {len(faces)} faces are there twice; the copies are dropped.")
        kept = np.sort(first)
        faces = faces[kept]
    faces = _outside_out(name, vertices, faces, points)
    corners = vertices[faces]
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    flat = face_normals(corners)[1] <= (WELD * extent) ** 2
    if flat.any():
        warn(f"'{name}': {np.count_nonzero(flat)} of {len(faces)} faces have no area; they are dropped.")
        faces, kept = faces[~flat], kept[~flat]
    return faces, kept


def _outside_out(name: str, vertices: Array, faces: Index, points: Index) -> Index:
    """Turn faces so that neighbours agree and solids have their outside out; warn of turned faces and open borders."""
    welded = points[faces]
    # Faces collapsed to a line or a point touch no edge but their own.
    sound = (welded[:, 0] != welded[:, 1]) & (welded[:, 1] != welded[:, 2]) & (welded[:, 2] != welded[:, 0])
    start, end = welded[sound].ravel(), np.roll(welded[sound], -1, axis=1).ravel()
    owner = np.repeat(np.flatnonzero(sound), 3)
    key = np.minimum(start, end) * (int(welded.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, first, uses = np.unique(key[order], return_index=True, return_counts=True)
    one, other = order[first[uses == 2]], order[first[uses == 2] + 1]
    piece, turned, one_sided = agreeing_pieces(
        len(faces), owner[one], owner[other], (start < end)[one] == (start < end)[other]
    )
    borders = int(np.count_nonzero(uses % 2))
    if borders:
        warn(
            f"'{name}' is open: {borders} edges have a face on one side only. Light works, but it has no inside: a surface "
            "that is clearly open has a half space behind each of its sides; close the holes if it is meant to be solid."
        )
    if one_sided:
        warn(f"'{name}' has a surface with one side only: parts of it may stay dark.")
    result = np.where(turned[:, None], faces[:, ::-1], faces)
    is_open = np.zeros(piece.max() + 1, bool)
    is_open[piece[owner[order[first[uses % 2 == 1]]]]] = True
    negative = _inside_out(vertices[result], piece) & ~is_open
    # Which of the two sides of an open piece is the outer one only its file can say: the one that more faces show.
    majority = np.bincount(piece, turned) > 0.5 * np.bincount(piece)
    flip = np.where(is_open, majority, negative)[piece]
    result = np.where(flip[:, None], result[:, ::-1], result)
    changed = np.count_nonzero(turned ^ flip)
    if changed == len(faces):
        warn(f"'{name}' is inside out (its volume is negative); the winding of all its faces is turned.")
    elif changed:
        warn(f"'{name}': {changed} of {len(faces)} faces pointed inwards; they are turned.")
    return result


def agreeing_pieces(
    count: int, one: Index, other: Index, clash: NDArray[np.bool_]
) -> tuple[Index, NDArray[np.bool_], bool]:
    """Find the connected pieces of ``count`` faces, and which faces to turn so that the neighbours in each agree.

    Every face is two nodes of a graph, as it is and turned; an edge of the mesh joins the nodes that agree. A piece then
    falls into two halves that mirror each other, unless it has one side only, like a Moebius strip.
    """
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([np.where(clash, other + count, other), np.where(clash, other, other + count)])
    graph = coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(2 * count, 2 * count))
    half = connected_components(graph, directed=False)[1]
    as_is, mirrored = half[:count], half[count:]
    _, first, piece = np.unique(np.minimum(as_is, mirrored), return_index=True, return_inverse=True)
    piece = piece.ravel().astype(np.int64)
    one_sided = as_is == mirrored
    return piece, (as_is != as_is[first[piece]]) & ~one_sided, bool(one_sided.any())


def _inside_out(corners: Array, piece: Index) -> NDArray[np.bool_]:
    """Tell which pieces of closed triangles (m, 3, 3) have a negative volume although they are no cavity of another."""
    pieces = int(piece.max()) + 1
    low, high = np.full((pieces, 3), np.inf), np.full((pieces, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(1))
    np.maximum.at(high, piece, corners.max(1))
    p = corners - low[piece][:, None]
    negative = np.bincount(piece, np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2]))) < 0
    for k in np.flatnonzero(negative):
        negative[k] = not ((low < low[k]).all(1) & (high > high[k]).all(1)).any()
    return negative
