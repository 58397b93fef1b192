"""Triples of an eye point, a cluster of irradiance samples and a cluster of lights: their estimates and their bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ....gather.gather import cosine, lookup
from ..trees.bounds import HUGE, Cluster, profile_bound, read_cluster
from ..trees.light_tree import LIGHT_FLOAT4S, luminance
from ..trees.sample_tree import NODE_FLOAT4S, SAMPLE_FLOAT4S, Placement
from .light_cut import intensity, link_bound
from .representatives import EYE_SLOT_BITS, LIGHT_REPRESENTATIVES, eye_place
from .tables import CutTables


@dataclass
class Triple:
    """A triple of a cut: its error bound, its two nodes, and the link factor of its representative.

    ``lights`` also holds how many refinements of one kind led to it in a row, and of which kind they were.
    """

    bound: mi.Float
    receivers: mi.UInt32
    lights: mi.UInt32
    factor: mi.Float


@dataclass
class Settings:
    """Numbers that kernels take as inputs: ``bright`` is alpha times W, ``beta`` the paper's over the area of the body [1/area]."""

    max_error: mi.Float
    bright: mi.Float
    beta: mi.Float
    alternation: mi.UInt32
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
    """A triple in the making: its nodes, its BSSRDF link R_b, both strengths multiplied, and representatives.

    ``power`` has the colours of the sample and the light that stand for the others; ``strength`` has those of all.
    """

    receivers: mi.UInt32
    lights: mi.UInt32
    profile: mi.Color3f
    strength: mi.Color3f
    power: mi.Color3f
    sample: mi.UInt32
    light: mi.UInt32


def look_up(tables: CutTables, eye: Eye, receivers, lights) -> Half:
    """Look up what the estimate of a triple needs but for its irradiance link."""
    strength = dr.gather(mi.Array4f, tables.strength, receivers)
    light = intensity(tables.lights, lights)
    sample = dr.reinterpret_array(mi.UInt32, strength[3])
    slot = mixed(sample) % LIGHT_REPRESENTATIVES
    chosen = dr.gather(mi.UInt32, tables.light_choices, lights * LIGHT_REPRESENTATIVES + slot)
    # Members of a cluster differ in colour, and in whether they are lit or seen: where the sun is hidden, the light of the sky is blue.
    own = dr.gather(mi.Array4f, tables.samples.samples, sample * SAMPLE_FLOAT4S + 4)
    colour, all_colours = (mi.Color3f(x[0], x[1], x[2]) for x in (own, strength))
    power = _of_colour(all_colours, colour) * _of_colour(
        light, intensity(tables.lights, chosen + tables.lights.leaves_opaque)
    )
    profile = bssrdf_link(tables, eye, receivers, mixed(eye.bits ^ (receivers * 0x9E3779B9)))[1]
    return Half(
        mi.UInt32(receivers),
        mi.UInt32(lights),
        profile,
        all_colours * light,
        power,
        sample,
        chosen,
    )


def _of_colour(total, colour) -> mi.Color3f:
    """Give a total the colour of one of its parts: as much in all, and in the mean over parts drawn by their sums the total itself."""
    own = dr.sum(colour)
    return colour * dr.select(own > 0, dr.maximum(dr.sum(total), 0) / own, 0)


def bssrdf_link(tables: CutTables, eye: Eye, receivers, bits) -> tuple[mi.UInt32, mi.Color3f]:
    """Choose one of the 64 representatives of irradiance clusters by random bits, and look its R_j up."""
    place = eye_place(tables.depth_opaque, receivers, bits >> (32 - EYE_SLOT_BITS))
    sample = dr.gather(mi.UInt32, tables.eye_choices, place)
    p = dr.gather(mi.Array4f, tables.samples.samples, sample * SAMPLE_FLOAT4S)
    way = eye.p - mi.Point3f(p[0], p[1], p[2])
    r2 = dr.squared_norm(way)
    return sample, mi.Color3f(*lookup(tables.profile, r2, True, mu=cosine(eye.n, way, r2)))


def estimate(half: Half, factor, most) -> mi.Color3f:
    """Estimate a triple, without E: ``R_b F_bl [sum B_j] [sum I_i]`` (AWB08 eq. 8); no more than its bound.

    What exceeds the bound is wrong for certain: where a light that stands for thousands is next to the sample, the total would be far
    too large, and refinement would end, since bounds are compared with the total.
    """
    return half.profile * half.power * dr.minimum(factor, most)


def bound_of_link(tables: CutTables, eye: Eye, settings: Settings, half: Half) -> mi.Float:
    """Bound the irradiance link of a triple, as a mean over its pairs; infinite where both clusters are single, and need none.

    Besides the bound of every pair (`bounds.irradiance_bound`), two bounds hold for all pairs together where clusters touch. The lights
    of a cluster give no more than the radiosity of the surface that they stand for (`light_tree.near2_together`); and no more reaches
    all samples than the lights send, ``pi I`` each: ``sum_j B_j F_ji <= pi``.
    """
    local = read_cluster(tables.samples.nodes, half.receivers, NODE_FLOAT4S, 2)
    world = Cluster(
        eye.place.point(eye.instance, local.centre),
        local.radius,
        mi.Vector3f(eye.place.normal(eye.instance, local.axis)),
        local.cos_cone,
        eye.place.extent(eye.instance, local.half),
    )
    link = link_bound(world, tables.lights, half.lights, settings.eta)
    kind, box = (dr.gather(mi.Array4f, tables.lights.nodes, half.lights * LIGHT_FLOAT4S + k) for k in (2, 3))
    several = half.receivers < tables.leaves_opaque
    area = dr.gather(mi.Float, tables.samples.strength, half.receivers)
    together = dr.minimum(link, dr.rcp(dr.maximum(box[3], 1 / HUGE)))
    together = dr.select(several, dr.minimum(together, dr.pi * dr.rcp(dr.maximum(area, 1 / HUGE))), together)
    link = dr.select(kind[3] < 0, link, together)  # directional lights have no place
    # Node 1 holds lights with a position and those without, which have no common bound.
    exact = ~several & (half.lights >= tables.lights.leaves_opaque)
    return dr.select((half.lights == 1) | exact, HUGE, link)


def bound_of_triple(tables: CutTables, eye: Eye, half: Half, link) -> mi.Float:
    """Bound the error of a triple by the luminance of its bound; zero where both clusters are single samples.

    Source: AWB08 section 4.3, after eq. 6.
    """
    local = read_cluster(tables.samples.nodes, half.receivers, NODE_FLOAT4S, 2)
    bound = luminance(profile_bound(tables.bound, eye.p, local) * half.strength) * link
    single = (half.receivers >= tables.leaves_opaque) & (half.lights >= tables.lights.leaves_opaque)
    return dr.select(single, 0, dr.clip(bound, 0, HUGE))


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
