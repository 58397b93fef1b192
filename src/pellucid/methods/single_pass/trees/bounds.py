"""Upper bounds of what a cluster of lights gives to a cluster of receivers, and of R_d between a point and a cluster.

All bounds are made of spheres and cones, and free of inverse trigonometry: an angle is known by its cosine, and the cosine
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

NODE_FLOAT4S = 3  # of nodes of light trees and of sample trees
HUGE = 1e30
"""Stands for an infinite bound, and leaves room to be multiplied."""


@dataclass
class Cluster:
    """A sphere around the members of a cluster, and a cone around their normals; ``cos_cone = -1`` is every direction."""

    centre: mi.Point3f
    radius: mi.Float
    axis: mi.Vector3f
    cos_cone: mi.Float


def read_cluster(nodes: mi.Float, node: Any, active: Any = True) -> Cluster:
    """Fetch sphere and cone of nodes of a light tree or a sample tree."""
    sphere = dr.gather(mi.Array4f, nodes, node * NODE_FLOAT4S, active)
    cone = dr.gather(mi.Array4f, nodes, node * NODE_FLOAT4S + 1, active)
    return Cluster(
        mi.Point3f(sphere[0], sphere[1], sphere[2]), sphere[3], mi.Vector3f(cone[0], cone[1], cone[2]), cone[3]
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
        Receivers with their shading normals; lights with their normals, or the directions to them.
    near2 : Float
        Square of the distance below which no light of the cluster grows brighter; -1 marks directional lights.
    eta : Float
        Relative index of refraction behind the receivers.

    Source: WABG06, their bounds of materials and geometry. The Fresnel transmittance is ours; times the cosine it grows
    with the cosine.
    """
    directional = near2 < 0
    way = mi.Vector3f(lights.centre - receivers.centre)
    distance = dr.norm(way)
    reach = receivers.radius + lights.radius
    # Directions from any receiver to any light lie in a cone around the line between the centres.
    sine = reach / dr.maximum(distance, 1 / HUGE)
    apart = sine < 1
    cos_ways = dr.select(apart, dr.safe_sqrt(1 - dr.square(sine)), -1)
    way = dr.select(directional, lights.axis, way / dr.maximum(distance, 1 / HUGE))
    cos_ways = dr.select(directional, lights.cos_cone, cos_ways)

    at_receiver = closer(closer(dr.dot(receivers.axis, way), receivers.cos_cone), cos_ways)
    at_light = closer(closer(-dr.dot(lights.axis, way), lights.cos_cone), cos_ways)
    at_light = dr.select(directional, 1, dr.maximum(at_light, 0))
    nearest = dr.maximum(distance - reach, 0)
    falloff = dr.select(directional, 1, dr.rcp(dr.maximum(dr.maximum(dr.square(nearest), near2), 1 / HUGE)))
    return dr.maximum(at_receiver, 0) * transmitted(at_receiver, eta) * at_light * falloff


def profile_bound(source: Source, point: mi.Point3f, cluster: Cluster, active: Any = True) -> mi.Color3f:
    """Bound R_d between a point and any member of a cluster: R_d at the nearest point of the cluster's sphere.

    Source: AWB08 section 4.3.
    """
    nearest = dr.maximum(dr.norm(cluster.centre - point) - cluster.radius, 0)
    return mi.Color3f(*lookup(source, dr.square(nearest), active))


def closer(cosine: Any, cos_by: Any, sin_by: Any = None) -> Any:
    """Make an angle smaller by another one, but not below zero: ``cos(max(a - b, 0))`` from ``cos a`` and ``cos b``.

    The sine of b is better given where it is known: of a small angle, the cosine has lost it.
    """
    sin_by = dr.safe_sqrt(1 - dr.square(cos_by)) if sin_by is None else sin_by
    return dr.select(cosine >= cos_by, 1, dr.fma(cosine, cos_by, dr.safe_sqrt(1 - dr.square(cosine)) * sin_by))
