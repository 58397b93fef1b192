"""Virtual point lights: what a scene reflects diffusely, as oriented lights where photons have hit (instant radiosity)."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...effort import count as count_effort
from ...kernels.memory import columns, lanes_where, rows, upload
from ...kernels.morton import morton_codes
from ...progress import chunks, steps
from .emission import Receivers, plan_emission
from .records import DIRECTIONAL, ORIENTED, LightRecords, LightSamples, oriented, visible

USEFUL_PER_LIGHT, HITS_PER_LIGHT = 2, 16
"""Hits to choose each light from: that are of use to receivers, or of any kind where none are known."""

FIRST_PHOTONS, MOST_PHOTONS, FEWEST_LIGHTS = 4, 32, 1 << 14
"""Photons a light that tell how many are needed, and at most, where few of their hits are useful; as if there were so many lights
at least, since photons leave noise of their own."""

MOST_BOUNCES = 32
HITS_AT_ONCE = 1 << 23
"""Hits that have room at once (36 bytes each). To describe a scene of many instances to a kernel takes longer than to follow photons
through it, so there are few launches."""

TESTS, BLOCK = 4, 32
"""Receivers that a light is tested against, and lights that are judged together: 128 shadow rays for each."""

FEWER = 4
"""One in so many hits that no test has found useful is kept."""

FLOOR = 0.1
"""The part of the lights that is chosen by strength alone: what no test has found is at most ten times too strong."""

NEIGHBOURS = 16
"""Lights from which the radiosity around one of them is estimated."""


def virtual_lights(
    scene: mi.Scene,
    sources: LightSamples,
    count: int,
    max_depth: int,
    seed: int,
    receivers: Receivers | None = None,
) -> LightSamples:
    """Follow photons from lights and leave an oriented light wherever one is reflected diffusely.

    A photon of flux ``phi`` at a surface of albedo ``rho`` leaves ``I = phi rho / pi``, on the side that was hit. More hits
    are collected than lights are asked for; of them lights are drawn, each at most once, with a probability in proportion to
    their power times what a unit of it sends to some receivers, and ``I`` is divided by it: the expected light is the same,
    whatever the receivers are. Mirrors and glass only redirect photons, and translucent materials do what their role says.

    Parameters
    ----------
    sources : LightSamples
        Where photons start.
    count : int
        Lights to draw.
    max_depth : int
        As for the paths of `gather_irradiance`: 2 is direct light, for which there are no virtual lights.
    receivers : (m, 3) float, (m, 3) float
        Points that are to be lit, and their normals; without them power alone counts.

    Source: Keller, *Instant Radiosity*, 1997; the light samples of AWB08 section 4.1.
    """
    bounces = min(max_depth - 2, MOST_BOUNCES)
    if count < 1 or bounces < 1 or not len(sources) or not scene.bbox().valid():
        return LightSamples.none()
    rng = np.random.default_rng(seed)
    hits, sent, photons = _collect(scene, sources, count, bounces, rng, receivers)
    lights = draw(hits, sent, count, rng)
    lights.intensity /= photons
    lights.near2[:] = _near_field(lights)
    return lights


def draw(lights: LightSamples, sent: NDArray, count: int, rng) -> LightSamples:
    """Draw some of many lights, with a probability in proportion to what they send to receivers, as far as it is known.

    A light that was drawn stands for others: it is divided by the probability that it had; what sends most is drawn for certain, and
    stands for itself. Neighbours share what they send by unit of strength, since each was tested a few times only; the draw is
    even along their order in space.

    Parameters
    ----------
    sent : (n,) float
        Estimates of the irradiance that each light gives to the mean receiver.
    count : int
        How many to draw.
    """
    if len(lights) <= count:
        return lights
    order, block = _blocks(lights)
    lights, sent = lights.take(order), sent[order]
    strength = np.maximum(lights.intensity.mean(axis=1, dtype=float), 0)
    worth = np.bincount(block, sent) / np.maximum(np.bincount(block, strength), 1e-300)
    usual = (np.bincount(lights.kind, strength) / np.maximum(np.bincount(lights.kind), 1))[lights.kind]
    weight = strength * worth[block] + FLOOR * (sent.mean() or 1.0) * strength / np.maximum(usual, 1e-300)
    if not weight.sum() > 0:
        return LightSamples.none()
    expected = _probabilities(weight, count)
    drawn = np.diff(np.floor(np.cumsum(expected) + rng.random()), prepend=0.0)
    chosen = np.flatnonzero(drawn)
    factor = drawn[chosen] / expected[chosen]
    result = lights.take(chosen)
    result.intensity *= factor[:, None]
    result.near2 *= factor  # as the area that it stands for
    return result


def _probabilities(weight: NDArray, count: int) -> NDArray[np.float64]:
    """Give the probabilities with which ``count`` are drawn in the mean: in proportion to weights, and 1 for the heaviest."""
    heaviest = np.sort(weight)[::-1]
    certain = np.arange(min(count, len(weight)))
    rest = np.cumsum(heaviest[::-1])[::-1][: len(certain)]  # what those weigh that are not certain, if so many are
    scale = (count - certain) / np.maximum(rest, 1e-300)
    return np.minimum(weight * scale[np.argmax(heaviest[: len(certain)] * scale <= 1)], 1)


def sent_to(scene: mi.Scene, lights: LightRecords, count: int, receivers: Receivers, rng) -> NDArray[np.float64]:
    """Estimate the irradiance that each of ``count`` lights gives to the mean receiver, from few of them: ``(n,) float``."""
    if not count:
        return np.zeros(0)
    points, normals = receivers
    pick = upload(rng.integers(len(np.asarray(points)), size=count * TESTS, dtype=np.uint32))
    si = dr.zeros(mi.SurfaceInteraction3f, count * TESTS)
    si.p = dr.gather(mi.Point3f, mi.Point3f(*columns(points)), pick)
    si.n = dr.gather(mi.Normal3f, mi.Normal3f(*columns(normals)), pick)
    index = dr.arange(mi.UInt32, count * TESTS) // TESTS
    direction, distance, light = lights.arriving(index, si.p, mi.Vector3f(si.n), True)
    falling = dr.sum(light) / 3  # a kernel of dr.mean serves one width only
    count_effort("light rays", mi.UInt32(falling > 0))
    falling = dr.select(visible(scene, si, direction, distance, falling > 0), falling, 0)
    return (falling.numpy().reshape(count, TESTS) @ np.full(TESTS, 1 / TESTS, np.float32)).astype(float)


def _collect(
    scene, sources: LightSamples, count: int, bounces: int, rng, receivers
) -> tuple[LightSamples, NDArray, int]:
    """Trace as many photons as the first of them tell are needed; return their hits as lights, what these send, and their number."""
    emission = plan_emission(scene, sources, bounces, rng, receivers)
    lights = max(count, FEWEST_LIGHTS)
    first, most = FIRST_PHOTONS * lights, MOST_PHOTONS * lights
    found: list[LightSamples] = []
    sent: list[NDArray] = []

    def follow(begin: int, end: int) -> None:
        for number, size in steps("virtual lights", chunks(end - begin, HITS_AT_ONCE // bounces), "photons"):
            ray, flux = emission.photons(begin + number, size)
            hits, worth = _hits(scene, ray, flux, bounces, rng, receivers)
            found.append(hits)
            sent.append(worth)

    follow(0, first)
    useful = sum(int(np.count_nonzero(worth)) for worth in sent)
    enough = lights * (HITS_PER_LIGHT if receivers is None else USEFUL_PER_LIGHT)
    photons = min(max(math.ceil(first * enough / max(useful, 1)), first), most)
    if photons > first:
        follow(first, photons)
    return LightSamples.join(found), np.concatenate(sent), photons


def _hits(
    scene, ray: mi.Ray3f, flux: mi.Color3f, bounces: int, rng, receivers
) -> tuple[LightSamples, NDArray[np.float64]]:
    """Follow photons: where they hit as lights, and what these send."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, int(rng.integers(1 << 31))), dr.width(ray))
    p, n, power = _follow(scene, sampler, ray, flux, bounces)
    real = lanes_where(dr.max(power) > 0)  # most of the room stays empty
    p, n, intensity = (dr.gather(type(value), value, real) for value in (p, n, power * dr.inv_pi))
    dr.eval(p, n, intensity)
    del power  # tests take its memory
    count = dr.width(real)
    if not count:  # there is nothing to meet, or nothing that reflects
        return LightSamples.none(), np.zeros(0)
    near2 = 1e-6 * float(np.sum(np.square(scene.bbox().extents())))  # tames the few that lie next to a receiver
    stands_for = np.ones(count, np.float32)
    if receivers is None:
        worth = rows(intensity).mean(axis=1, dtype=float)
    else:
        worth = sent_to(scene, oriented(p, n, intensity, near2), count, receivers, rng)
        # Most are of no use as far as is known: some of them stand for all.
        stands_for[worth == 0] = FEWER
        kept = (worth > 0) | (np.arange(count) % FEWER == rng.integers(FEWER))
        index = upload(np.flatnonzero(kept).astype(np.uint32))
        p, n, intensity = (dr.gather(type(value), value, index) for value in (p, n, intensity))
        worth, stands_for = worth[kept], stands_for[kept]
    light = rows(intensity) * stands_for[:, None]
    return LightSamples.make(ORIENTED, rows(p), rows(n), light, near2, indirect=True), worth


@dr.syntax
def _follow(scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, flux: mi.Color3f, bounces: int):
    """Follow photons; return position, normal and reflected power of ``bounces`` hits each, without power if there is none.

    Surfaces with vertex normals are lit as if they were smooth, but photons see their facets: the factors of the cosines
    turn one into the other (Veach 1997, section 5.3).
    """
    size = dr.width(ray) * bounces
    p, n, power = dr.empty(mi.Point3f, size), dr.empty(mi.Normal3f, size), dr.zeros(mi.Color3f, size)
    diffuse, every = mi.BSDFContext(), mi.BSDFContext(mi.TransportMode.Importance)
    diffuse.type_mask = mi.BSDFFlags.DiffuseReflection
    slot = dr.arange(mi.UInt32, dr.width(ray)) * dr.opaque(mi.UInt32, bounces)
    end = slot + dr.opaque(mi.UInt32, bounces)
    ray, flux = mi.Ray3f(ray), mi.Color3f(flux)
    active = dr.max(flux) > 0

    while dr.hint(active, label="pellucid photons"):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        facet = dr.mulsign(
            mi.Vector3f(si.n), dr.dot(si.n, si.sh_frame.n)
        )  # faces may be wound against their vertex normals
        facing = -dr.dot(ray.d, facet)
        side = dr.sign(facing)
        smooth = dr.abs(si.wi.z) / dr.maximum(dr.abs(facing), 1e-4)
        active &= si.wi.z * facing > 0

        # ---------------------- The light that stays ----------------------
        wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        wo.z *= side
        lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseReflection)
        albedo = bsdf.eval(diffuse, si, wo, lit) * (dr.pi / dr.abs(wo.z))
        normal = facet * side
        dr.scatter(p, si.spawn_ray(normal).o, slot, lit)
        dr.scatter(n, mi.Normal3f(normal), slot, lit)
        dr.scatter(power, flux * albedo * smooth, slot, lit)

        # ---------------------- The next direction ----------------------
        sample, weight = bsdf.sample(every, si, sampler.next_1d(active), sampler.next_2d(active), active)
        ray = si.spawn_ray(si.to_world(sample.wo))
        leaving = dr.dot(ray.d, facet)
        active &= leaving * sample.wo.z > 0
        weight *= smooth * dr.abs(leaving) / dr.maximum(dr.abs(sample.wo.z), 1e-6)

        # ---------------------- Russian roulette ----------------------
        before = dr.max(flux)
        flux *= weight
        survival = dr.minimum(dr.max(flux) / before, 1)
        active &= sampler.next_1d(active) < survival
        flux *= dr.rcp(survival)
        slot += 1
        active &= slot < end

    return p, n, power


def _blocks(lights: LightSamples) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Order lights along a Morton curve, those of each of six directions by themselves; return the order and block numbers."""
    low, high = lights.p.min(axis=0), lights.p.max(axis=0)
    place = (lights.p - low) / max(float((high - low).max()), 1e-30)
    directional = lights.kind == DIRECTIONAL
    place[directional] = 0.5 + 0.5 * lights.n[directional]
    axis = np.abs(lights.n).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(lights.n, axis[:, None], 1)[:, 0] > 0) + 6 * directional
    # The last octal digit of the place makes room for the direction.
    code = face.astype(np.uint64) << np.uint64(60) | morton_codes(place) >> np.uint64(3)
    order = np.argsort(code, kind="stable")
    return order, np.arange(len(order)) // BLOCK


def _near_field(lights: LightSamples) -> NDArray[np.float64]:
    """Choose ``near2`` so that no light sends more than the radiosity of the surface it stands for: ``near2 = I / B``.

    ``pi B`` is the intensity of the nearest lights that face the same way, over the disc that they fill.
    """
    if not len(lights):
        return np.zeros(0)
    p, n, strength = lights.p, lights.n, lights.intensity.mean(axis=1, dtype=float)
    neighbours = min(NEIGHBOURS, len(p))
    # Faster than the default for so many neighbours.
    tree = cKDTree(p, leafsize=32, balanced_tree=False, compact_nodes=False)
    distance, index = tree.query(p, neighbours, workers=-1)
    distance, index = distance.reshape(len(p), neighbours), index.reshape(len(p), neighbours)
    alike = np.einsum("ijk,ik->ij", n[index], n) > 0.5
    around = np.sum(np.where(alike, strength[index], 0), axis=1)
    return strength / np.maximum(around, 1e-300) * distance[:, -1] ** 2
