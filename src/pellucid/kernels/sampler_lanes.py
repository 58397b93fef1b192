"""A sampler of Mitsuba for some of the lanes that it would be seeded for."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def seeded_for(sampler: mi.Sampler, lanes: mi.UInt32, seed: int, count: int) -> mi.Sampler:
    """Seed a sampler for some of ``count`` lanes: each draws the numbers that it draws among all of them.

    Mitsuba seeds by the place in the array. So one sampler is seeded for all lanes, and the states of those that are wanted are
    gathered into another one, of their number.

    Parameters
    ----------
    lanes : UInt32 of m lanes
        Which lanes. Those that belong to one pixel are complete, and follow each other.
    """
    whole, part = sampler.clone(), sampler.clone()
    whole.seed(seed, count)
    part.seed(seed, dr.width(lanes))
    states = [dr.detail.update_indices(mi.UInt32(0), [index]) for index in dr.detail.collect_indices(whole)]
    taken = [dr.gather(mi.UInt32, state, lanes) if dr.width(state) > 1 else state for state in states]
    return dr.detail.update_indices(part, [state.index for state in taken])
