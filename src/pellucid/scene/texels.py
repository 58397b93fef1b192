"""Texels of an atlas as surface samples: where on the surface each lies, and how much of it it stands for."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .atlas import SQUARE, Atlas, fragment_areas, largest_in_texel
from .meshes import mesh_interaction
from .sampling_draw import AnalyticPiece, MeshPiece, Sites, area_factor, join_sites, to_world_frame
from .surface import SurfaceSamples, _describe

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
        ``row * resolution + column``, ascending; column along u and row along v of the atlas.
    resolution : int
        Texels along each side.
    """

    samples: SurfaceSamples
    texel: NDArray[np.uint32]
    resolution: int


def rasterise(atlas: Atlas) -> Texels:
    """Turn texels into surface samples: each with all of the surface inside it, at the centre of its largest piece.

    No part of the surface is lost, however small its triangle: the areas add up to that of the surface.

    Returns
    -------
    Texels
        In the space of the scene.

    Source: CLHHC08 section 3 (position map), eqs. 6-7.
    """
    fragments = atlas.fragments
    area = fragment_areas(atlas.area_surface, fragments)
    place = fragments.centre / atlas.resolution
    for k, piece in enumerate(atlas.surface.pieces):
        if isinstance(piece, AnalyticPiece) and piece.to_world is not None and piece.largest is not None:
            rows = np.flatnonzero(atlas.piece[fragments.triangle] == k)
            inside = _inside(atlas, fragments.triangle[rows], place[rows])
            _, n = _on_shape(piece, _square(atlas.prim[fragments.triangle[rows]], inside))
            factor = np.array(area_factor(n, piece.to_world), dtype=float)
            area[rows] *= factor / np.average(factor, weights=area[rows])
    texel = np.unique(fragments.texel)
    chosen = largest_in_texel(fragments.texel, area)[texel]
    described = _describe_places(atlas, fragments.triangle[chosen], place[chosen])
    mass = np.bincount(fragments.texel, area)[texel]
    samples = SurfaceSamples(area=mass.astype(np.float32), violations=0, candidates=1.0, **described)
    return Texels(samples, texel.astype(np.uint32), atlas.resolution)


def _describe_places(atlas: Atlas, triangle: Index, place: Array) -> dict[str, np.ndarray]:
    """Describe places of the unit square (n, 2) that lie in triangles (n,): fields of `SurfaceSamples`."""
    piece = atlas.piece[triangle]
    by_piece = np.argsort(piece, kind="stable")
    parts = []
    for k in np.unique(piece):
        rows = by_piece[piece[by_piece] == k]
        u = _inside(atlas, triangle[rows], place[rows])
        parts.append(_sites(atlas.surface.pieces[k], k, atlas.prim[triangle[rows]], u))
    described = _describe(atlas.surface, join_sites(parts))
    back = np.argsort(by_piece)
    return {name: values[back] for name, values in described.items()}


def _inside(atlas: Atlas, triangle: Index, place: Array) -> Array:
    """Turn places of the unit square (n, 2) into barycentric coordinates of their triangles' second and third corners, (n, 2)."""
    origin = atlas.uv[triangle, 0]
    a, b, d = atlas.uv[triangle, 1] - origin, atlas.uv[triangle, 2] - origin, place - origin
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    inverse = np.divide(1, twice, out=np.zeros_like(twice), where=twice != 0)
    second = np.clip((d[:, 0] * b[:, 1] - d[:, 1] * b[:, 0]) * inverse, 0, 1)
    third = np.clip((a[:, 0] * d[:, 1] - a[:, 1] * d[:, 0]) * inverse, 0, 1 - second)
    middle = (twice == 0)[:, None]
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
    corner = SQUARE[prim]
    return corner[:, 0] + inside[:, :1] * (corner[:, 1] - corner[:, 0]) + inside[:, 1:] * (corner[:, 2] - corner[:, 0])


def _on_shape(piece: AnalyticPiece, u: Array) -> tuple[mi.Point3f, mi.Normal3f]:
    """Find where the even map of a shape takes points (n, 2) of the unit square, in the space of the shape, and the normals there."""
    points = mi.Point2f(np.ascontiguousarray(u.T, np.float32)) + dr.opaque(mi.Float, 0)
    _, _, p, n = AnalyticPiece(piece.shape, None).draw(len(u), 0, lambda *_: points)
    return p, n
