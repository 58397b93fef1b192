"""Texels of an atlas as surface samples: where on the surface each lies, and how much of it it stands for."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...kernels.morton import interleave
from ..meshes.buffers import mesh_interaction
from ..samples.draw import AnalyticPiece, MeshPiece, Sites, area_factor, join_sites, to_world_frame
from ..samples.surface import SurfaceSamples, make_samples
from .clipping import Fragments
from .layout import Atlas, fragment_areas, largest_in_texel
from .unwrapping import HALVES

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass
class Texels:
    """The texels of an atlas that are covered, n of them.

    Attributes
    ----------
    samples : SurfaceSamples
        One for each texel, in the order of ``texel``. Irradiance times ``area`` is the flux through the texel, E' of
        CLHHC08 eq. 7 times the area of the texel.
    texel : (n,) uint32
        ``row * resolution + column``; column along u and row along v of the atlas. Along the Morton curve: what follows each
        other is near in both directions, and rays from there keep together.
    resolution : int
        Texels along each side.
    """

    samples: SurfaceSamples
    texel: NDArray[np.uint32]
    resolution: int


def rasterise(atlas: Atlas) -> Texels:
    """Turn texels into surface samples: each with all of the surface inside it, at its centre of mass.

    No part of the surface is lost, however small its triangle: the areas add up to that of the surface.

    Returns
    -------
    Texels
        In the space of the scene.

    Source: CLHHC08 section 3 (position map), eqs. 6-7.
    """
    fragments = atlas.fragments
    area = fragment_areas(atlas.area_surface, fragments)
    for k, piece in enumerate(atlas.surface.pieces):
        if isinstance(piece, AnalyticPiece) and piece.to_world is not None and piece.largest is not None:
            rows = np.flatnonzero(atlas.piece[fragments.triangle] == k)
            triangle = fragments.triangle[rows]
            inside = _inside(atlas, triangle, fragments.centre[rows] / atlas.resolution)
            _, n = _on_shape(piece, _square(atlas.prim[triangle], inside))
            factor = np.array(area_factor(n, piece.to_world), dtype=float)
            area[rows] *= factor / np.average(factor, weights=area[rows])
    texels: Array = np.bincount(fragments.texel, area).astype(float)
    covered = np.flatnonzero(texels)
    row, column = np.divmod(covered.astype(np.uint32), np.uint32(atlas.resolution))
    covered = covered[np.argsort(interleave(column, row))]
    chosen, place = _places(fragments, area, texels)
    places = fragments.triangle[chosen[covered]], place[covered] / atlas.resolution
    samples = _samples(atlas, *places, texels[covered].astype(np.float32))
    return Texels(samples, covered.astype(np.uint32), atlas.resolution)


def _places(fragments: Fragments, area: Array, texels: Array) -> tuple[Index, Array]:
    """Find where in each texel its surface is on average, (texels, 2), and the fragment that is the nearest to there."""
    mass = np.maximum(texels, np.finfo(float).tiny)
    place = np.stack([np.bincount(fragments.texel, area * x) / mass for x in fragments.centre.T], axis=-1)
    away = np.sum((fragments.centre - place[fragments.texel]) ** 2, axis=-1)
    return largest_in_texel(fragments.texel, -away), place


def _samples(atlas: Atlas, triangle: Index, place: Array, area: NDArray[np.float32]) -> SurfaceSamples:
    """Make samples of places of the unit square (n, 2) that lie in triangles (n,) and stand for areas (n,)."""
    inside, prim, piece = _inside(atlas, triangle, place), atlas.prim[triangle], atlas.piece[triangle]
    rows = [np.flatnonzero(piece == k) for k in range(len(atlas.surface.pieces))]
    parts = zip(atlas.surface.pieces, rows, strict=True)
    sites = [_sites(part, k, prim[some], inside[some]) for k, (part, some) in enumerate(parts) if len(some)]
    order = np.concatenate(rows)
    return make_samples(atlas.surface, join_sites(sites), area[order]).take(np.argsort(order))


def _inside(atlas: Atlas, triangle: Index, place: Array) -> Array:
    """Turn places of the unit square (n, 2) into barycentric coordinates of their triangles' second and third corners, (n, 2)."""
    edges = atlas.uv[:, 1:] - atlas.uv[:, :1]
    (a, b), (c, d) = edges[:, 0].T, edges[:, 1].T
    twice = a * d - b * c
    inverse = np.divide(1, twice, out=np.zeros_like(twice), where=twice != 0)
    rows = np.column_stack([atlas.uv[:, 0], d * inverse, -c * inverse, -b * inverse, a * inverse, twice == 0])[triangle]
    x, y = (place - rows[:, :2]).T
    second = np.clip(rows[:, 2] * x + rows[:, 3] * y, 0, 1)
    third = np.clip(rows[:, 4] * x + rows[:, 5] * y, 0, 1 - second)
    middle = rows[:, 6:] != 0
    return np.where(middle, 1 / 3, np.stack([second, third], axis=-1))


def _sites(piece: MeshPiece | AnalyticPiece, number: int, prim: Index, inside: Array) -> Sites:
    """Find places given by triangle and barycentric coordinates on the surface of a piece."""
    zero = dr.opaque(mi.UInt32, 0)  # an array straight from NumPy may compile the kernel that reads it anew
    if isinstance(piece, MeshPiece):
        prim_index = mi.UInt32(prim.astype(np.uint32)) + zero
        prim_uv = mi.Point2f(np.ascontiguousarray(inside.T, np.float32)) + mi.Float(zero)
        si = mesh_interaction(piece.mesh, prim_index, prim_uv)
        p, n = to_world_frame(si.p, si.n, piece.to_world)
    else:
        prim_index, prim_uv = dr.zeros(mi.UInt32, len(prim)), dr.zeros(mi.Point2f, len(prim))
        p, n = to_world_frame(*_on_shape(piece, _square(prim, inside)), piece.to_world)
    return Sites(dr.opaque(mi.UInt32, int(number), len(prim)), prim_index, prim_uv, p, n)


def _square(prim: Index, inside: Array) -> Array:
    """Turn barycentric coordinates in the halves of the unit square into its coordinates, (n, 2)."""
    corner = HALVES[prim]
    return corner[:, 0] + inside[:, :1] * (corner[:, 1] - corner[:, 0]) + inside[:, 1:] * (corner[:, 2] - corner[:, 0])


def _on_shape(piece: AnalyticPiece, u: Array) -> tuple[mi.Point3f, mi.Normal3f]:
    """Find where the even map of a shape takes points (n, 2) of the unit square, in the space of the shape, and the normals there."""
    if piece.shape.class_name() == "Sphere":
        u = _by_octahedron(u)
    points = mi.Point2f(np.ascontiguousarray(u.T, np.float32)) + dr.opaque(mi.Float, 0)
    _, _, p, n = AnalyticPiece(piece.shape, None).draw(len(u), 0, lambda *_: points)
    return p, n


def _by_octahedron(u: Array) -> Array:
    """Rearrange the unit square, evenly, so that texels of a sphere are about as long as wide.

    Mitsuba takes u to the longitude and v to the height, and the rows at the poles to long rings. Here points (n, 2) go to
    the sphere by way of an unfolded octahedron, and are then given as longitude and height.

    Source: P. Clarberg, Fast equal-area mapping of the (hemi)sphere using SIMD, Journal of Graphics Tools 13(3), 2008.
    """
    x, y = 2 * u.T - 1
    beyond = 1 - np.abs(x) - np.abs(y)
    r = 1 - np.abs(beyond)
    quarter = np.divide(np.abs(y) - np.abs(x), r, out=np.zeros_like(r), where=r > 0) + 1
    longitude = np.arctan2(np.copysign(np.sin(quarter * np.pi / 4), y), np.copysign(np.cos(quarter * np.pi / 4), x))
    height = np.copysign(1 - r**2, beyond)
    return np.stack([longitude / (2 * np.pi) % 1, (1 - height) / 2], axis=-1)
