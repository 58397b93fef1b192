"""Virtual point lights: what a scene reflects diffusely, as oriented lights where photons have hit (instant radiosity)."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..progress import chunks, steps
from .emitters import Receivers, plan_emission, rows
from .light_samples import ORIENTED, LightSamples

HITS_PER_LIGHT = 4
"""Useful hits to choose each light from."""

PHOTONS_PER_LIGHT = 64
"""Photons a light at most, where few of their hits are useful."""

MOST_BOUNCES = 32
SLOTS = 1 << 21
"""Hits that have room at once (36 bytes each)."""

TESTS, BLOCK = 4, 32
"""Receivers that a hit is tested against, and hits that are judged together: 128 shadow rays for each."""

FLOOR = 0.1
"""The part of the lights that is chosen by flux alone: no light is more than ten times as strong as without receivers."""

NEIGHBOURS = 16
"""Lights from which the radiosity around one of them is estimated."""


@dataclass
class Hits:
    """Photons on diffuse surfaces: position, normal, reflected power [W times photons], and what a unit of it is worth."""

    p: NDArray[np.float32]
    n: NDArray[np.float32]
    power: NDArray[np.float32]
    worth: NDArray[np.float64]


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
    are collected than lights are asked for; of them lights are drawn with a probability ``q`` in proportion to their power
    times what a unit of it sends to some receivers, and ``I`` is divided by ``count q``: the expected light is the same,
    whatever the receivers are. Mirrors and glass only redirect photons, and translucent materials do what their role says.

    Parameters
    ----------
    sources : LightSamples
        Where photons start.
    count : int
        Lights to draw; the same hit drawn again is one stronger light.
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
    hits, photons = _collect(scene, sources, count, bounces, rng, receivers)
    strength = hits.power.mean(axis=1, dtype=float)
    order, block = _blocks(hits)
    worth = (_block_mean(hits.worth[order], strength[order], block) + FLOOR * _mean(hits.worth, strength)) * strength[
        order
    ]
    if not worth.sum() > 0:
        return LightSamples.none()
    chosen, factor = _resample(worth, count, rng)
    chosen = order[chosen]
    intensity = hits.power[chosen] * (factor[:, None] / (np.pi * photons))
    near2 = _near_field(hits.p[chosen], hits.n[chosen], intensity.mean(axis=1))
    return LightSamples.make(ORIENTED, hits.p[chosen], hits.n[chosen], intensity, near2, indirect=True)


def _collect(scene, sources: LightSamples, count: int, bounces: int, rng, receivers) -> tuple[Hits, int]:
    """Trace photons until enough of their hits are useful; return the hits and the number of photons."""
    emission = plan_emission(scene, sources, bounces, rng, receivers)
    sampler = mi.load_dict({"type": "independent"})
    found, photons, useful = [], 0, 0
    sizes = chunks(PHOTONS_PER_LIGHT * count, min(SLOTS // bounces, 2 * count))
    for first, size in steps("virtual lights", sizes, "photons"):
        ray, flux = emission.photons(first, size)
        sampler.seed(int(rng.integers(1 << 31)), size)
        p, n, power = (rows(value) for value in _follow(scene, sampler, ray, flux, bounces))
        real = np.any(power > 0, axis=1)
        p, n, power = p[real], n[real], power[real]
        worth = _worth(scene, p, n, receivers, rng)
        found.append(Hits(p, n, power, worth))
        photons += size
        useful += int(np.count_nonzero(worth))
        if useful >= HITS_PER_LIGHT * count:
            break
    return Hits(*(np.concatenate([getattr(h, key) for h in found]) for key in ("p", "n", "power", "worth"))), photons


@dr.syntax
def _follow(scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f, flux: mi.Color3f, bounces: int):
    """Follow photons; return position, normal and reflected power of ``bounces`` hits each, without power if there is none.

    Surfaces with vertex normals are lit as if they were smooth, but photons see their facets: the factors of the cosines
    turn one into the other (Veach 1997, section 5.3).
    """
    size = dr.width(ray) * bounces
    p, n, power = dr.zeros(mi.Point3f, size), dr.zeros(mi.Normal3f, size), dr.zeros(mi.Color3f, size)
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
        facing = -dr.dot(ray.d, si.n)
        side = dr.sign(facing)
        smooth = dr.abs(si.wi.z) / dr.maximum(dr.abs(facing), 1e-4)
        active &= si.wi.z * facing > 0

        # ---------------------- The light that stays ----------------------
        wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        wo.z *= side
        lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.DiffuseReflection)
        albedo = bsdf.eval(diffuse, si, wo, lit) * (dr.pi / dr.abs(wo.z))
        normal = mi.Vector3f(si.n) * side
        dr.scatter(p, si.spawn_ray(normal).o, slot, lit)
        dr.scatter(n, mi.Normal3f(normal), slot, lit)
        dr.scatter(power, flux * albedo * smooth, slot, lit)

        # ---------------------- The next direction ----------------------
        sample, weight = bsdf.sample(every, si, sampler.next_1d(active), sampler.next_2d(active), active)
        ray = si.spawn_ray(si.to_world(sample.wo))
        leaving = dr.dot(ray.d, si.n)
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


def _worth(scene, p: NDArray, n: NDArray, receivers, rng) -> NDArray[np.float64]:
    """Estimate the irradiance that a unit of power from each hit gives to the mean receiver, from few of them; or one."""
    count = len(p)
    if receivers is None or not count:
        return np.ones(count)
    points, normals = (np.ascontiguousarray(np.asarray(value, np.float32).T) for value in receivers)
    reach2 = float(np.sum(np.square(scene.bbox().extents()))) * 1e-6
    place, normal = mi.Point3f(np.ascontiguousarray(p.T)), mi.Vector3f(np.ascontiguousarray(n.T))
    pick = mi.UInt32(rng.integers(points.shape[1], size=count * TESTS))
    light = dr.arange(mi.UInt32, count * TESTS) // TESTS
    place, normal = dr.gather(mi.Point3f, place, light), dr.gather(mi.Vector3f, normal, light)
    way = dr.gather(mi.Point3f, mi.Point3f(points), pick) - place
    d2 = dr.maximum(dr.squared_norm(way), dr.smallest(mi.Float))
    direction = way * dr.rsqrt(d2)
    facing = -dr.dot(direction, dr.gather(mi.Vector3f, mi.Vector3f(normals), pick))
    factor = (
        dr.maximum(dr.dot(direction, normal), 0) * dr.maximum(facing, 0) / dr.maximum(d2, dr.opaque(mi.Float, reach2))
    )
    ray = mi.Ray3f(place, direction)
    ray.maxt = dr.sqrt(d2) * (1 - mi.math.ShadowEpsilon)
    factor = dr.select((factor > 0) & ~scene.ray_test(ray, factor > 0), factor, 0)
    return dr.block_sum(factor, TESTS).numpy().astype(float) / TESTS


def _blocks(hits: Hits) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Order hits along a Morton curve, those of each of six directions by themselves; return the order and block numbers."""
    low = hits.p.min(axis=0, initial=np.inf)
    extent = max(float((hits.p.max(axis=0, initial=-np.inf) - low).max(initial=0)), 1e-30)
    cell = ((hits.p - low) * (1023 / extent)).astype(np.uint64)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | (cell << np.uint64(shift))) & np.uint64(mask)
    axis = np.abs(hits.n).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(hits.n, axis[:, None], 1)[:, 0] > 0)
    code = (
        face.astype(np.uint64) << np.uint64(30) | cell[:, 0] << np.uint64(2) | cell[:, 1] << np.uint64(1) | cell[:, 2]
    )
    order = np.argsort(code, kind="stable")
    return order, np.arange(len(order)) // BLOCK


def _mean(worth: NDArray, strength: NDArray) -> float:
    return float((worth * strength).sum() / max(strength.sum(), 1e-300))


def _block_mean(worth: NDArray, strength: NDArray, block: NDArray) -> NDArray[np.float64]:
    """Average what a unit of power is worth over each block."""
    total = np.bincount(block, weights=worth * strength)
    return (total / np.maximum(np.bincount(block, weights=strength), 1e-300))[block]


def _resample(weights: NDArray, count: int, rng) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Draw in proportion to weights, evenly along their order; return who was drawn, and times drawn over times expected."""
    expected = weights * (count / weights.sum())
    if len(weights) <= count:
        return np.arange(len(weights)), np.ones(len(weights))
    drawn = np.diff(np.floor(np.cumsum(expected) + rng.random()), prepend=0.0)
    chosen = np.flatnonzero(drawn)
    return chosen, drawn[chosen] / expected[chosen]


def _near_field(p: NDArray, n: NDArray, strength: NDArray) -> NDArray[np.float64]:
    """Choose ``near2`` so that no light sends more than the radiosity of the surface it stands for: ``near2 = I / B``.

    ``pi B`` is the intensity of the nearest lights that face the same way, over the disc that they fill.
    """
    neighbours = min(NEIGHBOURS, len(p))
    distance, index = cKDTree(p).query(p, neighbours)
    distance, index = distance.reshape(len(p), neighbours), index.reshape(len(p), neighbours)
    alike = np.sum(n[index] * n[:, None, :], axis=2) > 0.5
    around = np.sum(np.where(alike, strength[index], 0), axis=1)
    return strength / np.maximum(around, 1e-300) * distance[:, -1] ** 2
