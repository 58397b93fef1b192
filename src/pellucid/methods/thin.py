"""Thin parts of bodies: in a slab light leaves through both sides that a half space would keep.

There the profile, summed over the body itself, is larger than the total reflectance, and the light that enters is multiplied by a factor
that was measured on slabs. On balls and other convex bodies the sum is larger too, rightly. The sum without absorption tells the two
apart: it has to be 1, as all light that enters leaves again, and bounds the factor from below.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ..errors import warn
from ..gather.gather import gather
from ..gather.octree import build_octree
from ..kernels.memory import columns
from ..model.medium import Medium
from ..model.slopes import STEP, moved
from ..scene.bodies import Body
from ..scene.samples.surface import SurfaceSamples, sample_surface
from .stretch import stretch_of_samples, table_of_samples

POINTS, MAX_ERROR = 8192, 0.1
NEIGHBOURS = 8
"""A sum over samples is noisy: the mean of so many counts."""


def thin_factor(body: Body, samples: SurfaceSamples, medium: Medium | None = None) -> np.ndarray | None:
    """Evaluate what the light that enters at samples of a body is multiplied by, ``(n, 3) float``; None if it is 1 everywhere.

    An open surface is a half space on each side. The ``medium`` is the body's, or one beside it.
    """
    medium = medium or body.medium
    if body.side or not medium.flat_profile.is_curved:
        return None
    is_few = len(samples) <= POINTS and not samples.is_part
    few = samples if is_few else sample_surface(body.surface(), POINTS, "poisson", 0)
    white = Medium(medium.sigma_t_prime, 0.0, medium.g, medium.eta, None, medium.profile)
    sums = np.stack([_sum_over_itself(body, m, few) for m in ((medium, white) if medium.sigma_a.any() else (white,))])
    _, near = cKDTree(few.p).query(samples.p, min(NEIGHBOURS, len(few)), workers=-1)
    smooth = sums[:, near].reshape(len(sums), len(samples), -1, 3).mean(axis=2)
    return medium.thin(smooth[0], smooth[-1])


def thin_slope(body: Body, samples: SurfaceSamples, name: str) -> np.ndarray | None:
    """Find how fast the logarithm of `thin_factor` changes with that of ``sigma_a``, ``sigma_s_prime`` or ``eta``; None if nowhere."""
    up, down = (thin_factor(body, samples, moved(body.medium, name, step)) for step in (STEP, -STEP))
    return None if up is None or down is None else (np.log(up) - np.log(down)) / (2 * STEP)


def warn_of_thin_parts(body: Body, who: str) -> None:
    """Warn of a body whose profile has a factor for thin parts that ``who`` leaves out."""
    if body.medium.flat_profile.is_curved:
        warn(
            f"{who} follows the curve of the body '{body.name}', but has no factor for thin parts, which come out too bright."
        )


def _sum_over_itself(body: Body, medium: Medium, samples: SurfaceSamples) -> np.ndarray:
    """Sum the curved profile of a medium over a body, at its samples: ``(n, 3) float``."""
    octree = build_octree(samples.p, samples.area, np.repeat(samples.area[:, None], 3, axis=1))
    p, n = mi.Point3f(*columns(samples.p)), mi.Normal3f(*columns(samples.n * np.float32(samples.outside)))
    table, stretch = table_of_samples(body, medium, samples), stretch_of_samples(body, samples)
    sums = gather(octree, table, p, MAX_ERROR, scattered=True, n=n, stretch=stretch)
    return np.stack([c.numpy() for c in sums], axis=1).astype(float)
