"""The clusters whose light is measured: the finest that eye points ask for, and what fills the gaps between them.

Eye points ask for clusters of many sizes, and those that one asks for lie inside those that another asks for. Light is measured
at the finest of them alone, which cover the surface without overlap; a coarser cluster has the mean of those below it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..memory import upload
from .binary import level_of
from .sample_tree import SampleTree


@dataclass
class Frontier:
    """The m nodes of the smallest trees that hold all clusters asked for, in slots, and the f leaves of those trees.

    Attributes
    ----------
    slots : UInt32
        The slot of every node of every copy, copy by copy.
    node, copy : (f,) int
        Leaves of the small trees, those of one copy and neighbours beside each other: node of the sample tree, number of the
        copy among those that are seen.
    place : (f,) int
        Their slots.
    area : (m,) float
        Area [scene units squared] of each slot.
    families : list of (parents, left, right)
        Slots of parents and of their children, level by level from the top; -1 where there is no right child.
    """

    slots: mi.UInt32
    node: NDArray[np.int64]
    copy: NDArray[np.int64]
    place: NDArray[np.int64]
    area: NDArray[np.float64]
    families: list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]

    def mean_light(self, light: NDArray) -> mi.Float:
        """Take the light ``(f, 3)`` of the leaves up to all slots, as means by area: a packet a slot."""
        mean = np.zeros((len(self.area), 4), np.float32)
        mean[self.place, :3] = light
        for parent, left, right in reversed(self.families):
            share = (self.area[left] / self.area[parent])[:, None]
            mean[parent] = share * mean[left] + np.where(right[:, None] < 0, 0, (1 - share) * mean[right])
        return upload(mean, mi.Float)

    def by_slot(self, values: Any) -> NDArray[np.float64]:
        """Fetch what belongs to the nodes of all copies, slot by slot: those ``(m,)`` that are not zero, and zeros."""
        there = dr.compress(values != 0)
        found = np.zeros(len(self.area))
        found[dr.gather(mi.UInt32, self.slots, there).numpy()] = dr.gather(type(values), values, there).numpy()
        return found

    def share_concern(self, concern: NDArray) -> NDArray[np.float64]:
        """Take what errors of the slots ``(m,)`` matter, squared, down to the leaves: as their share of the area squared ``(f,)``."""
        density = concern / np.square(self.area)
        for parent, left, right in self.families:
            density[left] += density[parent]
            there = right >= 0
            density[right[there]] += density[parent[there]]
        return (density * np.square(self.area))[self.place]

    def groups(self, samples: SampleTree, most: int) -> NDArray[np.int64]:
        """Group the leaves of the small trees by the largest nodes that hold at most so many: the number of the group of each."""
        first = self._first(samples)
        begins = np.ones(len(first), bool)
        for level in range(1, samples.depth + 1):
            starts = np.flatnonzero(np.diff(first >> level, prepend=-1))
            sizes = np.diff(starts, append=len(first))
            small = np.repeat(sizes <= most, sizes)
            if not small.any():
                break
            begins[small] = False
            begins[starts] = True
        return np.cumsum(begins) - 1

    def find(self, copy: NDArray, node: NDArray, samples: SampleTree) -> NDArray[np.int64]:
        """Tell which leaf of the small trees holds the first sample of each node."""
        return np.searchsorted(self._first(samples), copy * samples.leaves + samples.members(node)[0], side="right") - 1

    def _first(self, samples: SampleTree) -> NDArray[np.int64]:
        """Give the first sample of each leaf of the small trees, counted over all copies."""
        return self.copy * samples.leaves + samples.members(self.node)[0]


def find_frontier(samples: SampleTree, asked: Any, copies: int) -> Frontier:
    """Split every node that has a node below it which is asked for.

    Parameters
    ----------
    asked : UInt32 or UInt64
        Not zero for the nodes that are asked for, of every copy.
    """
    size, exists = 2 * samples.leaves, samples.tree.strength > 0
    touched = dr.compress(asked != 0).numpy().astype(np.int64)
    levels = level_of(touched % size)
    # From below: which nodes of each level have something below them that is asked for, counted over all copies.
    split, held = [np.zeros(0, np.int64)], touched[levels == samples.depth]
    for level in range(samples.depth - 1, -1, -1):
        node = held % size
        split.append(_once(held - node + (node >> 1)))
        held = _once(np.sort(np.concatenate([touched[levels == level], split[-1]])))
    # From above: the children of those are the nodes of the small trees, slot after slot.
    every, families, first = [held], [], 0
    for parent in split[:0:-1]:
        behind = first + len(every[-1])
        place = first + np.searchsorted(every[-1], parent)
        children = np.stack([parent + parent % size, parent + parent % size + 1], axis=1)
        there = exists[children % size]
        number = (np.cumsum(there) - 1).reshape(-1, 2) + behind
        families.append((place, number[:, 0], np.where(there[:, 1], number[:, 1], -1)))
        every.append(children[there])
        first = behind
    keys = np.concatenate(every)
    slots = dr.empty(mi.UInt32, size * copies)
    dr.scatter(slots, dr.arange(mi.UInt32, len(keys)), upload(keys.astype(np.uint32), mi.UInt32))
    dr.eval(slots)
    whole = np.ones(len(keys), bool)
    for parent, _, _ in families:
        whole[parent] = False
    place = np.flatnonzero(whole)
    copy, node = keys[place] // size, keys[place] % size
    order = np.argsort(copy * samples.leaves + samples.members(node)[0])
    return Frontier(slots, node[order], copy[order], place[order], samples.tree.strength[keys % size], families)


def _once(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Leave out what repeats the number before."""
    return numbers[np.diff(numbers, prepend=-1) != 0]
