"""An atlas: a bijection between the surface of a body and part of the unit square."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from ..bodies import Body
from ..meshes.buffers import mesh_interaction, triangle_areas, triangle_corners
from ..samples.draw import MeshPiece, Surface
from .clipping import Fragments, cut_triangles
from .unwrapping import HALVES, UnwrapError, by_triangles, by_uvunwrap, by_xatlas, charts_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OWN = "its own coordinates"

# At most this part of a surface may lie in a texel that stands for another place, or have no area in the square.
MISPLACED = 1e-3

# The part of a surface that may be stretched at will: the tips and slits of otherwise good texture coordinates.
TIPS = 0.01


@dataclass
class Atlas:
    """The surface of a body, laid out as t triangles in the unit square.

    Meshes bring their triangles, any other shape the two halves of the square that its even map takes to its surface.

    Attributes
    ----------
    surface : Surface
        The shapes of the body.
    resolution : int
        Texels along each side, which charts keep apart.
    piece, prim : (t,) int64
        Which of ``surface.pieces``, and which triangle of it, or which half of its square.
    uv : (t, 3, 2) float64
        Where the corners lie in the unit square.
    chart : (t,) int64
        Which connected part of the layout.
    area_surface, area_texture : (t,) float64
        A_S [scene units squared] and A_T [unit square] of CLHHC08 eq. 6.
    fragments : Fragments
        The triangles, cut into texels.
    notes : list of str
        What was decided, and why.
    """

    surface: Surface
    resolution: int
    piece: Index
    prim: Index
    uv: Array
    chart: Index
    area_surface: Array
    area_texture: Array
    fragments: Fragments
    notes: list[str]


@dataclass
class _Triangles:
    """The triangles of a body before they are laid out: as in `Atlas`, and ``corners`` (t, 3, 3), ``own`` (t, 3, 2) or None."""

    piece: Index
    prim: Index
    area: Array
    corners: Array
    own: Array | None


def build_atlas(body: Body, resolution: int = 1024, stretch: float = 4.0, largest_chart: float = 0.0) -> Atlas:
    """Lay the surface of a body out in the unit square, so that a texel stands for one place and areas stay alike.

    The texture coordinates of its meshes serve if they are a bijection and keep areas well enough; else the surface is
    unwrapped by uvunwrap, or if that fails by xatlas, or if that fails too triangle by triangle. The own coordinates of a
    shape that is no mesh are those of its even map.

    Parameters
    ----------
    body : Body
        Its shapes are laid out together.
    resolution : int
        Texels along each side of the square.
    stretch : float
        Own texture coordinates are given up if more than a hundredth of the surface has texels that stand for more than
        so many times ``area / resolution^2``. With ``inf`` any bijection is kept, however it distorts; with 0 none.
    largest_chart : float
        Share of the surface that a chart of uvunwrap has at most, 0 for no limit: small charts are found in less time, and what is
        spread evenly over the square is a little less even on the surface.

    Raises
    ------
    SceneError
        For a resolution below 1, and for shapes without a surface or that cannot be sampled by area.

    Source: CLHHC08 section 2.2.
    """
    if resolution < 1:
        raise SceneError(f"the resolution of an atlas is its texels along each side, at least 1; found {resolution}.")
    surface = body.surface()
    triangles = _triangles(surface)
    notes: list[str] = []
    for method, uv, chart in _layouts(triangles, resolution, largest_chart, notes):
        area_texture = triangle_areas(np.pad(uv, ((0, 0), (0, 0), (0, 1))))
        fragments = cut_triangles(uv, resolution)
        limit = stretch if method == OWN else np.inf
        problem = _problem(triangles.area, area_texture, chart, fragments, limit)
        if problem is None:
            break
        notes.append(f"{method}: {problem}")
    notes.append(f"laid out by {method}")
    return Atlas(
        surface,
        resolution,
        triangles.piece,
        triangles.prim,
        uv,
        chart,
        triangles.area,
        area_texture,
        fragments,
        notes,
    )


def _triangles(surface: Surface) -> _Triangles:
    """List the triangles of all shapes that have an area."""
    corners: list[Array] = []
    own: list[Array | None] = []
    areas: list[Array] = []
    beside = 0.0
    for piece in surface.pieces:
        if isinstance(piece, MeshPiece):
            corners.append(triangle_corners(piece.mesh, piece.to_world))
            areas.append(triangle_areas(corners[-1]))
            own.append(_texture_coordinates(piece.mesh, len(corners[-1])))
        else:
            # A square of the same area stands for the shape; no two of them touch each other.
            side = np.sqrt(piece.area)
            corners.append(np.pad(HALVES * side + np.array([beside, 0]), ((0, 0), (0, 0), (0, 1))))
            beside += 2 * side
            areas.append(np.full(2, piece.area / 2))
            own.append(HALVES)
    counts = [len(c) for c in corners]
    area = np.concatenate(areas)
    keep = area > 0
    given = [uv for uv in own if uv is not None]
    return _Triangles(
        np.repeat(np.arange(len(counts)), counts)[keep],
        np.concatenate([np.arange(count) for count in counts])[keep],
        area[keep],
        np.concatenate(corners)[keep],
        np.concatenate(given)[keep] if len(given) == len(own) else None,
    )


def _texture_coordinates(mesh: mi.Mesh, count: int) -> Array | None:
    """Read the texture coordinates of the corners of all triangles, (t, 3, 2); None where a mesh has none."""
    if not mesh.has_vertex_texcoords():
        return None
    corner = dr.arange(mi.UInt32, 3 * count)
    which = corner % 3
    prim_uv = mi.Point2f(mi.Float(which == 1), mi.Float(which == 2))
    si = mesh_interaction(mesh, corner // 3, prim_uv)
    return np.asarray(si.uv.numpy(), float).T.reshape(count, 3, 2)


def _layouts(
    triangles: _Triangles, resolution: int, largest_chart: float, notes: list[str]
) -> Iterator[tuple[str, Array, Index]]:
    """Offer layouts, the best first: what made it, uv and chart of every triangle."""
    own = triangles.own
    if own is not None:
        # Coordinates at the border may be rounded.
        if np.all(np.abs(own - 0.5) <= 0.5 + 1e-6):
            yield OWN, own, charts_of(triangles.corners, own)
        else:
            notes.append(f"{OWN}: they leave the unit square")
    for name, method in (("uvunwrap", partial(by_uvunwrap, largest_chart=largest_chart)), ("xatlas", by_xatlas)):
        try:
            yield name, *method(triangles.corners, resolution)
        except UnwrapError as error:
            notes.append(f"{name}: {error}")
    yield "triangles, which share texels", *by_triangles(triangles.corners)


def _problem(area: Array, area_texture: Array, chart: Index, fragments: Fragments, stretch: float) -> str | None:
    """Say why a layout is no bijection, or stretches too much; None for a good one."""
    total = area.sum()
    flat = float(area[fragments.triangle[fragments.area == 0]].sum() / total)
    if not flat <= MISPLACED:
        return f"{flat:.1%} of the surface has no area in the square"
    covered = np.bincount(fragments.texel, fragments.area)
    double = float(np.maximum(covered - 1, 0).sum() / covered.sum())
    if double > MISPLACED:
        return f"{double:.1%} of them overlap"
    shared = _shared(area, chart, fragments)
    if shared > MISPLACED:
        return f"{shared:.1%} of the surface is in texels of other charts"
    order = np.argsort(area_texture / area)
    tip = order[np.searchsorted(np.cumsum(area[order]), TIPS * total)]
    worst = float(area[tip] / area_texture[tip] / total) if area_texture[tip] > 0 else np.inf
    if worst > stretch:
        return f"texels that stand for {worst:.3g} times area / resolution^2"
    return None


def _shared(area: Array, chart: Index, fragments: Fragments) -> float:
    """Measure the part of the surface that lies in a texel together with more of another chart."""
    main = chart[fragments.triangle[largest_in_texel(fragments.texel, fragments.area)]]
    other = main[fragments.texel] != chart[fragments.triangle]
    mass = fragment_areas(area, fragments)
    return float(mass[other].sum() / area.sum())


def fragment_areas(area: Array, fragments: Fragments) -> Array:
    """Divide the ``area`` (t,) of triangles among their fragments: all of it, in proportion to theirs."""
    whole = np.bincount(fragments.triangle, fragments.area, minlength=len(area))
    flat = whole == 0
    return area[fragments.triangle] * np.divide(
        fragments.area, whole[fragments.triangle], out=np.ones_like(fragments.area), where=~flat[fragments.triangle]
    )


def largest_in_texel(texel: Index, value: Array) -> Index:
    """Find the fragment with the largest value in every texel, the first of equals: (texels,) index, 0 for empty ones."""
    most = np.full(int(texel.max()) + 1, -np.inf)
    np.maximum.at(most, texel, value)
    best = np.flatnonzero(value == most[texel])[::-1]
    index = np.zeros(len(most), np.int64)
    index[texel[best]] = best
    return index
