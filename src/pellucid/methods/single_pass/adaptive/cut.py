"""The clusters whose light is measured: the finest that are asked for, and what fills the gaps between them.

Eye points ask for clusters of many sizes, and those that one asks for lie inside those that another asks for. Light is measured at
the finest of them alone: a cut through the sample tree of each copy, which covers its surface once. A larger cluster has the mean of
those below it, and a smaller one the light of that which holds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....kernels.memory import lanes_where, upload
from ..trees.sample_tree import SampleTree


@dataclass
class Family:
    """Slots of the parents of one level, and of their children; the right one is the left where there is only that."""

    parent: mi.UInt32
    left: mi.UInt32
    right: mi.UInt32


@dataclass
class Cut:
    """The f clusters of a cut through the trees of k copies, and the nodes above them: m slots together.

    Attributes
    ----------
    slots : UInt32
        For every node of every copy, copy by copy, the slot of the node itself, or of the cluster of the cut that holds it.
    node, copy : (f,) int
        The clusters of the cut, those of one copy and neighbours beside each other: node of the sample tree, number of the copy.
    place : UInt32
        Their slots.
    area : Float
        Area [scene units squared] of each slot.
    families : list of Family
        Level by level from the top.
    until : UInt32
        By sample of every copy how many clusters of the cut begin at it or before it.
    """

    slots: mi.UInt32
    node: NDArray[np.int64]
    copy: NDArray[np.int64]
    place: mi.UInt32
    area: mi.Float
    families: list[Family]
    until: mi.UInt32

    def mean_light(self, light: NDArray) -> mi.Float:
        """Average the light ``(f, 3)`` of the cut over the nodes above it, by area: a float4 a slot."""
        mean = dr.empty(mi.Float, 4 * dr.width(self.area))
        found = mi.Array4f(*(upload(np.asarray(column, np.float32), mi.Float) for column in light.T), 0)
        dr.scatter(mean, found, self.place)
        dr.eval(mean)
        for family in reversed(self.families):
            both = self._mean_of_children(mean, family)
            dr.scatter(mean, both, family.parent)
            dr.eval(mean)
        return mean

    def _mean_of_children(self, values: mi.Float, family: Family) -> mi.Array4f:
        """Average the float4s of children by area."""
        # Evaluated here, where nothing that waits to read them stays behind: or else all would be copied before they change.
        share = dr.gather(mi.Float, self.area, family.left) / dr.gather(mi.Float, self.area, family.parent)
        left, right = (dr.gather(mi.Array4f, values, child) for child in (family.left, family.right))
        mean = dr.fma(share, left - right, right)
        dr.eval(mean)
        return mean

    def share_importance(self, importance: mi.UInt64) -> NDArray[np.float64]:
        """Sum over each cluster of the cut the importance of the nodes around it ``(f,)``.

        A cluster of the share q of the area of a node changes its mean by q times its own error, so q squared of the importance of
        the node is its own.

        Parameters
        ----------
        importance : UInt64
            Of every node of every copy.
        """
        there = lanes_where(importance != 0)
        found = dr.opaque(mi.Float64, 0, dr.width(self.area))
        value = mi.Float64(dr.gather(mi.UInt64, importance, there))
        dr.scatter(found, value, dr.gather(mi.UInt32, self.slots, there))
        square = dr.square(mi.Float64(self.area))
        density = found / square
        dr.eval(density)
        for family in self.families:
            for child, value in self._with_above(density, family):
                dr.scatter(density, value, child)
            dr.eval(density)
        return dr.gather(mi.Float64, density * square, self.place).numpy()

    def _with_above(self, density: mi.Float64, family: Family) -> list[tuple[mi.UInt32, mi.Float64]]:
        """Add to children what their parents have."""
        above = dr.gather(mi.Float64, density, family.parent)
        each = [(child, dr.gather(mi.Float64, density, child) + above) for child in (family.left, family.right)]
        dr.eval(each)  # as in `_mean_of_children`
        return each

    def groups(self, samples: SampleTree, most: int) -> NDArray[np.int64]:
        """Group the clusters of the cut by the largest nodes that hold at most so many: the number of the group of each."""
        node, copy = (upload(values.astype(np.uint32), mi.UInt32) for values in (self.node, self.copy))
        first = copy * dr.opaque(mi.UInt32, samples.leaves) + _first_sample(node, samples)
        begins = _begins(first, self.until, dr.opaque(mi.UInt32, samples.depth), dr.opaque(mi.UInt32, most))
        return np.cumsum(begins) - 1

    def find(self, copy: NDArray, node: NDArray, samples: SampleTree) -> NDArray[np.int64]:
        """Tell which cluster of the cut holds the first sample of each node."""
        sample = upload((copy * samples.leaves + samples.members(node)[0]).astype(np.uint32), mi.UInt32)
        return dr.gather(mi.UInt32, self.until, sample).numpy().astype(np.int64) - 1


@dr.syntax
def _begins(first, until, depth, most) -> NDArray[np.bool_]:
    """Tell which clusters, that begin at some samples, are the first of a group."""
    level, larger = mi.UInt32(0), mi.UInt32(1)
    while dr.hint((level < depth) & (larger <= most), label="pellucid groups"):
        level += 1
        begin = first >> level << level
        before = dr.gather(mi.UInt32, until, begin - 1, begin > 0)
        larger = dr.gather(mi.UInt32, until, begin + (1 << level) - 1) - before
    level -= dr.select(larger > most, mi.UInt32(1), 0)
    begin = first >> level << level
    before = dr.gather(mi.UInt32, until, begin - 1, begin > 0)
    return (dr.gather(mi.UInt32, until, first) == before + 1).numpy()


def find_cut(samples: SampleTree, importance: mi.UInt64, copies: int) -> Cut:
    """Find the coarsest cut of every copy on or below all nodes that are asked for: those whose importance is not zero."""
    size = dr.opaque(mi.UInt32, 2 * samples.leaves)
    split = _split(importance, samples, copies, size)
    levels, families, first = [dr.arange(mi.UInt32, copies) * size + 1], [], 0
    while True:
        node = levels[-1]
        parent = lanes_where(dr.gather(mi.UInt8, split, node) != 0)
        if dr.width(parent) == 0:
            break
        behind = first + dr.width(node)
        place = parent + dr.opaque(mi.UInt32, first)
        family, children = _children(dr.gather(mi.UInt32, node, parent), place, samples, size, behind)
        families.append(family)
        levels.append(children)
        first = behind
    return _lay_out(levels, families, split, samples, copies, size)


def _split(importance: mi.UInt64, samples: SampleTree, copies: int, size: mi.UInt32) -> mi.UInt8:
    """Tell, from below, which nodes of all copies have a node below them that is asked for."""
    split = dr.opaque(mi.UInt8, 0, 2 * samples.leaves * copies)
    for level in range(samples.depth - 1, -1, -1):
        copy, node = _nodes_of(level, copies)
        dr.scatter(split, _any_below(importance, split, copy * size + 2 * node), copy * size + node)
        dr.eval(split)
    return split


def _nodes_of(level: int, copies: int) -> tuple[mi.UInt32, mi.UInt32]:
    """List the nodes of one level of all copies: copy, node."""
    lane, shift = dr.arange(mi.UInt32, copies << level), dr.opaque(mi.UInt32, level)
    return lane >> shift, (lane & ((1 << shift) - 1)) | (1 << shift)


def _any_below(importance: mi.UInt64, split: mi.UInt8, left: mi.UInt32) -> mi.UInt8:
    """Tell which of two neighbours is asked for, or is split."""
    there = mi.Bool(False)
    for child in (left, left + 1):
        there |= (dr.gather(mi.UInt64, importance, child) != 0) | (dr.gather(mi.UInt8, split, child) != 0)
    value = dr.select(there, mi.UInt8(1), 0)
    dr.eval(value)  # as in `Cut._mean_of_children`
    return value


def _children(
    parent: mi.UInt32, place: mi.UInt32, samples: SampleTree, size: mi.UInt32, behind: int
) -> tuple[Family, mi.UInt32]:
    """Lay out the children of some nodes, whose slots are given, behind all others: where they are, and which they are."""
    node = parent & (size - 1)
    both = dr.select(dr.gather(mi.Float, samples.strength, 2 * node + 1) > 0, mi.UInt32(1), 0)
    number = dr.prefix_sum(both + 1)
    dr.eval(both, number)
    count = int(dr.sum(both)[0]) + dr.width(parent)
    children = dr.empty(mi.UInt32, count)
    dr.scatter(children, parent + node, number)
    dr.scatter(children, parent + node + 1, number + 1, both > 0)
    left = number + dr.opaque(mi.UInt32, behind)
    family = Family(place, left, left + both)
    dr.eval(children, family)
    return family, children


def _lay_out(
    levels: list[mi.UInt32],
    families: list[Family],
    split: mi.UInt8,
    samples: SampleTree,
    copies: int,
    size: mi.UInt32,
) -> Cut:
    """Number the nodes of the cut and above, level after level, and put the cut in the order of the samples."""
    every = dr.empty(mi.UInt32, sum(map(dr.width, levels)))
    first = 0
    for node in levels:
        dr.scatter(every, node, dr.arange(mi.UInt32, dr.width(node)) + dr.opaque(mi.UInt32, first))
        first += dr.width(node)
    dr.eval(every)
    slots = dr.empty(mi.UInt32, 2 * samples.leaves * copies)
    dr.scatter(slots, dr.arange(mi.UInt32, dr.width(every)), every)
    area = dr.gather(mi.Float, samples.strength, every & (size - 1))
    dr.eval(slots, area)
    _hand_down(slots, split, samples, copies, size)
    place = lanes_where(dr.gather(mi.UInt8, split, every) == 0)
    leaf = dr.gather(mi.UInt32, every, place)
    node, copy = leaf & (size - 1), leaf // size
    begin = copy * (size >> 1) + _first_sample(node, samples)
    begins = dr.opaque(mi.UInt32, 0, samples.leaves * copies)
    dr.scatter(begins, mi.UInt32(1), begin)
    until = dr.cumsum(begins)
    rank = dr.gather(mi.UInt32, until, begin) - 1
    ordered = dr.empty(mi.Array3u, dr.width(place))
    dr.scatter(ordered, mi.Array3u(place, node, copy), rank)
    dr.eval(until, ordered)
    node, copy = (part.numpy().astype(np.int64) for part in (ordered.y, ordered.z))
    return Cut(slots, node, copy, ordered.x, area, families, until)


def _hand_down(slots: mi.UInt32, split: mi.UInt8, samples: SampleTree, copies: int, size: mi.UInt32) -> None:
    """Give the slots of the cut to all nodes below it, level by level."""
    for level in range(1, samples.depth + 1):
        copy, node = _nodes_of(level, copies)
        above = copy * size + (node >> 1)
        slot = dr.gather(mi.UInt32, slots, above)
        below = dr.gather(mi.UInt8, split, above) == 0
        dr.eval(slot, below)  # as in `Cut._mean_of_children`
        dr.scatter(slots, slot, copy * size + node, below)
        dr.eval(slots)


def _first_sample(node: mi.UInt32, samples: SampleTree) -> mi.UInt32:
    """Give the first of the samples of each node (`SampleTree.members`)."""
    leaves = dr.opaque(mi.UInt32, samples.leaves)
    return (node << (dr.lzcnt(node) - dr.lzcnt(leaves))) - leaves
