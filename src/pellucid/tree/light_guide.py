"""Which lights a region of the surface sees: learnt from its shadow rays, so that the next ones go where it is not yet known.

All lights are divided once into some thousand clusters. Each region, some patches of irradiance samples that lie beside each
other, counts how many of its rays towards each of them arrived. What a region knows little of it takes from the larger region
around it, and that from all. A patch besides learns of every single one of the lights that were chosen for it.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..memory import upload
from .chosen_lights import NOBODY, SEEN, ChosenLights
from .light_tree import DIRECTIONAL_ROOT, LOCAL_ROOT, LUMINANCE, NODE_PACKETS, LightTree

CLUSTERS = 2048
AROUND = 8
"""Regions of a larger region."""

TRUST, TRUST_AT_HAND = 4.0, 1.5
"""Rays that what is known of the surroundings counts for; and that what a region knows of a cluster of lights counts for in one
of its patches, about one of those lights: neighbours mostly see the same light alike."""


@dataclass
class LightGuide:
    """What r regions know of c clusters of lights.

    Attributes
    ----------
    owner : UInt32
        The cluster that each node of the light tree lies in, `NOBODY` for those above.
    regions : int
        Their number r; `AROUND` that follow each other make up a larger region.
    visibility : Float
        Share of the rays from a region to a cluster that arrive, as far as is known: ``(r, c)``, row by row.
    tried, seen : UInt32
        Rays that were traced, and that arrived.
    """

    owner: mi.UInt32
    regions: int
    visibility: mi.Float
    tried: mi.UInt32
    seen: mi.UInt32

    def __post_init__(self) -> None:
        self.clusters = dr.opaque(mi.UInt32, CLUSTERS)
        self.whole = [np.zeros(CLUSTERS, np.uint32)] * 2

    def count(self, chosen: ChosenLights) -> None:
        """Count the rays that were traced of late, for the regions of the patches."""
        tried, seen = chosen.rays % SEEN, chosen.rays // SEEN
        for target, counts in ((self.tried, tried), (self.seen, seen)):
            dr.scatter_add(target, counts, chosen.place, counts > 0, mode=dr.ReduceMode.Direct)
        chosen.known += chosen.rays
        chosen.rays = dr.opaque(mi.UInt32, 0, dr.width(chosen.known))
        dr.eval(self.tried, self.seen, chosen.known)

    def inform(self, chosen: ChosenLights) -> None:
        """Set the visibility of the lights of patches to what their rays and their regions have taught."""
        around = dr.gather(mi.Float, self.visibility, chosen.place)
        tried, seen = mi.Float(chosen.known % SEEN), mi.Float(chosen.known // SEEN)
        chosen.expect(dr.fma(TRUST_AT_HAND, around, seen) / (TRUST_AT_HAND + tried))

    def learn(self, first: int = 0, end: int | None = None) -> None:
        """Estimate visibility anew from the rays until now, in the regions ``first`` to ``end``; those that lie in the same
        larger regions learn with them. What all others know is looked up when all of them learn."""
        begin = first // AROUND
        larger = -(-(self.regions if end is None else min(end, self.regions)) // AROUND) - begin
        size = min((begin + larger) * AROUND, self.regions) - begin * AROUND
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


def build_guide(lights: LightTree, regions: int) -> LightGuide:
    """Begin to know nothing in ``regions`` regions."""
    # Opaque: kernels would be compiled for the size of literal zeros.
    tried, seen = (dr.opaque(mi.UInt32, 0, regions * CLUSTERS) for _ in range(2))
    half = dr.opaque(mi.Float, 0.5, regions * CLUSTERS)
    return LightGuide(upload(_owners(lights), mi.UInt32), regions, half, tried, seen)


def _owners(lights: LightTree) -> np.ndarray:
    """Divide all lights, always the cluster whose power times size is largest: the cluster of each node, ``(2 leaves,)``."""
    nodes = lights.nodes.numpy().reshape(-1, NODE_PACKETS, 4)
    power, size = nodes[:, 2, :3] @ LUMINANCE, nodes[:, 0, 3].copy()
    for root in (LOCAL_ROOT, DIRECTIONAL_ROOT):  # each kind in its own measure: sizes and powers as shares of the whole
        members = (nodes[:, 2, 3] < 0) == (root == DIRECTIONAL_ROOT)
        size[members] /= max(size[root], 1e-30)
        power[members] /= max(power[root], 1e-30)
    score = power * (size + 1e-3)
    queue = [(-float(score[root]), root) for root in (LOCAL_ROOT, DIRECTIONAL_ROOT)]
    done: list[int] = []
    while queue and len(queue) + len(done) < CLUSTERS:
        _, node = heapq.heappop(queue)
        if node >= lights.leaves:
            done.append(node)
        else:
            for child in (2 * node, 2 * node + 1):
                heapq.heappush(queue, (-float(score[child]), child))
    owner = np.zeros(2 * lights.leaves, np.uint32)
    chosen = sorted([*done, *(node for _, node in queue)])
    owner[chosen] = np.arange(len(chosen))
    given = np.zeros(2 * lights.leaves, bool)
    given[chosen] = True
    for level in range(lights.depth):
        parents = np.arange(1 << level, 2 << level)
        parents = parents[given[parents]]
        for below in (2 * parents, 2 * parents + 1):
            owner[below], given[below] = owner[parents], True
    owner[~given] = NOBODY
    return owner
