"""Light as a set of points: all emitters of a scene, and what they light, as lamps that a kernel can sum over or cluster."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...kernels.memory import upload

OMNI, ORIENTED, DIRECTIONAL = 0, 1, 2


PACKETS = 3  # of four floats a light: position and near2, normal and kind, intensity


@dataclass
class LightSamples:
    """``n`` point lights, in host memory.

    A light of intensity ``I`` at distance ``d`` gives a surface that it sees under the cosine ``c`` the irradiance
    ``I c / d^2`` (OMNI), ``I c_light c / max(d^2, near2)`` (ORIENTED, ``c_light`` the cosine at the light) or ``I c``
    (DIRECTIONAL). The light of a spot is ``I`` up to the angle ``beam`` from its axis and falls linearly to zero at
    ``cutoff``, as that of Mitsuba's ``spot``.

    Attributes
    ----------
    kind : (n,) uint8
        OMNI, ORIENTED or DIRECTIONAL.
    p : (n, 3) float32
        Position, a hair in front of its surface [scene units]; zeros for DIRECTIONAL.
    n : (n, 3) float32
        Unit vector. ORIENTED: normal of the emitting surface. DIRECTIONAL: direction to the light. OMNI: axis of a
        spot, or zeros.
    intensity : (n, 3) float32
        Radiant intensity [W/sr], along the normal where there is one; DIRECTIONAL: irradiance of a facing surface.
    near2 : (n,) float32
        The square of the distance below which an ORIENTED light grows no brighter [scene units^2]: its irradiance is at
        most ``I / near2``, the radiosity of the surface it stands for. Zero for other kinds.
    cutoff, beam : (n,) float32
        Angles of a spot [rad]; pi for all others.
    indirect : (n,) bool
        A virtual point light.
    reach2 : (n,) float32
        The square of the distance below which rays carry the light of a lamp that is too near for samples (`lamps.CloseLamps`), and the
        point light grows no brighter [scene units^2]. Zero for others.
    """

    kind: NDArray[np.uint8]
    p: NDArray[np.float32]
    n: NDArray[np.float32]
    intensity: NDArray[np.float32]
    near2: NDArray[np.float32]
    cutoff: NDArray[np.float32]
    beam: NDArray[np.float32]
    indirect: NDArray[np.bool_]
    reach2: NDArray[np.float32]

    @classmethod
    def make(
        cls,
        kind: int,
        p: ArrayLike,
        n: ArrayLike,
        intensity: ArrayLike,
        near2: ArrayLike = 0.0,
        cutoff: float = np.pi,
        beam: float = np.pi,
        indirect: bool = False,
    ) -> LightSamples:
        """Make lights of one kind; whatever is the same for all need be given only once."""
        count = np.broadcast_shapes((1, 3), np.shape(p), np.shape(n), np.shape(intensity))[0]

        def vectors(value: ArrayLike) -> NDArray[np.float32]:
            return np.array(np.broadcast_to(np.asarray(value, np.float32), (count, 3)))

        def numbers(value: ArrayLike) -> NDArray[np.float32]:
            return np.array(np.broadcast_to(np.asarray(value, np.float32), (count,)))

        return cls(
            np.full(count, kind, np.uint8),
            vectors(p),
            vectors(n),
            vectors(intensity),
            numbers(near2),
            numbers(cutoff),
            numbers(beam),
            np.full(count, indirect),
            np.zeros(count, np.float32),
        )

    @classmethod
    def none(cls) -> LightSamples:
        """Make no lights at all."""
        return cls.make(OMNI, 0, 0, np.zeros((0, 3)))

    @classmethod
    def join(cls, parts: list[LightSamples]) -> LightSamples:
        """Put lights behind each other."""
        parts = [cls.none(), *parts]
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def even_within2(self) -> NDArray[np.float32]:
        """The squares of the distances below which lights grow no brighter, ``(n,) float32`` [scene units^2]."""
        return np.maximum(self.near2, self.reach2)

    def without_rays(self) -> LightSamples:
        """Let lights send what rays carry elsewhere."""
        return replace(self, reach2=np.zeros_like(self.reach2))

    def take(self, index: Any) -> LightSamples:
        """Select or reorder lights by numbers or a mask."""
        return LightSamples(*(getattr(self, field.name)[index] for field in fields(self)))


@dataclass
class Light:
    """One light a lane, in kernels: position (for DIRECTIONAL none), normal, intensity, the square of the near distance, kind, and
    the numbers of a spot if any of the lights is one."""

    p: mi.Vector3f
    n: mi.Vector3f
    intensity: mi.Color3f
    near2: mi.Float
    kind: mi.Float
    spot: Any

    def towards(self, p, n) -> tuple[mi.Vector3f, mi.Float, mi.Float, mi.Float]:
        """Evaluate the way from a point with the normal ``n``: direction, distance, the cosine there, and what intensity times
        that cosine is multiplied by."""
        directional, oriented = self.kind == DIRECTIONAL, self.kind == ORIENTED
        way = self.p - p
        d2 = dr.maximum(dr.squared_norm(way), dr.smallest(mi.Float))
        direction = dr.select(directional, self.n, way * dr.rsqrt(d2))
        distance = dr.select(directional, dr.largest(mi.Float), dr.sqrt(d2))
        cos_light = -dr.dot(direction, self.n)
        factor = dr.rcp(dr.maximum(d2, self.near2)) * dr.select(oriented, dr.maximum(cos_light, 0), 1)
        if self.spot is not None:
            factor *= spot_falloff(self.spot, cos_light)
        return direction, distance, dr.dot(direction, n), dr.select(directional, 1, factor)


@dataclass
class LightRecords:
    """The lights in device memory, for kernels; ``spots`` is there only where a light is a spot."""

    packets: Any
    spots: Any

    def fetch(self, index, active=True) -> Light:
        """Fetch a light; one of the intensity zero where not ``active``."""
        position, facing, intensity = (
            dr.gather(mi.Array4f, self.packets, index * PACKETS + k, active) for k in range(PACKETS)
        )
        spot = None if self.spots is None else dr.gather(mi.Array4f, self.spots, index, active)
        p, n, colour = (mi.Vector3f(packet[0], packet[1], packet[2]) for packet in (position, facing, intensity))
        return Light(p, n, mi.Color3f(colour), position[3], facing[3], spot)

    def arriving(self, index, p, n, active) -> tuple[mi.Vector3f, mi.Float, mi.Color3f]:
        """Evaluate one light at a point with the normal ``n``, as if nothing stood between them.

        Returns
        -------
        direction : Vector3f
            Unit vector to the light.
        distance : Float
            Distance of the light; the largest number there is for DIRECTIONAL.
        irradiance : Color3f
            What arrives; zero below the horizon of the point or behind the light, and where not ``active``.
        """
        light = self.fetch(index, active)
        direction, distance, cosine, factor = light.towards(p, n)
        return direction, distance, light.intensity * (factor * dr.maximum(cosine, 0))


def spot_falloff(spot, cosine) -> mi.Float:
    """Evaluate how the light of a spot falls off with the angle from its axis: as `spot` of Mitsuba has it."""
    cutoff, per_width, cos_cutoff, cos_beam = spot
    ramp = (cutoff - dr.safe_acos(cosine)) * per_width
    return dr.select(cosine >= cos_beam, 1, dr.select(cosine > cos_cutoff, ramp, 0))


def to_device(lights: LightSamples) -> LightRecords:
    """Pack lights for kernels."""
    packets = np.zeros((max(len(lights), 1), PACKETS, 4), np.float32)
    count = len(lights)
    packets[:count, 0, :3], packets[:count, 0, 3] = lights.p, lights.even_within2
    packets[:count, 1, :3], packets[:count, 1, 3] = lights.n, lights.kind
    packets[:count, 2, :3] = lights.intensity
    if not np.any(lights.cutoff < np.pi):
        return LightRecords(upload(packets), None)
    cutoff, beam = lights.cutoff.astype(float), lights.beam.astype(float)
    cos_beam = np.where(lights.cutoff < np.pi, np.cos(beam), -2)  # what is no spot shines in all directions
    spots = np.stack([cutoff, 1 / np.maximum(cutoff - beam, 1e-9), np.cos(cutoff), cos_beam], axis=1)
    return LightRecords(upload(packets), upload(spots.astype(np.float32)))


def oriented(p: mi.Point3f, n: mi.Normal3f, intensity: mi.Color3f, near2: float) -> LightRecords:
    """Pack lights on surfaces that are on the device already."""
    packets = dr.empty(mi.Float, 4 * PACKETS * dr.width(p))
    first = dr.arange(mi.UInt32, dr.width(p)) * PACKETS
    last = dr.opaque(mi.Float, near2), mi.Float(ORIENTED), mi.Float(0)
    for k, (value, number) in enumerate(zip((p, n, intensity), last, strict=True)):
        dr.scatter(packets, mi.Array4f(*value, number), first + k)
    dr.eval(packets)
    return LightRecords(packets, None)


def visible(scene: mi.Scene, si, direction, distance, active) -> mi.Bool:
    """Trace one shadow ray from a surface to a light at a distance, short of the surface that the light may lie on."""
    ray = si.spawn_ray(direction)
    ray.maxt = distance * (1 - mi.math.ShadowEpsilon)
    return active & ~scene.ray_test(ray, active)
