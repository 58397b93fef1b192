"""The irradiance at a point from a few shadow rays: many lights are weighed, and a few of them are tried.

What a light would send if nothing stood between costs little to find out, a shadow ray costs much. So the many lights that were
chosen for the surroundings are all weighed. Their sum, each times the visibility that is expected of it, is the estimate;
shadow rays correct it, and are dealt out by how much they may have to. Where the patch knows what it sees, little is left to
chance; and what is expected in the end, after all rays have arrived, takes the place of what was expected before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ....kernels.memory import upload
from ....light.points.records import Light, visible
from ....model.fresnel import transmitted
from ..trees.light_tree import LightTree, luminance
from .candidates import DRAWS, FRACTION, MOST_LIGHTS, ChosenLights

GROUP = 4
"""Receivers of a patch that one lane weighs lights and deals rays for: to fetch a light takes as long as to evaluate it."""

COARSE = 0xFFFF0000
"""The bits of a number that are stored."""

TILE = 16
"""Groups whose doubts lie light by light: as many as lanes of a packet at least, which then read memory from one end to the other."""


@dataclass
class Receiver:
    """A point with its normal, what is behind it, the patch that lights were chosen for, those of one patch beside each other, and
    the number that its random numbers come from."""

    si: mi.SurfaceInteraction3f
    eta: mi.Float
    patch: mi.UInt32
    number: mi.UInt32


@dataclass
class Estimate:
    """Light that enters at receivers, how much of it was in doubt (luminance), and the number of shadow rays that were traced."""

    light: mi.Color3f
    doubt: mi.Float
    traced: mi.UInt32


def sampled_cut(
    scene: mi.Scene,
    lights: LightTree,
    chosen: ChosenLights,
    receiver: Receiver,
    demand: mi.Float,
    least: mi.Float,
    most: mi.Float,
) -> Estimate:
    """Estimate the light that enters at points.

    All lights of a patch are weighed, and of those as many as there are rays are tried, by systematic resampling:
    a control variate with its correction. Nothing that can send light is left out: the estimate has no bias.

    Parameters
    ----------
    chosen : ChosenLights
        The lights of each patch, and what is expected of their visibility. The rays are counted there.
    demand : Float
        Rays for each unit of luminance that is in doubt. The doubt is the standard deviation of a single ray.
    least, most : Float
        Bounds of the number of rays; less than one of them is traced as often.

    Source: J. Talbot et al., *Importance resampling for global illumination*, EGSR 2005.
    """
    count = dr.gather(mi.UInt32, chosen.count, receiver.patch)
    groups = _group(receiver)
    doubts, expected, total = _weigh(lights, chosen, receiver, groups)
    rays = dr.clip(total * demand, least, most)
    step = total / rays
    # No ray has more lights than it deals, and one for what remains of the last step; nor than there are.
    room = dr.minimum(mi.UInt32(rays) + 2, count)
    end = dr.cumsum(room)
    jobs, owner = (dr.opaque(mi.UInt32, 0, int(end[-1]) + 1) for _ in range(2))
    traced = _deal(receiver, chosen, doubts, groups, step, end - room, jobs, owner)
    dr.eval(jobs, owner, traced, step)
    given = dr.compress(jobs > 0)
    jobs, owner = dr.gather(mi.UInt32, jobs, given), dr.gather(mi.UInt32, owner, given)
    light = expected
    if dr.width(jobs):
        entry, tried = _try(scene, lights, chosen, receiver, groups, jobs, owner)
        light = light + _reconsider(lights, chosen, receiver, groups, doubts)
        dealt = mi.Float(jobs // MOST_LIGHTS) * dr.gather(mi.Float, step, owner)
        light = light + _sum(_corrections(chosen, entry, tried, dealt), dr.prefix_sum(traced), traced)
    dr.eval(light)
    return Estimate(light, total, traced)


@dataclass
class Groups:
    """Up to `GROUP` receivers each, strewn over a patch: neighbours are in different groups, and these try different lights.

    Attributes
    ----------
    first, stride, size : UInt32
        By group the first receiver, how far it is to the next, and how many there are.
    drawn : UInt32
        By group which of the lights that were drawn of each cluster it tries.
    seat : UInt32
        By receiver its place among all that groups have room for.
    """

    first: mi.UInt32
    stride: mi.UInt32
    size: mi.UInt32
    drawn: mi.UInt32
    seat: mi.UInt32

    def members(self) -> list[mi.UInt32]:
        """Name the receivers of each group, the last one where there is no other."""
        return [self.first + self.stride * dr.minimum(k, self.size - 1) for k in range(GROUP)]

    def by_receiver(self, values: Sequence[Any]) -> Any:
        """Give receivers what their groups hold for them, member by member."""
        given = dr.empty(type(values[0]), dr.width(self.seat))
        for k, value in enumerate(values):
            dr.scatter(given, value, self.first + self.stride * k, self.size > k)
        return given


@dataclass
class Doubts:
    """What each light may have to be corrected by: by group and light a pair of numbers, for `GROUP` receivers; of each `TILE` groups
    light by light, with room for ``most`` lights."""

    pairs: mi.UInt32
    most: mi.UInt32

    @classmethod
    def make(cls, groups: int, most: int) -> Doubts:
        """Make room, with anything in it."""
        tiles = -(-groups // TILE)
        return cls(dr.empty(mi.UInt32, max(most, 1) * tiles * TILE * (GROUP // 2)), dr.opaque(mi.UInt32, most))

    def begin(self, group: mi.UInt32) -> mi.UInt32:
        """Tell where the pair of the first light of a group is; those of the others follow `TILE` behind each other."""
        return group // TILE * self.most * TILE + group % TILE


def _halves(pair: mi.Array2u) -> list[mi.Float]:
    """Unpack the doubts of a group about one light."""
    return [dr.reinterpret_array(mi.Float, bits) for two in pair for bits in (two & COARSE, two << 16)]


def _group(receiver: Receiver) -> Groups:
    """Put the receivers into groups."""
    width = dr.width(receiver.si.p)
    patch = np.broadcast_to(receiver.patch.numpy(), width)
    begin = np.flatnonzero(np.diff(patch, prepend=-1))
    many = np.diff(begin, append=width)
    count = -(-many // GROUP)
    # By patch: its first receiver, how many there are, how many groups, and how many of these are ahead of them.
    table = np.zeros((int(patch.max()) + 1, 4), np.uint32)
    table[patch[begin]] = np.stack([begin, many, count, np.cumsum(count) - count], axis=1)
    by_patch, whose = (upload(values, mi.UInt32) for values in (table, np.repeat(patch[begin], count)))
    first, many, groups, ahead = dr.gather(mi.Array4u, by_patch, whose)
    stride = dr.maximum(groups, 1)  # lanes beyond the last one have nothing to divide by
    number = dr.arange(mi.UInt32, dr.width(whose)) - ahead
    size = (many - number + stride - 1) // stride
    begin, _, apart, before = dr.gather(mi.Array4u, by_patch, receiver.patch)
    place, apart = dr.arange(mi.UInt32, width) - begin, dr.maximum(apart, 1)
    seat = (before + place % apart) * GROUP + place // apart
    found = Groups(first + number, stride, size, number % DRAWS, seat)
    dr.eval(found)
    return found


def _weigh(lights: LightTree, chosen: ChosenLights, receiver: Receiver, groups: Groups):
    """Weigh all lights; returns the `Doubts` of all groups; the light that is expected; and the sum of all doubts."""
    members = groups.members()
    points = [dr.gather(mi.Point3f, receiver.si.p, member) for member in members]
    normals = [dr.gather(mi.Normal3f, receiver.si.sh_frame.n, member) for member in members]
    patch = dr.gather(mi.UInt32, receiver.patch, groups.first)
    first, count = (dr.gather(mi.UInt32, by_patch, patch) for by_patch in (chosen.first, chosen.count))
    doubts = Doubts.make(dr.width(count), int(dr.max(count)[0]))
    dr.eval(points, normals, first, count)

    def weigh(k, entry, sums):
        number, scale, visibility, doubt = chosen.fetch(first + k, groups.drawn)
        light = lights.lights.fetch(number)
        share = [_share(light, p, n, receiver.eta)[2] for p, n in zip(points, normals, strict=True)]
        colour, doubt = light.intensity * (scale * visibility), doubt * scale * luminance(light.intensity)
        each = [_coarse(doubt * s) for s in share]
        dr.scatter(
            doubts.pairs, mi.Array2u(*(a | (b >> 16) for a, b in zip(each[::2], each[1::2], strict=True))), entry
        )
        sums = [
            (dr.fma(colour, s, light), total + dr.reinterpret_array(mi.Float, d))
            for (light, total), s, d in zip(sums, share, each, strict=True)
        ]
        return k + 1, entry + TILE, sums

    nothing = [(dr.zeros(mi.Color3f, dr.width(count)), dr.zeros(mi.Float, dr.width(count))) for _ in members]
    start = dr.zeros(mi.UInt32, dr.width(count)), doubts.begin(dr.arange(mi.UInt32, dr.width(count))), nothing
    sums = dr.while_loop(start, lambda k, entry, sums: k < count, weigh, label="pellucid weigh")[2]
    dr.eval(doubts.pairs, sums)  # before they are scattered: or else each scatter would run the loop again
    expected, total = (groups.by_receiver(values) for values in zip(*sums, strict=True))
    dr.eval(expected, total)
    return doubts, expected, total


def _deal(receiver: Receiver, chosen: ChosenLights, doubts: Doubts, groups: Groups, step, first, jobs, owner):
    """Deal out the rays, one to every ``step`` of doubt: which lights get some, and how many, goes to ``jobs`` from ``first`` on,
    and whose they are to ``owner``; tells how many lights."""
    count = dr.gather(mi.UInt32, chosen.count, dr.gather(mi.UInt32, receiver.patch, groups.first))
    members = groups.members()
    begin = mi.Float((receiver.number * FRACTION) >> 8) * 2.0**-24
    steps = [dr.gather(mi.Float, step, member) for member in members]
    per_step = [dr.select((size > 0) & (groups.size > k), dr.rcp(size), 0) for k, size in enumerate(steps)]
    passed = [dr.gather(mi.Float, begin, member) for member in members]
    places = [dr.gather(mi.UInt32, first, member) for member in members]
    dr.eval(count, members, per_step, passed, places)

    def give(place, number, lane):
        dr.scatter(jobs, number, place)
        dr.scatter(owner, lane, place)

    def deal(k, entry, passed, dealt, places):
        each = _halves(dr.gather(mi.Array2u, doubts.pairs, entry))
        passed = [dr.fma(doubt, each_step, p) for doubt, each_step, p in zip(each, per_step, passed, strict=True)]
        until = [mi.UInt32(p) for p in passed]
        places = list(places)
        for j, (now, before) in enumerate(zip(until, dealt, strict=True)):
            some, given = now > before, (places[j], (now - before) * MOST_LIGHTS + k, members[j])
            # Not masked scatters: mostly no lane has anything to give, and then this costs nothing.
            dr.if_stmt(given, some, give, lambda *_: None, label="pellucid given")
            places[j] = places[j] + dr.select(some, mi.UInt32(1), 0)
        return k + 1, entry + TILE, passed, until, places

    lane = dr.arange(mi.UInt32, dr.width(count))
    state = dr.zeros(mi.UInt32, dr.width(count)), doubts.begin(lane), passed, [mi.UInt32(0)] * GROUP, places
    ends = dr.while_loop(state, lambda k, *_: k < count, deal, label="pellucid deal")[4]
    dr.eval(ends, jobs, owner)
    return groups.by_receiver(ends) - first


def _try(
    scene, lights: LightTree, chosen: ChosenLights, receiver: Receiver, groups: Groups, jobs, owner
) -> tuple[mi.UInt32, mi.Float]:
    """Trace a ray to each light that was dealt some, on behalf of them all: the entries of their clusters, and packets: what would
    arrive of each light if it is seen, and the doubt about it as it was stored, negative if it is not."""
    here = dr.gather(Receiver, receiver, owner)
    entry = dr.gather(mi.UInt32, chosen.first, here.patch) + jobs % MOST_LIGHTS
    number, scale, _, doubt = chosen.fetch(
        entry, dr.gather(mi.UInt32, groups.drawn, dr.gather(mi.UInt32, groups.seat, owner) // GROUP)
    )
    light = lights.lights.fetch(number)
    direction, distance, share = _share(light, here.si.p, here.si.sh_frame.n, here.eta)
    seen = visible(scene, here.si, direction, distance, mi.Bool(True))
    chosen.count_ray(entry, seen)
    doubt = dr.reinterpret_array(mi.Float, _coarse(doubt * scale * luminance(light.intensity) * share))
    arrives = light.intensity * (share * scale)
    tried = dr.empty(mi.Float, 4 * dr.width(jobs))
    packet = mi.Vector4f(arrives.x, arrives.y, arrives.z, dr.select(seen, doubt, -doubt))
    dr.scatter(tried, packet, dr.arange(mi.UInt32, dr.width(jobs)))
    dr.eval(entry, tried, chosen.rays)
    return entry, tried


def _reconsider(lights: LightTree, chosen: ChosenLights, receiver: Receiver, groups: Groups, doubts) -> mi.Color3f:
    """Expect the light anew after all rays have arrived: by how much more it is."""
    news = dr.compress(chosen.rays > 0)
    before = dr.prefix_sum(dr.select(chosen.rays > 0, mi.UInt32(1), 0))
    lane = dr.arange(mi.UInt32, DRAWS * dr.width(news))
    entry, drawn = dr.gather(mi.UInt32, news, lane // DRAWS), lane % DRAWS
    number, _, visibility, doubt = chosen.fetch(entry, drawn)
    intensity = lights.lights.fetch(number).intensity
    change = intensity * ((chosen.hindsight(entry) - visibility) / (doubt * dr.maximum(luminance(intensity), 1e-30)))
    changes = dr.empty(mi.Float, 4 * dr.width(lane))
    dr.scatter(changes, mi.Vector4f(change.x, change.y, change.z, 0), lane)
    patch = dr.gather(mi.UInt32, receiver.patch, groups.first)
    first, count = (dr.gather(mi.UInt32, by_patch, patch) for by_patch in (chosen.first, chosen.count))
    last = first + dr.maximum(count, 1) - 1
    begin = dr.gather(mi.UInt32, before, first)
    end = dr.gather(mi.UInt32, before, last) + dr.select(dr.gather(mi.UInt32, chosen.rays, last) > 0, mi.UInt32(1), 0)
    dr.eval(news, changes, first, begin, end)

    entries = doubts.begin(dr.arange(mi.UInt32, dr.width(first)))

    def add(k, sums):
        place = entries + (dr.gather(mi.UInt32, news, k) - first) * TILE
        change = dr.gather(mi.Vector4f, changes, DRAWS * k + groups.drawn)
        colour = mi.Color3f(change.x, change.y, change.z)
        each = _halves(dr.gather(mi.Array2u, doubts.pairs, place))
        return k + 1, [dr.fma(colour, d, s) for s, d in zip(sums, each, strict=True)]

    nothing = [dr.zeros(mi.Color3f, dr.width(first)) for _ in range(GROUP)]
    sums = dr.while_loop((begin, nothing), lambda k, sums: k < end, add, label="pellucid reconsider")[1]
    dr.eval(sums)
    return groups.by_receiver(sums)


def _corrections(chosen: ChosenLights, entry: mi.UInt32, tried: mi.Float, dealt: mi.Float) -> mi.Float:
    """Correct what is expected by what each ray has found, on behalf of all the doubt that was dealt to it: packets. It must not tell
    what to expect of itself: without it, what others found is as likely above the truth as below."""
    job = dr.arange(mi.UInt32, dr.width(entry))
    packet = dr.gather(mi.Vector4f, tried, job)
    arrives, seen = mi.Color3f(packet.x, packet.y, packet.z), dr.select(packet.w > 0, 1, mi.Float(0))
    _, _, before, doubt = chosen.fetch(entry, 0)
    others = chosen.hindsight(entry, 1, seen)
    # What was expected anew was weighed by the doubts as they are stored, which are cut off.
    kept = dr.abs(packet.w) / (doubt * luminance(arrives))
    surprise = seen - before - kept * (others - before)
    factor = surprise * dealt / dr.abs(packet.w) + kept * (others - chosen.hindsight(entry))
    correction = arrives * factor
    corrections = dr.empty(mi.Float, 4 * dr.width(entry))
    dr.scatter(corrections, mi.Vector4f(correction.x, correction.y, correction.z, 0), job)
    dr.eval(corrections)
    return corrections


@dr.syntax
def _sum(corrections, first, count) -> mi.Color3f:
    """Sum the corrections of each receiver."""
    total, k = dr.zeros(mi.Color3f, dr.width(count)), mi.UInt32(0)
    while dr.hint(k < count, label="pellucid corrections"):
        packet = dr.gather(mi.Vector4f, corrections, first + k)
        total += mi.Color3f(packet.x, packet.y, packet.z)
        k += 1
    return total


def _coarse(value: mi.Float) -> mi.UInt32:
    """Cut a number off to 16 bits, the upper ones, that are stored in half the memory."""
    return dr.reinterpret_array(mi.UInt32, value) & COARSE


def _share(light: Light, p, n, eta) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
    """Evaluate which share of a light's intensity would enter: with the direction and the distance to it."""
    direction, distance, cosine, factor = light.towards(p, n)
    return direction, distance, factor * dr.maximum(cosine, 0) * transmitted(cosine, eta)
