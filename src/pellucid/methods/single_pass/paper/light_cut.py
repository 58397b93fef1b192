"""Lightcuts: the irradiance at many points from many lights, by one cut through the light tree for each point.

Every lane keeps its cut as a heap in local memory, the cluster with the largest error bound on top, and refines that until
its bound is a small part of what all clusters give.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ....kernels.heap import check_size, push, replace_top
from ....light.points.records import visible
from ....model.fresnel import transmitted
from ..trees.bounds import HUGE, Cluster, irradiance_bound, read_cluster
from ..trees.light_tree import LIGHT_FLOAT4S, LightTree, luminance
from .representatives import LIGHT_REPRESENTATIVES, light_representatives, upload_representatives

DEFAULT_MAX_ERROR = 0.02  # of the total: Weber's law (WFABDG05; AWB08 section 4.3)
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
        Most clusters of a cut, at which refinement ends; up to 16384.
    seed : int
        Same seed, same representatives, same result, bit for bit.

    Raises
    ------
    SceneError
        When ``max_cut`` is out of range.

    Source: WFABDG05, with the exact Fresnel transmittance of each direction.
    """
    check_size(max_cut)
    chosen = upload_representatives(light_representatives(lights, seed))
    dr.eval(si.p, si.n, si.sh_frame.n)  # how they came about is no part of the kernel, which is then compiled once
    lane = dr.arange(mi.UInt32, dr.width(si))
    slot = mi.sample_tea_32(lane, dr.opaque(mi.UInt32, seed))[0] % LIGHT_REPRESENTATIVES
    index = mi.Float(eta)
    dr.make_opaque(index)
    found = _refine(scene, si, index, lights, chosen, slot, dr.opaque(mi.Float, max_error), max_cut)
    dr.eval(found)
    return found


@dr.syntax
def _refine(scene, si, eta, lights, chosen, slot, max_error, max_cut):
    """Refine the cuts of all receivers."""
    # Opaque, and as wide as all lanes: see `lift`.
    zero = dr.opaque(mi.UInt32, 0, dr.width(si))
    point = Cluster(mi.Point3f(si.p), mi.Float(0), mi.Vector3f(si.sh_frame.n), mi.Float(1), mi.Vector3f(0))
    heap = dr.alloc_local(LightCluster, max_cut)

    # Node 1 holds lights with a position and those without, which have no common bound: it is refined in any case.
    leaf = dr.gather(mi.UInt32, chosen, LIGHT_REPRESENTATIVES + slot)
    factor, traced = link_factor(scene, si, eta, lights, leaf, mi.Bool(True))
    total = mi.Color3d(factor * intensity(lights, mi.UInt32(1)))
    heap[0] = LightCluster(mi.Float(HUGE), mi.UInt32(1), factor)
    size, cut_size, rays = zero + 1, zero + 1, zero + dr.select(traced, 1, 0)
    worst = zero + mi.Float(HUGE)

    while dr.hint(
        (size > 0) & (worst > max_error * luminance(total)) & (cut_size < max_cut), label="pellucid light cuts"
    ):
        top = heap[0]
        left, right = 2 * top.node, 2 * top.node + 1

        # ---------------------- One child keeps the representative of its parent ----------------------
        parent = dr.gather(mi.UInt32, chosen, top.node * LIGHT_REPRESENTATIVES + slot)
        leaf_left = dr.gather(mi.UInt32, chosen, left * LIGHT_REPRESENTATIVES + slot)
        leaf_right = dr.gather(mi.UInt32, chosen, right * LIGHT_REPRESENTATIVES + slot)
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
    value = dr.gather(mi.Array4f, lights.nodes, node * LIGHT_FLOAT4S + 2)
    return mi.Color3f(value[0], value[1], value[2])


def cluster_bound(point: Cluster, lights: LightTree, node, eta, light) -> mi.Float:
    """Bound the luminance of a cluster of lights, and so its error; that of a single light is zero."""
    bound = link_bound(point, lights, node, eta) * luminance(light)
    return dr.select(node < lights.leaves_opaque, dr.minimum(bound, HUGE), 0)


def link_bound(receivers: Cluster, lights: LightTree, node, eta) -> mi.Float:
    """Bound the irradiance link factors between receivers and a cluster of lights, visibility aside."""
    near2 = dr.gather(mi.Array4f, lights.nodes, node * LIGHT_FLOAT4S + 2)[3]
    return irradiance_bound(receivers, read_cluster(lights.nodes, node, LIGHT_FLOAT4S, 3), near2, eta)
