"""A sampler of Mitsuba for some of the lanes that it would be seeded for."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class SamplerLanes:
    """A sampler that is seeded for ``count`` lanes, and hands out parts of itself: each lane draws what it draws among all.

    Mitsuba seeds by the place in the array. So the states of the lanes that are wanted are gathered into another sampler, of their number.
    """

    def __init__(self, sampler: mi.Sampler, count: int):
        self.sampler, self.count = sampler, count
        self._seed = 0
        self._states: list[mi.UInt32] = []

    def seed(self, seed: int) -> None:
        """Seed all lanes."""
        self._seed, self._states = seed, []  # what was there before needs its memory no more
        whole = self.sampler.clone()
        whole.seed(seed, self.count)
        self._states = [dr.detail.update_indices(mi.UInt32(0), [index]) for index in dr.detail.collect_indices(whole)]

    def take(self, lanes: mi.UInt32) -> mi.Sampler:
        """Take some lanes. Those that belong to one pixel are complete, and follow each other."""
        part = self.sampler.clone()
        part.seed(self._seed, dr.width(lanes))
        taken = [dr.gather(mi.UInt32, state, lanes) if dr.width(state) > 1 else state for state in self._states]
        return dr.detail.update_indices(part, [state.index for state in taken])
