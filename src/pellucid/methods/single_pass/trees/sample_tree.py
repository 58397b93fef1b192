"""The irradiance samples of a prototype and their binary tree, on the device; and where the copies of a prototype stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....gather.moments import PAIRS, disks
from ....kernels.memory import aligned, hand_over, upload
from ....light.direct import receivers
from ....scene.samples.surface import SurfaceSamples
from .binary import BLOCK, BinaryTree, boxes, build_binary_tree, by_blocks, level_of, sum_up

NODE_FLOAT4S, SAMPLE_FLOAT4S, WALK_FLOAT4S, PLACE_FLOAT4S = 3, 5, 3, 3

TURN = 0.7
"""How much normals count in clustering samples: the two sides of a thin wall are kept apart, since their light differs."""


@dataclass
class SampleTree:
    """Samples in the order of the leaves, and bounds of their clusters; in the space of the prototype.

    Attributes
    ----------
    p, area, colour : (n, 3), (n,), (n, 3) float32
        On the host: positions [scene units], areas [scene units squared], and what a texture multiplies the light with.
    colours : Float or None
        A float4 a node, its mean colour; none without a texture.
    samples : Float
        Five float4s a sample: (p, area), where shadow rays start (p_smooth, 0), (n, 0), (sh_n, 0), (colour, 0). Normals
        point to where light comes from.
    strength : Float
        Summed area of each node.
    tree : BinaryTree
        The same on the host.
    """

    p: NDArray[np.float32]
    area: NDArray[np.float32]
    colour: NDArray[np.float32]
    colours: mi.Float | None
    samples: mi.Float
    strength: mi.Float
    tree: BinaryTree

    @property
    def depth(self) -> int:
        """Levels below the root."""
        return self.tree.depth

    @property
    def leaves(self) -> int:
        """Number of leaves, and of the first of them."""
        return self.tree.leaves

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.tree.count

    @property
    def nbytes(self) -> int:
        """Bytes in use, on host and device."""
        there = (self.colours, self.samples, self.strength, vars(self).get("nodes"))
        device = 4 * sum(len(array) for array in there if array is not None)
        return self.p.nbytes + self.area.nbytes + self.colour.nbytes + self.tree.nbytes + device

    @cached_property
    def nodes(self) -> mi.Float:
        """Lay out the bounds of each node as three float4s: sphere (centre, radius), cone of normals (axis, cosine), half its box."""
        nodes = np.zeros((2 * self.leaves, NODE_FLOAT4S, 4), np.float32)
        nodes[:, 0, :3], nodes[:, 0, 3] = self.tree.centre, self.tree.radius
        nodes[:, 1, :3], nodes[:, 1, 3] = self.tree.axis, self.tree.cos_cone
        nodes[:, 2, :3] = boxes(self.p, self.depth)
        return upload(nodes, mi.Float)

    def members(self, node: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Give the first of the samples of each node, in the order of the leaves, and the one behind the last."""
        shift = self.depth - level_of(node)
        first = (np.asarray(node, np.int64) << shift) - self.leaves
        return first, np.minimum(first + (1 << shift), self.count)

    def receiver(self, leaf: Any, placement: Placement, instance: Any, active: Any = True) -> mi.SurfaceInteraction3f:
        """Describe the place of samples in the world, where shadow rays start.

        Parameters
        ----------
        leaf : UInt32
            Their numbers, in the order of the leaves.
        placement, instance : Placement, UInt32
            Where the copies of the prototype are, and which of them.
        """
        first = leaf * SAMPLE_FLOAT4S
        p, n, sh_n = (dr.gather(mi.Array4f, self.samples, first + k, active) for k in (1, 2, 3))
        return receivers(
            placement.point(instance, mi.Point3f(p.x, p.y, p.z), active),
            placement.normal(instance, mi.Normal3f(n.x, n.y, n.z), active),
            placement.normal(instance, mi.Normal3f(sh_n.x, sh_n.y, sh_n.z), active),
        )


def build_sample_tree(samples: SurfaceSamples, colour: NDArray | None = None) -> SampleTree:
    """Cluster the samples of a prototype.

    Parameters
    ----------
    samples : SurfaceSamples
        In the space of the prototype.
    colour : (n, 3) float, optional
        Texture over its mean, by sample; 1 without.
    """

    p, area = samples.p, samples.area
    n, sh_n = samples.outside * samples.n, samples.outside * samples.sh_n
    tree = build_binary_tree(p, sh_n, area, TURN)
    table = aligned((len(p), SAMPLE_FLOAT4S, 4))
    table[:, 1:, 3] = 0
    table[:, 0, 3] = area[tree.order]
    for k, values in enumerate((p, samples.ray_start(), n, sh_n)):
        table[:, k, :3] = values[tree.order]
    table[:, 4, :3] = 1 if colour is None else colour[tree.order]
    colours = None
    if colour is not None:
        colours = np.zeros((2 * tree.leaves, 4), np.float32)
        sums = sum_up(table[:, 0, 3:] * table[:, 4, :3], tree.depth)
        colours[:, :3] = sums / np.maximum(tree.strength, 1e-300)[:, None]
    return SampleTree(
        p=table[:, 0, :3].copy(),
        area=table[:, 0, 3].copy(),
        colour=table[:, 4, :3].copy(),
        colours=None if colours is None else upload(colours, mi.Float),
        samples=hand_over(table, mi.Float),
        strength=upload(tree.strength.astype(np.float32), mi.Float),
        tree=tree,
    )


def walk_records(samples: SampleTree, max_error: float, reach: Callable[[NDArray], NDArray]) -> mi.Float:
    """Lay out what a walk by distance reads: (centroid, squared opening distance), (spread v, c) and (area, squared distance of
    what is negligible, squared distance of what covers it, 0) of every node.

    As in the octree (docs/theory/tree.md), a cluster of area A may stand for its members where its solid angle is at most
    ``max_error`` and the point is outside of what covers it; and where it counts for nothing. All is weighed by area, since the light is
    not known when it is read.

    Parameters
    ----------
    reach : callable
        Takes areas to the distance from which on so much area counts for nothing.

    Source: JB02 eq. 12; the second moment is ours.
    """
    tree, origin = samples.tree, samples.p[0].astype(np.float64)
    above = max(tree.depth - BLOCK, 0)
    below = tree.depth - above

    def lay_out(nodes: NDArray, sums: NDArray) -> NDArray[np.float32]:
        return _walk_records(tree, nodes, sums, origin, max_error, reach)

    records = aligned((2 * tree.leaves, WALK_FLOAT4S, 4))

    def lay_out_block(block: slice) -> NDArray[np.float64]:
        sums = sum_up(_moments(samples.p[block] - origin, samples.area[block]), below)
        within = np.arange(1, 2 << below)
        level, root = level_of(within), 1 << above | block.start >> below
        node = (root << level) + within - (1 << level)
        records[node] = lay_out(node, sums[1:])
        return sums[1]

    records[tree.strength == 0] = 0
    top = np.arange(1, 1 << above)
    roots = np.stack(by_blocks(lay_out_block, samples.count, below))
    records[top] = lay_out(top, sum_up(roots, above)[top])
    return hand_over(records, mi.Float)


def _moments(x: NDArray, area: NDArray) -> NDArray[np.float64]:
    """Multiply the area of samples by 1, their coordinates, and the products of these: ``(n, 10)``."""
    factors = [np.ones(len(x)), *x.T, *(x[:, i] * x[:, j] for i, j in PAIRS)]
    return np.stack(factors, axis=1) * area[:, None].astype(np.float64)


def _walk_records(tree: BinaryTree, node: NDArray, sums: NDArray, origin: NDArray, max_error: float, reach: Callable):
    """Lay out the records of some nodes from the sums of their moments."""
    strength = tree.strength[node]
    _, x, y, z, *second = sums.T / np.maximum(strength, 1e-300)
    mean = np.stack([x, y, z])
    spread = disks([moment - mean[i] * mean[j] for moment, (i, j) in zip(second, PAIRS, strict=True)])
    centroid = (mean + origin[:, None]).T.astype(np.float32)
    cover = (np.linalg.norm(tree.centre[node] - centroid, axis=1) + tree.radius[node]) ** 2
    disk_area = 2 * np.pi * (3 * spread[:, 3] - (spread[:, :3] ** 2).sum(axis=1))
    opening = np.maximum(strength, disk_area) / max_error if max_error else np.inf
    records = np.zeros((len(node), WALK_FLOAT4S, 4), np.float32)
    records[:, 0, :3] = centroid
    # Leaves and empty nodes are never opened, and a leaf has no spread.
    single = node >= tree.leaves
    never = single | (strength == 0)
    records[:, 0, 3] = np.where(never, 0, opening)
    records[:, 1] = np.where(single[:, None], 0, spread)
    records[:, 2, 0] = strength
    records[:, 2, 1] = (np.sqrt(cover) + reach(strength)) ** 2
    records[:, 2, 2] = np.where(never, 0, cover)
    return records


@dataclass
class Placement:
    """Rigid transforms of the copies of a prototype: three float4s each, the rows of ``to_world``."""

    rows: mi.Float

    def _rows(self, instance: Any, active: Any) -> list[Any]:
        return [dr.gather(mi.Array4f, self.rows, instance * PLACE_FLOAT4S + k, active) for k in range(PLACE_FLOAT4S)]

    def point(self, instance: Any, p: Any, active: Any = True) -> mi.Point3f:
        """Take points of the prototype to the world."""
        return mi.Point3f(
            *(dr.fma(r[0], p.x, dr.fma(r[1], p.y, dr.fma(r[2], p.z, r[3]))) for r in self._rows(instance, active))
        )

    def normal(self, instance: Any, n: Any, active: Any = True) -> mi.Normal3f:
        """Turn directions of the prototype into those of the world."""
        return mi.Normal3f(*(dr.fma(r[0], n.x, dr.fma(r[1], n.y, r[2] * n.z)) for r in self._rows(instance, active)))

    def extent(self, instance: Any, half: Any) -> mi.Vector3f:
        """Enclose boxes of the prototype by boxes along the axes of the world: half their sizes."""
        return mi.Vector3f(*(dr.dot(dr.abs(mi.Vector3f(r[0], r[1], r[2])), half) for r in self._rows(instance, True)))

    def to_local(self, instance: Any, p: Any, active: Any = True) -> mi.Point3f:
        """Take points of the world to the prototype."""
        rows = self._rows(instance, active)
        return mi.Point3f(_turned_back(rows, [p[k] - rows[k][3] for k in range(3)]))

    def turn_to_local(self, instance: Any, n: Any, active: Any = True) -> mi.Normal3f:
        """Turn directions of the world into those of the prototype."""
        return mi.Normal3f(_turned_back(self._rows(instance, active), n))


def _turned_back(rows: list[Any], v: Any) -> list[Any]:
    """Multiply by the transpose of the rotation whose rows are given."""
    return [dr.fma(rows[0][k], v[0], dr.fma(rows[1][k], v[1], rows[2][k] * v[2])) for k in range(3)]


def build_placement(to_world: NDArray) -> Placement:
    """Bring the transforms ``(k, 4, 4)`` of the copies to the device."""
    return Placement(upload(np.asarray(to_world, np.float32)[:, :3].copy(), mi.Float))
