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

from ..memory import upload
from .chosen_lights import SEEN, ChosenLights
from .light_tree import CLUSTERS, LightTree

AROUND = 8
"""Patches of a region."""

TRUST, TRUST_AT_HAND = 4.0, 1.5
"""Rays that what is known of the surroundings counts for; and that what the guide knows of a cluster of lights counts for about a
cluster inside it that was chosen: neighbours mostly see the same lights alike."""


@dataclass
class LightGuide:
    """What r patches know of c clusters of lights.

    Attributes
    ----------
    owner : UInt32
        The cluster that each node of the light tree lies in (`LightTree.owner`).
    patches : int
        Their number r; `AROUND` that follow each other make up a region.
    visibility : Float
        Share of the rays from a patch to a cluster that arrive, as far as is known: ``(r, c)``, row by row.
    tried, seen : UInt32
        Rays that were traced, and that arrived.
    """

    owner: mi.UInt32
    patches: int
    visibility: mi.Float
    tried: mi.UInt32
    seen: mi.UInt32

    def __post_init__(self) -> None:
        self.clusters = dr.opaque(mi.UInt32, CLUSTERS)
        self.whole = [np.zeros(CLUSTERS, np.uint32)] * 2

    def count(self, chosen: ChosenLights) -> None:
        """Count the rays that were traced of late."""
        tried, seen = chosen.rays % SEEN, chosen.rays // SEEN
        for target, counts in ((self.tried, tried), (self.seen, seen)):
            dr.scatter_add(target, counts, chosen.place, counts > 0, mode=dr.ReduceMode.Direct)
        chosen.known += chosen.rays
        chosen.rays = dr.opaque(mi.UInt32, 0, dr.width(chosen.known))
        dr.eval(self.tried, self.seen, chosen.known)

    def inform(self, chosen: ChosenLights) -> None:
        """Set the visibility of the clusters of patches to what rays have taught."""
        around = dr.gather(mi.Float, self.visibility, chosen.place)
        tried, seen = mi.Float(chosen.known % SEEN), mi.Float(chosen.known // SEEN)
        chosen.expect(dr.fma(TRUST_AT_HAND, around, seen) / (TRUST_AT_HAND + tried))

    def learn(self, first: int = 0, end: int | None = None) -> None:
        """Estimate visibility anew from the rays until now, in the patches ``first`` to ``end``; those that lie in the same
        regions learn with them. What all others know is looked up when all of them learn."""
        begin = first // AROUND
        larger = -(-(self.patches if end is None else min(end, self.patches)) // AROUND) - begin
        size = min((begin + larger) * AROUND, self.patches) - begin * AROUND
        lane = dr.arange(mi.UInt32, size * CLUSTERS)
        place = lane + dr.opaque(mi.UInt32, begin * AROUND * CLUSTERS)
        cluster = lane % self.clusters
        around = lane // (self.clusters * AROUND) * self.clusters + cluster
        own = [dr.gather(mi.UInt32, counts, place) for counts in (self.tried, self.seen)]
        large = [dr.opaque(mi.UInt32, 0, larger * CLUSTERS) for _ in range(2)]
        for target, counts in zip(large, own, strict=True):
            dr.scatter_add(target, counts, around, mode=dr.ReduceMode.Direct)
        if end is None:
            self.whole = [counts.numpy().reshape(-1, CLUSTERS).sum(axis=0, dtype=np.uint32) for counts in large]
        visibility: Any = 0.5
        whole = [upload(counts, mi.UInt32) for counts in self.whole]
        for tried, seen, index in ((*whole, cluster), (*large, around), (*own, None)):
            if index is not None:
                tried, seen = dr.gather(mi.UInt32, tried, index), dr.gather(mi.UInt32, seen, index)
            visibility = (mi.Float(seen) + TRUST * visibility) / (TRUST + mi.Float(tried))
        dr.scatter(self.visibility, visibility, place)
        dr.eval(self.visibility)


def build_guide(lights: LightTree, patches: int) -> LightGuide:
    """Begin to know nothing in so many patches."""
    # Opaque: kernels would be compiled for the size of literal zeros.
    tried, seen = (dr.opaque(mi.UInt32, 0, patches * CLUSTERS) for _ in range(2))
    half = dr.opaque(mi.Float, 0.5, patches * CLUSTERS)
    return LightGuide(lights.owner, patches, half, tried, seen)
