"""Which lights a patch of the surface sees: learnt from its shadow rays, so that the next ones go where it is not yet known.

All lights are divided once into some thousand clusters. Each patch counts how many of its rays towards each of them arrived. What
a patch knows little of it takes from the region around it, and that from all. A patch besides learns of every single one of the
clusters that were chosen for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....kernels.memory import upload
from ..trees.light_tree import CLUSTERS
from .candidates import SEEN, ChosenLights

AROUND = 8
"""Patches of a region."""

TRUST = 4.0
"""Rays that what is known of the surroundings counts for."""


@dataclass
class LightGuide:
    """What r patches know of c clusters of lights.

    Attributes
    ----------
    tried, seen : UInt32
        Rays that were traced from a patch to a cluster, and that arrived: ``(r, c)``, row by row.
    visibility : Float
        Share of them that was to be expected to arrive when all patches learnt: ``(r, c)``.
    """

    tried: mi.UInt32
    seen: mi.UInt32
    visibility: mi.Float

    def __post_init__(self) -> None:
        regions = -(-(dr.width(self.tried) // CLUSTERS) // AROUND)
        self.whole = [dr.opaque(mi.UInt32, 0, CLUSTERS) for _ in range(2)]
        self.around = [dr.opaque(mi.UInt32, 0, regions * CLUSTERS) for _ in range(2)]

    def count(self, chosen: ChosenLights) -> None:
        """Count the rays that were traced of late."""
        self.add(chosen.place, chosen.rays % SEEN, chosen.rays // SEEN)
        chosen.known += chosen.rays
        chosen.rays = dr.opaque(mi.UInt32, 0, dr.width(chosen.known))
        dr.eval(chosen.known)

    def add(self, place: mi.UInt32, tried: mi.UInt32, seen: mi.UInt32) -> None:
        """Add rays, and those that arrived, to what patches and regions know of some clusters."""
        for own, around, counts in zip((self.tried, self.seen), self.around, (tried, seen), strict=True):
            dr.scatter_add(own, counts, place, tried > 0, mode=dr.ReduceMode.Direct)
            dr.scatter_add(around, counts, _around(place), tried > 0, mode=dr.ReduceMode.Direct)
        dr.eval(self.tried, self.seen, self.around)

    def inform(self, chosen: ChosenLights) -> None:
        """Set the visibility of the clusters of patches to what rays have taught."""
        chosen.expect(self._expected(chosen.place))

    def learn(self) -> None:
        """Let all patches learn from the rays until now. What others at a distance know is looked up only here."""
        sums = [counts.numpy().reshape(-1, CLUSTERS).sum(axis=0, dtype=np.uint32) for counts in self.around]
        self.whole = [upload(counts, mi.UInt32) for counts in sums]
        self.visibility = self._expected(dr.arange(mi.UInt32, dr.width(self.tried)))
        dr.eval(self.visibility)

    def _expected(self, place: mi.UInt32) -> mi.Float:
        """Tell what a patch expects of a cluster: what it knows, then what is known around it, then everywhere, and then a half."""
        visibility: Any = 0.5
        known = (*self.whole, place % CLUSTERS), (*self.around, _around(place)), (self.tried, self.seen, place)
        for tried, seen, index in known:
            tried, seen = dr.gather(mi.UInt32, tried, index), dr.gather(mi.UInt32, seen, index)
            visibility = (mi.Float(seen) + TRUST * visibility) / (TRUST + mi.Float(tried))
        return visibility


def build_guide(patches: int) -> LightGuide:
    """Begin to know nothing in so many patches."""
    # Opaque: kernels would be compiled for the size of literal zeros.
    tried, seen = (dr.opaque(mi.UInt32, 0, patches * CLUSTERS) for _ in range(2))
    return LightGuide(tried, seen, dr.opaque(mi.Float, 0.5, patches * CLUSTERS))


def _around(place: mi.UInt32) -> mi.UInt32:
    """Tell where the region of a patch counts a cluster."""
    return place // (AROUND * CLUSTERS) * CLUSTERS + place % CLUSTERS
