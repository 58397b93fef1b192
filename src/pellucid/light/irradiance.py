"""How much light falls on the surface samples of a body, and how much of it enters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.even_sampler import EvenSampler
from ..kernels.memory import columns, rows, upload
from ..kernels.morton import morton_order
from ..model.fresnel import transmitted
from ..progress import chunks, steps
from ..scene.samples.grid import PointGrid
from ..scene.samples.surface import SurfaceSamples
from .direct import receivers, sample_emitters
from .lamps import CloseLamps
from .transport import Limits, Start, Translucency, mis_weight, trace

LANES = 1 << 22
"""Paths traced at once: enough to fill any machine, small enough (about 100 bytes a path) for any memory."""

STEP = 1 << 19
"""Paths to surface samples traced at once: a step of the progress."""

SMOOTHED_PATHS, MOST_NEIGHBOURS = 2048, 128
"""Paths whose indirect light is averaged for each sample, and of so many samples at most: what noise is left is that of the direct light,
and what is blurred is less than the noise was."""


@dataclass
class Irradiance:
    """Light at surface samples: ``total`` falls on them, ``entering`` passes the surface; both ``(n, 3) float32``."""

    total: np.ndarray
    entering: np.ndarray


@dataclass
class PathLight:
    """Light as paths have measured it at samples, along the Morton curve through those of a body or through a part of them.

    Attributes
    ----------
    values : (4, m, 3) float32
        Straight from emitters, the part of it that enters, by way of other surfaces, and the part of that which enters.
    paths : int
        To each sample.
    """

    values: np.ndarray
    paths: int

    @classmethod
    def join(cls, parts: Sequence[PathLight]) -> PathLight:
        """Put the light along consecutive parts of a curve together."""
        return cls(np.concatenate([part.values for part in parts], axis=1), parts[0].paths)

    def irradiance(self, samples: SurfaceSamples, neighbours: int) -> Irradiance:
        """Bring light into the order of all samples of a body, and average what changes slowly over so many neighbours at most."""
        light = np.empty_like(self.values)
        light[:, morton_order(samples.p)] = self.values
        direct, direct_entering, indirect, indirect_entering = light
        if indirect.any():
            indirect, indirect_entering = _smoothed(
                samples, min(SMOOTHED_PATHS // self.paths, neighbours), indirect, indirect_entering
            )
        return Irradiance(direct + indirect, direct_entering + indirect_entering)


def path_radiance(scene, sampler, start: Start, limits: Limits, translucency: Translucency | None, active=True):
    """Trace paths and let ``translucency`` answer their translucent vertices (None: the materials' diffuse lobes do)."""
    seen, reflected = _along_paths(scene, sampler, start, limits, translucency, active)
    return seen + reflected


def _along_paths(scene, sampler, start: Start, limits: Limits, translucency: Translucency | None, active):
    """Trace paths: the radiance of the emitters that they meet first, and of all else."""
    radiance, seen, _, vertices = trace(scene, sampler, start, limits, translucency, mi.Bool(active))
    return seen, radiance if translucency is None else radiance + translucency.radiance(vertices)


@dataclass
class Incident:
    """Light that falls on points, by one path each: straight from emitters, and by way of other surfaces; and the parts that enter."""

    direct: mi.Color3f
    direct_entering: mi.Color3f
    indirect: mi.Color3f
    indirect_entering: mi.Color3f

    @property
    def entering(self) -> mi.Color3f:
        """All that enters."""
        return self.direct_entering + self.indirect_entering


def incident(
    scene,
    sampler,
    si,
    eta,
    limits: Limits,
    translucency: Translucency | None,
    sets,
    is_open: bool = False,
    close: CloseLamps | None = None,
    active=True,
) -> Incident:
    """Estimate the light that falls on points and the part that enters, by one path each; without what rays carry of ``close`` lamps.

    On a surface without thickness, ``is_open``, nothing arrives from behind it, however its shading normals are turned. ``sets`` are
    two 2D random numbers: for the choice of an emitter and for the direction of the path. The exact Fresnel transmittance of every
    direction is used. JB02 eq. 13 multiplies the irradiance by its diffuse mean instead, which is the same under even light, and too
    bright under grazing light.
    """
    direct, entering = mi.Color3f(0), mi.Color3f(0)
    for ds, emitted, pdf in sample_emitters(scene, si, sets[0], active, limits.differentiated):
        cosine = dr.dot(ds.d, si.sh_frame.n)
        lit = active & (ds.pdf > 0) & (cosine > 0)
        mis = dr.select(ds.delta, 1, mis_weight(pdf, cosine * dr.inv_pi))
        falling = dr.select(lit, emitted * (cosine * mis), 0)
        if close is not None:
            falling *= close.by_samples(scene, ds.emitter, ds.dist)
        direct += falling
        entering += dr.select(lit, falling * transmitted(cosine, eta), 0)

    wo = mi.warp.square_to_cosine_hemisphere(sets[1])
    start = Start.surface(si, wo, mi.warp.square_to_cosine_hemisphere_pdf(wo))
    before = active & (dr.dot(start.ray.d, si.n) > 0) if is_open else active
    seen, reflected = _along_paths(scene, sampler, start, limits, translucency, before)
    if close is not None:
        first = scene.ray_intersect(start.ray, before)
        seen *= close.by_samples(scene, first.emitter(scene, before), first.t)
    seen, reflected, passing = dr.pi * seen, dr.pi * reflected, transmitted(wo.z, eta)
    return Incident(direct + seen, entering + seen * passing, reflected, reflected * passing)


def sample_receivers(samples: SurfaceSamples, index: Any) -> mi.SurfaceInteraction3f:
    """Make samples of a body points that light falls on, on the outside: one a lane, by their numbers ``(m,) UInt32``."""
    side = dr.opaque(mi.Float, samples.outside)

    def take(array: np.ndarray, kind):
        return dr.gather(kind, kind(*columns(array)), index)

    n, sh_n = (mi.Normal3f(side * take(normals, mi.Normal3f)) for normals in (samples.n, samples.sh_n))
    return receivers(take(samples.ray_start(), mi.Point3f), n, sh_n)


def at_once(paths: int) -> int:
    """Choose how many samples are lit at once, so many paths to each."""
    return max(1, STEP // paths)


def gather_irradiance(
    scene: mi.Scene,
    samples: SurfaceSamples,
    eta: float,
    limits: Limits,
    paths: int,
    seed: int,
    translucency: Translucency | None = None,
) -> Irradiance:
    """Path-trace the irradiance at surface samples, from emitters and from everything they light.

    The parameters are those of `measure_light`, whose noise neighbours share where it can be shared.
    """
    return measure_light(scene, samples, eta, limits, paths, seed, translucency).irradiance(samples, MOST_NEIGHBOURS)


def measure_light(
    scene: mi.Scene,
    samples: SurfaceSamples,
    eta: float,
    limits: Limits,
    paths: int,
    seed: int,
    translucency: Translucency | None = None,
    part: range | None = None,
    close: CloseLamps | None = None,
) -> PathLight:
    """Trace paths to surface samples along the Morton curve through them.

    Runs of paths, and of those to neighbours on the curve, fill all directions evenly together.

    Parameters
    ----------
    samples : SurfaceSamples
        The ``n`` points.
    eta : float
        Relative index of refraction of their body.
    paths : int
        Paths a sample; the noise of the irradiance falls with their square root.
    seed : int
        Same seed, same result, bit for bit.
    part : range, optional
        Only these places along the curve: their light is what it is among all.
    close : CloseLamps, optional
        Lamps of whose light rays carry a part, which is left out.
    """
    order = morton_order(samples.p)
    part = range(len(order)) if part is None else part
    values = np.empty((4, len(part), 3), np.float32)
    for done, size in steps("irradiance", chunks(len(part), at_once(paths)), "samples"):
        first = part.start + done
        place = np.arange(first, first + size, dtype=np.uint32)
        found = measure_some(scene, samples, eta, limits, paths, seed, translucency, order[place], place, close)
        for target, value in zip(values, vars(found).values(), strict=True):
            target[done : done + size] = rows(value)
    return PathLight(values, paths)


def measure_some(
    scene: mi.Scene,
    samples: SurfaceSamples,
    eta: Any,
    limits: Limits,
    paths: int,
    seed: int,
    translucency: Translucency | None,
    index: np.ndarray,
    place: np.ndarray,
    close: CloseLamps | None,
) -> Incident:
    """Estimate the light at samples ``index (m,) uint32``; parameters as for `measure_light`, ``place`` are theirs along the curve.

    The random numbers of paths come from their places. What rays carry of the light of ``close`` lamps is left out.
    """
    lane, each = dr.arange(mi.UInt32, len(index) * paths), dr.opaque(mi.UInt32, paths)
    sample = lane // each
    number = dr.gather(mi.UInt32, upload(place), sample) * each + (lane - sample * each)
    sampler = EvenSampler.from_indices(number, seed)
    sets = [sampler.next_2d(), sampler.next_2d()]
    si = sample_receivers(samples.take(index), sample)
    eta = eta if dr.is_jit_v(eta) else dr.opaque(mi.Float, eta)
    found = incident(scene, sampler, si, eta, limits, translucency, sets, samples.is_open, close)
    dr.eval(found)
    means = (mi.Color3f(*(dr.block_sum(channel, paths) / paths for channel in v)) for v in vars(found).values())
    return Incident(*means)


def _smoothed(samples: SurfaceSamples, neighbours: int, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Average light over the neighbours of every sample, where it changes slowly enough: that by way of other surfaces.

    Parameters
    ----------
    neighbours : int
        So many, itself counted.
    values : (n, 3) float32
    """
    count, area = len(samples.p), float(np.sum(samples.area, dtype=float))
    if neighbours < 2:
        return values
    p, n = mi.Point3f(*columns(samples.p)), mi.Normal3f(*columns(samples.n))
    grid = PointGrid(p, n, float(np.sqrt(min(neighbours, count) * area / count / np.pi)))
    return tuple(rows(mean) for mean in grid.means([mi.Color3f(*columns(value)) for value in values]))
