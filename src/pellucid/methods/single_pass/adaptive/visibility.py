"""Which lights a receiver group sees: learnt from its shadow rays, so that the next ones go where it is not yet known.

All lights are divided once into some thousand clusters. Each group counts how many of its rays towards each of them arrived. What
a group knows little of it takes from the region around it, and that from all. A group besides counts the rays towards every single
one of its candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....kernels.memory import upload
from ..trees.light_tree import CLUSTERS
from .candidates import Candidates

REGION = 8
"""Receiver groups of a region."""

REGION_RAYS = 4.0
"""Rays that what is known of a wider region counts for when it is combined with the rays of a narrower one."""

PRIOR_RAYS = 1.5
"""Rays that what the guide expects of a candidate counts for when rays to it arrive: it is known from lights around it and from
groups nearby, and neighbours mostly see the same lights alike."""

LEAST_DEVIATION = 0.0075
"""What seems certain has this standard deviation besides, so that errors are found, and the estimate has no bias."""


@dataclass
class RayCounts:
    """Rays that were traced towards each candidate, and those that arrived."""

    tried: mi.UInt32
    seen: mi.UInt32

    @classmethod
    def none(cls, candidates: Candidates) -> RayCounts:
        """Begin without any."""
        # Opaque: kernels would be compiled for the size of literal zeros.
        return cls(*(dr.opaque(mi.UInt32, 0, dr.width(candidates.place)) for _ in range(2)))

    def add(self, entry: mi.UInt32, arrives: mi.Bool) -> None:
        """Count one ray a lane."""
        # Direct: other modes have kernels of their own for tables of each size.
        dr.scatter_add(self.tried, mi.UInt32(1), entry, mode=dr.ReduceMode.Direct)
        dr.scatter_add(self.seen, mi.UInt32(1), entry, arrives, mode=dr.ReduceMode.Direct)

    def __add__(self, other: RayCounts) -> RayCounts:
        both = RayCounts(self.tried + other.tried, self.seen + other.seen)
        dr.eval(both)
        return both


@dataclass
class Expectation:
    """The visibility that is expected of each candidate, the rays that this counts for, and the standard deviation of one more."""

    visibility: mi.Float
    rays: mi.Float
    deviation: mi.Float

    def after(self, found: RayCounts, entry: mi.UInt32, without: mi.Float | None = None) -> mi.Float:
        """Combine what was expected of some candidates with rays that arrived (1) or not (0) since; ``without`` leaves out one of them."""
        visibility, prior = dr.gather(mi.Float, self.visibility, entry), dr.gather(mi.Float, self.rays, entry)
        tried, seen = (mi.Float(dr.gather(mi.UInt32, counts, entry)) for counts in (found.tried, found.seen))
        if without is not None:
            tried, seen = tried - 1, seen - without
        return dr.fma(visibility, prior, seen) / (prior + tried)


@dataclass
class LightGuide:
    """What r receiver groups know of c clusters of lights.

    Attributes
    ----------
    tried, seen : UInt32
        Rays that were traced from a group to a cluster, and that arrived: ``(r, c)``, row by row.
    visibility : Float
        Share of them that was to be expected to arrive when all groups learnt: ``(r, c)``.
    """

    tried: mi.UInt32
    seen: mi.UInt32
    visibility: mi.Float

    def __post_init__(self) -> None:
        regions = -(-(dr.width(self.tried) // CLUSTERS) // REGION)
        self.whole = [dr.opaque(mi.UInt32, 0, CLUSTERS) for _ in range(2)]
        self.around = [dr.opaque(mi.UInt32, 0, regions * CLUSTERS) for _ in range(2)]

    def add(self, place: mi.UInt32, rays: RayCounts) -> None:
        """Add rays to what groups and regions know of some clusters."""
        for own, around, counts in zip((self.tried, self.seen), self.around, (rays.tried, rays.seen), strict=True):
            dr.scatter_add(own, counts, place, rays.tried > 0, mode=dr.ReduceMode.Direct)
            dr.scatter_add(around, counts, _around(place), rays.tried > 0, mode=dr.ReduceMode.Direct)
        dr.eval(self.tried, self.seen, self.around)

    def expect(self, candidates: Candidates, own: RayCounts) -> Expectation:
        """Combine what is known around candidates with the rays that were traced towards them: ``own``."""
        rays = PRIOR_RAYS + mi.Float(own.tried)
        visibility = dr.fma(PRIOR_RAYS, self._known(candidates.place), mi.Float(own.seen)) / rays
        deviation = LEAST_DEVIATION + dr.sqrt(visibility * (1 - visibility))
        expected = Expectation(visibility, rays, deviation)
        dr.eval(expected)
        return expected

    def learn(self) -> None:
        """Let all groups learn from the rays until now. What others at a distance know is looked up only here."""
        sums = [counts.numpy().reshape(-1, CLUSTERS).sum(axis=0, dtype=np.uint32) for counts in self.around]
        self.whole = [upload(counts, mi.UInt32) for counts in sums]
        self.visibility = self._known(dr.arange(mi.UInt32, dr.width(self.tried)))
        dr.eval(self.visibility)

    def _known(self, place: mi.UInt32) -> mi.Float:
        """Tell the visibility of a cluster: what a group knows, then what is known around it, then everywhere, and then a half."""
        visibility: Any = 0.5
        known = (*self.whole, place % CLUSTERS), (*self.around, _around(place)), (self.tried, self.seen, place)
        for tried, seen, index in known:
            tried, seen = dr.gather(mi.UInt32, tried, index), dr.gather(mi.UInt32, seen, index)
            visibility = (mi.Float(seen) + REGION_RAYS * visibility) / (REGION_RAYS + mi.Float(tried))
        return visibility


def build_guide(groups: int) -> LightGuide:
    """Begin to know nothing in so many groups."""
    # Opaque: kernels would be compiled for the size of literal zeros.
    tried, seen = (dr.opaque(mi.UInt32, 0, groups * CLUSTERS) for _ in range(2))
    return LightGuide(tried, seen, dr.opaque(mi.Float, 0.5, groups * CLUSTERS))


def _around(place: mi.UInt32) -> mi.UInt32:
    """Tell where the region of a group counts a cluster."""
    return place // (REGION * CLUSTERS) * CLUSTERS + place % CLUSTERS
