"""Upper bounds of what a cluster of lights gives to a cluster of receivers, and of R_d between a point and a cluster.

All bounds are made of boxes, spheres and cones, and free of inverse trigonometry: an angle is known by its cosine, and the cosine
of an angle made smaller by another follows from the addition theorem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ....gather.gather import lookup
from ....gather.source import Source
from ....model.fresnel import transmitted

HUGE = 1e30
"""Stands for an infinite bound, and leaves room to be multiplied."""


@dataclass
class Cluster:
    """A box and a sphere around the members of a cluster, both with the same centre, and a cone around their normals.

    ``half`` is half the size of the box, along the axes of the space of the cluster; ``cos_cone = -1`` is every direction.
    """

    centre: mi.Point3f
    radius: mi.Float
    axis: mi.Vector3f
    cos_cone: mi.Float
    half: mi.Vector3f


def read_cluster(nodes: mi.Float, node: Any, float4s: int, box_at: int) -> Cluster:
    """Fetch sphere, cone and box of nodes of so many float4s each: the first two of them, and the one at ``box_at``."""
    sphere, cone, box = (dr.gather(mi.Array4f, nodes, node * float4s + k) for k in (0, 1, box_at))
    return Cluster(
        mi.Point3f(sphere[0], sphere[1], sphere[2]),
        sphere[3],
        mi.Vector3f(cone[0], cone[1], cone[2]),
        cone[3],
        mi.Vector3f(box[0], box[1], box[2]),
    )


def irradiance_bound(receivers: Cluster, lights: Cluster, near2: Any, eta: Any) -> mi.Float:
    """Bound the irradiance link factor between any member of two clusters: ``F <= F_t(c) c c_light / max(d^2, near2)``.

    `light_tree.importance` is no bound: it keeps clusters at a distance, since a bound is infinite where they touch, and is cheaper.

    The cosines c at the receiver and c_light at oriented lights, and the distance d, are the best ones possible between
    members of the clusters; visibility is at most 1. Between two points the bound is the factor itself, but for spots,
    which are bounded as if they shone in all directions.

    Parameters
    ----------
    receivers, lights : Cluster
        Receivers with their shading normals; lights with their normals, or the directions to them. Both in the same space.
    near2 : Float
        Square of the distance below which the lights of the cluster grow no brighter; -1 marks directional lights.
    eta : Float
        Relative index of refraction behind the receivers.

    Source: WABG06 and WFABDG05, their bounds of materials and geometry. The Fresnel transmittance is ours; times the cosine it
    grows with the cosine.
    """
    directional = near2 < 0
    way = mi.Vector3f(lights.centre - receivers.centre)
    gaps = dr.maximum(dr.abs(way) - receivers.half - lights.half, 0)
    distance, reach = dr.norm(way), receivers.radius + lights.radius
    nearest = dr.maximum(dr.norm(gaps), distance - reach)
    # Directions from any receiver to any light lie in a cone around the line between the centres.
    sine = reach / dr.maximum(distance, 1 / HUGE)
    cos_ways = dr.select(sine < 1, dr.safe_sqrt(1 - dr.square(sine)), -1)
    direction = dr.select(directional, lights.axis, way / dr.maximum(distance, 1 / HUGE))
    cos_ways = dr.select(directional, lights.cos_cone, cos_ways)

    def cosine(cluster: Cluster, side: Any) -> Any:
        axis = cluster.axis * side
        best = closer(dr.dot(axis, direction), cos_ways)
        # How far along the axis the other cluster reaches, at most.
        height = dr.dot(axis, way) + reach_along(axis, receivers) + reach_along(axis, lights)
        slope = height / dr.maximum(dr.select(height > 0, nearest, distance + reach), 1 / HUGE)
        return closer(dr.select(directional, best, dr.minimum(best, slope)), cluster.cos_cone)

    at_receiver = cosine(receivers, 1)
    at_light = dr.select(directional, 1, dr.maximum(cosine(lights, -1), 0))
    falloff = dr.select(directional, 1, dr.rcp(dr.maximum(dr.maximum(dr.square(nearest), near2), 1 / HUGE)))
    return dr.maximum(at_receiver, 0) * transmitted(at_receiver, eta) * at_light * falloff


def reach_along(axis: Any, cluster: Cluster) -> mi.Float:
    """Bound how far the members of a cluster lie from its centre along a direction."""
    return dr.minimum(dr.dot(dr.abs(axis), cluster.half), cluster.radius)


def profile_bound(source: Source, point: mi.Point3f, cluster: Cluster, active: Any = True) -> mi.Color3f:
    """Bound R_d between a point and any member of a cluster: R_d at the nearest point of its box and its sphere.

    Source: AWB08 section 4.3.
    """
    way = cluster.centre - point
    box = dr.norm(dr.maximum(dr.abs(way) - cluster.half, 0))
    nearest = dr.maximum(dr.maximum(box, dr.norm(way) - cluster.radius), 0)
    return mi.Color3f(*lookup(source, dr.square(nearest), active))


def closer(cosine: Any, cos_by: Any, sin_by: Any = None) -> Any:
    """Make an angle smaller by another one, but not below zero: ``cos(max(a - b, 0))`` from ``cos a`` and ``cos b``.

    The sine of b is better given where it is known: of a small angle, the cosine has lost it.
    """
    sin_by = dr.safe_sqrt(1 - dr.square(cos_by)) if sin_by is None else sin_by
    return dr.select(cosine >= cos_by, 1, dr.fma(cosine, cos_by, dr.safe_sqrt(1 - dr.square(cosine)) * sin_by))
