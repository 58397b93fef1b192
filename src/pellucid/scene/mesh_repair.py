"""What a triangle mesh must be before light can enter it: checks that refuse, repairs that warn, smooth normals."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import PellucidWarning, SceneError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CREASE_ANGLE = 40.0


@dataclass
class MeshArrays:
    """A mesh as arrays: ``vertices`` (n, 3), ``faces`` (m, 3), and ``normals`` (n, 3) and ``uv`` (n, 2) or None."""

    vertices: Floats
    faces: Ints
    normals: Floats | None = None
    uv: Floats | None = None

    def corners(self) -> Floats:
        """Positions of the corners of the faces, (m, 3, 3)."""
        return self.vertices[self.faces]


def check_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    normals: ArrayLike | None = None,
    uv: ArrayLike | None = None,
    name: str = "mesh",
) -> MeshArrays:
    """Refuse a mesh that cannot be rendered, and repair what can be: degenerate and repeated faces, winding, normals.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
    normals : (n, 3) float, optional
        Kept if they are all finite and not zero; generated otherwise, with creases sharper than 40 degrees kept.
    uv : (n, 2) float, optional
    name : str
        What to call the mesh in messages.

    Returns
    -------
    MeshArrays
        With unit normals.

    Raises
    ------
    SceneError
        For no faces, indices out of range, NaN or infinite vertices, no area.

    Warns
    -----
    PellucidWarning
        When faces were dropped or turned, and when the surface is open.
    """
    mesh = MeshArrays(np.asarray(vertices, float).reshape(-1, 3), np.asarray(faces, np.int64).reshape(-1, 3))
    _refuse(mesh, name)
    mesh.uv = _usable(uv, len(mesh.vertices), 2)
    mesh.normals = _usable(normals, len(mesh.vertices), 3)
    if mesh.normals is not None and not (np.linalg.norm(mesh.normals[mesh.faces], axis=-1) > 0).all():
        mesh.normals = None
    _drop_faces(mesh, name)
    _orient(mesh, name)
    return with_smooth_normals(mesh) if mesh.normals is None else _agreeing(_compact(mesh))


def _refuse(mesh: MeshArrays, name: str) -> None:
    """Raise for what has no remedy."""
    if len(mesh.faces) == 0:
        raise SceneError(f"{name}: it has no faces ({len(mesh.vertices)} vertices): give a mesh with triangles.")
    low, high = mesh.faces.min(), mesh.faces.max()
    if low < 0 or high >= len(mesh.vertices):
        wrong = high if high >= len(mesh.vertices) else low
        raise SceneError(f"{name}: a face uses vertex {wrong} of {len(mesh.vertices)}: the file is damaged.")
    bad = ~np.isfinite(mesh.corners()).all((1, 2))
    if bad.any():
        raise SceneError(f"{name}: {bad.sum()} of {len(bad)} faces have NaN or infinite vertices: repair the mesh.")
    if not (_areas(mesh) > 0).any():
        raise SceneError(f"{name}: all {len(mesh.faces)} faces have zero area: nothing could be seen of it.")


def _usable(values: ArrayLike | None, count: int, width: int) -> Floats | None:
    """Accept an attribute (count, width) of finite numbers; None for anything else."""
    if values is None:
        return None
    array = np.asarray(values, float)
    return array if array.shape == (count, width) and np.isfinite(array).all() else None


def _areas(mesh: MeshArrays) -> Floats:
    """Areas of the faces, (m,)."""
    a, b, c = np.moveaxis(mesh.corners(), 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def welded(mesh: MeshArrays) -> Ints:
    """Faces (m, 3) in terms of positions: vertices at the same place, split for their normals or uv, count as one."""
    _, label = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)
    return label.ravel()[mesh.faces]


def _drop_faces(mesh: MeshArrays, name: str) -> None:
    """Remove faces without area and all but the first of faces over the same three positions."""
    flat = _areas(mesh) <= 1e-14 * np.ptp(mesh.corners().reshape(-1, 3), axis=0).max() ** 2
    if flat.any():
        warnings.warn(f"{name}: dropped {flat.sum()} faces without area", PellucidWarning, stacklevel=4)
        mesh.faces = mesh.faces[~flat]
    _, first = np.unique(np.sort(welded(mesh), axis=1), axis=0, return_index=True)
    repeated = len(mesh.faces) - len(first)
    if repeated:
        warnings.warn(f"{name}: dropped {repeated} faces that repeat another one", PellucidWarning, stacklevel=4)
        mesh.faces = mesh.faces[np.sort(first)]


@dataclass
class _Edges:
    """Pairs of faces (k, 2) over an edge, whether both run along it the same ``alike`` (wrongly), and its two positions."""

    pair: Ints
    alike: NDArray[np.bool_]
    ends: Ints
    corner: Ints  # (k, 2 faces, 2 ends): 3 face + place of that end in the face
    open_faces: Ints


def _edges(faces: Ints) -> _Edges:
    """Match the edges of welded faces, those that exactly two faces share."""
    place = np.stack([np.arange(3), np.roll(np.arange(3), -1)], -1)
    directed = faces[:, place].reshape(-1, 2)
    corner = (3 * np.arange(len(faces))[:, None, None] + place).reshape(-1, 2)
    upward = directed[:, 0] < directed[:, 1]
    ends = np.where(upward[:, None], directed, directed[:, ::-1])
    corner = np.where(upward[:, None], corner, corner[:, ::-1])
    key = ends[:, 0] * (faces.max() + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    first, second = order[start[count == 2]], order[start[count == 2] + 1]
    return _Edges(
        np.stack([first, second], -1) // 3,
        upward[first] == upward[second],
        ends[first],
        np.stack([corner[first], corner[second]], 1),
        order[start[count == 1]] // 3,
    )


def _orient(mesh: MeshArrays, name: str) -> None:
    """Turn faces so that neighbours agree and every solid has its outside out; warn about open surfaces."""
    edges = _edges(welded(mesh))
    count = len(mesh.faces)
    # Every face is two nodes, as it is and turned; an edge joins the nodes that agree. A piece of surface falls into two
    # halves, one the mirror of the other, unless it is one-sided like a Moebius strip.
    a, b = edges.pair.T
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([np.where(edges.alike, b + count, b), np.where(edges.alike, b, b + count)])
    nodes = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    _, half = connected_components(nodes, directed=False)
    one_sided = half[:count] == half[count:]
    _, first, piece = np.unique(np.minimum(half[:count], half[count:]), return_index=True, return_inverse=True)
    turned = (half[:count] != half[first[piece]]) & ~one_sided
    mesh.faces[turned] = mesh.faces[turned, ::-1]
    turned ^= _turn_inside_out(mesh, piece, edges.open_faces)
    if turned.any():
        warnings.warn(f"{name}: turned {turned.sum()} faces that faced inwards", PellucidWarning, stacklevel=4)
    if len(edges.open_faces):
        warnings.warn(
            f"{name}: its surface is open at {len(edges.open_faces)} edges; it is rendered as if solid behind the surface",
            PellucidWarning,
            stacklevel=4,
        )


def _turn_inside_out(mesh: MeshArrays, piece: Ints, open_faces: Ints) -> NDArray[np.bool_]:
    """Turn the pieces of negative volume, except cavities inside another piece; tell which faces, (m,)."""
    corners = mesh.corners()
    pieces = piece.max() + 1
    low, high = np.full((pieces, 3), np.inf), np.full((pieces, 3), -np.inf)
    np.minimum.at(low, piece, corners.min(1))
    np.maximum.at(high, piece, corners.max(1))
    # Seen from the middle of its rim, an open bowl has nearly the volume of the closed one.
    is_open = np.bincount(piece[open_faces], minlength=pieces) > 0
    rim = np.stack([np.bincount(piece[open_faces], corners[open_faces, :, k].mean(1), pieces) for k in range(3)], -1)
    centre = np.where(is_open[:, None], rim / np.maximum(np.bincount(piece[open_faces], minlength=pieces), 1)[:, None], low)
    a, b, c = np.moveaxis(corners - centre[piece][:, None], 1, 0)
    volume = np.bincount(piece, (a * np.cross(b, c)).sum(-1) / 6, pieces)
    negative = volume < np.where(is_open, -1e-2 * (high - low).max(1) ** 3, 0)
    for k in np.flatnonzero(negative):
        inside = (low < low[k]).all(1) & (high > high[k]).all(1)
        negative[k] = not inside.any()
    turn = negative[piece]
    mesh.faces[turn] = mesh.faces[turn, ::-1]
    return turn


def with_smooth_normals(mesh: MeshArrays, crease_angle: float = CREASE_ANGLE) -> MeshArrays:
    """Give a mesh normals that are smooth except across edges sharper than ``crease_angle`` [degrees].

    Corners of faces around a position share a normal when edges below that angle connect them; the normals of the faces
    are weighed by the angle at the corner, so that the tessellation does not show.
    """
    faces = mesh.faces
    corners = mesh.corners()
    side = np.roll(corners, -1, 1) - corners
    normal = np.cross(side[:, 0], side[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    side /= np.linalg.norm(side, axis=2, keepdims=True)
    angle = np.arccos(np.clip(-(side * np.roll(side, 1, 1)).sum(-1), -1, 1))

    edges = _edges(welded(mesh))
    a, b = edges.pair.T
    smooth = ((normal[a] * normal[b]).sum(-1) > np.cos(np.deg2rad(crease_angle))) & ~edges.alike
    links = edges.corner[smooth].transpose(0, 2, 1).reshape(-1, 2)
    graph = coo_array((np.ones(len(links), np.int8), links.T), shape=(faces.size, faces.size))
    groups, group = connected_components(graph, directed=False)
    weighted = (angle[..., None] * normal[:, None]).reshape(-1, 3)
    total = np.stack([np.bincount(group, weighted[:, k], groups) for k in range(3)], -1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    # Where the faces of a fold cancel each other, one of them decides.
    total = np.where(length > 1e-6, total, weighted[np.unique(group, return_index=True)[1]])

    key = np.stack([faces.ravel(), group], -1)
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    chosen = faces.ravel()[first]
    normals = total[group[first]]
    return MeshArrays(
        mesh.vertices[chosen],
        label.reshape(faces.shape),
        normals / np.linalg.norm(normals, axis=1, keepdims=True),
        None if mesh.uv is None else mesh.uv[chosen],
    )


def _compact(mesh: MeshArrays) -> MeshArrays:
    """Leave out vertices that no face uses."""
    used, label = np.unique(mesh.faces, return_inverse=True)
    normals, uv = (None if values is None else values[used] for values in (mesh.normals, mesh.uv))
    return MeshArrays(mesh.vertices[used], label.reshape(mesh.faces.shape), normals, uv)


def _agreeing(mesh: MeshArrays) -> MeshArrays:
    """Scale given normals to unit length, and turn them all when the faces look the other way."""
    assert mesh.normals is not None
    a, b, c = np.moveaxis(mesh.corners(), 1, 0)
    side = np.sign((np.cross(b - a, c - a)[:, None] * mesh.normals[mesh.faces]).sum())
    mesh.normals = side * mesh.normals / np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    return mesh
