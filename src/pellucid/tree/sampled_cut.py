"""The irradiance at a point from a few shadow rays: many lights are weighed, and a few of them are tried.

What a light would send if nothing stood between costs little to find out, a shadow ray costs much. So the many lights that were
chosen for the surroundings are all weighed. Their sum, each times the visibility that is expected of it, is the estimate;
shadow rays correct it, and are dealt out by how much they may have to. Where the region knows what it sees, little is left to
chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..light.light_samples import transmitted, visible
from .chosen_lights import FRACTION, MOST_LIGHTS, ChosenLights
from .light_guide import LightGuide
from .light_tree import LightTree, luminance

DOUBT = 0.01
"""What seems certain is doubted by so much, so that errors are found, and the estimate has no bias."""


@dataclass
class Receiver:
    """A point with its normal, what is behind it, the patch that lights were chosen for, the region that learns, and the number
    that its random numbers come from."""

    si: mi.SurfaceInteraction3f
    eta: mi.Float
    patch: mi.UInt32
    region: mi.UInt32
    number: mi.UInt32


@dataclass
class Estimate:
    """Light that enters at receivers, and the number of shadow rays that were traced."""

    light: mi.Color3f
    traced: mi.UInt32


def sampled_cut(
    scene: mi.Scene,
    lights: LightTree,
    chosen: ChosenLights,
    guide: LightGuide,
    receiver: Receiver,
    demand: mi.Float,
    least: mi.UInt32,
    most: mi.UInt32,
) -> Estimate:
    """Estimate the light that enters at points.

    All lights of a patch are weighed, and of those as many as there are rays are tried, by systematic resampling:
    a control variate with its correction. Nothing that can send light is left out: the estimate has no bias.

    Parameters
    ----------
    guide : LightGuide
        What is known of visibility. It counts the rays.
    demand : Float
        Rays over the variance of a single one in luminance: the inverse of the variance that is allowed.
    least, most : UInt32
        Bounds of the number of rays.

    Source: J. Talbot et al., *Importance resampling for global illumination*, EGSR 2005.
    """
    zero = dr.opaque(mi.UInt32, 0, dr.width(receiver.number))
    count = dr.gather(mi.UInt32, chosen.count, receiver.patch)
    worths = dr.alloc_local(mi.Float, MOST_LIGHTS)
    worths, expected, worth = _weigh(lights, chosen, guide, receiver, count, worths, zero)
    rays = dr.clip(dr.square(worth) * demand, mi.Float(least), mi.Float(most))
    step = worth / rays
    dealt, tried = _deal(receiver, count, worths, step, zero)
    correction = _try(scene, lights, chosen, guide, receiver, tried, dealt, step, zero)
    return Estimate(expected + correction, tried)


@dr.syntax
def _weigh(lights: LightTree, chosen: ChosenLights, guide: LightGuide, receiver: Receiver, count, worths, zero):
    """Weigh all lights; returns what each may have to be corrected by, the light that is expected, and the sum of all doubts."""
    total, k = mi.Float(zero), mi.UInt32(zero)
    expected = mi.Color3f(0) + mi.Float(zero)
    while dr.hint(k < count, label="pellucid weigh"):
        light, cluster, scale = chosen.fetch(receiver.patch, k)
        found = _arriving(lights, light, receiver)[2] * scale
        _, visibility, doubt = _known(guide, receiver.region, cluster)
        worth = luminance(found) * doubt
        worths[k] = worth
        expected += found * visibility
        total += worth
        k += 1
    return worths, expected, total


@dr.syntax
def _deal(receiver: Receiver, count, worths, step, zero):
    """Deal out the rays, one to every ``step`` of doubt: leaves the lights that get some in the memory of the worths, from the
    beginning on, each with its rays; and tells how many lights."""
    passed = mi.Float((receiver.number * FRACTION) >> 8) * 2.0**-24
    per_step = dr.select(step > 0, dr.rcp(step), 0)
    dealt, tried, k = mi.UInt32(zero), mi.UInt32(zero), mi.UInt32(zero)
    while dr.hint(k < count, label="pellucid deal"):
        passed = dr.fma(worths[k], per_step, passed)
        until = mi.UInt32(passed)
        if until > dealt:
            worths[tried] = dr.reinterpret_array(mi.Float, (until - dealt) * MOST_LIGHTS + k)
            tried += 1
        dealt = until
        k += 1
    return worths, tried


@dr.syntax
def _try(
    scene, lights: LightTree, chosen: ChosenLights, guide: LightGuide, receiver: Receiver, tried, dealt, step, zero
):
    """Trace a ray to each light that was dealt some, on behalf of them all: the correction."""
    correction, k = mi.Color3f(0) + mi.Float(zero), mi.UInt32(zero)
    while dr.hint(k < tried, label="pellucid try"):
        entry = dr.reinterpret_array(mi.UInt32, dealt[k])
        light, cluster, scale = chosen.fetch(receiver.patch, entry % MOST_LIGHTS)
        direction, distance, found = _arriving(lights, light, receiver)
        found *= scale
        known, visibility, doubt = _known(guide, receiver.region, cluster)
        seen = visible(scene, receiver.si, direction, distance, mi.Bool(True))
        # Direct: other modes have kernels of their own for tables of each size.
        dr.scatter_add(guide.tried, mi.UInt32(1), known, mode=dr.ReduceMode.Direct)
        dr.scatter_add(guide.seen, mi.UInt32(1), known, seen, mode=dr.ReduceMode.Direct)
        surprise = dr.select(seen, 1, mi.Float(0)) - visibility
        rays = mi.Float(entry // MOST_LIGHTS)
        correction += found * (surprise * rays * step / (luminance(found) * doubt))
        k += 1
    return correction


def _known(guide: LightGuide, region, cluster):
    """Look up what a region knows of a cluster of lights: where, the share of rays that arrive, and how unsure that is."""
    entry = region * guide.clusters + cluster
    visibility = dr.gather(mi.Float, guide.visibility, entry)
    return entry, visibility, DOUBT + dr.sqrt(visibility * (1 - visibility))


def _arriving(lights: LightTree, light, receiver: Receiver):
    """Evaluate the light that would enter: direction, distance, colour."""
    n = receiver.si.sh_frame.n
    direction, distance, value = lights.lights.arriving(light, receiver.si.p, n, mi.Bool(True))
    return direction, distance, value * transmitted(dr.dot(direction, n), receiver.eta)
