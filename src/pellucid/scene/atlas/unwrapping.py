"""Triangles in space become charts in the unit square: by one of two libraries, or each on its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...kernels.morton import deinterleave, morton_codes
from ..meshes.buffers import triangle_areas
from ..meshes.repair import weld

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# The unit square as two triangles.
HALVES = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)

# Empty texels around a chart, so that no texel has a part of two.
PADDING = 1

# Charts are split where triangles would change their area by more than this.
AREA_DISTORTION = 1.5


# A separate piece of a mesh takes no fewer, with the empty ones around it.
FEWEST_TEXELS = 16

# xatlas takes a minute for so many triangles, and more than twice as long for twice as many.
XATLAS_LIMIT = 100_000

# The smallest square that holds two triangles has a side of 1/2 to this power.
SMALLEST = 16


class UnwrapError(Exception):
    """A library could not lay a surface out; the text says why."""


def by_uvunwrap(corners: Array, resolution: int, largest_chart: float = 0.0) -> tuple[Array, Index]:
    """Lay triangles out with uvunwrap.

    Parameters
    ----------
    corners : (t, 3, 3) float
        Triangles in space.
    resolution : int
        Texels along each side of the square, which charts keep apart.
    largest_chart : float
        Share of the surface that a chart has at most, 0 for no limit. Large ones take most of the time.

    Returns
    -------
    uv : (t, 3, 2) float64
        Their corners in the unit square.
    chart : (t,) int64
        The chart of each triangle.

    Raises
    ------
    UnwrapError
        When the library gives up.
    """
    import uvunwrap

    vertices, faces = _indexed(corners, resolution)
    # The other way to pack gains a tenth of the square, and takes a minute for ten thousand charts.
    options = {"packing": "fast", "padding": PADDING, "max_area_distortion": AREA_DISTORTION}
    options["max_chart_area"] = largest_chart  # of the whole, which has an area of one
    try:
        atlas = uvunwrap.generate([uvunwrap.Mesh(vertices, faces)], page_size=resolution, **options)
    except uvunwrap.UnwrapError as error:
        raise UnwrapError(" ".join(str(error).split())) from error
    if atlas.page_count != 1:
        raise UnwrapError(
            f"{atlas.chart_count} charts fill {atlas.page_count} squares of {resolution} x {resolution} texels"
        )
    mesh = atlas.meshes[0]
    uv = np.array(mesh.corner_uvs, float).reshape(-1, 3, 2) * (atlas.width, atlas.height)
    chart = np.array(mesh.chart, np.int64)[np.array(mesh.indices, np.int64).reshape(-1, 3)[:, 0]]
    return uv / max(atlas.width, atlas.height), chart


def by_xatlas(corners: Array, resolution: int) -> tuple[Array, Index]:
    """Lay triangles out with xatlas; parameters, result and errors as for `by_uvunwrap`."""
    import xatlas

    if len(corners) > XATLAS_LIMIT:
        raise UnwrapError(f"{len(corners):,} triangles would take it minutes")
    vertices, faces = _indexed(corners, resolution)
    packing = xatlas.PackOptions()
    packing.padding = PADDING + 1  # what is left of it when the page comes out larger than asked for
    packing.texels_per_unit = 0.7 * resolution
    atlas = xatlas.Atlas()
    try:
        atlas.add_mesh(vertices, faces)
        atlas.generate(pack_options=packing)
    except RuntimeError as error:
        raise UnwrapError(" ".join(str(error).split())) from error
    if atlas.atlas_count != 1:
        raise UnwrapError(f"charts fill {atlas.atlas_count} squares")
    _, indices, uv = atlas.get_mesh(0)
    indices = indices.astype(np.int64)
    uv = uv.astype(float)[indices] * (atlas.width, atlas.height) / max(atlas.width, atlas.height)
    return uv, components(indices)


def by_triangles(corners: Array) -> tuple[Array, Index]:
    """Give each pair of triangles a square of about its area; parameters and result as for `by_uvunwrap`, one chart.

    Sides are powers of 1/2. The largest squares come first along Morton's curve, which leaves no gaps between them, and
    equal ones in the order of the same curve in space: who shares a texel is near in space, most often.
    """
    area = triangle_areas(corners)
    share = area / area.sum()
    scale = 4.0
    while True:
        level = np.clip(np.ceil(-np.log2(2 * scale * share) / 2), 0, SMALLEST).astype(np.int64)
        order = np.lexsort((morton_codes(corners.mean(axis=1)), level))
        ordered = level[order]
        rank = np.arange(len(order)) - np.searchsorted(ordered, ordered)
        side = 1 << (SMALLEST - ordered)
        # The first of a pair moves on by a square, in units of the smallest.
        before = np.cumsum(np.where(rank % 2 == 0, side**2, 0)) - side**2
        if before[-1] + side[-1] ** 2 <= 4**SMALLEST:
            break
        scale /= 2
    x, y = deinterleave(before.astype(np.uint32))
    half = HALVES[rank % 2]
    uv = np.empty((len(corners), 3, 2))
    uv[order] = (np.stack([x, y], axis=-1)[:, None] + half * side[:, None, None]) / 2**SMALLEST
    return uv, np.zeros(len(corners), np.int64)


def charts_of(corners: Array, uv: Array) -> Index:
    """Number the charts of triangles, (t,) int: those that share corners both in space (t, 3, 3) and in texture (t, 3, 2)."""
    point = weld(corners.reshape(-1, 3))
    joint = weld(np.column_stack([uv.reshape(-1, 2), point / max(int(point.max()), 1)]))
    return components(joint.reshape(-1, 3))


def components(faces: Index) -> Index:
    """Number the connected parts of triangles, (t,) int, from their vertex numbers (t, 3)."""
    size = int(faces.max()) + 1
    start, end = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_array((np.ones(len(start), bool), (start, end)), shape=(size, size))
    return connected_components(graph, directed=False)[1][faces[:, 0]].astype(np.int64)


def _indexed(corners: Array, resolution: int) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Join corners at the same place, and scale the whole to an area of one, since the libraries have tolerances."""
    flat = corners.reshape(-1, 3)
    point = weld(flat)
    pieces = int(components(point.reshape(-1, 3)).max()) + 1
    if pieces * FEWEST_TEXELS > resolution**2:
        raise UnwrapError(f"{pieces:,} separate pieces are too many for {resolution} x {resolution} texels")
    unit = np.sqrt(triangle_areas(corners).sum())
    vertices = np.empty((int(point.max()) + 1, 3), np.float32)
    vertices[point] = (flat - flat.mean(axis=0)) / unit
    return vertices, point.reshape(-1, 3).astype(np.uint32)
