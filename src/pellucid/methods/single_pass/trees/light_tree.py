"""The binary tree over light samples: bounds for cuts, and estimates of what clusters send."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....kernels.memory import upload
from ....light.points.records import DIRECTIONAL, OMNI, LightRecords, LightSamples, to_device
from .binary import BinaryTree, boxes, build_binary_tree, depth_of, sum_up
from .bounds import closer

LIGHT_FLOAT4S = 4

TURN = 0.7
"""How much the orientation of lights counts in clustering them: those that shine in opposite directions are kept apart."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
NEAR = 0.1
"""Share of its radius that a cluster is taken to be away at least: with less, clusters around a point would never be divided."""

ROOT, LOCAL_ROOT, DIRECTIONAL_ROOT = 1, 2, 3

CLUSTERS = 2048
"""Clusters of lights about which patches learn whether they see them."""

NOBODY = 0xFFFFFFFF
"""What stands for no cluster."""


@dataclass
class LightTree:
    """Light samples in the order of the leaves, and bounds of their clusters.

    Node 1 holds all lights; below it node 2 those that have a position, and node 3 the directional ones, for which
    position and normal are both the direction to the light. Either may be empty.

    Attributes
    ----------
    lights : LightRecords
        Light of leaf node ``i`` is number ``i - leaves``.
    nodes : Float
        Four float4s a node: sphere (centre, radius), cone (axis, cosine), (summed intensity, least near2 or -1 for
        directional lights), and (half its box, the near2 of all together: `near2_together`).
    strength : Float
        Luminance of the summed intensity of each node.
    depth, leaves, count
        Levels below node 1, number of leaves, and of the lights among them.
    """

    lights: LightRecords
    nodes: mi.Float
    strength: mi.Float
    depth: int
    leaves: int
    count: int

    def __post_init__(self) -> None:
        self.leaves_opaque = dr.opaque(mi.UInt32, self.leaves)

    @cached_property
    def owner(self) -> mi.UInt32:
        """Which of some `CLUSTERS` clusters each node lies in, `NOBODY` for those above: ``(2 leaves,)``."""
        return upload(_owners(self), mi.UInt32)

    @property
    def nbytes(self) -> int:
        """Bytes on the device."""
        there = (self.nodes, self.strength, self.lights.packets, vars(self).get("owner"))
        return 4 * sum(len(array) for array in there if array is not None)


def build_light_tree(lights: LightSamples, turn: float = TURN) -> LightTree:
    """Cluster light samples by position, and by orientation as far as that counts; strengths are luminances.

    Source: AWB08 section 4.3; WFABDG05 section 4.
    """
    directional = np.flatnonzero(lights.kind == DIRECTIONAL)
    local = np.flatnonzero(lights.kind != DIRECTIONAL)
    strength = lights.intensity @ LUMINANCE
    axis = np.where((lights.kind == OMNI)[:, None], 0, lights.n)  # what is no spot shines in all directions
    depth = 1 + depth_of(max(len(local), len(directional), 1))
    leaves = 1 << depth
    nodes = np.zeros((2 * leaves, LIGHT_FLOAT4S, 4), np.float32)
    order, filled = np.zeros(leaves, np.int64), np.zeros(leaves, bool)
    for side, (members, places, turns) in enumerate(((local, lights.p, turn), (directional, lights.n, 0.0))):
        if len(members) == 0:
            continue
        tree = build_binary_tree(places[members], axis[members], strength[members], turns, depth - 1)
        members = members[tree.order]
        first = side * leaves // 2
        order[first : first + len(members)] = members
        filled[first : first + len(members)] = True
        rows = _rows(tree, lights.take(members), bool(side))
        for level in range(depth):
            at = (2 + side) << level
            nodes[at : at + (1 << level)] = rows[1 << level : 2 << level]
    nodes[1, 2, :3] = nodes[2, 2, :3] + nodes[3, 2, :3]
    kept = lights.take(order) if len(lights) else LightSamples.make(OMNI, 0, 0, np.zeros((leaves, 3)))
    kept.intensity[~filled] = 0
    return LightTree(
        to_device(kept),
        upload(nodes, mi.Float),
        upload(nodes[:, 2, :3] @ LUMINANCE, mi.Float),
        depth,
        leaves,
        len(lights),
    )


def _rows(tree: BinaryTree, lights: LightSamples, directional: bool) -> np.ndarray:
    """Lay out the nodes of one half of the tree: ``(m, 3, 4) float32``."""
    near2 = np.full(2 * tree.leaves, np.inf, np.float32)
    near2[tree.leaves : tree.leaves + len(lights)] = lights.even_within2
    for level in range(tree.depth - 1, -1, -1):
        first = 1 << level
        near2[first : 2 * first] = np.minimum(near2[2 * first : 4 * first : 2], near2[2 * first + 1 : 4 * first : 2])
    rows = np.zeros((2 * tree.leaves, LIGHT_FLOAT4S, 4), np.float32)
    rows[:, 0, :3], rows[:, 0, 3] = tree.centre, tree.radius
    rows[:, 1, :3], rows[:, 1, 3] = tree.axis, tree.cos_cone
    rows[:, 2, :3] = sum_up(lights.intensity, tree.depth)
    rows[:, 2, 3] = -1.0 if directional else np.where(np.isfinite(near2), near2, 0)
    rows[:, 3, :3] = boxes(lights.n if directional else lights.p, tree.depth)
    rows[:, 3, 3] = 0 if directional else near2_together(lights, tree.depth)
    return rows


def near2_together(lights: LightSamples, depth: int) -> np.ndarray:
    """Give the square of the distance below which all lights of a node together grow no brighter: ``sum I / max (I / near2)``, ``(m,)``.

    ``I / near2`` is the radiosity of the surface that a virtual light stands for. A surface of the radiosity B gives nothing more than
    the irradiance B, however large it is; so no point gets more than the largest ``I / near2`` from all of them, but for the noise
    that points in the place of a surface have. Zero, which is no limit, where one of the lights stands for no surface.
    """
    strength = lights.intensity @ LUMINANCE.astype(np.float64)
    radiosity = np.divide(
        strength, lights.near2, out=np.full(len(lights), np.inf), where=(lights.near2 > 0) & (lights.reach2 == 0)
    )
    brightest = np.zeros(2 << depth)
    brightest[1 << depth :][: len(lights)] = np.where(strength > 0, radiosity, 0)
    for level in range(depth - 1, -1, -1):
        first = 1 << level
        below = brightest[2 * first : 4 * first]
        brightest[first : 2 * first] = np.maximum(below[::2], below[1::2])
    return np.divide(sum_up(strength, depth), brightest, out=np.zeros(2 << depth), where=brightest > 0)


def luminance(colour: Any) -> mi.Float:
    """Weigh red, green and blue as the eye does: errors are compared in luminance."""
    return mi.luminance(mi.Color3f(colour))


def importance(
    tree: LightTree, node: Any, p: mi.Point3f, n: mi.Normal3f, radius: Any = 0.0, cos_cone: Any = 1.0
) -> mi.Float:
    """Estimate the luminance that the lights of a node send to a point, or to points near each other, as if nothing stood between.

    An upper bound is `bounds.irradiance_bound`.

    Cosines are taken at their largest over spheres and cones of both, distances at their smallest but for `NEAR`: never
    zero where one of the lights gives something to one of the points, and exact for one light at one point.

    Parameters
    ----------
    p, n : Point3f, Normal3f
        Point and normal; or the middle of a sphere of points, and the axis of a cone of normals.
    radius, cos_cone : Float
        Radius of the sphere [scene units], and cosine of half the angle of the cone.

    Source: the bounds of WABG06 section 5, with the distance of an estimate.
    """
    base = node * LIGHT_FLOAT4S
    sphere, cone, light = (dr.gather(mi.Array4f, tree.nodes, base + k) for k in range(3))
    directional = light[3] < 0
    facing = mi.Vector3f(cone[0], cone[1], cone[2])
    away = mi.Vector3f(sphere[0], sphere[1], sphere[2]) - p
    d2, both = dr.squared_norm(away), sphere[3] + radius
    inside = ~directional & (d2 <= dr.square(both))
    direction = dr.select(directional, facing, away * dr.rsqrt(dr.maximum(d2, 1e-30)))
    cos_light, sin_light = cone[3], dr.safe_sqrt(1 - dr.square(cone[3]))
    # Half the angle of directions from any of the points to any of the lights; all around from inside.
    sin2 = dr.select(directional, dr.square(sin_light), dr.minimum(dr.square(both) / dr.maximum(d2, 1e-30), 1))
    sin_wide, cos_wide = dr.sqrt(sin2), dr.safe_sqrt(1 - sin2)
    at_point = closer(closer(dr.dot(direction, n), cos_cone), cos_wide, sin_wide)
    at_point = dr.select(inside | (directional & (cos_light < 0)) | (cos_cone < 0), 1, at_point)
    at_light = closer(closer(-dr.dot(direction, facing), cos_light, sin_light), cos_wide, sin_wide)
    at_light = dr.select(directional | inside | (cos_light <= -1), 1, at_light)
    nearest = dr.maximum(dr.sqrt(d2) - both, NEAR * both)
    falloff = dr.select(directional, 1, dr.rcp(dr.maximum(dr.square(nearest), dr.maximum(light[3], 1e-30))))
    return (
        luminance(mi.Color3f(light[0], light[1], light[2]))
        * falloff
        * dr.maximum(at_point, 0)
        * dr.maximum(at_light, 0)
    )


def _owners(lights: LightTree) -> np.ndarray:
    """Divide all lights, always the cluster whose power times size is largest: the cluster of each node, ``(2 leaves,)``."""
    nodes = lights.nodes.numpy().reshape(-1, LIGHT_FLOAT4S, 4)
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
