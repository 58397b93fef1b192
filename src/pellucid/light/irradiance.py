"""How much light falls on the surface samples of a body, and how much of it enters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.sequences import hammersley
from ..model.fresnel import transmitted
from ..progress import chunks, steps
from ..scene.samples.surface import SurfaceSamples
from .direct import receivers, sample_emitters
from .lamps import CloseLamps, close_lamps
from .transport import Limits, Start, Translucency, mis_weight, trace

LANES = 1 << 22
"""Paths traced at once: enough to fill any machine, small enough (about 100 bytes a path) for any memory."""

STEP = 1 << 19
"""Paths to surface samples traced at once: a step of the progress."""


@dataclass
class Irradiance:
    """Light at surface samples: ``total`` falls on them, ``entering`` passes the surface; both ``(n, 3) float32``."""

    total: np.ndarray
    entering: np.ndarray


def join(parts: Sequence[Irradiance]) -> Irradiance:
    """Put the light at consecutive samples together."""
    return Irradiance(np.concatenate([p.total for p in parts]), np.concatenate([p.entering for p in parts]))


def path_radiance(scene, sampler, start: Start, limits: Limits, translucency: Translucency | None, active=True):
    """Trace paths and let ``translucency`` answer their translucent vertices (None: the materials' diffuse lobes do)."""
    radiance, _, vertices = trace(scene, sampler, start, limits, translucency, mi.Bool(active))
    return radiance if translucency is None else radiance + translucency.radiance(vertices)


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
):
    """Estimate the light that falls on points and the part that enters, by one path each: two colours; without that of close lamps.

    On a surface without thickness, ``is_open``, nothing arrives from behind it, however its shading normals are turned. ``sets`` are
    two 2D random numbers: for the choice of an emitter and for the direction of the path. The exact Fresnel transmittance of every
    direction is used. JB02 eq. 13 multiplies the irradiance by its diffuse mean instead, which is the same under even light, and too
    bright under grazing light.
    """
    direct, entering = mi.Color3f(0), mi.Color3f(0)
    for ds, emitted, pdf in sample_emitters(scene, si, sets[0], active):
        cosine = dr.dot(ds.d, si.sh_frame.n)
        lit = active & (ds.pdf > 0) & (cosine > 0)
        if close is not None:
            lit &= ~close.covers(ds)
        mis = dr.select(ds.delta, 1, mis_weight(pdf, cosine * dr.inv_pi))
        falling = dr.select(lit, emitted * (cosine * mis), 0)
        direct += falling
        entering += dr.select(lit, falling * transmitted(cosine, eta), 0)

    wo = mi.warp.square_to_cosine_hemisphere(sets[1])
    start = Start.surface(si, wo, mi.warp.square_to_cosine_hemisphere_pdf(wo))
    before = active & (dr.dot(start.ray.d, si.n) > 0) if is_open else active
    along_path = dr.pi * path_radiance(scene, sampler, start, limits, translucency, before)

    return direct + along_path, entering + along_path * transmitted(wo.z, eta)


def sample_receivers(samples: SurfaceSamples, index: Any) -> mi.SurfaceInteraction3f:
    """Make some of the samples of a body, ``index (m,) UInt32``, points that light falls on, on the outside."""
    side = dr.opaque(mi.Float, samples.outside)

    def take(array: np.ndarray, kind):
        return dr.gather(kind, kind(np.ascontiguousarray(array.T)), index)

    n, sh_n = (mi.Normal3f(side * take(normals, mi.Normal3f)) for normals in (samples.n, samples.sh_n))
    return receivers(take(samples.ray_start(), mi.Point3f), n, sh_n)


def at_once(paths: int) -> int:
    """Choose how many samples are lit at once, so many paths to each: their random numbers belong together."""
    return max(1, STEP // paths)


def gather_irradiance(
    scene: mi.Scene,
    samples: SurfaceSamples,
    eta: float,
    limits: Limits,
    paths: int,
    seed: int,
    translucency: Translucency | None = None,
    part: range | None = None,
) -> Irradiance:
    """Path-trace the irradiance at surface samples, from emitters and from everything they light.

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
        Only these samples: some of `at_once`, which are lit as they are among all.
    """
    part = range(len(samples.p)) if part is None else part
    count = len(part)
    total = np.empty((count, 3), np.float32)
    entering = np.empty((count, 3), np.float32)
    sampler = mi.load_dict({"type": "independent"})
    close = close_lamps(scene, samples)
    eta_device = dr.opaque(mi.Float, eta)
    for done, size in steps("irradiance", chunks(count, at_once(paths)), "samples"):
        first = part.start + done
        lane = dr.arange(mi.UInt32, size * paths)
        index, path = lane // dr.opaque(mi.UInt32, paths), lane % dr.opaque(mi.UInt32, paths)
        sampler.seed(seed + first, size * paths)
        sets = []
        for _ in range(2):
            # All paths of a sample share one shift, drawn by the first of them.
            shift = sampler.next_2d()
            dr.eval(shift)
            shift = dr.gather(mi.Point2f, shift, index * dr.opaque(mi.UInt32, paths))
            sets.append(mi.Point2f(*hammersley(path, paths, shift)))
        si = sample_receivers(samples, index + dr.opaque(mi.UInt32, first))
        falling, passing = incident(scene, sampler, si, eta_device, limits, translucency, sets, samples.is_open, close)
        dr.eval(falling, passing)
        for target, value in ((total, falling), (entering, passing)):
            mean = mi.Color3f(*(dr.block_sum(channel, paths) / paths for channel in value))
            target[done : done + size] = mean.numpy().T
    return Irradiance(total, entering)
