"""The emitters of a Mitsuba scene as point lights, and the photons that start at them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..errors import PellucidWarning
from ..memory import rows
from ..scene.sampling_draw import to_world_frame
from .light_samples import (
    DIRECTIONAL,
    OMNI,
    ORIENTED,
    LightRecords,
    LightSamples,
    columns,
    spot_falloff,
    to_device,
    upload,
    visible,
)

FEWEST = 64
"""Points of an emitter with an extent, however many there are."""

PROBES, AIMS, AIM_NEIGHBOURS = 1 << 15, 512, 8
"""Paths back from the receivers, discs that they find for the photons of a sky to aim at, and neighbours in their radius."""

LINES_PER_LANE = 8
"""Photons whose chances to aim at a disc one lane sums up: to fetch a disc takes longer than to look at it from one line."""

UNAIMED, RAREST = 0.2, 0.1
"""Part of the photons of a sky that is spread over all of the scene, and the least part for sky or lamps."""

KRONECKER = [int(2**32 * x) for x in (*(1.22074408460575947536**-k for k in (1, 2, 3)), (3 - 5**0.5) / 2)]
"""Multiples of these fractions of 2^32 fill three dimensions evenly, however many there are (Roberts 2018); and one more."""

Receivers = tuple[ArrayLike, ArrayLike]
"""Points that are to be lit and their normals, ``(m, 3) float`` both."""


def find_emitters(scene: mi.Scene) -> list[mi.Emitter]:
    """List the emitters of a scene that point lights can stand for.

    Warns
    -----
    PellucidWarning
        For each of the others.
    """
    found = []
    for emitter in scene.emitters():
        if builder_of(emitter) is not None:
            found.append(emitter)
            continue
        warnings.warn(
            f"The emitter '{emitter.id()}' ({emitter.class_name()}) cannot be turned into point lights and is left out: "
            "use another emitter, or another integrator.",
            PellucidWarning,
            stacklevel=3,
        )
    return found


def discretise_emitters(scene: mi.Scene, emitters: list[mi.Emitter], direct: int, seed: int) -> LightSamples:
    """Turn emitters into point lights.

    A point, a spot and a directional light become one light each, exactly. An area light becomes points on its shape,
    ``I = L dA``. Whatever shines from infinitely far away becomes directions, sampled by its radiance: the sum of their
    intensities is unbiased, and exact where the radiance is constant.

    Parameters
    ----------
    emitters : list of Emitter
        Of those that `find_emitters` lists.
    direct : int
        Points that the emitters with an extent share evenly, at least ``FEWEST`` each.

    Source: AWB08 section 4.1.
    """
    builders = [(emitter, builder_of(emitter)) for emitter in emitters]
    extended = sum(has_extent(emitter) for emitter in emitters)
    share = max(FEWEST, direct // max(extended, 1))
    centre = np.array(scene.bbox().center()) if scene.bbox().valid() else np.zeros(3)
    parts = []
    for number, (emitter, build) in enumerate(builders):
        assert build is not None
        lights = build(emitter, share, seed + number, centre)
        parts.append(lights.take(np.any(lights.intensity != 0, axis=1)))
    return LightSamples.join(parts)


Builder = Callable[..., LightSamples]


def builder_of(emitter: mi.Emitter) -> Builder | None:
    """Choose what turns an emitter into point lights; None if nothing can."""
    if emitter.is_environment():
        return _environment
    textured = bool(emitter.flags() & mi.EmitterFlags.SpatiallyVarying)
    return {
        "AreaLight": _area,
        "DirectionalEmitter": _directional,
        "PointLight": _point,
        "SpotLight": None if textured else _spot,
    }.get(emitter.class_name())


def has_extent(emitter: mi.Emitter) -> bool:
    """Tell whether many point lights stand for an emitter, not one."""
    return builder_of(emitter) in (_area, _environment)


def _area(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    """Points on the shape of an area light, where its texture is bright; each is as bright as its part of the surface.

    ``near2 = dA / pi`` keeps its irradiance below the radiosity ``pi L`` of that part.
    """
    ps, _ = emitter.sample_position(0.0, low_discrepancy(count, seed))
    shape = emitter.get_shape()
    if shape.class_name() == "Sphere":  # of a turned one Mitsuba turns the points, and forgets their normals
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        ps.n = to_world_frame(ps.p, ps.n, matrix)[1]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p, si.n, si.uv, si.sh_frame, si.wi = ps.p, ps.n, ps.uv, mi.Frame3f(ps.n), mi.Vector3f(0, 0, 1)
    area = dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0) / dr.opaque(mi.Float, count)
    light = mi.Color3f(emitter.eval(si)) * area
    return LightSamples.make(
        ORIENTED, rows(si.spawn_ray(mi.Vector3f(ps.n)).o), rows(ps.n), rows(light), area.numpy() / np.pi
    )


def _environment(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    """Directions of a sky, where it is bright."""
    ds, weight = emitter.sample_direction(_at(centre, count), low_discrepancy(count, seed))
    return LightSamples.make(DIRECTIONAL, 0, rows(ds.d), rows(weight) / count)


def _directional(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    ds, weight = emitter.sample_direction(_at(centre), mi.Point2f(0.5))
    return LightSamples.make(DIRECTIONAL, 0, rows(ds.d), rows(weight))


def _point(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    position = rows(emitter.sample_direction(_at(centre), mi.Point2f(0.5))[0].p)
    return LightSamples.make(OMNI, position, 0, _intensity(emitter, position[0], np.array([0, 0, 1])))


def _spot(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    position = rows(emitter.sample_direction(_at(centre), mi.Point2f(0.5))[0].p)
    axis = rows(emitter.world_transform() @ mi.Vector3f(0, 0, 1))[0]
    axis /= np.linalg.norm(axis)
    found = mi.traverse(emitter)
    cutoff, beam = (float(np.deg2rad(np.ravel(found[key])[0])) for key in ("cutoff_angle", "beam_width"))
    return LightSamples.make(
        OMNI, position, axis, _intensity(emitter, position[0], axis), cutoff=cutoff, beam=min(beam, cutoff)
    )


def _intensity(emitter: mi.Emitter, position: NDArray, axis: NDArray) -> NDArray[np.float32]:
    """Measure the intensity of a point light along an axis: ``(1, 3) float32`` [W/sr]."""
    reach = 1 + float(np.abs(position).max())  # far enough that the difference of positions keeps its digits
    ds, weight = emitter.sample_direction(_at(position + reach * axis), mi.Point2f(0.5))
    return rows(weight * dr.square(ds.dist))


def _at(p: NDArray, count: int = 1) -> mi.Interaction3f:
    """Stand at a point."""
    it = dr.zeros(mi.SurfaceInteraction3f, count)
    it.p = mi.Point3f(*(dr.opaque(mi.Float, float(x), count) for x in p))
    return it


def low_discrepancy(count: int, seed: int) -> mi.Point2f:
    """Place ``count`` numbers evenly over the unit square: Hammersley's set, shifted at random."""
    shift = np.random.default_rng(seed).random(2)
    index = np.arange(count)
    x = (index + shift[0]) / count
    mirrored = dr.brev(mi.UInt32(index)).numpy() * 2.0**-32
    return mi.Point2f(*columns(np.stack([x, (mirrored + shift[1]) % 1], axis=1)))


# ---------------------------------------------------------------------- photons


@dataclass
class Emission:
    """How photons are shared among lights, and where those of a sky aim at; see `plan_emission`."""

    records: LightRecords
    ends: mi.UInt32
    """Where the part of each light ends if all make up 2^32 by their probabilities."""
    weight: mi.Float
    """Power over intensity and probability of each light."""
    aims: Any
    """Centre and radius of each disc, packed; None for none."""
    aim_count: int
    centre: NDArray[np.float64]
    radius: float
    """A sphere around the scene."""
    shift: list[int]
    """Where the numbers that choose a photon begin, of 2^32."""

    def photons(self, first: int, size: int) -> tuple[mi.Ray3f, mi.Color3f]:
        """Start photons number ``first`` and following: rays, and flux [W times the number of all photons]."""
        number = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
        u = [dr.opaque(mi.UInt32, shift) + number * step for shift, step in zip(self.shift, KRONECKER, strict=True)]
        pick = _part(self.ends, u[0])
        x, y, choice = (mi.Float(value >> 8) * 2.0**-24 for value in u[1:])
        ray, directional, flux = _emit(self.records, pick, mi.Point2f(x, y))
        start, density = self._above(-ray.d, choice, mi.Point2f(x, y))
        ray.o = dr.select(directional, start, ray.o)
        return ray, flux * dr.gather(mi.Float, self.weight, pick) * dr.select(directional, dr.rcp(density), 1)

    def _above(self, to_light, choice, sample) -> tuple[mi.Point3f, mi.Float]:
        """Choose where light from infinity passes: a point outside the scene, and its density times the scene's disc."""
        centre = mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in self.centre))
        radius = dr.opaque(mi.Float, self.radius)
        middle, reach = mi.Point3f(centre), mi.Float(radius)
        count = dr.opaque(mi.UInt32, self.aim_count)
        if self.aims is not None:
            aim = mi.UInt32(dr.maximum(choice - UNAIMED, 0) / (1 - UNAIMED) * mi.Float(count))
            aimed = choice >= UNAIMED
            disc = dr.gather(mi.Array4f, self.aims, dr.minimum(aim, count - 1), aimed)
            middle = dr.select(aimed, mi.Point3f(disc[0], disc[1], disc[2]), centre)
            reach = dr.select(aimed, disc[3], radius)
        offset = mi.warp.square_to_uniform_disk_concentric(sample) * reach
        passing = middle + mi.Frame3f(to_light).to_world(mi.Vector3f(offset.x, offset.y, 0))
        start = passing + to_light * (radius - dr.dot(passing - centre, to_light))
        if self.aims is None:
            return start, mi.Float(1)
        aimed_density = _density(self.aims, count, start, to_light) / mi.Float(count)
        everywhere = dr.select(_beside(start - centre, to_light) < dr.square(radius), UNAIMED, 0)
        return start, dr.fma((1 - UNAIMED) * dr.square(radius), aimed_density, everywhere)


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


def _density(aims, count, p, axis) -> mi.Float:
    """Sum, over the discs that lines pass, the reciprocals of their squared radii."""
    dr.eval(p, axis)  # at once: each gather would do so by itself
    size = dr.width(p)
    lane, last = dr.arange(mi.UInt32, -(-size // LINES_PER_LANE)), dr.opaque(mi.UInt32, size - 1)
    index = [lane * LINES_PER_LANE + k for k in range(LINES_PER_LANE)]
    lines = [[dr.gather(type(value), value, dr.minimum(i, last)) for value in (p, axis)] for i in index]

    def add(number, totals):
        disc = dr.gather(mi.Array4f, aims, number)
        radius2 = dr.square(disc[3])
        away = [_beside(place - mi.Point3f(disc[0], disc[1], disc[2]), way) for place, way in lines]
        part = dr.rcp(radius2)
        return number + 1, [total + dr.select(d2 < radius2, part, 0) for total, d2 in zip(totals, away, strict=True)]

    nothing = dr.zeros(mi.UInt32, dr.width(lane)), [dr.zeros(mi.Float, dr.width(lane)) for _ in lines]
    totals = dr.while_loop(nothing, lambda number, _: number < count, add, label="pellucid aims")[1]
    dr.eval(totals)  # before they are scattered: or else each scatter would run the loop again
    density = dr.empty(mi.Float, size)
    for i, total in zip(index, totals, strict=True):
        dr.scatter(density, total, i, i <= last)
    return density


def _emit(records: LightRecords, index, sample) -> tuple[mi.Ray3f, mi.Bool, mi.Color3f]:
    """Start photons at lights: ray, whether the light is infinitely far away, intensity relative to how rays are spread."""
    light = records.fetch(index)
    oriented, directional = light.kind == ORIENTED, light.kind == DIRECTIONAL
    axis = dr.select(dr.squared_norm(light.n) > 0, light.n, mi.Vector3f(0, 0, 1))
    cone = mi.warp.square_to_uniform_cone(sample, mi.Float(-1) if light.spot is None else light.spot[2])
    falloff = mi.Float(1)
    if light.spot is not None:
        falloff = dr.select(oriented | directional, 1, spot_falloff(light.spot, cone.z))
    way = dr.select(oriented, mi.warp.square_to_cosine_hemisphere(sample), cone)
    direction = dr.select(directional, -light.n, mi.Frame3f(axis).to_world(way))
    return mi.Ray3f(mi.Point3f(light.p), direction), directional, light.intensity * falloff


def _extent(sources: LightSamples, radius: float) -> NDArray[np.float64]:
    """Evaluate power over intensity: pi for what obeys the cosine law, the solid angle of a cone, the disc that a sky sees."""
    cone = 2 * np.pi * (1 - np.cos(sources.cutoff.astype(float)))
    return np.select([sources.kind == ORIENTED, sources.kind == DIRECTIONAL], [np.pi, np.pi * radius**2], cone)


def plan_emission(scene, sources: LightSamples, bounces: int, rng, receivers: Receivers | None) -> Emission:
    """Decide how photons are shared among lights, by power; with receivers, also by what reaches them.

    Paths go back from the receivers and are connected to lights wherever they meet a surface. What they find decides how
    photons are shared between the sky and lamps, and at which discs those of the sky aim: through a skylight, or at the
    surroundings of a small thing on a wide plane, where next to none would go by themselves. The choice among all discs
    is made up for in the flux of each photon (the balance heuristic), so the expected light is the same.
    """
    centre, radius = np.array(scene.bbox().center(), float), float(np.linalg.norm(scene.bbox().extents())) / 2
    extent, sky = _extent(sources, radius), sources.kind == DIRECTIONAL
    power = np.maximum(sources.intensity.mean(axis=1, dtype=float), 0) * extent
    records, aims = to_device(sources), None
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
        aims = _aims(p[sky[pick]], found[sky[pick]], radius, rng)
    count = 0 if aims is None else len(aims)
    weight = upload(np.divide(extent, likely, out=np.zeros_like(extent), where=likely > 0).astype(np.float32))
    ends = upload(np.minimum(np.cumsum(likely) * 2.0**32, 2**32 - 1).astype(np.uint32))
    packed = None if aims is None else upload(aims)
    shift = rng.integers(1 << 32, size=4).tolist()
    return Emission(records, ends, weight, packed, count, centre, radius, shift)


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


def _aims(p: NDArray, worth: NDArray, radius: float, rng) -> NDArray[np.float32] | None:
    """Choose discs around the points where most light was found: ``(k, 4) float32``, or None without a point.

    Discs overlap a few times, and every other one is four times as wide: what lies just beside them is not missed.
    """
    if not len(p):
        return None
    steps = (np.arange(AIMS) + rng.random()) / AIMS * worth.sum()
    chosen = p[np.unique(np.minimum(np.searchsorted(np.cumsum(worth), steps), len(p) - 1))]
    neighbours = min(AIM_NEIGHBOURS + 1, len(chosen))
    reach = cKDTree(chosen).query(chosen, [neighbours])[0][:, 0].clip(1e-3 * radius, radius)
    reach[1::2] = np.minimum(4 * reach[1::2], radius)
    return np.concatenate([chosen, reach[:, None]], axis=1).astype(np.float32)
