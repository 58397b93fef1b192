"""Photons: where they start at the lights of a scene, and at which places they aim."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ...kernels.memory import columns, lanes_where, opaque, rows, upload
from ...kernels.sequences import GOLDEN, R3, fraction, kronecker
from .records import DIRECTIONAL, ORIENTED, Light, LightRecords, LightSamples, spot_falloff, to_device, visible

PROBES, AIMS, AIM_NEIGHBOURS = 1 << 15, 256, 8
"""Paths back from the receivers, balls that they find for the photons of the sky, or of lamps, to aim at, and neighbours in their
radius."""

LINES_PER_LANE = 8
"""Photons whose chances to aim at a ball one lane sums up: to fetch a ball takes longer than to look at it from one line."""

UNAIMED, RAREST = 0.5, 0.1
"""Part of the photons that go wherever light goes, and the least part for sky or lamps."""

STEPS = (*R3, 1 - GOLDEN)
"""By which the numbers that choose a photon go on: three dimensions filled evenly, however many photons there are; and one more."""

Receivers = tuple[ArrayLike, ArrayLike]
"""Points that are to be lit and their normals, ``(m, 3) float`` both."""


@dataclass
class Aims:
    """Balls that photons of the sky, or of lamps, aim at: centre and radius, packed; None where they aim at nothing."""

    packets: Any
    count: Any

    @classmethod
    def make(cls, balls: NDArray | None) -> Aims:
        """Pack balls ``(k, 4)``."""
        if balls is None:
            return cls(None, 0)
        return cls(upload(balls), dr.opaque(mi.UInt32, len(balls)))

    def choose(self, choice: mi.Float, active: mi.Bool) -> tuple[mi.Bool, mi.Point3f, mi.Float]:
        """Choose whether to aim, and at which ball."""
        if self.packets is None:
            return mi.Bool(False), mi.Point3f(0), mi.Float(0)
        number = mi.UInt32(dr.maximum(choice - UNAIMED, 0) / (1 - UNAIMED) * mi.Float(self.count))
        aimed = active & (choice >= UNAIMED)
        ball = dr.gather(mi.Array4f, self.packets, dr.minimum(number, self.count - 1), aimed)
        return aimed, mi.Point3f(ball[0], ball[1], ball[2]), ball[3]

    def mixed(self, own: mi.Float, ray: mi.Ray3f, chance: Chance, lanes: mi.UInt32) -> mi.Float:
        """Mix the density with which the rays of some lanes would be chosen without aims with that of all aims."""
        if self.packets is None:
            return own
        all_of_them = _sum_of_chances(self.packets, self.count, ray, chance, lanes) / mi.Float(self.count)
        return dr.fma(1 - UNAIMED, all_of_them, UNAIMED * own)


Chance = Callable[[mi.Vector3f, mi.Vector3f, mi.Float], mi.Float]
"""The density with which an aim at a ball chooses a ray: from the way to its centre, the direction, and its radius squared."""


@dataclass
class Emission:
    """How photons are shared among lights, and where they aim at; see `plan_emission`."""

    records: LightRecords
    ends: mi.UInt32
    """Where the part of each light ends if all make up 2^32 by their probabilities."""
    rarity: mi.Float
    """The reciprocal of the probability of each light."""
    sky: Aims
    lamps: Aims
    centre: NDArray[np.float64]
    radius: float
    """A sphere around the scene."""
    shift: list[int]
    """Where the numbers that choose a photon begin, of 2^32."""

    def photons(self, first: int, size: int) -> tuple[mi.Ray3f, mi.Color3f]:
        """Start photons number ``first`` and following: rays, and flux [W times the number of all photons]."""
        number = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
        u = kronecker(number, STEPS, [dr.opaque(mi.UInt32, shift) for shift in self.shift])
        pick = _part(self.ends, u[0])
        x, y, choice = (fraction(value) for value in u[1:])
        light, sample = self.records.fetch(pick), mi.Point2f(x, y)
        distant = light.kind == DIRECTIONAL
        start, own_above = self._from_sky(light, choice, sample, distant)
        direction, own_around, shape = self._from_lamp(light, choice, sample, ~distant)
        ray = mi.Ray3f(dr.select(distant, start, mi.Point3f(light.p)), dr.select(distant, -light.n, direction))
        flux = light.intensity * (dr.select(distant, 1, shape) * dr.gather(mi.Float, self.rarity, pick))
        own = dr.select(distant, own_above, own_around)
        dr.eval(ray, flux, own, distant)
        density = dr.zeros(mi.Float, size)
        for aims, chance, group in ((self.sky, _through_disc, distant), (self.lamps, _within_cone, ~distant)):
            lanes = lanes_where(group)
            if dr.width(lanes):
                dr.scatter(density, aims.mixed(dr.gather(mi.Float, own, lanes), ray, chance, lanes), lanes)
        return ray, dr.select(density > 0, flux / density, 0)

    def _from_sky(self, light: Light, choice, sample, active) -> tuple[mi.Point3f, mi.Float]:
        """Choose where light from infinity passes: a point outside the scene, and its density if nothing were aimed at."""
        centre, radius = opaque(mi.Point3f, self.centre), dr.opaque(mi.Float, self.radius)
        aimed, ball, reach = self.sky.choose(choice, active)
        offset = mi.warp.square_to_uniform_disk_concentric(sample) * dr.select(aimed, reach, radius)
        passing = dr.select(aimed, ball, centre) + mi.Frame3f(light.n).to_world(mi.Vector3f(offset.x, offset.y, 0))
        start = passing + light.n * (radius - dr.dot(passing - centre, light.n))
        return start, dr.select(_beside(start - centre, light.n) < dr.square(radius), dr.inv_pi / dr.square(radius), 0)

    def _from_lamp(self, light: Light, choice, sample, active) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
        """Choose a direction from a place: with its density if nothing were aimed at, and what intensity is multiplied by."""
        oriented = light.kind == ORIENTED
        axis = mi.Frame3f(dr.select(dr.squared_norm(light.n) > 0, light.n, mi.Vector3f(0, 0, 1)))
        cos_cutoff = mi.Float(-1) if light.spot is None else light.spot[2]
        cone = mi.warp.square_to_uniform_cone(sample, cos_cutoff)
        way = axis.to_world(dr.select(oriented, mi.warp.square_to_cosine_hemisphere(sample), cone))
        aimed, ball, reach = self.lamps.choose(choice, active)
        to_ball = ball - light.p
        narrow = _narrow(sample, _opening(dr.squared_norm(to_ball), dr.square(reach)))
        direction = dr.select(aimed, mi.Frame3f(dr.normalize(to_ball)).to_world(narrow), way)
        cosine = dr.dot(direction, light.n)
        lambert = dr.maximum(cosine, 0)
        around = dr.select(dr.dot(direction, axis.n) >= cos_cutoff, dr.inv_two_pi / (1 - cos_cutoff), 0)
        shape = mi.Float(1) if light.spot is None else spot_falloff(light.spot, dr.dot(direction, axis.n))
        return (
            direction,
            dr.select(oriented, lambert * dr.inv_pi, around),
            dr.select(oriented, lambert, shape),
        )


@dr.syntax
def _part(ends, u) -> mi.UInt32:
    """Find the part that a number lies in: the first that ends behind it."""
    low, high = dr.zeros(mi.UInt32, dr.width(u)), dr.opaque(mi.UInt32, dr.width(ends) - 1)
    while dr.hint(low < high, label="pellucid parts"):
        middle = (low + high) >> 1
        behind = dr.gather(mi.UInt32, ends, middle) > u
        high = dr.select(behind, middle, high)
        low = dr.select(behind, low, middle + 1)
    return low


def _beside(way, axis) -> mi.Float:
    """Square the distance from an axis."""
    return dr.squared_norm(way - axis * dr.dot(way, axis))


def _through_disc(way, axis, radius2) -> mi.Float:
    """Evaluate the density of lines that pass a disc across them."""
    return dr.select(_beside(way, axis) < radius2, dr.inv_pi * dr.rcp(radius2), 0)


def _opening(distance2, radius2) -> mi.Float:
    """Evaluate one less the cosine of the cone that holds a ball; from within, of all directions."""
    sine2 = radius2 * dr.rcp(distance2)
    return dr.select(sine2 < 1, sine2 * dr.rcp(1 + dr.safe_sqrt(1 - sine2)), 2)


def _narrow(sample, opening) -> mi.Vector3f:
    """Choose a direction within a cone by one less its cosine: the cosine itself has no digits left where a ball is far away."""
    p = mi.warp.square_to_uniform_disk_concentric(sample)
    z = opening * dr.squared_norm(p)
    p *= dr.safe_sqrt(opening * (2 - z))
    return mi.Vector3f(p.x, p.y, 1 - z)


def _within_cone(way, axis, radius2) -> mi.Float:
    """Evaluate the density of directions that fill the cone around a ball: those that pass its centre near enough, as for discs."""
    opening = _opening(dr.squared_norm(way), radius2)
    within = (opening > 1) | ((dr.dot(way, axis) > 0) & (_beside(way, axis) < radius2))
    return dr.select(within, dr.inv_two_pi * dr.rcp(opening), 0)


def _sum_of_chances(packets, count, ray: mi.Ray3f, chance: Chance, lanes: mi.UInt32) -> mi.Float:
    """Sum, over all balls, the densities with which aims at them choose the rays of some lanes."""
    size = dr.width(lanes)
    lane, last = dr.arange(mi.UInt32, -(-size // LINES_PER_LANE)), dr.opaque(mi.UInt32, size - 1)
    index = [lane * LINES_PER_LANE + k for k in range(LINES_PER_LANE)]
    each = [dr.gather(mi.UInt32, lanes, dr.minimum(i, last)) for i in index]
    lines = [(dr.gather(mi.Point3f, ray.o, i), dr.gather(mi.Vector3f, ray.d, i)) for i in each]

    def add(number, totals):
        ball = dr.gather(mi.Array4f, packets, number)
        centre, radius2 = mi.Point3f(ball[0], ball[1], ball[2]), dr.square(ball[3])
        return number + 1, [t + chance(centre - o, d, radius2) for t, (o, d) in zip(totals, lines, strict=True)]

    nothing = dr.zeros(mi.UInt32, dr.width(lane)), [dr.zeros(mi.Float, dr.width(lane)) for _ in lines]
    totals = dr.while_loop(nothing, lambda number, _: number < count, add, label="pellucid aims")[1]
    dr.eval(totals)  # before they are scattered: or else each scatter would run the loop again
    total = dr.empty(mi.Float, size)
    for i, value in zip(index, totals, strict=True):
        dr.scatter(total, value, i, i <= last)
    return total


def _extent(sources: LightSamples, radius: float) -> NDArray[np.float64]:
    """Evaluate power over intensity: pi for what obeys the cosine law, the solid angle of a cone, the disc that a sky sees."""
    cone = 2 * np.pi * (1 - np.cos(sources.cutoff.astype(float)))
    return np.select([sources.kind == ORIENTED, sources.kind == DIRECTIONAL], [np.pi, np.pi * radius**2], cone)


def plan_emission(scene, sources: LightSamples, bounces: int, rng, receivers: Receivers | None) -> Emission:
    """Decide how photons are shared among lights, by power; with receivers, also by what reaches them.

    Paths go back from the receivers and are connected to lights wherever they meet a surface. What they find decides how
    photons are shared between the sky and lamps, and at which balls those of either aim: through a skylight, or at the
    surroundings of a small thing on a wide plane, where next to none would go by themselves. The choice among all balls
    is made up for in the flux of each photon (the balance heuristic), so the expected light is the same.
    """
    centre, radius = np.array(scene.bbox().center(), float), float(np.linalg.norm(scene.bbox().extents())) / 2
    extent, sky = _extent(sources, radius), sources.kind == DIRECTIONAL
    power = np.maximum(sources.intensity.mean(axis=1, dtype=float), 0) * extent
    records, above, around = to_device(sources), Aims.make(None), Aims.make(None)
    likely = power / power.sum()
    if receivers is not None:
        # Half of the connections go to the sky and half to lamps: where both are, and by their power among themselves.
        groups = [group for group in (sky, ~sky) if power[group].sum() > 0]
        fair = sum(np.where(group, power / power[group].sum(), 0) for group in groups) / len(groups)
        p, pick, found = _probe(scene, sources, records, fair, bounces, rng, receivers)
        shares = np.array([found[group[pick]].sum() for group in groups])
        if shares.sum() > 0:
            shares = np.maximum(shares / shares.sum(), RAREST)
            share = shares / shares.sum()
            likely = sum(fair * len(groups) * s * group for s, group in zip(share, groups, strict=True))
        above, around = (Aims.make(_balls(p[group[pick]], found[group[pick]], radius, rng)) for group in (sky, ~sky))
    rarity = upload(np.divide(1, likely, out=np.zeros_like(likely), where=likely > 0).astype(np.float32))
    ends = upload(np.minimum(np.cumsum(likely) * 2.0**32, 2**32 - 1).astype(np.uint32))
    shift = rng.integers(1 << 32, size=4).tolist()
    return Emission(records, ends, rarity, above, around, centre, radius, shift)


def _probe(scene, sources, records, fair, bounces: int, rng, receivers: Receivers):
    """Follow paths back from receivers; return where they met a light, which, and what it sends to the receivers."""
    cumulative = np.cumsum(fair)
    lanes = PROBES * bounces
    pick = np.searchsorted(cumulative, (np.arange(lanes) + rng.random()) / lanes * cumulative[-1], side="right")
    pick = rng.permutation(np.minimum(pick, len(fair) - 1)).astype(np.uint32)
    points, normals = (np.asarray(value, np.float32) for value in receivers)
    start = rng.integers(len(points), size=PROBES)
    si = dr.zeros(mi.SurfaceInteraction3f, PROBES)
    si.p, si.n = mi.Point3f(*columns(points[start])), mi.Normal3f(*columns(normals[start]))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, int(rng.integers(1 << 31))), PROBES)
    p, worth = _connect(scene, sampler, records, upload(pick), si, bounces)
    found = worth.numpy() / np.maximum(fair[pick], 1e-300)
    met = found > 0
    return rows(p)[met], pick[met], found[met]


@dr.syntax
def _connect(scene, sampler, records, picks, si, bounces: int):
    """Trace the paths of `_probe`: where each of their vertices is, and the light that one light sends along the path."""
    size = dr.width(si) * bounces
    p, worth = dr.zeros(mi.Point3f, size), dr.zeros(mi.Float, size)
    slot = dr.arange(mi.UInt32, dr.width(si)) * dr.opaque(mi.UInt32, bounces)
    end = slot + dr.opaque(mi.UInt32, bounces)
    ctx = mi.BSDFContext()
    ray = si.spawn_ray(mi.Frame3f(si.n).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d())))
    throughput, active = mi.Color3f(1), mi.Bool(True)
    while dr.hint(active, label="pellucid probes"):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        side = dr.sign(si.wi.z)
        pick = dr.gather(mi.UInt32, picks, slot, active)
        direction, distance, light = records.arriving(pick, si.p, si.sh_frame.n * side, active)
        cosine = dr.maximum(dr.abs(dr.dot(direction, si.sh_frame.n)), 1e-6)
        lit = active & (dr.max(light) > 0)
        value = throughput * light * bsdf.eval(ctx, si, si.to_local(direction), lit) / cosine
        lit &= visible(scene, si, direction, distance, lit & (dr.max(value) > 0))
        dr.scatter(p, si.p, slot, lit)
        dr.scatter(worth, dr.sum(value) / 3, slot, lit)
        sample, weight = bsdf.sample(ctx, si, sampler.next_1d(active), sampler.next_2d(active), active)
        ray = si.spawn_ray(si.to_world(sample.wo))
        throughput *= weight
        slot += 1
        active &= (slot < end) & (dr.max(throughput) > 0)
    return p, worth


def _balls(p: NDArray, worth: NDArray, radius: float, rng) -> NDArray[np.float32] | None:
    """Choose balls around the points where most light was found: ``(k, 4) float32``, or None without a point.

    They overlap a few times, and every other one is four times as wide: what lies just beside them is not missed.
    """
    if not len(p):
        return None
    steps = (np.arange(AIMS) + rng.random()) / AIMS * worth.sum()
    chosen = p[np.unique(np.minimum(np.searchsorted(np.cumsum(worth), steps), len(p) - 1))]
    neighbours = min(AIM_NEIGHBOURS + 1, len(chosen))
    reach = cKDTree(chosen).query(chosen, [neighbours])[0][:, 0].clip(1e-3 * radius, radius)
    reach[1::2] = np.minimum(4 * reach[1::2], radius)
    return np.concatenate([chosen, reach[:, None]], axis=1).astype(np.float32)
