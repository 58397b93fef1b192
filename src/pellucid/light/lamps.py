"""Lamps where the method cannot use their light: inside a body, or nearer to it than its samples are to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..kernels.memory import rows
from ..kernels.sequences import fibonacci_lattice
from ..scene.bodies import Body, Lookup
from ..scene.samples.surface import SurfaceSamples

CROSSINGS = 32
"""Surfaces that a ray from a lamp is followed through."""

DIRECTIONS = ((0.36, 0.48, 0.8), (-0.6, 0.0, 0.8), (0.28, -0.96, 0.0))

NORMALS = 256
"""Points of a surface whose normals tell whether it is flat."""

FLAT = 0.999
"""Length of the mean normal of a flat surface, at least."""

NEAR = 1.0
"""Sample spacings within which a lamp lights few samples, if any."""


CLOSE, REACH = 2.0, 4.0
"""Sample spacings within which rays carry the light of a lamp, and up to which they carry it."""

Lamps = list[tuple[str, NDArray[np.float32], Any]]
"""Names, positions ``(3,)`` [scene units], and the emitters."""


@dataclass
class CloseLamps:
    """Point lamps and spots that are so near to a body that its samples miss much of their light: within ``reach``, all of it is left out.

    Attributes
    ----------
    positions : list of (3,) float
    emitters : list of Emitter
    reach : float
        [scene units]
    """

    positions: list[NDArray[np.float32]]
    emitters: list[Any]
    reach: float

    def covers(self, ds: mi.DirectionSample3f) -> mi.Bool:
        """Tell whether light comes from one of the lamps, from within reach."""
        close = mi.Bool(False)
        for emitter in self.emitters:
            close |= ds.emitter == mi.EmitterPtr(emitter)
        return close & (ds.dist < dr.opaque(mi.Float, self.reach))


def lamp_positions(scene: mi.Scene) -> Lamps:
    """List the lamps that have a place, by name: points and spots, and the middles of area lights."""
    found = []
    for number, emitter in enumerate(scene.emitters()):
        name = emitter.id() or f"emitter {number}"
        if emitter.class_name() in ("PointLight", "SpotLight"):
            at: Any = emitter.sample_direction(dr.zeros(mi.SurfaceInteraction3f, 1), mi.Point2f(0.5))[0].p
        elif emitter.get_shape() is not None:
            at = mi.Point3f(emitter.get_shape().bbox().center())
        else:
            continue
        found.append((name, np.asarray(at.numpy(), np.float32).reshape(3), emitter))
    return found


def lamps_inside(scene: mi.Scene, bodies: list[Body], lookup: Lookup) -> list[tuple[str, str]]:
    """Find the lamps inside closed bodies: names of lamp and body. Rays in most directions leave the body once more than they enter."""
    lamps = lamp_positions(scene)
    if not lamps:
        return []
    count = len(DIRECTIONS)
    origin = mi.Point3f(*np.repeat([at for _, at, _ in lamps], count, axis=0).T)
    ray = mi.Ray3f(origin, mi.Vector3f(*np.tile(DIRECTIONS, (len(lamps), 1)).T.astype(np.float32)))
    crossed = np.zeros((len(lamps) * count, len(bodies) + 1), np.int64)
    for _ in range(CROSSINGS):
        si = scene.ray_intersect(ray)
        valid = si.is_valid()
        body = lookup.body_index(si, valid).numpy() * valid.numpy()
        np.add.at(crossed, (np.arange(len(body)), body), 1)
        if not valid.numpy().any():
            break
        ray = dr.select(valid, si.spawn_ray(ray.d), ray)
        dr.eval(ray)
    odd = (crossed[:, 1:] % 2 == 1).reshape(len(lamps), count, len(bodies)).sum(axis=1) > count / 2
    odd[:, [body.side != 0 for body in bodies]] = False
    return [(lamps[k][0], bodies[b].name) for k, b in np.argwhere(odd).tolist()]


def lamps_too_near(lamps: Lamps, samples: SurfaceSamples, within: float = NEAR) -> list[tuple[str, float, float, Any]]:
    """Find the lamps that are ``within`` so many sample spacings of a body: name, distance and spacing [scene units], emitter."""
    found = []
    reach = within * float(np.sqrt(samples.area.max()))
    low, high = samples.p.min(axis=0) - reach, samples.p.max(axis=0) + reach
    for name, at, emitter in lamps:
        if np.any(at < low) or np.any(at > high):
            continue
        square = np.sum(np.square(samples.p - at), axis=1)
        near = int(np.argmin(square))
        spacing = float(np.sqrt(samples.area[near]))
        height = float(np.dot(at - samples.p[near], samples.n[near])) * samples.outside
        distance = abs(height)
        if samples.is_open and height < 0:
            continue
        if square[near] < (within * spacing) ** 2 + distance**2 and distance < within * spacing:
            found.append((name, distance, spacing, emitter))
    return found


def close_lamps(scene: mi.Scene, samples: SurfaceSamples) -> CloseLamps | None:
    """Find the point lamps and spots whose light the samples of a body would miss; None where there are none."""
    lamps = [lamp for lamp in lamp_positions(scene) if lamp[2].get_shape() is None]
    too_near = lamps_too_near(lamps, samples, CLOSE)
    if not too_near:
        return None
    reach = REACH * max(spacing for _, _, spacing, _ in too_near)
    return CloseLamps([at for _, at, _ in lamps], [emitter for _, _, emitter in lamps], reach)


def both_sides_matter(scene: mi.Scene, lamps: Lamps, body: Body) -> bool:
    """Tell whether an open surface may be lit or seen from both sides: always where it is curved or the sky shines."""
    sites = body.surface().draw(NORMALS, 0, fibonacci_lattice)
    point, mean = rows(sites.p)[0], rows(sites.n).astype(float).mean(axis=0)
    if np.linalg.norm(mean) < FLAT or any(emitter.is_environment() for emitter in scene.emitters()):
        return True
    eyes = [np.array(sensor.world_transform().matrix, float).reshape(4, 4)[:3, 3] for sensor in scene.sensors()]
    heights = [np.dot(at - point, mean) for at in (*(at for _, at, _ in lamps), *eyes)]
    return any(height > 0 for height in heights) and any(height < 0 for height in heights)
