"""``pellucid_sampled``: sampling the profile at every point and the light at every sampled point (JMLH01), the baseline of JB02."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, final

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.keyed_sampler import KeyedSampler
from ..kernels.memory import lanes_where
from ..light.irradiance import incident
from ..light.lamps import CloseLamps
from ..light.transport import opacity
from ..model.medium import Medium
from ..model.profiles import ProfileTable
from ..scene.bodies import Role, acting_as, build_lookup, marks_of_turned_faces
from ..scene.samples.surface import sample_surface
from .close_lamps import add_close_light, close_light
from .contract import Method, Points
from .preparation import LitBody, LitScene, shortest_mfp
from .thin import warn_of_thin_parts

CELLS_PER_OCTAVE = 8
NEAR = 0.5
"""Mean free paths that stand for the distance of samples: the light of a lamp much nearer than that falls on hardly any point drawn."""

MAX_CROSSINGS = 16
"""Crossings of one probe ray with the surface that are looked at."""

ROUNDING = 32 * 2.0**-23
"""By how much of its largest coordinate a point in single precision may be off, after a ray has been traced to it."""


@dataclass
class RadialSampler:
    """Draws radii from the profile: constant density in each of a row of annuli whose squared radii double every few cells."""

    r2_first: float
    r_max: float
    cdf: mi.Float
    density: mi.Float
    bound: mi.Float

    @classmethod
    def from_medium(cls, medium: Medium) -> RadialSampler:
        """Tabulate the mean of the channels, each normalised, out to where 1e-4 of the light is left."""
        r2_first = (0.05 * float(np.min(medium.mfp))) ** 2
        bound = np.concatenate([[0.0], r2_first * 2.0 ** (np.arange(CELLS_PER_OCTAVE * 60) / CELLS_PER_OCTAVE)])
        middle = np.sqrt(0.5 * (bound[1:] + bound[:-1]))
        mass = medium.diffuse_reflectance(middle) * (np.pi * np.diff(bound))[:, None]
        mass = (mass / mass.sum(axis=0)).mean(axis=1)
        cells = int(np.searchsorted(np.cumsum(mass), 1 - 1e-4)) + 1
        mass, bound = mass[:cells] / mass[:cells].sum(), bound[: cells + 1]
        return cls(
            r2_first,
            float(np.sqrt(bound[-1])),
            mi.Float(np.cumsum(mass)),
            mi.Float(mass / (np.pi * np.diff(bound))),
            mi.Float(bound),
        )

    def sample(self, u) -> mi.Float:
        """Draw a radius."""
        last = dr.width(self.cdf) - 1
        cell = dr.binary_search(0, last, lambda i: dr.gather(mi.Float, self.cdf, i) < u)
        lower = dr.select(cell > 0, dr.gather(mi.Float, self.cdf, dr.maximum(cell, 1) - 1), 0)
        upper = dr.gather(mi.Float, self.cdf, cell)
        t = dr.clip((u - lower) / (upper - lower), 0, 1)
        return dr.sqrt(dr.lerp(dr.gather(mi.Float, self.bound, cell), dr.gather(mi.Float, self.bound, cell + 1), t))

    def pdf(self, r2) -> mi.Float:
        """Evaluate the density per area in the plane."""
        octave = dr.log2(dr.maximum(r2 / self.r2_first, 2.0**-0.5 / CELLS_PER_OCTAVE))
        cell = mi.UInt32(dr.maximum(dr.floor(octave * CELLS_PER_OCTAVE) + 1, 0))
        return dr.gather(mi.Float, self.density, cell, cell < dr.width(self.density))


@dataclass
class StretchedSampler:
    """A `RadialSampler` for points at each of which the profile is wider, in every channel by another factor."""

    radial: RadialSampler
    stretch: mi.Color3f

    @property
    def r_max(self) -> mi.Float:
        """The largest radius of each point."""
        return self.radial.r_max * dr.max(self.stretch)

    def sample(self, u) -> mi.Float:
        """Draw a channel, and a radius from it."""
        channel = dr.minimum(dr.floor(3 * u), 2)
        factor = dr.select(channel == 0, self.stretch.x, dr.select(channel == 1, self.stretch.y, self.stretch.z))
        return factor * self.radial.sample(3 * u - channel)

    def pdf(self, r2) -> mi.Float:
        """Evaluate the density per area in the plane."""
        return sum((self.radial.pdf(r2 / dr.square(x)) / dr.square(x) for x in self.stretch), mi.Float(0)) / 3


class SampledBody(NamedTuple):
    """The inverse of the profile, the profile, the side of the normals that light comes from (`SurfaceSamples.outside`), the shapes
    that have faces which are wound the other way, with a mark for each of their faces, and the lamps that points would hardly find."""

    radial: RadialSampler
    profile: ProfileTable
    outside: int
    turned: list[tuple[mi.Shape, mi.UInt32]]
    close: CloseLamps | None

    def side(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Float:
        """Tell on which side of the normals of points light comes."""
        side = mi.Float(self.outside)
        for shape, marks in self.turned:
            here = active & (si.shape == mi.ShapePtr(shape))
            side = dr.select(dr.gather(mi.UInt32, marks, si.prim_index, here) == 1, -side, side)
        return side


@final
@dataclass
class Sampled(Method[LitScene]):
    r"""
    .. _integrator-pellucid_sampled:

    Sampling the profile (:monosp:`pellucid_sampled`)
    -------------------------------------------------

    The parameters of :ref:`pellucid_two_pass <integrator-pellucid_two_pass>` that concern paths. Every translucent point
    draws one point where light may have entered, from the profile around it, and traces one path for the light there:
    noise falls with the samples a pixel. Probe rays along three axes find the points also where the surface is curved.
    """

    name = "sampled"
    is_reference = True
    is_random = True
    needs_normals = True
    stretches = True

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Tabulate the profile of each body and its inverse."""
        for number, lit in enumerate(opened.bodies):
            warn_of_thin_parts(lit.body, "pellucid_sampled")
            side = sample_surface(lit.body.surface(), 4096, "uniform", 0).outside
            medium = lit.body.medium
            profile = ProfileTable.from_medium(medium)
            close = opened.lamps.close_to({number: NEAR * shortest_mfp(lit.body)})
            lit.close = close_light(scene, opened, number, close)
            turned = marks_of_turned_faces(lit.body)
            lit.state = SampledBody(RadialSampler.from_medium(medium), profile, side, turned, close)
        return opened

    def exitance(self, scene: mi.Scene, state: LitScene, points: Points) -> mi.Color3f:
        """Estimate JB02 eq. 8 by one sample at each point."""
        result = dr.zeros(mi.Color3f, dr.width(points.p))
        for number, lit in enumerate(state.bodies, 1):
            index = lanes_where(points.body == number)
            if dr.width(index):
                dr.scatter(result, self._of_body(scene, state, lit, points.take(index)), index)
            if lit.close is not None:
                add_close_light(result, points, number, lit, lit.state.outside)
        return result

    def _of_body(self, scene: mi.Scene, state: LitScene, lit: LitBody[SampledBody], points: Points) -> mi.Color3f:
        """Estimate the exitance at points of one body."""
        radial, table, outside, _, close = lit.state
        p, sampler = points.p, KeyedSampler.from_keys(points.key)
        stretch = points.stretch if lit.body.is_stretched else None
        radii = radial if stretch is None else StretchedSampler(radial, stretch)
        frame = mi.Frame3f(mi.Vector3f(points.n))
        si, crossings, pdf = self._probe(scene, lit, radii, frame, p, sampler)
        found = crossings > 0
        lit_side = lit.state.side(si, found)
        si.n *= lit_side
        if lit.body.side:  # as far off the surface as `SurfaceSamples.ray_start`
            si.p += si.n * (2 * mi.math.RayEpsilon * (1 + dr.max(dr.abs(si.p))))
        sh_n = state.lookup.shading_normal(si, found)
        si.sh_frame = mi.Frame3f(dr.mulsign(sh_n, dr.dot(sh_n, si.n)))
        sets = [sampler.next_2d(), sampler.next_2d()]
        eta = mi.Float(lit.body.medium.eta)
        with acting_as(Role.DIFFUSE, [each.body for each in state.bodies]):
            entering = incident(
                scene, sampler, si, eta, self.light_limits, None, sets, lit.body.side != 0, close, found
            ).entering
        if lit.body.bsdf.texture is not None:
            entering *= lit.body.bsdf.texture.eval(si, found) / mi.Color3f(lit.body.medium.total_diffuse_reflectance)
        if state.lookup.has_holes:
            entering *= opacity(si, found)
        way = mi.Vector3f(p - si.p)
        mu = dr.dot(dr.normalize(way), mi.Vector3f(points.n)) * dr.opaque(mi.Float, outside)
        profile = mi.Color3f(table.lookup(dr.squared_norm(way), mu, stretch))
        return dr.select(found, profile * entering * (mi.Float(crossings) / pdf), 0)

    @dr.syntax
    def _probe(self, scene, lit: LitBody, radial: RadialSampler | StretchedSampler, frame, p, sampler):
        """Choose one crossing of a random probe ray with the body; also their number and the density of the chosen point."""
        lookup = build_lookup(scene, [lit.body])
        u = sampler.next_1d()
        r, phi = radial.sample(sampler.next_1d()), sampler.next_1d() * dr.two_pi
        axis = dr.select(u < 0.5, frame.n, dr.select(u < 0.75, frame.s, frame.t))
        across = mi.Frame3f(axis)
        half = dr.sqrt(dr.maximum(radial.r_max**2 - r * r, 0))
        sine, cosine = dr.sincos(phi)
        origin = p + across.s * (r * cosine) + across.t * (r * sine) + axis * half
        ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(-axis))
        ray.maxt = 2 * half

        chosen = dr.zeros(mi.PreliminaryIntersection3f, dr.width(p))
        chosen_ray = mi.Ray3f(ray)
        crossings = mi.UInt32(0)
        steps = mi.UInt32(0)
        active = ray.maxt > 0
        while active:
            hit = scene.ray_intersect_preliminary(ray, False, active=active)
            si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, active)
            active &= si.is_valid()
            here = active & (lookup.body_index(si, active) != 0)
            crossings = dr.select(here, crossings + 1, crossings)
            # Reservoir of one: the k-th crossing replaces the choice with probability 1/k.
            keep = here & (sampler.next_1d() * mi.Float(crossings) < 1)
            chosen = dr.select(keep, hit, chosen)
            chosen_ray = dr.select(keep, ray, chosen_ray)
            # Beyond what has been met, also where coordinates are rounded to more than that: nothing is counted twice.
            rounding = ROUNDING * dr.max(dr.abs(si.p))
            travelled = hit.t + dr.maximum(dr.maximum(hit.t * 1e-5, 1e-5 * radial.r_max), rounding)
            ray.o = dr.select(active, ray(travelled), ray.o)
            ray.maxt = ray.maxt - travelled
            steps += 1
            active &= (ray.maxt > 0) & (steps < MAX_CROSSINGS)

        si = chosen.compute_surface_interaction(chosen_ray, mi.RayFlags.All, crossings > 0)
        offset = si.p - p
        distance2 = dr.squared_norm(offset)
        pdf = mi.Float(0)
        for direction, weight in ((frame.n, 0.5), (frame.s, 0.25), (frame.t, 0.25)):
            across2 = distance2 - dr.square(dr.dot(offset, direction))
            pdf += weight * radial.pdf(dr.maximum(across2, 0)) * dr.abs(dr.dot(si.n, direction))
        return si, crossings, pdf
