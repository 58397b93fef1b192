"""Points drawn by area on the shapes of a body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import SceneError
from ...kernels.memory import lanes_where, upload
from ...kernels.morton import morton_codes
from ..meshes.buffers import affine, mesh_buffers, mesh_interaction, transformed_mesh, triangle_areas, triangle_corners
from ..solids import turned_faces

Parts = Sequence[tuple[mi.Shape, np.ndarray | None]]

# A way to fill the unit square: (index, count, stream, seed) -> points.
Square = Callable[[mi.UInt32, mi.UInt32, mi.UInt32, int], mi.Point2f]


@dataclass
class Sites:
    """Places on a surface: shape of the body, triangle and barycentric coordinates (meshes only), position, normal."""

    shape_index: mi.UInt32
    prim_index: mi.UInt32
    prim_uv: mi.Point2f
    p: mi.Point3f
    n: mi.Normal3f

    def __len__(self) -> int:
        return dr.width(self.p)

    def take(self, index: mi.UInt32) -> Sites:
        """Select sites by index."""
        picked = Sites(**{name: dr.gather(type(value), value, index) for name, value in vars(self).items()})
        dr.eval(*vars(picked).values())
        return picked


def join_sites(parts: Sequence[Sites]) -> Sites:
    """Put several sets of sites behind each other."""
    parts = [part for part in parts if len(part)]
    if len(parts) == 1:
        return parts[0]
    ends = np.cumsum([len(part) for part in parts])
    joined = dr.empty(Sites, int(ends[-1]))
    for part, end in zip(parts, ends.tolist(), strict=True):
        # An opaque offset, unlike that of `dr.concat`, is no part of the kernel: parts of one kind share a kernel.
        to = dr.arange(mi.UInt32, len(part)) + dr.opaque(mi.UInt32, end - len(part))
        dr.scatter(joined, part, to)
    dr.eval(*vars(joined).values())
    return joined


class MeshPiece:
    """The triangles of one mesh of a body."""

    def __init__(self, mesh: mi.Mesh, to_world: np.ndarray | None):
        self.mesh, self.to_world = mesh, to_world
        corners = triangle_corners(mesh, to_world)
        areas = triangle_areas(corners)
        self.area = float(areas.sum())
        # Triangles along a space-filling curve: what is even along the list is even in space.
        order = np.argsort(morton_codes(corners.mean(axis=1)), kind="stable")
        order = order[areas[order] > 0]
        self.order = order.astype(np.uint32)
        turned = turned_faces(*mesh_buffers(mesh))
        self.turned = None if turned is None else upload(turned.astype(np.uint32))
        """1 for triangles that are wound against the others; None where there are none."""
        self.share = np.cumsum(areas[order]) / max(self.area, np.finfo(float).tiny)
        self.cut: tuple[np.ndarray, np.ndarray] | None = None
        """Of a stretch of the list: between which numbers, the first of two, each triangle is drawn from; it ends inside of triangles."""

    def stretch(self, first: float, last: float) -> MeshPiece:
        """Take what lies between two shares of the area, along the list of triangles."""
        part = copy(self)
        part.area = self.area * (last - first)
        if not part.area > 0:
            return part
        ends = self.share / self.share[-1]
        before = np.concatenate([[0.0], ends[:-1]])
        mine = (ends > first) & (before < last)
        before, after = before[mine], ends[mine]
        size = after - before
        part.order, part.share = self.order[mine], (np.minimum(after, last) - first) / (last - first)
        part.cut = np.maximum(first - before, 0) / size, np.minimum((last - before) / size, 1)
        return part

    def draw(self, count: int, seed: int, square: Square) -> tuple[mi.UInt32, mi.Point2f, mi.Point3f, mi.Normal3f]:
        """Draw ``count`` points: every stretch of the list of triangles gets its share to within one point."""
        offset = np.random.default_rng(seed).random()
        edges = np.floor(self.share * count + offset).astype(np.int64)
        edges[-1] = count
        counts = np.diff(edges, prepend=0)
        rank = upload(np.repeat(np.arange(len(counts), dtype=np.uint32), counts))
        before = dr.gather(mi.UInt32, upload((edges - counts).astype(np.uint32)), rank)
        inside = dr.gather(mi.UInt32, upload(counts.astype(np.uint32)), rank)
        prim_index = dr.gather(mi.UInt32, upload(self.order), rank)
        u = square(dr.arange(mi.UInt32, count) - before, inside, prim_index, seed)
        if self.cut is not None:
            low, high = (dr.gather(mi.Float, upload(edge.astype(np.float32)), rank) for edge in self.cut)
            u.x = dr.lerp(low, high, u.x)
        prim_uv = mi.warp.square_to_uniform_triangle(u)
        si = mesh_interaction(self.mesh, prim_index, prim_uv)
        return prim_index, prim_uv, *to_world_frame(si.p, si.n, self.to_world)

    def for_tracing(self, name: str) -> tuple[dict, mi.Shape | None]:
        """Describe the piece for a scene of its own: its entries, and the shape that rays will hit."""
        shape = self.mesh if self.to_world is None else transformed_mesh(self.mesh, self.to_world)
        return {name: shape}, shape


class AnalyticPiece:
    """A sphere, cylinder, disk or any other shape that can draw points on itself."""

    def __init__(self, shape: mi.Shape, to_world: np.ndarray | None):
        self.shape, self.to_world = shape, to_world
        self.cut: tuple[float, float] | None = None
        """Of a strip: between which numbers, the second of two, it is drawn from."""
        # The largest factor by which the transform enlarges area, if it does so unevenly.
        self.largest: float | None = None
        try:
            self.area = self._area()
        except (RuntimeError, NotImplementedError) as error:
            kind = shape.class_name()
            raise SceneError(
                f"shape '{shape.id()}' ({kind}) cannot be sampled by area: use a mesh, sphere, cylinder or disk."
            ) from error

    def stretch(self, first: float, last: float) -> AnalyticPiece:
        """Take the strip between two shares of the numbers that the shape is drawn from."""
        part = copy(self)
        part.cut = first, last
        part.area = part._area() * (last - first)
        return part

    def _area(self) -> float:
        """Measure the shape after the transform; for a strip, as if all of it were like that."""
        area = float(self.shape.surface_area()[0])
        return area if self.to_world is None else area * self._factor(self.to_world)

    def _factor(self, to_world: np.ndarray) -> float:
        """Integrate the area factor of the transform over the shape by Gauss-Legendre; return its mean."""
        nodes, weights = np.polynomial.legendre.leggauss(128)
        x, y = np.meshgrid(0.5 * (nodes + 1), 0.5 * (nodes + 1))
        u = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
        normals = self._sample(u).n + dr.zeros(mi.Normal3f, x.size)
        factor = np.array(area_factor(normals, to_world), dtype=np.float64)
        if np.ptp(factor) > 1e-5 * factor.max():
            singular = np.linalg.svd(to_world[:3, :3], compute_uv=False)
            self.largest = float(singular[0] * singular[1])
        return float(np.sum(0.25 * np.outer(weights, weights).ravel() * factor))

    def _sample(self, u: mi.Point2f) -> mi.PositionSample3f:
        """Draw points in the space of the shape. Mitsuba turns those of a turned sphere, and forgets their normals."""
        if self.cut is not None:
            low, high = (dr.opaque(mi.Float, edge) for edge in self.cut)
            u = mi.Point2f(u.x, dr.lerp(low, high, u.y))
        sample = self.shape.sample_position(0, u)
        if self.shape.class_name() == "Sphere":
            matrix = np.array(mi.traverse(self.shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
            sample.n = to_world_frame(sample.p, sample.n, matrix)[1]
        return sample

    def draw(self, count: int, seed: int, square: Square) -> tuple[mi.UInt32, mi.Point2f, mi.Point3f, mi.Normal3f]:
        """Draw ``count`` points evenly by the area after the transform."""
        tries = count
        while True:
            index = dr.arange(mi.UInt32, tries)
            sample = self._sample(square(index, dr.opaque(mi.UInt32, tries), mi.UInt32(0), seed))
            if self.largest is None or self.to_world is None:
                break
            # Rejection: a place is kept in proportion to the factor by which the transform enlarges the area there.
            keep = area_factor(sample.n, self.to_world) > self.largest * mi.sample_tea_float32(index, seed + 1)
            kept = lanes_where(keep)
            if dr.width(kept) >= count:
                thin = np.linspace(0, dr.width(kept), count, endpoint=False).astype(np.uint32)
                sample = dr.gather(mi.PositionSample3f, sample, dr.gather(mi.UInt32, kept, mi.UInt32(thin)))
                break
            tries = int(1.1 * tries * count / max(dr.width(kept), 1)) + 16
        zero = dr.zeros(mi.UInt32, count)
        p, n = to_world_frame(sample.p, sample.n, self.to_world)
        return zero, dr.zeros(mi.Point2f, count), p + dr.zeros(mi.Point3f, count), n + dr.zeros(mi.Normal3f, count)

    def for_tracing(self, name: str) -> tuple[dict, mi.Shape | None]:
        """Describe the piece for a scene of its own: its entries, and the shape that rays hit; None for an instance."""
        if self.to_world is None:
            return {name: self.shape}, self.shape
        group = f"{name}_group"
        instance = {"type": "instance", "group": {"type": "ref", "id": group}}
        instance["to_world"] = mi.ScalarTransform4f(self.to_world.tolist())
        return {group: {"type": "shapegroup", "shape": self.shape}, name: instance}, None


class Surface:
    """The whole surface of a body: its ``area`` [scene units squared] and longest side, ``extent`` [scene units].

    Parameters
    ----------
    parts
        The shapes of the body, each with the (4, 4) matrix of its instance or None.
    side
        Of the normals, 1 or -1, where light is looked for on an open surface; 0 for the outside of a closed one.

    Raises
    ------
    SceneError
        When there is no surface, or one that cannot be sampled by area.
    """

    def __init__(self, parts: Parts, side: int = 0):
        self.side = side
        self.whole: Surface | None = None
        """What this is a stretch of."""
        if not parts:
            raise SceneError("the body has no shapes: give it at least one.")
        shapes = [shape for shape, _ in parts]
        matrices = [None if m is None else np.asarray(getattr(m, "matrix", m), dtype=np.float64) for _, m in parts]
        self.pieces: list[MeshPiece | AnalyticPiece] = [
            (MeshPiece if shape.is_mesh() else AnalyticPiece)(shape, matrix)
            for shape, matrix in zip(shapes, matrices, strict=True)
        ]
        self.area = float(sum(piece.area for piece in self.pieces))
        corners = np.concatenate([_box_corners(*part) for part in zip(shapes, matrices, strict=True)])
        self.extent = float(np.ptp(corners, axis=0).max())
        if not self.area > 0:
            raise SceneError(
                "the body has no surface: all of its triangles have zero area; give it a mesh with an extent."
            )

    def stretch(self, first: float, last: float) -> Surface:
        """Take what lies between two shares of the area, 0 to 1, along the list of shapes.

        On a mesh it is compact, for its triangles lie along a space-filling curve.
        """
        if (first, last) == (0, 1):
            return self
        part, before = copy(self), 0.0
        part.whole, part.pieces = self, []
        for piece in self.pieces:
            share = piece.area / self.area
            ends = ((edge - before) / share if share else 0.0 for edge in (first, last))
            part.pieces.append(piece.stretch(*(min(max(end, 0.0), 1.0) for end in ends)))
            before += share
        part.area = float(sum(piece.area for piece in part.pieces))
        return part

    def draw(self, count: int, seed: int, square: Square) -> Sites:
        """Draw ``count`` points by area over all shapes; ``square`` spreads those of one triangle or shape."""
        share = np.cumsum([piece.area for piece in self.pieces]) / self.area
        edges = np.floor(share * count + np.random.default_rng([seed, 1]).random()).astype(int)
        edges[-1] = count
        sets = []
        for k, (piece, number) in enumerate(zip(self.pieces, np.diff(edges, prepend=0).tolist(), strict=True)):
            if number:
                prim_index, prim_uv, p, n = piece.draw(number, seed * 1009 + k, square)
                sets.append(Sites(dr.opaque(mi.UInt32, k, number), prim_index, prim_uv, p, n))
        return join_sites(sets)

    def alike(self, sites: Sites) -> Sites:
        """Turn the normals of sites of a closed surface where a mesh is wound the other way than most of it."""
        if self.side != 0:
            return sites
        side = mi.Float(1)
        for k, piece in enumerate(self.pieces):
            if isinstance(piece, MeshPiece) and piece.turned is not None:
                here = sites.shape_index == k
                side *= 1 - 2 * mi.Float(dr.gather(mi.UInt32, piece.turned, sites.prim_index, here))
        return replace(sites, n=mi.Normal3f(sites.n * side)) if dr.width(side) > 1 else sites


def _box_corners(shape: mi.Shape, to_world: np.ndarray | None) -> np.ndarray:
    """Return the corners of the box around a shape after the transform, (8, 3) float64."""
    box = shape.bbox()
    ends = np.array([box.min, box.max], dtype=np.float64).reshape(2, 3)
    corners = ends[np.indices((2, 2, 2)).reshape(3, 8).T, np.arange(3)]
    return corners if to_world is None else corners @ to_world[:3, :3].T + to_world[:3, 3]


def area_factor(n: mi.Normal3f, to_world: np.ndarray) -> mi.Float:
    """Return how much a transform M enlarges a piece of surface with unit normal n: |det M| |M^-T n|."""
    m = to_world[:3, :3]
    cofactor = mi.Matrix3f((np.linalg.inv(m).T * abs(np.linalg.det(m))).tolist())
    return dr.norm(cofactor @ mi.Vector3f(n))


def to_world_frame(p: mi.Point3f, n: mi.Normal3f, to_world: np.ndarray | None) -> tuple[mi.Point3f, mi.Normal3f]:
    """Carry points and normals from the space of a shape to that of its body."""
    if to_world is None:
        return p, n
    transform = affine(to_world)
    return transform @ p, dr.normalize(transform @ n)
