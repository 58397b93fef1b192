"""The hybrid method: light that stays near by filtering translucent shadow maps, light that goes far by surface samples.

`NearLight` is all that whoever sums the exitance of a body needs::

    near = NearLight(body, number, lookup, points)          # once a body
    near.forget(emitter)                                    # when a light has changed, or with None all that stands
    near.divide(bound), near.update(scene)                  # before a frame; only what has changed takes time
    near.exitance(p)                                        # of the lights where near.mapped, by R_l

To that it adds the sums over surface samples: those of the light of mapped emitters with a table of R_g
(``ProfileTable.from_medium(medium, weight=near.split.global_weight)``), all other light with a table of all of R_d.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...gather.gather import cosine
from ...gather.gather import lookup as lookup_profile
from ...gather.source import Source, make_source
from ...kernels.memory import upload
from ...kernels.sequences import GOLDEN
from ...model.decomposition import IMPORTANCE_BOUND, Decomposition, decompose
from ...model.medium import Medium
from ...model.profiles import Profile, ProfileTable, mean_over_disc
from ...scene.bodies import Body, Lookup
from .shadow_map import TranslucentShadowMap, bounding_sphere, emitter_camera, shadow_map

RINGS, PER_RING = 20, 20
RESOLUTION = 512
FINER = 2  # times the resolution while nothing moves: edges of shadows in a map are as ragged as its pixels are wide
MARGIN = 1.001
NODES = 2048
NEAREST, FARTHEST = 1e-3, 1e4  # where the profile is integrated [shortest mean free paths]
NEGLIGIBLE = 1e-9  # of the most light of a ring: where it ends


@dataclass
class Rings:
    """A circular filter: places around a point, each with the area of the plane that it stands for, and a profile.

    Attributes
    ----------
    source : Source
        Records of four numbers a place: two offsets [scene units], area [scene units squared], nothing; and the profile.
    count : int
        Number of places.
    """

    source: Source
    count: int

    def around(self, p: Any) -> Callable[[Any], tuple[Any, Any, Any]]:
        """Make what tells of the place of a number its two offsets from any of some points, and its area."""

        def place(k: Any) -> tuple[Any, Any, Any]:
            record = dr.gather(mi.Array4f, self.source.records, k)
            return record[0], record[1], record[2]

        return place


class Pattern(Protocol):
    """Places around points, of which each stands for a part of the plane: `Rings`, or others for every point."""

    source: Source

    def around(self, p: Any) -> Callable[[Any], tuple[Any, Any, Any]]:
        """Make what tells of the place of a number its two offsets from each of some points, and its area."""


def build_rings(medium: Medium, weight: Profile | None = None, rings: int = RINGS, per_ring: int = PER_RING) -> Rings:
    """Spread places around a point by importance sampling of a profile over a plane.

    A ring's radius is where the middle of its share of ``R(r) 2 pi r dr`` lies; R is the sum over the channels. The place
    in the middle stands for as much light as one on a ring. Every ring is turned against the one before by the golden
    ratio of a step, so that places lie evenly instead of in spokes; the pattern is the same for all points.

    Parameters
    ----------
    medium : Medium
        Whose R_d, per scene unit.
    weight : callable, optional
        Multiplies R_d, as for `ProfileTable.from_medium`.
    rings, per_ring : int
        L and C: there are ``L C + 1`` places.

    Source: CLHHC08 section 4.2; radii after MKBVR03.
    """
    r, share, density = plane_density(medium, weight)
    count = rings * per_ring + 1
    ring, step = np.divmod(np.arange(count - 1), per_ring)
    place = np.concatenate([[0.0], np.interp((1 + (ring + 0.5) * per_ring) / count, share, r)])
    angle = np.concatenate([[0.0], 2 * np.pi * (step + ring * (1 - GOLDEN) % 1) / per_ring])
    records = np.zeros((count, 4), np.float32)
    records[:, 0], records[:, 1] = place * np.cos(angle), place * np.sin(angle)
    records[:, 2] = 1 / (count * np.interp(place, r, density))
    table = ProfileTable.from_medium(medium, weight=weight)
    return Rings(make_source(upload(records), count, table, mi.Float), count)


class NearLight:
    """The local part of the exitance of one body, from frame to frame.

    Parameters
    ----------
    body, number, lookup
        The body ``bodies[number]`` of a scene, and what tells it from others.
    points : (n, 3) float
        Points all over its surface.
    resolution : int
        Of the maps; they are twice as fine while nothing moves.

    Attributes
    ----------
    split : Decomposition
        How R_d is divided.
    maps : list of TranslucentShadowMap or None
        One an emitter of the scene; None for those that have none, and while all of R_d is global.

    Source: CLHHC08 section 4.
    """

    def __init__(self, body: Body, number: int, lookup: Lookup, points: ArrayLike, resolution: int = RESOLUTION):
        self.body, self.number, self.lookup, self.resolution = body, number, lookup, resolution
        self.centre, radius = bounding_sphere(points)
        self.radius = MARGIN * radius
        self.maps: list[TranslucentShadowMap | None] = []
        self.stale: set[int] | None = None
        self.key: tuple[Any, ...] | None = None
        self.split: Decomposition
        self.rings: Rings
        self.divide()

    def divide(self, bound: float = IMPORTANCE_BOUND, rings: int = RINGS, per_ring: int = PER_RING) -> None:
        """Divide the profile of the medium that the body has now, unless it was the last time; ``bound`` is c [1/mm]."""
        medium, scale = self.body.medium, self.body.bsdf.scale
        if (key := (medium, scale, bound, rings, per_ring)) == self.key:
            return
        if self.key is not None and (medium.eta != self.key[0].eta or self.body.bsdf.texture is not None):
            self.forget()
        self.key = key
        self.split = decompose(medium, bound, scale)
        if self.split.radius > 0:
            self.rings = build_rings(medium, self.split.local_weight, rings, per_ring)
        if any(self.mapped) != (self.split.radius > 0):
            self.forget()  # there is something near now, or no longer

    def forget(self, emitter: int | None = None) -> None:
        """Mark the map of one emitter as out of date, or all."""
        if emitter is None:
            self.stale = None
        elif self.stale is not None:
            self.stale.add(emitter)

    def update(self, scene: mi.Scene, fine: bool = False) -> None:
        """See the body anew from the emitters whose maps are out of date, or ``fine`` and theirs are not."""
        emitters = scene.emitters()
        if self.stale is None:
            self.maps, self.stale = [None] * len(emitters), set(range(len(emitters)))
        resolution = self.resolution * (FINER if fine else 1)
        coarse = {k for k, seen in enumerate(self.maps) if seen is not None and seen.camera.resolution < resolution}
        for k in self.stale | coarse if self.split.radius > 0 else ():
            camera = emitter_camera(scene, emitters[k], self.centre, self.radius, resolution)
            if camera is not None:
                self.maps[k] = shadow_map(scene, emitters[k], camera, self.lookup, self.number, self.body)
            else:
                self.maps[k] = None
        self.stale = set()

    @property
    def mapped(self) -> list[bool]:
        """Tell of each emitter whether its light is divided."""
        return [seen is not None for seen in self.maps]

    def exitance(self, p: Any, n: Any = None) -> mi.Color3f:
        """Sum the local part of the exitance at points of the body, ``Point3f``; without normals, which point outside, it is flat."""
        if not any(self.mapped):
            return dr.zeros(mi.Color3f, dr.width(p))
        return filter_maps([seen for seen in self.maps if seen is not None], self.rings, p, n)


def filter_maps(maps: Iterable[TranslucentShadowMap], rings: Pattern, p: Any, n: Any = None) -> mi.Color3f:
    """Sum the exitance at points that the light in maps causes by the profile of the rings.

    Around the projection of a point, at its own depth, each place of the rings looks up the power of a pixel and where on
    the surface it enters: ``sum_k (power / pixel area) area_k R(|x_k - x_o|)``. The distance is that to the surface, so a point
    that the light does not see gets as much as the profile lets through to it.

    Parameters
    ----------
    maps : iterable of TranslucentShadowMap
    rings : Pattern
    p : Point3f of m lanes
        Points [scene units].
    n : Normal3f of m lanes, optional
        Normals there, away from the inside; without them the surface is flat.

    Returns
    -------
    Color3f of m lanes

    Source: CLHHC08 section 4.2.
    """
    total = dr.zeros(mi.Color3f, dr.width(p))
    for entering in maps:
        total += _filter(entering, rings, p, n)
    return total


def _filter(entering: TranslucentShadowMap, rings: Pattern, p: Any, n: Any) -> mi.Color3f:
    """Filter one map around points."""
    camera, source = entering.camera, rings.source
    here = camera.locate(mi.Point3f(p))
    normal = None if n is None else camera.turn(mi.Vector3f(n))
    scale = camera.scale(here.z)
    half = 0.5 * mi.Float(camera.size)
    column, row = dr.fma(here.x, scale, half), dr.fma(here.y, scale, half)
    dr.eval(here, normal, scale, column, row)
    place = rings.around(p)

    def visit(k: Any, total: Any) -> Any:
        across, down, area = place(k)
        x, y = dr.fma(across, scale, column), dr.fma(down, scale, row)
        inside = (x >= 0) & (y >= 0) & (x < mi.Float(camera.size)) & (y < mi.Float(camera.size))
        i, j = mi.UInt32(x), mi.UInt32(y)
        pixel = dr.gather(mi.Array4f, entering.records, j * camera.size + i, inside)
        slope = dr.gather(mi.Vector2f, entering.slopes, j * camera.size + i, inside)
        # Light enters at the place itself, in the plane of its pixel, the middle of which may be far nearer to the point.
        aside = mi.Vector2f(x - mi.Float(i) - 0.5, y - mi.Float(j) - 0.5)
        way = here - camera.place(x - 0.5, y - 0.5, pixel[3] + dr.dot(slope, aside))
        r2 = dr.squared_norm(way)
        value = lookup_profile(source, r2, inside, mu=cosine(normal, way, r2))
        power = mi.Color3f(pixel[0], pixel[1], pixel[2])
        return k + 1, dr.fma(power * area, mi.Color3f(*value), total)

    state = (mi.UInt32(0), dr.zeros(mi.Color3f, dr.width(p)))
    _, total = dr.while_loop(state, lambda k, _: k < source.end, visit, label="pellucid rings")
    total *= dr.square(scale)  # from power a pixel to power an area
    dr.eval(total)  # one kernel, however many maps there are
    return total


def plane_density(
    medium: Medium, weight: Profile | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Tabulate radii, the share of the profile's light within each over a plane, and its density there by area."""
    r = np.concatenate([[0.0], np.geomspace(NEAREST, FARTHEST, NODES) * float(medium.mfp.min())])
    profile = mean_over_disc(medium, r, 0.0, weight).sum(axis=1)
    # Trapezoids in the squared radius: exact for a profile that is flat where the grid is coarse, near 0.
    mass = 0.5 * np.pi * (profile[1:] + profile[:-1]) * np.diff(r * r)
    seen = np.flatnonzero(mass > NEGLIGIBLE * mass.max()).max(initial=0) + 2
    share = np.concatenate([[0.0], np.cumsum(mass)])[:seen]
    return r[:seen], share / share[-1], profile[:seen] / share[-1]
