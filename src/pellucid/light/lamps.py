"""Lamps whose light samples miss: inside a body, or nearer to it than its samples are to each other."""

from __future__ import annotations

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

AROUND, PLACES, PLACES_PER_POINT = 1024, 16, 4
"""Directions in which bodies are looked for from a lamp that is a point; places on one with an extent, and of how many as many directions
as of a point are."""

AT_ONCE = 1 << 20
"""Rays of one kernel launch."""

Array = NDArray[np.float64]

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
        Square roots of the areas of lamps that were looked around from [scene units].
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
    """Look around from all lamps that have a place for bodies no farther away than they are large."""
    numbers = [k for k, emitter in enumerate(scene.emitters()) if emitter.class_name() in KINDS]
    lamps = [scene.emitters()[k] for k in numbers]
    names = [_name(lamp, k) for k, lamp in zip(numbers, lamps, strict=True)]
    distance = np.full((len(lamps), len(bodies)), np.inf)
    extent = np.array([max(body.bbox().extents()) for body in bodies])
    near = (distances_of_boxes(lamps, bodies) <= extent).any(axis=1)
    shapes = [lamp.get_shape() for lamp in lamps]
    size = np.zeros(len(lamps))
    small = [k for k in np.flatnonzero(near) if shapes[k] is None]
    large = [k for k in np.flatnonzero(near) if shapes[k] is not None]
    _look_around(scene, lookup, lamp_places([lamps[k] for k in small]), np.array(small, int), AROUND, distance)
    on, size[large] = _off_shapes([lamps[k] for k in large], PLACES)
    _look_around(scene, lookup, on, np.repeat(np.array(large, int), PLACES), AROUND // PLACES_PER_POINT, distance)
    return NearLamps(names, numbers, size, distance)


def _look_around(
    scene: mi.Scene, lookup: Lookup, places: Array, lamp: NDArray[np.int64], count: int, distance: Array
) -> None:
    """Note in ``distance (l, b)`` how far bodies are, by ``count`` rays in all directions from each place ``(k, 3)`` of lamps."""
    around = mi.warp.square_to_uniform_sphere(mi.Point2f(*hammersley_set(mi.Float, count, 0)))
    for first in range(0, len(places), AT_ONCE // count):
        part = slice(first, first + AT_ONCE // count)
        lane = dr.arange(mi.UInt32, count * len(places[part]))
        origin = dr.gather(mi.Point3f, mi.Point3f(*columns(places[part])), lane // count)
        si = scene.ray_intersect(mi.Ray3f(origin, dr.gather(mi.Vector3f, around, lane % count)))
        number = lookup.body_index(si, si.is_valid()).numpy().astype(np.int64)
        met = si.is_valid().numpy() & (number > 0)
        np.minimum.at(distance, (np.repeat(lamp[part], count)[met], number[met] - 1), si.t.numpy()[met])


def distances_of_boxes(lamps: list[mi.Emitter], bodies: list[Body]) -> Array:
    """Evaluate the distances ``(l, b)`` of the boxes around lamps that have a place from those around bodies [scene units]."""
    if not lamps:
        return np.zeros((0, len(bodies)))
    boxes = [None if lamp.get_shape() is None else lamp.get_shape().bbox() for lamp in lamps]
    points = iter(lamp_places([lamp for lamp, box in zip(lamps, boxes, strict=True) if box is None]))
    low, high = np.array([(p := next(points), p) if box is None else (box.min, box.max) for box in boxes]).swapaxes(
        0, 1
    )
    body_low, body_high = np.array([(body.bbox().min, body.bbox().max) for body in bodies]).swapaxes(0, 1)
    gap = np.maximum(body_low - high[:, None], low[:, None] - body_high)
    return np.asarray(np.linalg.norm(np.maximum(gap, 0), axis=-1), float)


def lamp_places(emitters: list[mi.Emitter]) -> Array:
    """Find where point lamps and spots are, ``(k, 3)`` [scene units]."""
    if not emitters:
        return np.zeros((0, 3))
    it = dr.zeros(mi.SurfaceInteraction3f, len(emitters))
    return rows(mi.EmitterPtr(emitters).sample_direction(it, mi.Point2f(0.5))[0].p).astype(float)


def _off_shapes(emitters: list[mi.Emitter], count: int) -> tuple[Array, Array]:
    """Spread places over the shapes of area lights, a little in front of them [scene units].

    Returns
    -------
    places : (k count, 3)
    size : (k,)
        Square roots of the areas.
    """
    if not emitters:
        return np.zeros((0, 3)), np.zeros(0)
    si, area = places_on(emitters, count, 0)
    size = np.sqrt(area.numpy().astype(float).reshape(-1, count).sum(axis=1))
    return rows(si.spawn_ray(mi.Vector3f(si.n)).o).astype(float), size


def _name(emitter: mi.Emitter, number: int) -> str:
    """Name an emitter."""
    return emitter.id() or f"emitter {number}"


def lamp_positions(scene: mi.Scene) -> Lamps:
    """List the lamps that have a place, by name: points and spots, and a place on the surface of each area light."""
    lamps = [(_name(emitter, number), emitter) for number, emitter in enumerate(scene.emitters())]
    small = [lamp for lamp in lamps if lamp[1].class_name() in ("PointLight", "SpotLight")]
    large = [lamp for lamp in lamps if lamp[1].get_shape() is not None]
    places = np.concatenate([lamp_places([e for _, e in small]), _off_shapes([e for _, e in large], 1)[0]])
    return [
        (name, at, emitter) for (name, emitter), at in zip([*small, *large], places.astype(np.float32), strict=True)
    ]


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
        crossed[np.arange(len(body)), body] += 1
    odd = (crossed[:, 1:] % 2 == 1).reshape(len(lamps), count, len(bodies)).sum(axis=1) > count / 2
    odd[:, [body.side != 0 for body in bodies]] = False
    return [(lamps[k][0], bodies[b].name) for k, b in np.argwhere(odd).tolist()]


@dr.syntax
def bodies_along(scene: mi.Scene, ray: mi.Ray3f, lookup: Lookup) -> NDArray[np.uint32]:
    """Follow rays through all surfaces: the numbers of the bodies that each crosses first, second and so on, ``(k, n)``; 0 for none."""
    count = dr.width(ray)
    crossed = dr.zeros(mi.UInt32, CROSSINGS * count)
    place, stride = dr.arange(mi.UInt32, count), dr.opaque(mi.UInt32, count)
    number, active, ray = mi.UInt32(0), mi.Bool(True), mi.Ray3f(ray)
    while dr.hint(active & (number < CROSSINGS), label="pellucid crossings"):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        dr.scatter(crossed, lookup.body_index(si, active), place, active)
        ray = si.spawn_ray(ray.d)
        place += stride
        number += 1
    return crossed.numpy().reshape(CROSSINGS, count)


def both_sides_matter(scene: mi.Scene, lamps: Lamps, body: Body) -> bool:
    """Tell whether an open surface may be lit or seen from both sides: always where it is curved or the sky shines."""
    sites = body.surface().draw(NORMALS, 0, fibonacci_lattice)
    point, mean = rows(sites.p)[0], rows(sites.n).astype(float).mean(axis=0)
    if np.linalg.norm(mean) < FLAT or any(emitter.is_environment() for emitter in scene.emitters()):
        return True
    eyes = [np.array(sensor.world_transform().matrix, float).reshape(4, 4)[:3, 3] for sensor in scene.sensors()]
    heights = [np.dot(at - point, mean) for at in (*(at for _, at, _ in lamps), *eyes)]
    return any(height > 0 for height in heights) and any(height < 0 for height in heights)
