"""Which members stand for a cluster in the links between clusters: chosen at random in proportion to their strength."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..trees.binary import sum_up
from ..trees.light_tree import LIGHT_FLOAT4S, LightTree

LIGHT_REPRESENTATIVES = 32
"""Representatives of each light cluster, as in WABG06: receivers differ in which of them they use."""

SPREAD_BITS = 8
"""256 members of each cluster represent it in triples; the paper has 64 of irradiance clusters for BSSRDF links (AWB08 section 5.1)."""


def light_representatives(lights: LightTree, seed: int) -> NDArray[np.uint32]:
    """Choose the representatives of all light clusters for Lightcuts, in proportion to strength: ``(m, LIGHT_REPRESENTATIVES)``."""
    return representatives(light_strength(lights), lights.depth, LIGHT_REPRESENTATIVES, seed)


def light_strength(lights: LightTree) -> NDArray[np.float64]:
    """Sum red, green and blue of the intensity of each light, in the order of the leaves: ``(leaves,)``."""
    nodes = lights.nodes.numpy().reshape(-1, LIGHT_FLOAT4S, 4)
    return np.maximum(nodes[lights.leaves :, 2, :3].sum(axis=1, dtype=float), 0)


def representatives(strength: NDArray, depth: int, slots: int, seed: int) -> NDArray[np.uint32]:
    """Choose ``slots`` representatives of every node, at random in proportion to the strength of leaves: ``(m, slots)``.

    A representative of a node is also one of its children's, in the same slot: a cluster that is split hands its link on.

    Source: WFABDG05, WABG06.
    """
    leaves = 1 << depth
    total = sum_up(strength, depth)
    chosen = np.zeros((2 * leaves, slots), np.uint32)
    chosen[leaves:] = np.arange(leaves)[:, None]
    rng = np.random.default_rng(seed)
    for level in range(depth - 1, -1, -1):
        first = 1 << level
        both, left = total[first : 2 * first], total[2 * first : 4 * first : 2]
        share = np.divide(left, both, out=np.ones(first), where=both > 0).astype(np.float32)
        # 1 - u is in (0, 1]: a child without strength is never chosen.
        to_right = 1 - _even(first, slots, level, rng) > share[:, None]
        below = chosen[2 * first : 4 * first].reshape(first, 2, slots)
        chosen[first : 2 * first] = np.where(to_right, below[:, 1], below[:, 0])
    return chosen


def _even(nodes: int, slots: int, level: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw numbers in [0, 1) for the slots of nodes, half of them below 1/2: ``(nodes, slots)``.

    Which slots are below is told by one bit of their numbers, another on every level, flipped at random by node: the
    representatives of a node are spread evenly over what lies some levels below it.
    """
    bits = max((slots - 1).bit_length(), 1)
    half = np.arange(slots) >> (level % bits) & 1
    return ((half ^ rng.integers(2, size=(nodes, 1))) + rng.random((nodes, slots))) / 2


def upload_representatives(chosen: NDArray[np.uint32]) -> mi.UInt32:
    """Bring representatives to the device."""
    return mi.UInt32(chosen.ravel())


def spread_place(depth, node, slot) -> mi.UInt32:
    """Tell where a representative of a node stands among those of `spread_representatives`, of a tree so many levels deep."""
    top = dr.maximum(depth, SPREAD_BITS - 1) - (SPREAD_BITS - 1)
    level = 31 - dr.lzcnt(node)
    share = depth - level  # logarithm of the number of leaves
    below = (mi.UInt32(1) << (top + SPREAD_BITS)) + ((level - top) << depth)
    below += ((node - (mi.UInt32(1) << level)) << share) + (slot >> (SPREAD_BITS - dr.minimum(share, SPREAD_BITS)))
    return dr.select(level < top, (node << SPREAD_BITS) + slot, below)


def spread_representatives(strength: NDArray, depth: int, seed: int) -> NDArray[np.uint32]:
    """Choose 256 representatives of every node, or as many as it has leaves if they are fewer; spread over the node.

    Each stands for an equal share of the node's strength, at a random place within it. A node i of at least 256 leaves has its
    own at ``256 i``; then follow the nodes of the lower levels, ``leaves`` numbers a level.
    """
    leaves, slots = 1 << depth, 1 << SPREAD_BITS
    top = max(depth - SPREAD_BITS + 1, 0)
    upto = np.concatenate([[0.0], np.cumsum(strength)])
    rng = np.random.default_rng(seed)
    rows = [np.zeros(slots, np.uint32)]  # of node 0, which is none
    for level in range(depth + 1):
        share = leaves >> level
        count = slots if level < top else share
        edge = np.arange(0, leaves + 1, share)
        low, high = upto[edge[:-1], None], upto[edge[1:], None]
        target = low + (np.arange(count) + rng.random((len(edge) - 1, count))) / count * (high - low)
        leaf = np.searchsorted(upto, target, side="right") - 1
        rows.append(np.clip(leaf, edge[:-1, None], edge[1:, None] - 1).astype(np.uint32).ravel())
    return np.concatenate(rows)
