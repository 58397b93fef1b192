"""Triples of an eye point, a cluster of irradiance samples and a cluster of lights: their links, their estimates and their bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ....gather.gather import cosine, lookup
from ..trees.bounds import HUGE, Cluster, profile_bound, read_cluster
from ..trees.light_tree import LIGHT_FLOAT4S, luminance
from ..trees.sample_tree import NODE_FLOAT4S, SAMPLE_FLOAT4S, Placement
from .light_cut import intensity, link_bound, link_factor, unshadowed_factor
from .representatives import SPREAD_BITS, spread_place
from .tables import CutTables

PAIR_BITS = 4
MOST_PAIRS = 1 << PAIR_BITS
"""Most pairs of representatives that stand for a triple."""

FACTOR = (1 << 31) - MOST_PAIRS
"""The bits of a link that are its factor; the last ones number a pair."""

MOST_OF_BSSRDF = 4
"""Most representatives from which the BSSRDF link of a triple is estimated: with more, errors are hardly smaller."""

BELOW = 2
"""So many levels below its nodes the bound of a triple is summed."""


@dataclass
class Triple:
    """A triple of a cut: its error bound, its two nodes, and its irradiance link (`irradiance_link`).

    ``lights`` also holds how many refinements of one kind led to it in a row, and of which kind they were.
    """

    bound: mi.Float
    receivers: mi.UInt32
    lights: mi.UInt32
    link: mi.UInt32


@dataclass
class Settings:
    """Numbers that kernels take as inputs: ``bright`` is alpha times W, ``beta`` the paper's over the area of the body [1/area]."""

    max_error: mi.Float
    bright: mi.Float
    beta: mi.Float
    alternation: mi.UInt32
    pairs: mi.UInt32
    eta: mi.Float
    first_key: mi.UInt64


@dataclass
class Fetched(Placement):
    """The transforms of the lanes' instances, fetched once and not for every refinement."""

    fetched: list[Any]

    def _rows(self, instance: Any, active: Any) -> list[Any]:
        return self.fetched


@dataclass
class Eye:
    """Eye points: position and normal in the prototype, instance, random bits of its own, and the way to the world."""

    p: mi.Point3f
    n: mi.Normal3f
    instance: mi.UInt32
    bits: mi.UInt32
    place: Fetched


@dataclass
class Half:
    """A triple in the making: its nodes, its BSSRDF link R_b, and both strengths multiplied."""

    receivers: mi.UInt32
    lights: mi.UInt32
    profile: mi.Color3f
    strength: mi.Color3f


def look_up(tables: CutTables, eye: Eye, settings: Settings, receivers, lights) -> Half:
    """Look up what the estimate of a triple needs but for its irradiance link."""
    number = dr.minimum(settings.pairs, MOST_OF_BSSRDF)
    profile = bssrdf_link(tables, eye, receivers, mixed(eye.bits ^ (receivers * 0x9E3779B9)), number)
    strength = sample_strength(tables, receivers) * intensity(tables.lights, lights)
    return Half(mi.UInt32(receivers), mi.UInt32(lights), profile, strength)


def sample_strength(tables: CutTables, node) -> mi.Color3f:
    """Fetch the summed strength ``B_j`` of clusters of samples."""
    value = dr.gather(mi.Array4f, tables.strength, node)
    return mi.Color3f(value[0], value[1], value[2])


# ---------------------- Links ----------------------


@dr.syntax
def bssrdf_link(tables: CutTables, eye: Eye, receivers, bits, number) -> mi.Color3f:
    """Evaluate R_j of an irradiance cluster: the mean over so many representatives, spread over it at random."""
    total, k = mi.Color3f(0), mi.UInt32(0)
    while k < number:
        sample, weight = sample_of(tables, receivers, k, number, bits)
        total += weight * profile_at(tables, eye, sample)
        k += 1
    return total * dr.rcp(mi.Float(number))


def profile_at(tables: CutTables, eye: Eye, sample) -> mi.Color3f:
    """Evaluate R_d between eye points and samples."""
    p = dr.gather(mi.Array4f, tables.samples.samples, sample * SAMPLE_FLOAT4S)
    way = eye.p - mi.Point3f(p[0], p[1], p[2])
    r2 = dr.squared_norm(way)
    return mi.Color3f(*lookup(tables.profile, r2, True, mu=cosine(eye.n, way, r2)))


def sample_of(tables: CutTables, node, k, number, bits) -> tuple[mi.UInt32, mi.Float]:
    """Choose the k-th of so many representatives of a cluster of samples; and its weight in the mean over them."""
    sample, share = _member(tables.sample_choices, tables.depth_opaque, node, k, number, bits)
    sample = dr.minimum(sample, tables.last_opaque)
    own, all_of_them = (dr.sum(sample_strength(tables, n)) for n in (sample + tables.leaves_opaque, node))
    return sample, _weight(own, all_of_them, share)


def light_of(tables: CutTables, node, k, number, bits) -> tuple[mi.UInt32, mi.Float]:
    """Choose the k-th of so many representatives of a cluster of lights; and its weight in the mean over them."""
    light, share = _member(tables.light_choices, tables.light_depth_opaque, node, k, number, bits)
    own, all_of_them = (dr.sum(intensity(tables.lights, n)) for n in (light + tables.lights.leaves_opaque, node))
    return light, _weight(own, all_of_them, share)


def _member(choices, depth, node, k, number, bits) -> tuple[mi.UInt32, mi.UInt32]:
    """Choose the k-th of so many members of a node, a power of two.

    All in turn if they are no more than that: the member and how many there are. Otherwise members drawn by strength, each within
    its own equal share of it, at random: the member and zero.
    """
    level = 31 - dr.lzcnt(node)
    below = depth - level
    in_turn = (node << below) - (mi.UInt32(1) << depth) + ((k << below) >> (31 - dr.lzcnt(number)))
    share = (1 << SPREAD_BITS) // number
    slot = k * share + (mixed(bits + k * 0x2545F491) & (share - 1))
    few = (mi.UInt32(1) << below) <= number
    drawn = dr.gather(mi.UInt32, choices, spread_place(depth, node, slot), ~few)
    return dr.select(few, in_turn, drawn), dr.select(few, mi.UInt32(1) << below, 0)


def _weight(own, all_of_them, share) -> mi.Float:
    """Weigh a member by its strength, if all stand in the mean alike."""
    return dr.select(share > 0, own * mi.Float(share) / dr.maximum(all_of_them, 1 / HUGE), 1)


def pair_of(tables: CutTables, settings: Settings, receivers, lights, k) -> tuple[mi.UInt32, mi.UInt32, mi.Float]:
    """Choose the k-th pair of a sample and a light that stand for two clusters, and its weight; in another order of each."""
    bits = tables.bits ^ mixed(receivers * 0x9E3779B9 ^ mixed(lights * 0x85EBCA77))
    other = (k * 5 + (bits >> 8)) & (settings.pairs - 1)
    sample, of_sample = sample_of(tables, receivers, k, settings.pairs, bits)
    light, of_light = light_of(tables, lights, other, settings.pairs, ~bits)
    return sample, light, of_sample * of_light


@dr.syntax
def irradiance_link(scene, tables: CutTables, eye: Eye, settings: Settings, half: Half) -> tuple[mi.UInt32, mi.Bool]:
    """Estimate the irradiance link of two clusters by some pairs of representatives and one shadow ray.

    Without visibility the link is the mean over all pairs. One of them, drawn in proportion to what it gives, is traced, and tells whether
    the mean arrives: that has the right mean, whatever hides the light.

    Returns the link, the factor and the number of the pair in the last bits of one word, and where a ray was traced.
    """
    total, chosen, k = mi.Float(0), mi.UInt32(0), mi.UInt32(0)
    bits = mixed(tables.bits ^ half.receivers * 0x1B56C4E9 ^ mixed(half.lights * 0x7FEB352D + eye.instance))
    u = mi.Float(bits >> 8) * 2.0**-24
    while k < settings.pairs:
        sample, light, weight = pair_of(tables, settings, half.receivers, half.lights, k)
        si = tables.samples.receiver(sample, eye.place, eye.instance)
        factor, _, _ = unshadowed_factor(si, settings.eta, tables.lights, light, True)
        factor *= weight
        total += factor
        # One of all so far, each in proportion to its factor, by what is left of one random number.
        share = dr.select(factor > 0, factor / total, 0)
        taken = u < share
        chosen = dr.select(taken, k, chosen)
        u = dr.clip(dr.select(taken, u / share, (u - share) / (1 - share)), 0, 1 - 2.0**-24)
        k += 1
    sample, light, _ = pair_of(tables, settings, half.receivers, half.lights, chosen)
    si = tables.samples.receiver(sample, eye.place, eye.instance)
    factor, traced = link_factor(scene, si, settings.eta, tables.lights, light, total > 0)
    mean = dr.select(factor > 0, total / mi.Float(settings.pairs), 0)
    return (dr.reinterpret_array(mi.UInt32, mean) & FACTOR) | chosen, traced


def estimate(tables: CutTables, settings: Settings, half: Half, link, bound) -> mi.Color3f:
    """Estimate a triple, without E: ``R_b F_bl [sum B_j] [sum I_i]`` (AWB08 eq. 8); no more than its bound, if that is not zero.

    What exceeds the bound is wrong for certain: where a light that stands for thousands is next to the sample, the total would be far
    too large, and refinement would end, since bounds are compared with the total.
    """
    factor = dr.reinterpret_array(mi.Float, link & FACTOR)
    sample, light, _ = pair_of(tables, settings, half.receivers, half.lights, link & (MOST_PAIRS - 1))
    # Members of a cluster differ in colour, and in whether they are lit or seen: where the sun is hidden, the light of the sky is blue.
    own = dr.gather(mi.Array4f, tables.samples.samples, sample * SAMPLE_FLOAT4S + 4)
    strength = _of_colour(sample_strength(tables, half.receivers), mi.Color3f(own[0], own[1], own[2]))
    strength *= _of_colour(
        intensity(tables.lights, half.lights), intensity(tables.lights, light + tables.lights.leaves_opaque)
    )
    found = luminance(half.profile * half.strength) * factor
    most = dr.select(bound > 0, dr.minimum(bound / dr.maximum(found, 1 / HUGE), 1), 1)
    return half.profile * strength * (factor * most)


def _of_colour(total, colour) -> mi.Color3f:
    """Give a total the colour of one of its parts: as much in all, and in the mean over parts drawn by their sums the total itself."""
    own = dr.sum(colour)
    return colour * dr.select(own > 0, dr.maximum(dr.sum(total), 0) / own, 0)


# ---------------------- Bounds ----------------------


def bound_of_triple(tables: CutTables, eye: Eye, settings: Settings, half: Half) -> mi.Float:
    """Bound the error of a triple by the luminance of its bound; zero where both clusters are single samples.

    What bounds the parts of a triple bounds their sum, and mostly more closely than largest factors over all of it do: the bounds of
    all pairs of nodes two levels below are added up.

    Source: AWB08 section 4.3, after eq. 6.
    """
    parts = _sum_of_bounds(
        tables,
        eye,
        settings,
        _below(half.receivers, tables.leaves_opaque),
        _below(half.lights, tables.lights.leaves_opaque),
    )
    whole = _sum_of_bounds(tables, eye, settings, [(half.receivers, True)], [(half.lights, True)])
    # Node 1 holds lights with a position and those without, which have no common bound.
    bound = dr.select(half.lights == 1, parts, dr.minimum(parts, whole))
    single = (half.receivers >= tables.leaves_opaque) & (half.lights >= tables.lights.leaves_opaque)
    return dr.select(single, 0, dr.clip(bound, 0, HUGE))


def _sum_of_bounds(tables: CutTables, eye: Eye, settings: Settings, samples: list, lights: list) -> mi.Float:
    """Add up what bounds the luminance of all pairs of some nodes: each with whether it counts."""
    total = mi.Float(0)
    for node, counts in samples:
        local = read_cluster(tables.samples.nodes, node, NODE_FLOAT4S, 2)
        power = profile_bound(tables.bound, eye.p, local) * sample_strength(tables, node)
        world = _in_the_world(eye, local)
        for other, also in lights:
            link = _mean_link_bound(tables, settings, node, world, other)
            total += dr.select(counts & also, luminance(power * intensity(tables.lights, other)) * link, 0)
    return total


def _below(node, leaves) -> list[tuple[mi.UInt32, mi.Bool]]:
    """List the nodes that lie some levels below a node, or are leaves above that: four, and whether each is one."""
    nodes = [(mi.UInt32(node), mi.Bool(True))]
    for _ in range(BELOW):
        nodes = [
            (dr.select(n < leaves, 2 * n + side, n), there & ((n < leaves) | (side == 0)))
            for n, there in nodes
            for side in range(2)
        ]
    return nodes


def _in_the_world(eye: Eye, local: Cluster) -> Cluster:
    """Take a cluster of samples to where the instance of the eye point has it."""
    return Cluster(
        eye.place.point(eye.instance, local.centre),
        local.radius,
        mi.Vector3f(eye.place.normal(eye.instance, local.axis)),
        local.cos_cone,
        eye.place.extent(eye.instance, local.half),
    )


def _mean_link_bound(tables: CutTables, settings: Settings, node, receivers: Cluster, lights) -> mi.Float:
    """Bound the irradiance link between a cluster of samples and one of lights, as a mean over all pairs.

    Besides the bound of every pair (`bounds.irradiance_bound`), two bounds hold for all pairs together where clusters touch. The lights
    of a cluster give no more than the radiosity of the surface that they stand for (`light_tree.near2_together`); and no more reaches
    all samples than the lights send, ``pi I`` each: ``sum_j B_j F_ji <= pi``.
    """
    link = link_bound(receivers, tables.lights, lights, settings.eta)
    kind, box = (dr.gather(mi.Array4f, tables.lights.nodes, lights * LIGHT_FLOAT4S + k) for k in (2, 3))
    area = dr.gather(mi.Float, tables.samples.strength, node)
    together = dr.minimum(link, dr.rcp(dr.maximum(box[3], 1 / HUGE)))
    to_all = dr.pi * dr.rcp(dr.maximum(area, 1 / HUGE))
    together = dr.select(node < tables.leaves_opaque, dr.minimum(together, to_all), together)
    return dr.select(kind[3] < 0, link, together)  # directional lights have no place


def scramble(p: mi.Point3f, instance) -> mi.UInt32:
    """Draw random bits for eye points from where they are: the same in any order, in any chunk."""
    bits = mi.UInt32(instance) * 0x85EBCA6B
    for x in p:
        bits = mixed(bits ^ dr.reinterpret_array(mi.UInt32, x))
    return bits


def mixed(bits) -> mi.UInt32:
    """Mix the bits of a number."""
    bits = (bits ^ (bits >> 16)) * 0x7FEB352D
    bits = (bits ^ (bits >> 15)) * 0x846CA68B
    return bits ^ (bits >> 16)
