"""The irradiance at a point from a few shadow rays: many clusters of lights are weighed, and a few lights of them are tried.

What a light would send if nothing stood between costs little to find out, a shadow ray costs much. So the light tree is
divided finely, and one random light of each cluster is weighed. Their sum, each times the visibility that is expected of it, is
the estimate; shadow rays correct it, and are dealt out by how much they may have to. Where the region knows what it
sees, little is left to chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..light.light_samples import transmitted, visible
from .draw import draw
from .light_guide import LightGuide
from .light_tree import LightTree, importance, luminance
from .local_heap import push, replace_top

CLUSTERS = 1024
"""Most clusters of a cut, 8 bytes of local memory each."""

HUGE = 1e30
DOUBT = 0.01
"""What seems certain is doubted by so much, so that errors are found, and the estimate has no bias."""

GOLDEN, FRACTION = 2654435769, 3242174889
"""Fractions of 2^32 whose multiples fill the unit interval evenly: the golden ratio's inverse along receivers, and the plastic
number's along the clusters of each."""


@dataclass
class Stratum:
    """A cluster of lights and the luminance that it may send; later a light of it and what that sends, for all of them."""

    bound: mi.Float
    node: mi.UInt32


@dataclass
class Estimate:
    """Light that enters at receivers, and the number of shadow rays that were traced."""

    light: mi.Color3f
    traced: mi.UInt32


def sampled_cut(
    scene,
    si,
    eta: Any,
    lights: LightTree,
    guide: LightGuide,
    region: mi.UInt32,
    number: mi.UInt32,
    clusters: mi.UInt32,
    demand: mi.Float,
    least: mi.UInt32,
    most: mi.UInt32,
) -> Estimate:
    """Estimate the light that enters at points.

    The cluster that may send most is divided until there are as many as are asked for. One light of each is drawn in
    proportion to its intensity, and weighed; and of those as many as there are rays are tried, by systematic resampling:
    a control variate with its correction. Nothing that can send light is left out: the estimate has no bias.

    Parameters
    ----------
    si : SurfaceInteraction3f
        Receivers; ``p``, ``n`` and ``sh_frame.n`` are read.
    guide, region : LightGuide, UInt32
        What is known of visibility, and the region of each receiver. The guide counts the rays.
    number : UInt32
        A running number of each receiver, which its random numbers come from.
    clusters : UInt32
        Clusters of lights, up to `CLUSTERS`.
    demand : Float
        Rays over the variance of a single one in luminance: the inverse of the variance that is allowed.
    least, most : UInt32
        Bounds of the number of rays.

    Source: cuts as in WFABDG05, by number; resampling as in J. Talbot et al., *Importance resampling for global
    illumination*, EGSR 2005.
    """
    zero = dr.opaque(mi.UInt32, 0, dr.width(number))
    receiver = Receiver(si, mi.Point3f(si.p), mi.Normal3f(si.sh_frame.n), eta, region, number)
    heap = dr.alloc_local(Stratum, CLUSTERS)
    heap, size, single = _divide(lights, receiver, heap, clusters, zero)
    heap, expected, worth = _weigh(lights, guide, receiver, heap, size, single, zero)
    rays = dr.clip(dr.square(worth) * demand, mi.Float(least), mi.Float(most))
    correction, traced = _try(scene, lights, guide, receiver, heap, size, single, worth / rays, zero)
    return Estimate(expected + correction, traced)


@dataclass
class Receiver:
    """A point with its normal, what is behind it, its region, and the number that its random numbers come from."""

    si: mi.SurfaceInteraction3f
    p: mi.Point3f
    n: mi.Normal3f
    eta: mi.Float
    region: mi.UInt32
    number: mi.UInt32


@dr.syntax
def _divide(lights: LightTree, receiver: Receiver, heap, clusters, zero):
    """Divide clusters; returns the heap of them, their number, and that of single lights at the end of its memory."""
    p, n = receiver.p, receiver.n
    heap[zero] = Stratum(mi.Float(HUGE) + mi.Float(zero), mi.UInt32(1) + zero)
    size, single = zero + 1, mi.UInt32(zero)
    while dr.hint((size > 0) & (size + single < clusters), label="pellucid strata"):
        left = 2 * heap[zero].node
        one, other = importance(lights, left, p, n), importance(lights, left + 1, p, n)
        swap = other > one
        larger = Stratum(dr.select(swap, other, one), dr.select(swap, left + 1, left))
        smaller = Stratum(dr.select(swap, one, other), dr.select(swap, left, left + 1))
        if left >= lights.leaves_opaque:
            if larger.bound > 0:
                heap[CLUSTERS - 1 - single] = larger
                single += 1
            if smaller.bound > 0:
                heap[CLUSTERS - 1 - single] = smaller
                single += 1
            larger.bound = mi.Float(0)
            smaller.bound = mi.Float(0)
        heap, size = replace_top(heap, size, larger, zero)
        heap, size = push(heap, size, smaller, zero)
    return heap, size, single


def _place(size, k):
    """Tell where in memory cluster ``k`` lies: single lights follow those of the heap, from the end on."""
    return dr.select(k < size, k, CLUSTERS - 1 - (k - size))


@dr.syntax
def _weigh(lights: LightTree, guide: LightGuide, receiver: Receiver, heap, size, single, zero):
    """Draw a light of each cluster; returns them in place of the clusters, the light expected, and the sum of all doubts."""
    count, total, k = size + single, mi.Float(zero), mi.UInt32(zero)
    expected = mi.Color3f(0) + mi.Float(zero)
    while dr.hint(k < count, label="pellucid weigh"):
        place = _place(size, k)
        u = mi.Float((receiver.number * GOLDEN + k * FRACTION) >> 8) * 2.0**-24
        node = heap[place].node
        light = draw(lights.strength, lights.leaves_opaque, node, u)
        all_of_it, strength = (dr.gather(mi.Float, lights.strength, i) for i in (node, light + lights.leaves_opaque))
        found = _arriving(lights, light, receiver, strength > 0)[2] * (all_of_it / strength)
        _, visibility, doubt = _known(guide, receiver.region, light)
        worth = luminance(found) * doubt
        heap[place] = Stratum(worth, light)
        expected += found * visibility
        total += worth
        k += 1
    return heap, expected, total


@dr.syntax
def _try(scene, lights: LightTree, guide: LightGuide, receiver: Receiver, heap, size, single, step, zero):
    """Deal out the rays, one to every ``step`` of doubt: the correction, and how many were traced."""
    passed = mi.Float((receiver.number * FRACTION) >> 8) * (2.0**-24) * step
    correction = mi.Color3f(0) + mi.Float(zero)
    tried, traced, k = mi.UInt32(zero), mi.UInt32(zero), mi.UInt32(zero)
    while dr.hint((k < size + single) & (step > 0), label="pellucid try"):
        stratum = heap[_place(size, k)]
        passed += stratum.bound
        # A light that may correct by more than a ray stands for is tried once, for several of them.
        until = mi.UInt32(passed / step)
        if until > tried:
            direction, distance, light = _arriving(lights, stratum.node, receiver, mi.Bool(True))
            entry, visibility, doubt = _known(guide, receiver.region, stratum.node)
            seen = visible(scene, receiver.si, direction, distance, mi.Bool(True))
            # Direct: other modes have kernels of their own for tables of each size.
            dr.scatter_add(guide.tried, mi.UInt32(1), entry, mode=dr.ReduceMode.Direct)
            dr.scatter_add(guide.seen, mi.UInt32(1), entry, seen, mode=dr.ReduceMode.Direct)
            light *= (dr.select(seen, 1, mi.Float(0)) - visibility) * step / (luminance(light) * doubt)
            correction += light * mi.Float(until - tried)
            traced += 1
        tried = until
        k += 1
    return correction, traced


def _known(guide: LightGuide, region, light):
    """Look up what a region knows of a light: where, the share of rays that arrive, and how unsure that is."""
    entry = region * guide.clusters + dr.gather(mi.UInt32, guide.owner, light)
    visibility = dr.gather(mi.Float, guide.visibility, entry)
    return entry, visibility, DOUBT + dr.sqrt(visibility * (1 - visibility))


def _arriving(lights: LightTree, light, receiver: Receiver, active):
    """Evaluate the light that would enter: direction, distance, colour."""
    direction, distance, value = lights.lights.arriving(light, receiver.p, receiver.n, active)
    return direction, distance, value * transmitted(dr.dot(direction, receiver.n), receiver.eta)
