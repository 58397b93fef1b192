"""Irradiance links that eye points have computed, kept for others (AWB08 section 4.4).

The paper keeps them in a tree of pointers that follows the refinement, and throws all of it away when it is full. Thousands
of lanes cannot grow one tree of pointers without locks. Here the cache is a table with one place for each link, in which a
newer link replaces an older one: nothing is ever locked, full, or thrown away at once, and what nearby eye points need is
what was written last.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ....errors import SceneError

DEFAULT_ENTRIES = 1 << 20  # of eight bytes; the paper has 1,000,000
TAG_BITS = 32
THERE = 1 << 31  # tells a link of zero from a place without an entry
MULTIPLIERS = (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9)  # odd: multiplying by them modulo a power of two can be undone


class _Memory:
    """Hands the memory of an array out to be shared, by the DLPack protocol."""

    def __init__(self, array: Any) -> None:
        self.array = array

    def __dlpack__(self, **_: Any) -> Any:
        return self.array.__dlpack__()

    def __dlpack_device__(self) -> Any:
        return self.array.__dlpack_device__()


def check_entries(entries: int) -> int:
    """Refuse a number of places that a cache cannot have; give it back otherwise."""
    if not 1024 <= entries <= 1 << 30 or entries & (entries - 1):
        raise SceneError(f"cache_entries is a power of two, 1024 to 2^30; found {entries}.")
    return entries


class LinkCache:
    """A direct-mapped table of link factors in device memory, shared by all eye points without locks.

    An entry is one word of 64 bits, tag and link, so that no lane can read half of what another writes. Keys are mixed by a
    function that can be undone; its lower bits are the place and the upper ones the tag: no two keys are ever confused.

    Dr.Jit reads what an array held before a kernel began, even where the kernel writes to it. The table is therefore known to
    it as two arrays over the same memory, one to read and one to write: lanes then find what others have written in the same
    launch, or the launches before. Which of them were fast enough is up to chance, but not what they find: a link is a
    function of its key. Pictures do not depend on the cache; numbers of hits and rays do.

    Parameters
    ----------
    entries : int
        Number of places, a power of two.

    Raises
    ------
    SceneError
        When ``entries`` is no power of two or less than 1024.

    Source: AWB08 section 4.4.
    """

    def __init__(self, entries: int = DEFAULT_ENTRIES) -> None:
        self.entries = check_entries(entries)
        self.place_bits = entries.bit_length() - 1
        self.written = dr.zeros(mi.UInt64, entries)
        dr.eval(self.written)
        self.read = mi.UInt64(_Memory(self.written))

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        return 8 * self.entries

    @property
    def most_keys(self) -> int:
        """Number of keys that place and tag can tell apart."""
        return 1 << (self.place_bits + TAG_BITS)

    def find(self, key: mi.UInt64, active: Any) -> tuple[mi.UInt32, mi.Bool]:
        """Look links up: their words, and whether they were there."""
        place, tag = self._mix(key)
        word = dr.gather(mi.UInt64, self.read, place, active)
        hit = active & (word >> TAG_BITS == tag) & (word != 0)
        return mi.UInt32(word) & (THERE - 1), hit

    def keep(self, key: mi.UInt64, link: mi.UInt32, active: Any) -> None:
        """Write links down, words of 31 bits."""
        place, tag = self._mix(key)
        dr.scatter(self.written, (tag << TAG_BITS) | mi.UInt64(link | THERE), place, active)

    def _mix(self, key: mi.UInt64) -> tuple[mi.UInt32, mi.UInt64]:
        """Spread keys over the table: place and tag, from which the key could be told."""
        bits = self.place_bits + TAG_BITS
        for multiplier in MULTIPLIERS:
            key = key ^ (key >> (bits // 2))
            key = (key * (multiplier & ((1 << bits) - 1))) & ((1 << bits) - 1)
        key = key ^ (key >> (bits // 2))
        return mi.UInt32(key & (self.entries - 1)), key >> self.place_bits
