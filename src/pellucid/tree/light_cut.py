"""Lightcuts: the irradiance at many points from many lights, by one cut through the light tree for each point.

Every lane keeps its cut as a heap in local memory, the cluster with the largest error bound on top, and refines that until
its bound is a small part of what all clusters give.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..light.light_samples import transmitted, visible
from .binary import sum_up
from .bounds import HUGE, NODE_PACKETS, Cluster, irradiance_bound, luminance, read_cluster
from .light_tree import LUMINANCE, LightTree

SLOTS = 32
"""Representatives of each light cluster, as in WABG06: receivers differ in which of them they use."""

DEFAULT_MAX_ERROR = 0.02  # of the total: Weber's law (WFABDG05 section 3.1, AWB08 section 4.3)
DEFAULT_MAX_CUT = 1000


@dataclass
class LightCuts:
    """The irradiance that enters at each receiver, the clusters of its cut, and the shadow rays it took."""

    entering: mi.Color3f
    cut_size: mi.UInt32
    shadow_rays: mi.UInt32


@dataclass
class LightCluster:
    """A cluster of a cut: its error bound, its node, and the link factor of its representative, visibility included."""

    bound: mi.Float
    node: mi.UInt32
    factor: mi.Float


def light_cuts(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    eta: Any,
    lights: LightTree,
    max_error: float = DEFAULT_MAX_ERROR,
    max_cut: int = DEFAULT_MAX_CUT,
    seed: int = 0,
) -> LightCuts:
    """Sum the light that enters at points over clusters of lights, refined until no error bound exceeds ``max_error``.

    Parameters
    ----------
    si : SurfaceInteraction3f
        Receivers; ``p``, ``n`` and ``sh_frame.n`` are read.
    eta : float or Float
        Relative index of refraction behind the surface.
    lights : LightTree
        Clusters of all lights.
    max_error : float
        Largest error bound of a cluster, as part of the total, in luminance. The error of the sum is far smaller as a
        rule: bounds are not reached, and errors of clusters cancel.
    max_cut : int
        Most clusters of a cut, at which refinement ends.
    seed : int
        Same seed, same representatives, same result, bit for bit.

    Source: WFABDG05 section 3 and 4, with the exact Fresnel transmittance of each direction.
    """
    chosen = upload_representatives(light_representatives(lights, seed))
    lane = dr.arange(mi.UInt32, dr.width(si))
    slot = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed))[0] % SLOTS
    found = _refine(scene, si, mi.Float(eta), lights, chosen, slot, dr.opaque(mi.Float, max_error), max_cut)
    dr.eval(found)
    return found


@dr.syntax
def _refine(scene, si, eta, lights, chosen, slot, max_error, max_cut):
    """Refine the cuts of all receivers."""
    # Opaque, and as wide as all lanes: see `lift`.
    zero = dr.opaque(mi.UInt32, 0, dr.width(si))
    point = Cluster(mi.Point3f(si.p), mi.Float(0), mi.Vector3f(si.sh_frame.n), mi.Float(1))
    heap = dr.alloc_local(LightCluster, max_cut)

    # Node 1 holds lights with a position and those without, which have no common bound: it is refined in any case.
    leaf = dr.gather(mi.UInt32, chosen, SLOTS + slot)
    factor, traced = link_factor(scene, si, eta, lights, leaf, mi.Bool(True))
    total = mi.Color3d(factor * intensity(lights, mi.UInt32(1)))
    heap[0] = LightCluster(mi.Float(HUGE), mi.UInt32(1), factor)
    size, cut_size, rays = zero + 1, zero + 1, zero + dr.select(traced, 1, 0)
    worst = zero + mi.Float(HUGE)

    while dr.hint((size > 0) & (worst > max_error * luminance(total)) & (cut_size < max_cut), label="pellucid light cuts"):
        top = heap[0]
        left, right = 2 * top.node, 2 * top.node + 1

        # ---------------------- One child keeps the representative of its parent ----------------------
        parent = dr.gather(mi.UInt32, chosen, top.node * SLOTS + slot)
        leaf_left = dr.gather(mi.UInt32, chosen, left * SLOTS + slot)
        leaf_right = dr.gather(mi.UInt32, chosen, right * SLOTS + slot)
        left_keeps = leaf_left == parent
        light_left, light_right = intensity(lights, left), intensity(lights, right)
        lit = dr.any(dr.select(left_keeps, light_right, light_left) > 0)
        fresh, traced = link_factor(scene, si, eta, lights, dr.select(left_keeps, leaf_right, leaf_left), lit)
        factor_left = dr.select(left_keeps, top.factor, fresh)
        factor_right = dr.select(left_keeps, fresh, top.factor)

        # ---------------------- The total ----------------------
        total -= mi.Color3d(top.factor * intensity(lights, top.node))
        total += mi.Color3d(factor_left * light_left) + mi.Color3d(factor_right * light_right)
        cut_size += dr.select(dr.any(light_left > 0) & dr.any(light_right > 0), 1, 0)
        rays += dr.select(traced, 1, 0)

        # ---------------------- The heap ----------------------
        first = LightCluster(cluster_bound(point, lights, left, eta, light_left), left, factor_left)
        second = LightCluster(cluster_bound(point, lights, right, eta, light_right), right, factor_right)
        swap = second.bound > first.bound
        larger, smaller = dr.select(swap, second, first), dr.select(swap, first, second)
        heap, size = replace_top(heap, size, larger, zero)
        heap, size = push(heap, size, smaller, zero)
        worst = dr.select(size > 0, heap[0].bound, 0)

    return LightCuts(mi.Color3f(dr.maximum(total, 0)), cut_size, rays)


def link_factor(scene, si, eta, lights: LightTree, leaf, active) -> tuple[mi.Float, mi.Bool]:
    """Evaluate the irradiance link between receivers and single lights: the factor of a light's intensity that enters.

    Returns the factor, 0 where the light does not reach, and where a shadow ray was traced.
    """
    factor, direction, distance = unshadowed_factor(si, eta, lights, leaf, active)
    traced = active & (factor > 0)
    return dr.select(visible(scene, si, direction, distance, traced), factor, 0), traced


def unshadowed_factor(si, eta, lights: LightTree, leaf, active) -> tuple[mi.Float, mi.Vector3f, mi.Float]:
    """Evaluate an irradiance link without its visibility: factor, direction and distance of the light."""
    direction, distance, light = lights.lights.arriving(leaf, si.p, si.sh_frame.n, active)
    full = dr.sum(intensity(lights, leaf + lights.leaves_opaque))
    factor = dr.select(full > 0, dr.sum(light) / full, 0) * transmitted(dr.dot(direction, si.sh_frame.n), eta)
    return factor, direction, distance


def intensity(lights: LightTree, node) -> mi.Color3f:
    """Fetch the summed intensity of nodes."""
    packet = dr.gather(mi.Array4f, lights.nodes, node * NODE_PACKETS + 2)
    return mi.Color3f(packet[0], packet[1], packet[2])


def cluster_bound(point: Cluster, lights: LightTree, node, eta, light) -> mi.Float:
    """Bound the luminance of a cluster of lights, and so its error; that of a single light is zero."""
    near2 = dr.gather(mi.Array4f, lights.nodes, node * NODE_PACKETS + 2)[3]
    bound = irradiance_bound(point, read_cluster(lights.nodes, node), near2, eta) * luminance(light)
    return dr.select(node < lights.leaves_opaque, dr.minimum(bound, HUGE), 0)


def light_representatives(lights: LightTree, seed: int) -> NDArray[np.uint32]:
    """Choose the representatives of all light clusters, in proportion to luminance: ``(m, SLOTS)``."""
    nodes = lights.nodes.numpy().reshape(-1, NODE_PACKETS, 4)
    return representatives(nodes[lights.leaves :, 2, :3] @ LUMINANCE, lights.depth, SLOTS, seed)


def representatives(strength: NDArray, depth: int, slots: int, seed: int) -> NDArray[np.uint32]:
    """Choose ``slots`` representatives of every node, at random in proportion to the strength of leaves: ``(m, slots)``.

    A representative of a node is also one of its children's, in the same slot: a cluster that is split hands its link on.

    Source: WFABDG05 section 3.3; WABG06 section 4.2.
    """
    leaves = 1 << depth
    total = sum_up(strength, depth)
    chosen = np.zeros((2 * leaves, slots), np.uint32)
    chosen[leaves:] = np.arange(leaves)[:, None]
    rng = np.random.default_rng(seed)
    for level in range(depth - 1, -1, -1):
        first = 1 << level
        both, left = total[first : 2 * first], total[2 * first : 4 * first : 2]
        share = np.divide(left, both, out=np.ones(first), where=both > 0).astype(np.float32)
        # 1 - u is in (0, 1]: a child without strength is never chosen.
        to_right = 1 - rng.random((first, slots), np.float32) > share[:, None]
        below = chosen[2 * first : 4 * first].reshape(first, 2, slots)
        chosen[first : 2 * first] = np.where(to_right, below[:, 1], below[:, 0])
    return chosen


def upload_representatives(chosen: NDArray[np.uint32]) -> mi.UInt32:
    """Bring representatives to the device."""
    return mi.UInt32(chosen.ravel())


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
