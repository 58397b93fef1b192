"""Which lights a region of the surface sees: learnt from its shadow rays, and used to aim the next ones.

All lights are divided once into a few hundred clusters. Each region, a patch of neighbouring clusters of irradiance samples,
keeps for every one of them what it would give if nothing stood between, and how many of the shadow rays towards it
arrived. The product says where light comes from; rays are shared out by it, so that where all of a cluster is seen, or none
of it, rays add nothing to the noise.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .light_tree import DIRECTIONAL_ROOT, LOCAL_ROOT, LUMINANCE, NODE_PACKETS, ONE_MINUS_EPSILON, LightTree, importance, sample_light

CLUSTERS = 512
LEAST = 0.02
"""Of its visibility a cluster keeps so much, so that a light that was missed is found."""


@dataclass
class LightGuide:
    """For each of r regions and c clusters of lights: the density of rays, and what they found.

    ``clusters`` are nodes of the light tree; ``around (r,)`` numbers the larger regions that regions lie in; ``unshadowed`` what each gives a region, ``cumulative`` the sums of their
    shares, ``(r, c)`` row by row; ``tried`` and ``seen`` count rays.
    """

    clusters: mi.UInt32
    around: np.ndarray
    unshadowed: np.ndarray
    cumulative: mi.Float
    tried: mi.UInt32
    seen: mi.UInt32

    def learn(self) -> None:
        """Share rays out anew by what was seen until now."""
        shape = self.unshadowed.shape
        tried, seen = (np.asarray(a.numpy(), np.float32).reshape(shape) for a in (self.tried, self.seen))
        visibility = np.full(shape, 0.5, np.float32)
        # What is not known of a region is taken from the one around it, and of that from all.
        for group in (np.zeros(shape[0], np.int64), self.around, np.arange(shape[0])):
            visibility = (_sum_groups(seen, group)[group] + visibility) / (_sum_groups(tried, group)[group] + 1)
        # The square root: among lights that are seen by chance, it leaves the least noise.
        share = self.unshadowed * (LEAST + (1 - LEAST) * np.sqrt(visibility))
        total = share.sum(axis=1, keepdims=True)
        share = np.where(total > 0, share / np.where(total > 0, total, 1), 1 / shape[1])
        cumulative = np.cumsum(share, axis=1, dtype=np.float64)
        self.cumulative = mi.Float((cumulative / cumulative[:, -1:]).astype(np.float32).ravel())


def _sum_groups(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Sum the rows of each group: ``(groups, c)``."""
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    return np.add.reduceat(values[order], starts, axis=0)


def build_guide(lights: LightTree, p: mi.Point3f, n: mi.Normal3f, per_region: int, around: np.ndarray) -> LightGuide:
    """Begin with what every region would see if nothing stood between.

    Parameters
    ----------
    p, n : Point3f, Normal3f
        Points of all regions, ``per_region`` for each, one region after the other.
    around : (r,) int
        The number of the larger region, from 0 on, in which each region lies.
    """
    clusters = mi.UInt32(choose_clusters(lights))
    count = dr.width(clusters)
    regions = dr.width(p) // per_region
    lane = dr.arange(mi.UInt32, regions * count)
    region, node = lane // count, dr.gather(mi.UInt32, clusters, lane % count)
    total = mi.Float(0)
    for k in range(per_region):
        point = region * per_region + k
        total += importance(lights, node, dr.gather(mi.Point3f, p, point), dr.gather(mi.Normal3f, n, point))
    unshadowed = total.numpy().reshape(regions, count)
    # A region's own points may all be below the horizon of a light that others of it can see.
    unshadowed += 1e-3 * unshadowed.mean(axis=1, keepdims=True)
    nothing = dr.zeros(mi.UInt32, regions * count)
    guide = LightGuide(clusters, around, unshadowed, mi.Float(0), nothing, mi.UInt32(nothing))
    guide.learn()
    return guide


def choose_clusters(lights: LightTree) -> np.ndarray:
    """Divide all lights: always the cluster whose power times size is largest; returns nodes ``(c,) uint32``."""
    nodes = lights.nodes.numpy().reshape(-1, NODE_PACKETS, 4)
    power = nodes[:, 2, :3] @ LUMINANCE
    directional = nodes[:, 2, 3] < 0
    # Each kind in its own measure, and both kinds alike: sizes as shares of the whole, powers too.
    size = nodes[:, 0, 3] / np.where(directional, max(nodes[3, 0, 3], 1e-30), max(nodes[2, 0, 3], 1e-30))
    whole = np.where(directional, max(power[3], 1e-30), max(power[2], 1e-30))
    score = (power / whole) * (size + 1e-3)
    queue = [(-float(score[root]), root) for root in (LOCAL_ROOT, DIRECTIONAL_ROOT) if power[root] > 0]
    heapq.heapify(queue)
    done = []
    while queue and len(queue) + len(done) < CLUSTERS:
        _, node = heapq.heappop(queue)
        if node >= lights.leaves:
            done.append(node)
            continue
        for child in (2 * node, 2 * node + 1):
            if power[child] > 0:
                heapq.heappush(queue, (-float(score[child]), child))
    found = sorted([*done, *(node for _, node in queue)], key=lambda node: node / 2 ** node.bit_length())
    return np.array(found or [LOCAL_ROOT], np.uint32)


@dr.syntax
def sample_guided(guide: LightGuide, lights: LightTree, region: mi.UInt32, p: mi.Point3f, n: mi.Normal3f, u: mi.Float):
    """Draw one light for each point as the guide of its region says, within a cluster by what each branch can give.

    Returns
    -------
    light, weight : UInt32, Float
        As `light_tree.sample_light`.
    entry : UInt32
        Where the guide counts what the ray finds.
    """
    count = dr.opaque(mi.UInt32, dr.width(guide.clusters))
    first = region * count
    low, high = mi.UInt32(0), count - 1
    low += dr.zeros(mi.UInt32, dr.width(region))
    high += dr.zeros(mi.UInt32, dr.width(region))
    while dr.hint(low < high, label="pellucid guide"):
        middle = (low + high) >> 1
        beyond = dr.gather(mi.Float, guide.cumulative, first + middle) <= u
        low = dr.select(beyond, middle + 1, low)
        high = dr.select(beyond, high, middle)
    entry = first + low
    upper = dr.gather(mi.Float, guide.cumulative, entry)
    lower = dr.select(low > 0, dr.gather(mi.Float, guide.cumulative, entry - 1, low > 0), 0)
    share = upper - lower
    within = dr.clip((u - lower) / share, 0, ONE_MINUS_EPSILON)
    node = dr.gather(mi.UInt32, guide.clusters, low)
    light, weight = sample_light(lights, p, n, within, share > 0, node)
    return light, dr.select(share > 0, weight / share, 0), entry
