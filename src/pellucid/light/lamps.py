"""Lamps whose light samples miss: inside a body, or nearer to it than its samples are to each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..kernels.memory import columns, rows
from ..kernels.sequences import fibonacci_lattice, hammersley_set
from ..scene.bodies import Body, Lookup
from .places import places_on

CROSSINGS = 32
"""Surfaces that a ray from a lamp is followed through."""

DIRECTIONS = ((0.36, 0.48, 0.8), (-0.6, 0.0, 0.8), (0.28, -0.96, 0.0))

NORMALS = 256
"""Points of a surface whose normals tell whether it is flat."""

FLAT = 0.999
"""Length of the mean normal of a flat surface, at least."""

CLOSE, REACH = 2.0, 4.0
"""Sample spacings within which samples would miss much of the light of a lamp, and up to which rays carry a part of it."""

LARGE = 8.0
"""Sample spacings along each side of a lamp that samples see as it is, however near it is."""

KINDS = ("PointLight", "SpotLight", "AreaLight")
"""Emitters that have a place, from which rays carry light."""

AROUND, PLACES = 1024, 16
"""Directions in which bodies are looked for from a place on a lamp, and such places on one with an extent."""

Lamps = list[tuple[str, NDArray[np.float32], Any]]
"""Names, positions ``(3,)`` [scene units], and the emitters."""


@dataclass
class CloseLamps:
    """Lamps that are so near to a body that its samples would miss much of their light.

    From within ``reach`` samples get no more than from that distance; the rest is carried by rays.

    Attributes
    ----------
    numbers : list of int
        Among the emitters of the scene, which are not kept: one that outlives its shape ends the process.
    reach : float
        [scene units]
    """

    numbers: list[int]
    reach: float

    def emitters(self, scene: mi.Scene) -> list[Any]:
        """Take the lamps out of their scene."""
        found = scene.emitters()
        return [found[k] for k in self.numbers]

    def by_rays(self, distance: mi.Float) -> mi.Float:
        """Evaluate the share of their light that rays carry to a distance."""
        return dr.maximum(1 - dr.square(distance / dr.opaque(mi.Float, self.reach)), 0)

    def by_samples(self, scene: mi.Scene, emitter: mi.EmitterPtr, distance: mi.Float) -> mi.Float:
        """Evaluate the share of the light of any emitter that samples get."""
        close = mi.Bool(False)
        for one in self.emitters(scene):
            close |= emitter == mi.EmitterPtr(one)
        return dr.select(close, 1 - self.by_rays(distance), 1)


@dataclass
class NearLamps:
    """How near the lamps of a scene are to its bodies.

    Attributes
    ----------
    names : list of str
    numbers : list of int
        Of the lamps among the emitters of the scene.
    size : (l,) float
        Square roots of the areas of lamps [scene units].
    distance : (l, b) float
        From each lamp to each body; infinite where it does not see it [scene units].
    """

    names: list[str]
    numbers: list[int]
    size: NDArray[np.float64]
    distance: NDArray[np.float64]

    def too_near(self, body: int, spacing: float) -> NDArray[np.int64]:
        """Find the lamps that are too near to a body whose samples are so far apart, of those that are not large."""
        return np.flatnonzero((self.distance[:, body] < CLOSE * spacing) & (self.size < LARGE * spacing))

    def close_to(self, bodies: dict[int, float]) -> CloseLamps | None:
        """Choose the lamps that are too near to any of some bodies with their sample spacings; None where there are none."""
        found = {int(k): spacing for body, spacing in bodies.items() for k in self.too_near(body, spacing)}
        if not found:
            return None
        return CloseLamps([self.numbers[k] for k in sorted(found)], REACH * max(found.values()))


def find_near_lamps(scene: mi.Scene, bodies: list[Body], lookup: Lookup) -> NearLamps:
    """Look around from all lamps that have a place for bodies."""
    lamps = [lamp for lamp in lamp_positions(scene) if lamp[2].class_name() in KINDS]
    size, distance = np.zeros(len(lamps)), np.full((len(lamps), len(bodies)), np.inf)
    around = mi.warp.square_to_uniform_sphere(mi.Point2f(*hammersley_set(mi.Float, AROUND, 0)))
    for k, (_, at, emitter) in enumerate(lamps):
        if not any(distance_of_boxes(emitter, body) <= float(max(body.bbox().extents())) for body in bodies):
            continue
        places = at[None]
        if emitter.get_shape() is not None:
            on, _ = places_on(emitter, PLACES, 0)
            places = rows(on.spawn_ray(mi.Vector3f(on.n)).o)
            size[k] = np.sqrt(float(np.ravel(emitter.get_shape().surface_area())[0]))
        lane = dr.arange(mi.UInt32, AROUND * len(places))
        origin = dr.gather(mi.Point3f, mi.Point3f(*columns(places)), lane // AROUND)
        si = scene.ray_intersect(mi.Ray3f(origin, dr.gather(mi.Vector3f, around, lane % AROUND)))
        number = lookup.body_index(si, si.is_valid()).numpy()
        met = si.is_valid().numpy() & (number > 0)
        np.minimum.at(distance[k], number[met].astype(np.int64) - 1, si.t.numpy()[met])
    numbers = [k for k, emitter in enumerate(scene.emitters()) if emitter.class_name() in KINDS]
    return NearLamps([name for name, _, _ in lamps], numbers, size, distance)


def distance_of_boxes(emitter: mi.Emitter, body: Body) -> float:
    """Evaluate the distance of the box around a lamp from that around a body [scene units]."""
    shape = emitter.get_shape()
    box = mi.ScalarBoundingBox3f(place_of(emitter)) if shape is None else shape.bbox()
    return float(body.bbox().distance(box))


def place_of(emitter: mi.Emitter) -> mi.ScalarPoint3f:
    """Find where a point lamp or a spot is."""
    at = emitter.sample_direction(dr.zeros(mi.SurfaceInteraction3f, 1), mi.Point2f(0.5))[0].p
    return mi.ScalarPoint3f(*np.ravel(at.numpy()).tolist())


def lamp_positions(scene: mi.Scene) -> Lamps:
    """List the lamps that have a place, by name: points and spots, and a place on the surface of each area light."""
    found = []
    for number, emitter in enumerate(scene.emitters()):
        name = emitter.id() or f"emitter {number}"
        if emitter.class_name() in ("PointLight", "SpotLight"):
            at = place_of(emitter)
        elif emitter.get_shape() is not None:
            si, _ = places_on(emitter, 1, 0)
            at = si.spawn_ray(mi.Vector3f(si.n)).o
        else:
            continue
        found.append((name, np.ravel(np.array(at, np.float32)), emitter))
    return found


def lamps_inside(scene: mi.Scene, bodies: list[Body], lookup: Lookup) -> list[tuple[str, str]]:
    """Find the lamps inside closed bodies: names of lamp and body. Rays in most directions leave the body once more than they enter."""
    lamps = lamp_positions(scene)
    if not lamps:
        return []
    count = len(DIRECTIONS)
    origin = mi.Point3f(*columns(np.repeat([at for _, at, _ in lamps], count, axis=0)))
    ray = mi.Ray3f(origin, mi.Vector3f(*columns(np.tile(DIRECTIONS, (len(lamps), 1)))))
    crossed = np.zeros((len(lamps) * count, len(bodies) + 1), np.int64)
    for body in bodies_along(scene, ray, lookup):
        np.add.at(crossed, (np.arange(len(body)), body), 1)
    odd = (crossed[:, 1:] % 2 == 1).reshape(len(lamps), count, len(bodies)).sum(axis=1) > count / 2
    odd[:, [body.side != 0 for body in bodies]] = False
    return [(lamps[k][0], bodies[b].name) for k, b in np.argwhere(odd).tolist()]


def bodies_along(scene: mi.Scene, ray: mi.Ray3f, lookup: Lookup) -> Iterator[NDArray[np.uint32]]:
    """Follow rays through all surfaces: the numbers of the bodies that they cross first, second and so on; 0 for none."""
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray)
        valid = si.is_valid()
        there = valid.numpy()
        if not there.any():
            return
        yield lookup.body_index(si, valid).numpy() * there
        ray = dr.select(valid, si.spawn_ray(ray.d), ray)
        dr.eval(ray)


def both_sides_matter(scene: mi.Scene, lamps: Lamps, body: Body) -> bool:
    """Tell whether an open surface may be lit or seen from both sides: always where it is curved or the sky shines."""
    sites = body.surface().draw(NORMALS, 0, fibonacci_lattice)
    point, mean = rows(sites.p)[0], rows(sites.n).astype(float).mean(axis=0)
    if np.linalg.norm(mean) < FLAT or any(emitter.is_environment() for emitter in scene.emitters()):
        return True
    eyes = [np.array(sensor.world_transform().matrix, float).reshape(4, 4)[:3, 3] for sensor in scene.sensors()]
    heights = [np.dot(at - point, mean) for at in (*(at for _, at, _ in lamps), *eyes)]
    return any(height > 0 for height in heights) and any(height < 0 for height in heights)
