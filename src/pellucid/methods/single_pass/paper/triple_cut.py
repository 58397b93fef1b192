"""The triple cut: radiant exitance from clusters of paths from a light over an irradiance sample to the eye point (AWB08).

A cluster triple is the eye point, a cluster of irradiance samples and a cluster of lights. Each lane refines the cut of one
eye point: a heap in local memory, the triple with the largest error bound on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ....errors import SceneError
from ....kernels.heap import check_size, push, replace_top
from ..trees.bounds import HUGE, read_cluster
from ..trees.light_tree import luminance
from ..trees.sample_tree import NODE_FLOAT4S, PLACE_FLOAT4S, Placement
from .cache import LinkCache
from .light_cut import intensity, unshadowed_factor
from .tables import CutTables
from .triples import (
    MOST_PAIRS,
    Eye,
    Fetched,
    Half,
    Settings,
    Triple,
    bound_of_triple,
    estimate,
    irradiance_link,
    light_of,
    look_up,
    mixed,
    profile_at,
    sample_of,
    scramble,
)

RUN_SHIFT, LAST_SHIFT = 27, 31
LONGEST_RUN = (1 << (LAST_SHIFT - RUN_SHIFT)) - 1


@dataclass
class CutParameters:
    """The paper's parameters.

    Attributes
    ----------
    max_error : float
        Largest error bound of a triple, as part of the total (AWB08 section 4.3).
    max_cut : int
        Most triples of a cut, at which refinement ends; up to 16384.
    alternation : int
        m: as many refinements of one kind in a row are followed by one of the other. The paper has 8.
    alpha, beta, white : float
        Weights of the third and the fourth test, and the radiance that is shown as white, W (AWB08 section 5.2).
    pairs : int
        How many pairs of representatives a triple is estimated from, a power of two up to 16; one of them is traced. The paper has 1.
    """

    max_error: float = 0.02
    max_cut: int = 16384
    alternation: int = 1
    alpha: float = 10.0
    beta: float = 1.0
    white: float = 1.0
    pairs: int = MOST_PAIRS

    def __post_init__(self) -> None:
        check_size(self.max_cut)
        if not 1 <= self.alternation <= LONGEST_RUN:
            raise SceneError(f"triple cut: alternation must be 1 to {LONGEST_RUN}; found {self.alternation}.")
        if not 1 <= self.pairs <= MOST_PAIRS or self.pairs & (self.pairs - 1):
            raise SceneError(f"triple cut: pairs must be a power of two, 1 to {MOST_PAIRS}; found {self.pairs}.")


@dataclass
class TripleCuts:
    """Results by eye point.

    Attributes
    ----------
    exitance : Color3f
        Radiant exitance ``sum R_j B_j F_ji I_i`` (AWB08 eq. 9 without E, the factor of the eye).
    cut_size, shadow_rays : UInt32
        Triples of the cut, and rays that were traced.
    links, cache_hits : UInt32
        Irradiance links that were asked for, and those that were found in the cache.
    full : Bool
        Refinement ended at ``max_cut``.
    """

    exitance: mi.Color3f
    cut_size: mi.UInt32
    shadow_rays: mi.UInt32
    links: mi.UInt32
    cache_hits: mi.UInt32
    full: mi.Bool

    @property
    def hit_rate(self) -> float:
        """Share of the links that were found in the cache."""
        links, hits = (int(dr.sum(mi.UInt64(x))[0]) for x in (self.links, self.cache_hits))
        return hits / max(links, 1)


def triple_cut(
    scene: mi.Scene,
    tables: CutTables,
    placement: Placement,
    eta: float,
    p_local: mi.Point3f,
    instance: mi.UInt32,
    parameters: CutParameters | None = None,
    cache: LinkCache | None = None,
    n_local: mi.Normal3f | None = None,
) -> TripleCuts:
    """Sum the radiant exitance at eye points over the triples of a cut.

    Parameters
    ----------
    placement, instance : Placement, UInt32
        The instances of the prototype, and the one of each eye point.
    eta : float
        Relative index of refraction of the body.
    p_local, n_local : Point3f, Normal3f
        Eye points in the space of the prototype, along a coherent order, and normals away from the inside; without them it is flat.
    cache : LinkCache, optional
        Shared by all calls. The picture does not depend on it.

    Raises
    ------
    SceneError
        When the cache is too small to tell all links apart.

    Source: AWB08 section 4 and 5.
    """
    chosen = parameters or CutParameters()
    width = dr.width(p_local)
    if cache is not None:
        instances = len(placement.rows) // (4 * PLACE_FLOAT4S)
        if tables.first_key + tables.keys(instances) > cache.most_keys:
            raise SceneError(f"cache_entries: {cache.entries} are too few for this scene; double them.")
    n_local = dr.zeros(mi.Normal3f, width) if n_local is None else n_local
    dr.eval(p_local, n_local, instance)  # how they came about is no part of the kernel, which is then compiled once
    rows = [dr.gather(mi.Array4f, placement.rows, instance * PLACE_FLOAT4S + k) for k in range(PLACE_FLOAT4S)]
    eye = Eye(
        mi.Point3f(p_local),
        mi.Normal3f(n_local),
        instance + dr.zeros(mi.UInt32, width),
        scramble(p_local, instance),
        Fetched(mi.Float(0), rows),
    )
    settings = Settings(
        dr.opaque(mi.Float, chosen.max_error),
        dr.opaque(mi.Float, chosen.alpha * chosen.white),
        dr.opaque(mi.Float, chosen.beta / float(tables.samples.tree.strength[1])),
        dr.opaque(mi.UInt32, chosen.alternation),
        dr.opaque(mi.UInt32, chosen.pairs),
        dr.opaque(mi.Float, eta),
        dr.opaque(mi.UInt64, tables.first_key),
    )
    cuts = _refine(scene, tables, eye, settings, cache, chosen.max_cut, dr.opaque(mi.UInt32, 0, width))
    dr.eval(cuts, None if cache is None else cache.written)  # what lanes write down is part of the same launch
    return cuts


@dr.syntax
def _refine(scene, tables, eye, settings, cache, max_cut, zero):
    """Refine the cuts of all eye points, from the triple of both roots."""
    heap = dr.alloc_local(Triple, max_cut)
    root = look_up(tables, eye, settings, zero + 1, zero + 1)
    link, hit, traced = _link(scene, tables, eye, settings, cache, root, mi.Bool(True))
    total = mi.Color3d(estimate(tables, settings, root, link, mi.Float(HUGE)))
    heap[0] = Triple(mi.Float(HUGE), zero + 1, zero + 1, link)
    size, cut_size = zero + 1, zero + 1
    rays, links, hits = zero + dr.select(traced, 1, 0), zero + 1, zero + dr.select(hit, 1, 0)
    worst = zero + mi.Float(HUGE)

    while dr.hint(
        (size > 0) & (worst > settings.max_error * luminance(total)) & (cut_size < max_cut), label="pellucid triple cut"
    ):
        top = heap[0]
        node = top.lights & ((1 << RUN_SHIFT) - 1)
        parent = look_up(tables, eye, settings, top.receivers, node)
        total -= mi.Color3d(estimate(tables, settings, parent, top.link, top.bound))

        # ---------------------- Which cluster to split ----------------------
        by_lights = _choose(tables, eye, settings, parent, top)
        run = history(top.lights, by_lights)
        # Both halves, one after the other: the kernel has the code of one.
        one, other = (Triple(mi.Float(0), zero, zero, zero) for _ in range(2))
        both, side = mi.Bool(True), mi.UInt32(0)
        while side < 2:
            half = look_up(
                tables,
                eye,
                settings,
                dr.select(by_lights, top.receivers, 2 * top.receivers + side),
                dr.select(by_lights, 2 * node + side, node),
            )
            lit = dr.any(half.strength > 0)
            link, hit, traced = _link(scene, tables, eye, settings, cache, half, lit)
            rays += dr.select(traced, 1, 0)
            links += dr.select(lit, 1, 0)
            hits += dr.select(hit, 1, 0)
            # The total, in double precision (AWB08 eq. 9): the estimates of the first triples can exceed it a million times.
            bound = bound_of_triple(tables, eye, settings, half)
            total += mi.Color3d(estimate(tables, settings, half, link, bound))
            both &= lit
            one = other
            other = Triple(bound, half.receivers, half.lights | run, link)
            side += 1
        cut_size += dr.select(both, 1, 0)

        # ---------------------- The heap ----------------------
        swap = other.bound > one.bound
        larger, smaller = dr.select(swap, other, one), dr.select(swap, one, other)
        heap, size = replace_top(heap, size, larger, zero)
        heap, size = push(heap, size, smaller, zero)
        worst = dr.select(size > 0, heap[0].bound, 0)

    exitance = mi.Color3f(dr.maximum(total, 0))
    full = (size > 0) & (worst > settings.max_error * luminance(total))
    return TripleCuts(exitance, cut_size, rays, links, hits, full)


def _choose(tables: CutTables, eye: Eye, settings: Settings, half: Half, triple: Triple) -> mi.Bool:
    """Choose which cluster of a triple is split: that of lights, or that of irradiance samples.

    The tests look at a pair of representatives of their own, drawn at random: what is split does not depend on the estimate.
    """
    cluster = read_cluster(tables.samples.nodes, half.receivers, NODE_FLOAT4S, 2)
    contains_eye = dr.all(dr.abs(cluster.centre - eye.p) <= cluster.half)
    bits = mixed(eye.bits ^ (half.receivers * 0x9E3779B9) ^ (half.lights * 0x85EBCA77) ^ 0x68E31DA4)
    one = mi.UInt32(1)
    sample, _ = sample_of(tables, half.receivers, mi.UInt32(0), one, bits)
    light, _ = light_of(tables, half.lights, mi.UInt32(0), one, ~bits)
    profile = profile_at(tables, eye, sample)
    si = tables.samples.receiver(sample, eye.place, eye.instance)
    link, direction, _ = unshadowed_factor(si, settings.eta, tables.lights, light, True)
    # Figure 3: F^(nv) is the cosine over pi. How light falls off on its way is left to I.
    factor = dr.maximum(dr.dot(direction, si.sh_frame.n), 0) * dr.inv_pi
    irradiance = link * dr.inv_pi * luminance(intensity(tables.lights, half.lights))
    run, last = (triple.lights >> RUN_SHIFT) & LONGEST_RUN, (triple.lights >> LAST_SHIFT) != 0
    by_lights = splits_lights(contains_eye, run, last, irradiance, luminance(profile), factor, settings)
    by_lights |= (half.lights == 1) | (half.receivers >= tables.leaves_opaque)
    return by_lights & (half.lights < tables.lights.leaves_opaque)


def splits_lights(contains_eye, run, last_was_lights, irradiance, profile, factor, settings) -> mi.Bool:
    """Apply the four tests of the heuristic in order; true where the light cluster is to be split.

    Parameters
    ----------
    contains_eye : Bool
        The irradiance cluster contains the eye point.
    run, last_was_lights : UInt32, Bool
        How many refinements of one kind led to the triple in a row, and whether they split lights.
    irradiance, profile, factor : Float
        ``F_ji^(nv) I_i``, ``R_j`` [1/area] and ``F_ji^(nv)`` of a pair of representatives.
    settings : Settings
        Parameters m (alternation), alpha W (bright), and beta over the area A of the body [1/area]. The fourth test of the
        paper compares R_j, which has a unit, with F_ji, which has none; here it is ``R_j A > beta F_ji``. Light that enters at
        b_j and leaves evenly from all of the surface has ``R_j A = 1``.

    Source: AWB08 section 5.2, eqs. 10, 11.
    """
    fourth = ~(profile > settings.beta * factor)  # AWB08 eq. 11
    third = irradiance > settings.bright  # AWB08 eq. 10
    return ~contains_eye & dr.select(run >= settings.alternation, ~last_was_lights, third | fourth)


def history(word, by_lights) -> mi.UInt32:
    """Count one more refinement of the same kind, or the first of the other; packed as in `Triple`."""
    run, last = (word >> RUN_SHIFT) & LONGEST_RUN, (word >> LAST_SHIFT) != 0
    run = dr.select((last == by_lights) & (run > 0), dr.minimum(run + 1, LONGEST_RUN), 1)
    return (run << RUN_SHIFT) | dr.select(by_lights, mi.UInt32(1 << LAST_SHIFT), mi.UInt32(0))


@dr.syntax
def _link(scene, tables, eye, settings, cache, half, active):
    """Find or compute the irradiance link of two clusters: the link, cache hits, rays."""
    link, hit, traced = mi.UInt32(0), mi.Bool(False), mi.Bool(False)
    receivers = mi.UInt64(eye.instance) * (2 * tables.leaves_opaque) + half.receivers
    key = settings.first_key + receivers * (2 * tables.lights.leaves_opaque) + half.lights
    if dr.hint(cache is not None, mode="scalar"):
        link, hit = cache.find(key, active)
    missing = active & ~hit
    if missing:
        link, traced = irradiance_link(scene, tables, eye, settings, half)
    if dr.hint(cache is not None, mode="scalar"):
        cache.keep(key, link, missing)
    return link, hit, traced
