"""Binary cluster trees over points: over surface samples and over light samples alike (AWB08 section 4.3).

The tree is a heap without pointers: node 1 is the root, the children of node i are 2i and 2i + 1, and leaf k is node
``leaves + k``. Items lie in the order of the leaves; where their number is no power of two, the last leaves are empty. A walk in
preorder needs no stack either: what follows the subtree of node i is ``(i + 1) >> ctz(i + 1)``, and 1 at the very end.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....errors import SceneError

Doubles = NDArray[np.float64]

BLOCK = 15
"""Levels of the subtrees that are built each by itself: they stay in the cache, and are shared among processors."""


@dataclass
class BinaryTree:
    """Clusters of n items, ``m = 2 leaves`` rows, of which row 0 is not used.

    Attributes
    ----------
    order : (n,) uint32
        The caller's number of each item.
    depth : int
        Levels below the root; there are ``leaves = 2**depth`` leaves.
    strength : (m,) float64
        Sum of the strengths of a node's items; 0 for an empty node.
    centre, radius : (m, 3), (m,) float32
        A sphere around the items.
    normals : (n, 3) float32
        Of the items, in the order of the leaves.
    """

    order: NDArray[np.uint32]
    depth: int
    strength: Doubles
    centre: NDArray[np.float32]
    radius: NDArray[np.float32]
    normals: NDArray[np.float32]

    @cached_property
    def cones(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Bound the normals of each node by a cone, when it is asked for: axis ``(m, 3)``, cosine ``(m,)``; -1 is all around."""
        return _bound_normals(self.normals, self.depth)

    @property
    def axis(self) -> NDArray[np.float32]:
        """Axes of the cones."""
        return self.cones[0]

    @property
    def cos_cone(self) -> NDArray[np.float32]:
        """Cosines of half their angles."""
        return self.cones[1]

    @property
    def count(self) -> int:
        """Number of items."""
        return len(self.order)

    @property
    def leaves(self) -> int:
        """Number of leaves, empty ones included; also the number of the first."""
        return 1 << self.depth

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        arrays = [*vars(self).values(), *vars(self).get("cones", ())]
        return sum(value.nbytes for value in arrays if isinstance(value, np.ndarray))


def build_binary_tree(
    p: ArrayLike, n: ArrayLike, strength: ArrayLike, turn: float = 0.0, depth: int | None = None
) -> BinaryTree:
    """Cluster items by place, and by orientation as far as it counts.

    Every node is halved across its longest side, so that the first half fills the left subtree. Six coordinates compete:
    three of position, and three of the normal times ``turn`` times the node's own size.

    Parameters
    ----------
    p, n : (n, 3) float
        Positions, and unit normals (zeros: none, which is every direction).
    strength : (n,) float
        What clusters sum; not negative.
    turn : float
        Share of a node's size that a turn by one radian counts for: its normals are divided before its places are where
        they differ by more than ``1 / turn``.
    depth : int, optional
        Levels below the root, if more than needed are wanted; the upper ones then have empty right halves.

    Raises
    ------
    SceneError
        No items, unequal lengths, or numbers that are not finite or negative strengths.

    Source: AWB08 section 4.3; WFABDG05 section 4.
    """
    places, normals, strengths = (np.asarray(a, np.float32) for a in (p, n, strength))
    if not (len(places) == len(normals) == len(strengths) > 0):
        raise SceneError(
            f"cluster tree: positions, normals and strengths differ in length or are empty: "
            f"{len(places)}, {len(normals)}, {len(strengths)}."
        )
    if not (all(np.isfinite(a).all() for a in (places, normals, strengths)) and (strengths >= 0).all()):
        raise SceneError(
            "cluster tree: values that are not finite, or negative strengths; check the mesh and the lights."
        )
    depth = depth_of(len(places)) if depth is None else depth
    order = _split(places, normals, turn, depth)
    places, normals, strengths = places[order], normals[order], strengths[order]
    total = sum_up(strengths.astype(np.float64), depth)
    return BinaryTree(order.astype(np.uint32), depth, total, *_bound_places(places, depth), normals)


def depth_of(count: int) -> int:
    """Give the levels below the root that so many leaves need."""
    return (count - 1).bit_length()


def level_of(node: NDArray) -> NDArray[np.int64]:
    """Give the level of nodes, 0 for the root."""
    return np.frexp(np.asarray(node, np.float64))[1].astype(np.int64) - 1


def sum_up(values: NDArray, depth: int) -> Doubles:
    """Sum ``values (n, ...)`` of items in tree order over every node: ``(m, ...) float64``."""
    leaves = 1 << depth
    result = np.zeros((2 * leaves, *values.shape[1:]))
    result[leaves : leaves + len(values)] = values
    for level in range(depth - 1, -1, -1):
        first = 1 << level
        result[first : 2 * first] = result[2 * first : 4 * first : 2] + result[2 * first + 1 : 4 * first : 2]
    return result


def _split(p: NDArray[np.float32], n: NDArray[np.float32], turn: float, depth: int) -> NDArray[np.uint32]:
    """Order items so that every node of every level halves its items across their longest side: ``(n,)``."""
    coordinates = np.concatenate([p, n], axis=1) if turn else p
    above = max(depth - BLOCK, 0)
    order = _halve(coordinates, turn, depth, above)

    def finish(block: slice) -> NDArray[np.uint32]:
        here = np.sort(order[block])
        return here[_halve(coordinates[here], turn, depth - above, depth - above)]

    return np.concatenate(by_blocks(finish, len(p), depth - above))


def by_blocks(function: Callable[[slice], Any], count: int, depth: int) -> list[Any]:
    """Call a function for the items of each subtree of some depth."""
    blocks = [slice(first, first + (1 << depth)) for first in range(0, count, 1 << depth)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, blocks))


def _halve(coordinates: NDArray[np.float32], turn: float, depth: int, levels: int) -> NDArray[np.uint32]:
    """Halve the nodes of the uppermost levels of a tree: the order of the items."""
    count, dimensions = coordinates.shape
    order = np.arange(count, dtype=np.uint32)
    for level in range(levels):
        share = 1 << (depth - level)  # leaves of a node of this level
        here, starts = coordinates[order], np.arange(0, count, share)
        extent = np.maximum.reduceat(here, starts) - np.minimum.reduceat(here, starts)
        extent[:, 3:] *= turn * extent[:, :3].max(axis=1, keepdims=True)
        axis = np.repeat(np.argmax(extent, axis=1), share)[:count]
        bits = here.ravel()[np.arange(0, count * dimensions, dimensions) + axis].view(np.uint32)
        # The place along the axis as an integer, and the item itself: to find halves of such keys takes less time than to read
        # them, and items in the same place have an order.
        key = np.where(bits >> 31, ~bits, bits | 0x80000000).astype(np.uint64) << 32 | order
        full = count // share * share
        key[:full].reshape(-1, share).partition(share // 2, axis=1)
        if count - full > share // 2:
            key[full:].partition(share // 2)
        order = key.astype(np.uint32)
    return order


def _levels(depth: int):
    """Yield the slices of parents, left and right children of every level, from the lowest up."""
    for level in range(depth - 1, -1, -1):
        first = 1 << level
        yield slice(first, 2 * first), slice(2 * first, 4 * first, 2), slice(2 * first + 1, 4 * first, 2)


def _bound_places(p: NDArray[np.float32], depth: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bound the items of every node by a sphere: centres and radii."""
    above = max(depth - BLOCK, 0)

    def bound(block: slice) -> tuple[NDArray, NDArray]:
        centre, radius = (np.zeros((2 << (depth - above), *shape), np.float32) for shape in ((3,), ()))
        _spheres(p[block], depth - above, depth - above + 1, centre, radius)
        return centre, radius

    found = by_blocks(bound, len(p), depth - above)
    centre, radius = (_join_blocks(arrays, depth, above, 0) for arrays in zip(*found, strict=True))
    _spheres(p, depth, above, centre, radius)
    return centre, radius


def boxes(p: NDArray[np.float32], depth: int) -> NDArray[np.float32]:
    """Give half the size of the box around the items of every node, which lie in the order of the leaves: ``(m, 3)``.

    Its middle is the centre of `BinaryTree`; a hair is added for rounding.
    """
    half = np.zeros((2 << depth, 3), np.float32)
    low = high = p
    for level in range(depth, -1, -1):
        half[1 << level :][: len(low)] = (high - low) / 2
        starts = np.arange(0, len(low), 2)
        low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    return half + 1e-6 * np.abs(p).max()


def _bound_normals(n: NDArray[np.float32], depth: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bound the normals of every node by a cone: axes and cosines."""
    above = max(depth - BLOCK, 0)
    found = by_blocks(lambda block: _cones(n[block], depth - above), len(n), depth - above)
    axis, angle = (
        _join_blocks(arrays, depth, above, empty)
        for arrays, empty in zip(zip(*found, strict=True), (0, -1), strict=True)
    )
    for parent, left, right in _levels(above):
        axis[parent], angle[parent] = _join(axis[left], angle[left], axis[right], angle[right])
    cosine = np.cos(np.minimum(angle * (1 + 1e-5), np.pi))
    return axis.astype(np.float32), cosine.astype(np.float32)


def _join_blocks(blocks: Sequence[NDArray], depth: int, above: int, empty: float) -> NDArray:
    """Put the nodes of subtrees, whose roots lie side by side on a level, into the whole tree."""
    stacked = np.stack(blocks)
    whole = np.full((2 << depth, *stacked.shape[2:]), empty, stacked.dtype)
    for level in range(depth - above + 1):
        nodes = stacked[:, 1 << level : 2 << level].reshape(-1, *stacked.shape[2:])
        whole[1 << (above + level) :][: len(nodes)] = nodes
    return whole


def _spheres(p: NDArray[np.float32], depth: int, levels: int, centre: NDArray, radius: NDArray) -> None:
    """Bound the items of every node of the uppermost levels by a sphere around the middle of their box."""
    for level in range(levels):
        share = 1 << (depth - level)
        starts = np.arange(0, len(p), share)
        middle = (np.minimum.reduceat(p, starts) + np.maximum.reduceat(p, starts)) / 2
        away = p - np.repeat(middle, share, axis=0)[: len(p)]
        here = slice(1 << level, (1 << level) + len(starts))
        centre[here] = middle
        radius[here] = np.sqrt(np.maximum.reduceat(np.einsum("ij,ij->i", away, away), starts)) * (1 + 1e-5)


def _cones(n: NDArray[np.float32], depth: int) -> tuple[Doubles, Doubles]:
    """Bound the normals of every node by a cone: axes, and half the opening angles."""
    leaves = 1 << depth
    axis = np.zeros((2 * leaves, 3))
    angle = np.full(2 * leaves, -1.0)  # -1: nothing in it
    axis[leaves : leaves + len(n)] = n
    angle[leaves : leaves + len(n)] = np.where((n != 0).any(axis=1), 0.0, np.pi)
    for parent, left, right in _levels(depth):
        axis[parent], angle[parent] = _join(axis[left], angle[left], axis[right], angle[right])
    return axis, angle


def _join(a: Doubles, angle_a: Doubles, b: Doubles, angle_b: Doubles) -> tuple[Doubles, Doubles]:
    """Join cones pairwise: the narrowest cone around two, unless one of them holds the other."""
    between = np.arccos(np.clip(np.sum(a * b, axis=1), -1, 1))
    joined = (angle_a + angle_b + between) / 2
    turn = joined - angle_a
    aside = b - np.sum(a * b, axis=1, keepdims=True) * a
    length = np.linalg.norm(aside, axis=1, keepdims=True)
    aside = np.divide(aside, length, out=np.zeros_like(aside), where=length > 1e-12)
    axis = np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * aside
    # Opposite normals leave the axis undetermined: every direction.
    lost = (length[:, 0] <= 1e-12) & (between > 1)
    angle = np.where(lost, np.pi, np.minimum(joined, np.pi))
    a_holds = (angle_b < 0) | (between + angle_b <= angle_a)
    b_holds = (angle_a < 0) | (between + angle_a <= angle_b)
    axis = np.where(b_holds[:, None], b, np.where(a_holds[:, None], a, axis))
    angle = np.where(b_holds, angle_b, np.where(a_holds, angle_a, angle))
    return axis, angle
