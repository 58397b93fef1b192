"""Numbers for the page: planes of one kind each, their bytes sorted by significance, deflated, in base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.morton import morton_codes

Array = NDArray[np.float64]

POSITION_STEPS = 65535
"""Of positions along the sides of their box."""

PLACE_STEPS = 16383
"""Of places in the atlas: 32 a texel."""

NORMAL_STEPS = 2047
"""Of unit vectors along the sides of an unfolded octahedron: 0.06 degrees."""

KINDS = {"u1": "u8", "i1": "i8", "u2": "u16", "u4": "u32", "f4": "f32"}


class Planes:
    """Collects planes of numbers for the page; `describe` says how to read what `packed` gives."""

    def __init__(self) -> None:
        self.describe: list[dict[str, Any]] = []
        self._bytes: list[bytes] = []

    def add(self, name: str, values: NDArray[Any], code: str = "plain") -> None:
        """Add numbers: as they are, or by a ``code`` that makes them small.

        ``delta`` is the difference to the number before, for what changes little; ``newest`` counts down from the first
        whole number that has not come yet, for vertices in the order of their use.
        """
        flat = np.ascontiguousarray(values).ravel()
        stored = flat
        if code == "delta":
            stored = np.diff(flat, prepend=flat[:1] * 0)
        elif code == "newest":
            known = np.maximum.accumulate(np.concatenate([[-1], flat[:-1].astype(np.int64)]))
            stored = (known + 1 - flat).astype(flat.dtype)
        self.describe.append({"name": name, "type": KINDS[flat.dtype.str[1:]], "count": len(flat), "code": code})
        self._bytes.append(stored.view(np.uint8).reshape(len(flat), -1).T.tobytes())

    def packed(self) -> str:
        """Deflate all planes."""
        return base64.b64encode(zlib.compress(b"".join(self._bytes), 9)).decode()


def octahedron(n: Array) -> Array:
    """Unfold unit vectors ``(k, 3)`` onto the square: ``(k, 2)`` in [-1, 1]."""
    n = n / np.maximum(np.abs(n).sum(axis=1, keepdims=True), 1e-30)
    folded = (1 - np.abs(n[:, 1::-1])) * np.where(n[:, :2] >= 0, 1, -1)
    return np.where(n[:, 2:] < 0, folded, n[:, :2])


def add_mesh(planes: Planes, corners: Array, normals: Array, uv: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Add a mesh whose triangles have corners, normals (t, 3, 3) and places in the unit square (t, 3, 2).

    Corners that are alike in all of them become one vertex. Triangles are put along the Morton curve and vertices in the
    order of their first use, so that neighbours in the file are neighbours in space.

    Returns
    -------
    low, size : (3,) float
        The box of the positions.
    first : (v,) int64
        A corner of each vertex, counted through all triangles.
    """
    low, size = corners.min(axis=(0, 1)), np.maximum(np.ptp(corners, axis=(0, 1)), 1e-12)
    order = np.argsort(morton_codes(corners.mean(axis=1)), kind="stable")
    position = np.rint((corners[order].reshape(-1, 3) - low) / size * POSITION_STEPS)
    normal = np.rint((octahedron(normals[order].reshape(-1, 3)) * 0.5 + 0.5) * NORMAL_STEPS)
    place = np.rint(np.clip(uv[order].reshape(-1, 2), 0, 1) * PLACE_STEPS)
    rows = np.column_stack([position, normal, place]).astype(np.uint16)
    _, first, vertex = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    by_use = np.argsort(first)
    number = np.empty(len(first), np.int64)
    number[by_use] = np.arange(len(first))
    columns = rows[first[by_use]].T
    for name, column in zip(("x", "y", "z", "nx", "ny", "u", "v"), columns, strict=True):
        planes.add(name, column, "delta")
    planes.add("triangles", number[vertex.ravel()].astype(np.uint32), "newest")
    corner = order[first[by_use] // 3] * 3 + first[by_use] % 3
    return low, size, corner
