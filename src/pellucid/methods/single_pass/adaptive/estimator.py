"""The irradiance at receivers from a few shadow rays: all lights are weighed, and a few of them are tried.

What a light would send if nothing stood between costs little to evaluate, a shadow ray costs much. So the many lights that were
chosen for a receiver group are all evaluated at each of its receivers. Their sum, each times the visibility that is expected of it, is
a control variate; shadow rays correct it, and go to lights in proportion to the standard deviation of what they may correct.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....kernels.memory import lanes_where, upload
from ....light.points.records import Light, visible
from ....model.fresnel import transmitted
from ..trees.light_tree import LightTree, luminance
from .candidates import DRAWS, FRACTION, Candidates
from .visibility import Expectation, RayCounts

BUNDLE = 4
"""Receivers of a group that one lane evaluates lights for: to fetch a light takes as long as to evaluate it. With one instead, the
kitchen's lights take twice as long."""

NOTHING = 1e-30


@dataclass
class Receiver:
    """A point with its normal, what is behind it, its receiver group, those of one group beside each other, and the number that its
    random numbers come from."""

    si: mi.SurfaceInteraction3f
    eta: mi.Float
    group: mi.UInt32
    number: mi.UInt32


@dataclass
class Estimate:
    """Light that enters at receivers; the standard deviation (luminance) that a single ray would leave there; and the rays by
    candidate."""

    light: mi.Color3f
    deviation: mi.Float
    rays: RayCounts


def estimate_light(
    scene: mi.Scene,
    lights: LightTree,
    candidates: Candidates,
    expected: Expectation,
    receiver: Receiver,
    demand: mi.Float,
    least: mi.Float,
    most: mi.Float,
    drawn: mi.UInt32 | None = None,
) -> Estimate:
    """Estimate the light that enters at points.

    All candidates of a group are evaluated, and of those as many as there are rays are tried, by systematic resampling in
    proportion to the standard deviation of what a ray may correct. No light has a probability of zero: the estimate has no bias.

    The visibility that is expected in the end takes account of all rays of this call. For the light that a ray was traced to it
    leaves out this ray (leave-one-out), or else estimates would depend on their own corrections and have a bias.

    Parameters
    ----------
    candidates : Candidates
        The lights of each group.
    expected : Expectation
        Their visibility, as far as it is known.
    demand : Float
        Rays for each unit of standard deviation.
    least, most : Float
        Bounds of the number of rays; less than one of them is traced as often.
    drawn : UInt32, optional
        Which of the lights that were drawn of each cluster each receiver uses, of one group those with the same beside each other. No
        receiver depends on another then: their rays teach nothing.

    Source: J. Talbot et al., *Importance resampling for global illumination*, EGSR 2005.
    """
    bundles = _bundle(receiver, drawn)
    deviations, total = _deviations(lights, candidates, expected, receiver, bundles)
    rays = dr.clip(total * demand, least, most)
    step = total / rays
    # No more lights are tried than there are rays, and one for what remains of the last step; nor than there are.
    room = dr.minimum(mi.UInt32(rays) + 2, dr.gather(mi.UInt32, candidates.count, receiver.group))
    end = dr.cumsum(room)
    trials = Trials(*(dr.opaque(mi.UInt32, 0, int(end[-1]) + 1) for _ in range(3)))
    tried = _allocate(receiver, candidates, deviations, bundles, step, end - room, trials)
    dr.eval(trials, tried, step)
    trials = dr.gather(Trials, trials, lanes_where(trials.steps > 0))
    found = RayCounts.none(candidates)
    light = dr.zeros(mi.Color3f, dr.width(total))
    if dr.width(trials.steps):
        corrections = _trace(scene, lights, candidates, expected, receiver, bundles, trials, step, found, drawn is None)
        light = _sum(corrections, dr.prefix_sum(tried), tried)
    light = light + _control_variate(lights, candidates, expected, found, receiver, bundles, deviations)
    dr.eval(light)
    return Estimate(light, total, found)


# ------------------------------------------------------------------ receivers


@dataclass
class Bundles:
    """Up to `BUNDLE` receivers of a group each: neighbours are in different bundles, and these use different lights.

    Attributes
    ----------
    first, stride, size : UInt32
        By bundle the first receiver, how far it is to the next, and how many there are.
    group : UInt32
        By bundle its receiver group.
    drawn : UInt32
        By bundle which of the lights that were drawn of each candidate it uses.
    drawn_of : UInt32
        The same by receiver.
    """

    first: mi.UInt32
    stride: mi.UInt32
    size: mi.UInt32
    group: mi.UInt32
    drawn: mi.UInt32
    drawn_of: mi.UInt32

    def members(self) -> list[mi.UInt32]:
        """Name the receivers of each bundle, the last one where there is no other."""
        return [self.first + self.stride * dr.minimum(k, self.size - 1) for k in range(BUNDLE)]

    def by_receiver(self, values: Any) -> Any:
        """Give receivers what their bundles hold for them, member by member."""
        given = dr.empty(type(values[0]), dr.width(self.drawn_of))
        for k, value in enumerate(values):
            dr.scatter(given, value, self.first + self.stride * k, self.size > k)
        return given


def _bundle(receiver: Receiver, fixed: mi.UInt32 | None = None) -> Bundles:
    """Put the receivers into bundles, all of which use the ``fixed`` lights if there are any."""
    width = dr.width(receiver.si.p)
    group = np.broadcast_to(receiver.group.numpy(), width)
    drawn = np.zeros(width, np.int64) if fixed is None else fixed.numpy()
    begin = np.flatnonzero(np.diff(group * np.int64(DRAWS) + drawn, prepend=-1))
    many = np.diff(begin, append=width)
    count = -(-many // BUNDLE)
    bundle_of_run, receiver_of_run = np.repeat(np.arange(len(begin)), count), np.repeat(np.arange(len(begin)), many)
    number = np.arange(len(bundle_of_run)) - (np.cumsum(count) - count)[bundle_of_run]
    stride, first = count[bundle_of_run], begin[bundle_of_run]
    size = (many[bundle_of_run] - number + stride - 1) // stride
    if fixed is None:
        used, drawn = number % DRAWS, (np.arange(width) - begin[receiver_of_run]) % count[receiver_of_run] % DRAWS
    else:
        used = drawn[first]
    arrays = (first + number, stride, size, group[first], used, drawn)
    return Bundles(*(upload(values.astype(np.uint32), mi.UInt32) for values in arrays))


# ------------------------------------------------------------------ lights


@dataclass
class Deviations:
    """The standard deviation of what a ray to each light may correct (luminance): a float4 by bundle and light, one number for each
    of the receivers; those of a bundle begin at ``first``."""

    values: mi.Float
    first: mi.UInt32


def _deviations(
    lights: LightTree, candidates: Candidates, expected: Expectation, receiver: Receiver, bundles: Bundles
) -> tuple[Deviations, mi.Float]:
    """Evaluate all lights at all receivers; returns standard deviations, and their sum by receiver."""
    members = bundles.members()
    points = [dr.gather(mi.Point3f, receiver.si.p, member) for member in members]
    normals = [dr.gather(mi.Normal3f, receiver.si.sh_frame.n, member) for member in members]
    etas = [dr.gather(mi.Float, receiver.eta, member) for member in members]
    first, count = (dr.gather(mi.UInt32, by_group, bundles.group) for by_group in (candidates.first, candidates.count))
    end = dr.cumsum(count)
    found = Deviations(dr.empty(mi.Float, 4 * (int(end[-1]) + 1)), end - count)
    dr.eval(points, normals, etas, first, count, found.first)

    def evaluate(k, sums):
        number, scale = candidates.fetch(first + k, bundles.drawn)
        light = lights.lights.fetch(number)
        factor = dr.gather(mi.Float, expected.deviation, first + k) * scale * luminance(light.intensity)
        each = [factor * _share(light, p, n, eta)[2] for p, n, eta in zip(points, normals, etas, strict=True)]
        dr.scatter(found.values, mi.Array4f(each), found.first + k)
        return k + 1, [total + value for total, value in zip(sums, each, strict=True)]

    start = dr.zeros(mi.UInt32, dr.width(count)), [dr.zeros(mi.Float, dr.width(count)) for _ in members]
    sums = dr.while_loop(start, lambda k, _: k < count, evaluate, label="pellucid evaluate lights")[1]
    dr.eval(found.values, sums)  # before they are scattered: or else each scatter would run the loop again
    total = bundles.by_receiver(sums)
    dr.eval(total)
    return found, total


@dataclass
class Trials:
    """Lights that are tried: which of the candidates of a group, for how many steps of the resampling, and for which receiver."""

    light: mi.UInt32
    steps: mi.UInt32
    receiver: mi.UInt32


def _allocate(
    receiver: Receiver, candidates: Candidates, deviations: Deviations, bundles: Bundles, step, first, trials: Trials
) -> mi.UInt32:
    """Allocate rays to lights by systematic resampling, one to every ``step`` of standard deviation: those of a receiver go to
    ``trials`` from ``first`` on; tells how many lights are tried."""
    count = dr.gather(mi.UInt32, candidates.count, bundles.group)
    members = bundles.members()
    begin = mi.Float((receiver.number * FRACTION) >> 8) * 2.0**-24
    steps = [dr.gather(mi.Float, step, member) for member in members]
    per_step = [dr.select((size > 0) & (bundles.size > k), dr.rcp(size), 0) for k, size in enumerate(steps)]
    passed = [dr.gather(mi.Float, begin, member) for member in members]
    places = [dr.gather(mi.UInt32, first, member) for member in members]
    dr.eval(count, members, per_step, passed, places)

    def keep(place, light, number, owner):
        dr.scatter(trials.light, light, place)
        dr.scatter(trials.steps, number, place)
        dr.scatter(trials.receiver, owner, place)

    def allocate(k, passed, before, places):
        each = dr.gather(mi.Array4f, deviations.values, deviations.first + k)
        passed = [dr.fma(value, each_step, p) for value, each_step, p in zip(each, per_step, passed, strict=True)]
        until = [mi.UInt32(p) for p in passed]
        places = list(places)
        for j, (now, then) in enumerate(zip(until, before, strict=True)):
            some, kept = now > then, (places[j], k, now - then, members[j])
            # Not masked scatters: mostly no lane has anything to keep, and then this costs nothing.
            dr.if_stmt(kept, some, keep, lambda *_: None, label="pellucid trials")
            places[j] = places[j] + dr.select(some, mi.UInt32(1), 0)
        return k + 1, passed, until, places

    state = dr.zeros(mi.UInt32, dr.width(count)), passed, [mi.UInt32(0)] * BUNDLE, places
    ends = dr.while_loop(state, lambda k, *_: k < count, allocate, label="pellucid allocate")[3]
    dr.eval(ends, trials)
    return bundles.by_receiver(ends) - first


def _trace(
    scene: mi.Scene,
    lights: LightTree,
    candidates: Candidates,
    expected: Expectation,
    receiver: Receiver,
    bundles: Bundles,
    trials: Trials,
    step: mi.Float,
    found: RayCounts,
    learns: bool,
) -> mi.Float:
    """Trace a ray for each trial, count it in ``found`` if that is to learn, and correct the control variate by it: a float4 a trial."""
    here = dr.gather(Receiver, receiver, trials.receiver)
    entry = dr.gather(mi.UInt32, candidates.first, here.group) + trials.light
    number, scale = candidates.fetch(entry, dr.gather(mi.UInt32, bundles.drawn_of, trials.receiver))
    light = lights.lights.fetch(number)
    direction, distance, share = _share(light, here.si.p, here.si.sh_frame.n, here.eta)
    arrives = visible(scene, here.si, direction, distance, mi.Bool(True))
    if learns:
        found.add(entry, arrives)
    sent = light.intensity * (share * scale)
    deviation = dr.gather(mi.Float, expected.deviation, entry) * luminance(sent)
    stands_for = mi.Float(trials.steps) * dr.gather(mi.Float, step, trials.receiver) / dr.maximum(deviation, NOTHING)
    dr.eval(entry, arrives, sent, stands_for, found)

    seen = dr.select(arrives, mi.Float(1), 0)
    others = expected.after(found, entry, without=seen if learns else None)
    # The ray corrects what all others tell about this light, here and for all lights that were not tried in its place.
    correction = sent * (stands_for * (seen - others) + others - expected.after(found, entry))
    values = dr.empty(mi.Float, 4 * dr.width(entry))
    dr.scatter(values, mi.Array4f(correction.x, correction.y, correction.z, 0), dr.arange(mi.UInt32, dr.width(entry)))
    dr.eval(values)
    return values


def _control_variate(
    lights: LightTree,
    candidates: Candidates,
    expected: Expectation,
    found: RayCounts,
    receiver: Receiver,
    bundles: Bundles,
    deviations: Deviations,
) -> mi.Color3f:
    """Sum all lights times the visibility that is expected of them after all rays."""
    # What is stored is the deviation: light over deviation, for each light that was drawn.
    lane = dr.arange(mi.UInt32, DRAWS * dr.width(expected.deviation))
    entry = lane // DRAWS
    intensity = lights.lights.fetch(candidates.fetch(entry, lane % DRAWS)[0]).intensity
    visibility, deviation = expected.after(found, entry), dr.gather(mi.Float, expected.deviation, entry)
    ratio = intensity * (visibility / (deviation * dr.maximum(luminance(intensity), NOTHING)))
    ratios = dr.empty(mi.Float, 4 * dr.width(lane))
    dr.scatter(ratios, mi.Array4f(ratio.x, ratio.y, ratio.z, 0), lane)
    first, count = (dr.gather(mi.UInt32, by_group, bundles.group) for by_group in (candidates.first, candidates.count))
    dr.eval(ratios, first, count)

    def add(k, sums):
        ratio = dr.gather(mi.Array4f, ratios, DRAWS * (first + k) + bundles.drawn)
        each = dr.gather(mi.Array4f, deviations.values, deviations.first + k)
        colour = mi.Color3f(ratio[0], ratio[1], ratio[2])
        return k + 1, [dr.fma(colour, value, total) for total, value in zip(sums, each, strict=True)]

    start = dr.zeros(mi.UInt32, dr.width(count)), [dr.zeros(mi.Color3f, dr.width(count)) for _ in range(BUNDLE)]
    sums = dr.while_loop(start, lambda k, _: k < count, add, label="pellucid control variate")[1]
    dr.eval(sums)
    return bundles.by_receiver(sums)


@dr.syntax
def _sum(values, first, count) -> mi.Color3f:
    """Sum the float4s of each receiver."""
    total, k = dr.zeros(mi.Color3f, dr.width(count)), mi.UInt32(0)
    while dr.hint(k < count, label="pellucid corrections"):
        value = dr.gather(mi.Array4f, values, first + k)
        total += mi.Color3f(value[0], value[1], value[2])
        k += 1
    return total


def _share(light: Light, p, n, eta) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
    """Evaluate which share of a light's intensity would enter: with the direction and the distance to it."""
    direction, distance, cosine, factor = light.towards(p, n)
    return direction, distance, factor * dr.maximum(cosine, 0) * transmitted(cosine, eta)
