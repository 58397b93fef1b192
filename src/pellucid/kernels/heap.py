"""A priority queue for every lane: a binary heap in local memory, of entries with a ``bound``; the largest is entry 0."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..errors import SceneError

MOST_ENTRIES = 1 << 14
"""Entries of a heap. On a CPU, local memory is the stack of a thread, 8 MB as a rule, and holds 16 lanes: triples of 16 bytes
fill it at 32768."""


def check_size(max_cut: int) -> None:
    """Refuse cuts that would not fit into local memory.

    Raises
    ------
    SceneError
        When ``max_cut`` is not 1 to 16384.
    """
    if not 1 <= max_cut <= MOST_ENTRIES:
        raise SceneError(
            f"max_cut must be 1 to {MOST_ENTRIES} clusters, which local memory has to hold; found {max_cut}."
        )


@dr.syntax
def replace_top(heap, size, entry, zero):
    """Replace the top of a heap in local memory by another entry, or just remove it if the bound of that is zero.

    ``zero`` is an opaque 0 of every lane, at which indices begin: Dr.Jit 1.5 takes an index that was one literal for all
    lanes to be so for ever, and writes to local memory where the first lane does.
    """
    shrinks = (entry.bound <= 0) & (size > 0)
    size = dr.select(shrinks, size - 1, size)
    last = heap[size]
    entry = dr.select(shrinks, last, entry)
    hole = mi.UInt32(zero)
    sinks = size > 0
    while sinks:
        left = 2 * hole + 1
        right = left + 1
        bound_left = heap[dr.minimum(left, size - 1)].bound
        bound_right = heap[dr.minimum(right, size - 1)].bound
        is_right = (right < size) & (bound_right > bound_left)
        child = dr.select(is_right, right, left)
        sinks &= (left < size) & (dr.select(is_right, bound_right, bound_left) > entry.bound)
        below = heap[dr.minimum(child, size - 1)]
        heap[hole] = dr.select(sinks, below, entry)
        hole = dr.select(sinks, child, hole)
    return heap, size


@dr.syntax
def push(heap, size, entry, zero):
    """Put an entry into a heap in local memory, unless its bound is zero: it will never be refined."""
    hole = zero + size
    rises = entry.bound > 0
    size = dr.select(rises, size + 1, size)
    while rises:
        parent = (dr.maximum(hole, 1) - 1) >> 1
        above = heap[parent]
        rises &= (hole > 0) & (above.bound < entry.bound)
        heap[hole] = dr.select(rises, above, entry)
        hole = dr.select(rises, parent, hole)
    return heap, size
