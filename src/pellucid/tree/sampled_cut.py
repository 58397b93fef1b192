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
from .chosen_lights import FRACTION, MOST_LIGHTS, ChosenLights, doubt_about
from .light_tree import LightTree, luminance


@dataclass
class Receiver:
    """A point with its normal, what is behind it, the patch that lights were chosen for, and the number that its random numbers
    come from."""

    si: mi.SurfaceInteraction3f
    eta: mi.Float
    patch: mi.UInt32
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
    chosen : ChosenLights
        The lights of each patch, and what is expected of their visibility. The rays are counted there.
    demand : Float
        Rays over the variance of a single one in luminance: the inverse of the variance that is allowed.
    least, most : UInt32
        Bounds of the number of rays.

    Source: J. Talbot et al., *Importance resampling for global illumination*, EGSR 2005.
    """
    count = dr.gather(mi.UInt32, chosen.count, receiver.patch)
    doubts, expected, total = _weigh(lights, chosen, receiver, count)
    dr.eval(doubts, expected, total)
    rays = dr.clip(dr.square(total) * demand, mi.Float(least), mi.Float(most))
    step = total / rays
    # No ray has more lights than it deals, and one for what remains of the last step; nor than there are.
    room = dr.minimum(mi.UInt32(rays) + 2, count)
    end = dr.cumsum(room)
    jobs, owner = (dr.opaque(mi.UInt32, 0, int(end[-1]) + 1) for _ in range(2))
    traced = _deal(receiver, count, doubts, step, end - room, jobs, owner)
    dr.eval(jobs, owner, traced, step)
    given = dr.compress(jobs > 0)
    jobs, owner = dr.gather(mi.UInt32, jobs, given), dr.gather(mi.UInt32, owner, given)
    light = expected
    if dr.width(jobs):
        corrections = _try(scene, lights, chosen, receiver, jobs, owner, step)
        light = light + _sum(corrections, dr.prefix_sum(traced), traced)
    dr.eval(light)
    return Estimate(light, traced)


@dr.syntax
def _weigh(lights: LightTree, chosen: ChosenLights, receiver: Receiver, count):
    """Weigh all lights; returns what each may have to be corrected by, light by light of all receivers; the light that is
    expected; and the sum of all doubts."""
    width = dr.opaque(mi.UInt32, dr.width(count))
    doubts = dr.empty(mi.Float, max(int(dr.max(count)[0]), 1) * dr.width(count))
    expected, total = dr.zeros(mi.Color3f, dr.width(count)), mi.Float(0)
    k, entry = mi.UInt32(0), dr.arange(mi.UInt32, dr.width(count))
    while dr.hint(k < count, label="pellucid weigh"):
        light, scale, visibility = chosen.fetch(receiver.patch, k)
        found = _arriving(lights, light, receiver)[2] * scale
        doubt = luminance(found) * doubt_about(visibility)
        dr.scatter(doubts, doubt, entry)
        expected += found * visibility
        total += doubt
        k += 1
        entry += width
    return doubts, expected, total


@dr.syntax
def _deal(receiver: Receiver, count, doubts, step, first, jobs, owner):
    """Deal out the rays, one to every ``step`` of doubt: which lights get some, and how many, goes to ``jobs`` from ``first`` on,
    and whose they are to ``owner``; tells how many lights."""
    lane = dr.arange(mi.UInt32, dr.width(count))
    width = dr.opaque(mi.UInt32, dr.width(count))
    passed = mi.Float((receiver.number * FRACTION) >> 8) * 2.0**-24
    per_step = dr.select(step > 0, dr.rcp(step), 0)
    dealt, k, entry = mi.UInt32(0), mi.UInt32(0), mi.UInt32(lane)
    place = mi.UInt32(first)
    while dr.hint(k < count, label="pellucid deal"):
        passed = dr.fma(dr.gather(mi.Float, doubts, entry), per_step, passed)
        until = mi.UInt32(passed)
        if until > dealt:
            dr.scatter(jobs, (until - dealt) * MOST_LIGHTS + k, place)
            dr.scatter(owner, lane, place)
            place += 1
        dealt = until
        k += 1
        entry += width
    return place - first


def _try(scene, lights: LightTree, chosen: ChosenLights, receiver: Receiver, jobs, owner, step) -> mi.Float:
    """Trace a ray to each light that was dealt some, on behalf of them all: the corrections, packets."""
    here = dr.gather(Receiver, receiver, owner)
    k = jobs % MOST_LIGHTS
    light, _, visibility = chosen.fetch(here.patch, k)
    direction, distance, found = _arriving(lights, light, here)
    seen = visible(scene, here.si, direction, distance, mi.Bool(True))
    chosen.count_ray(here.patch, k, seen)
    surprise = dr.select(seen, 1, mi.Float(0)) - visibility
    # As many rays, a step of doubt each, over the doubt about the light: what multiplies the light cancels out.
    share = mi.Float(jobs // MOST_LIGHTS) * dr.gather(mi.Float, step, owner)
    correction = found * (surprise * share / (luminance(found) * doubt_about(visibility)))
    packets = dr.empty(mi.Float, 4 * dr.width(jobs))
    packet = mi.Vector4f(correction.x, correction.y, correction.z, 0)
    dr.scatter(packets, packet, dr.arange(mi.UInt32, dr.width(jobs)))
    dr.eval(packets, chosen.rays)
    return packets


@dr.syntax
def _sum(corrections, first, count) -> mi.Color3f:
    """Sum the corrections of each receiver."""
    total, k = dr.zeros(mi.Color3f, dr.width(count)), mi.UInt32(0)
    while dr.hint(k < count, label="pellucid corrections"):
        packet = dr.gather(mi.Vector4f, corrections, first + k)
        total += mi.Color3f(packet.x, packet.y, packet.z)
        k += 1
    return total


def _arriving(lights: LightTree, light, receiver: Receiver):
    """Evaluate the light that would enter: direction, distance, colour."""
    n = receiver.si.sh_frame.n
    direction, distance, value = lights.lights.arriving(light, receiver.si.p, n, mi.Bool(True))
    return direction, distance, value * transmitted(dr.dot(direction, n), receiver.eta)
