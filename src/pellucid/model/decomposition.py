"""R_d split in two: what light does near where it enters, and what it does far away."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MediumError
from .medium import Medium

Array = NDArray[np.float64]

IMPORTANCE_BOUND = 0.1
"""Default of c [1/mm]. It gives the 2.4 mm that the paper prints for the red channel of skimmilk."""

STEEPNESS = 1.5
"""K [1/mm]: within a millimetre or two the weights change from near to far."""

GRID, NEAREST, FARTHEST = 513, 1e-3, 1e5  # where the largest root is looked for [mean free paths]
BISECTIONS = 50


@dataclass(frozen=True)
class Decomposition:
    """``R_d = R_l + R_g`` with ``R_l = R_d W_l``, ``R_g = R_d W_g``, one pair of weights for all channels.

    Attributes
    ----------
    radius : float
        R_p, at which both weights are one half [scene units]; 0 means that all of R_d is global.
    steepness : float
        K [1 / scene unit].

    Examples
    --------
    >>> split = decompose(Medium.from_preset("skimmilk"))
    >>> float(split.local_weight(split.radius)[0]), float(split.global_weight(0.0)[0].round(3))
    (0.5, 0.01)
    """

    radius: float
    steepness: float

    def local_weight(self, r: ArrayLike) -> Array:
        """Weigh the local part: ``W_l = 1 - e^{(r - R_p) K} / 2`` up to R_p, and ``e^{-(r - R_p) K} / 2`` beyond.

        As printed, the first line has the other sign in its exponent, jumps at R_p and is below zero near 0.

        Parameters
        ----------
        r : (...) float
            Distance from where the light enters [scene units].

        Returns
        -------
        (..., 1) float

        Source: CLHHC08 section 4.1.
        """
        return 1 - self.global_weight(r)

    def global_weight(self, r: ArrayLike) -> Array:
        """Weigh the global part, ``W_g = 1 - W_l``: ``(..., 1) float``. Source: CLHHC08 section 4.1."""
        beyond = (np.asarray(r, dtype=np.float64)[..., None] - self.radius) * self.steepness
        tail = 0.5 * np.exp(-np.abs(beyond))
        return np.where(beyond <= 0, tail, 1 - tail) if self.radius > 0 else np.ones_like(beyond)


def importance(medium: Medium, r: ArrayLike) -> Array:
    """Weigh R_d with the circumference of a circle: ``R_d(r) 2 pi r``, ``(..., 3) float`` [1 / scene unit].

    Source: CLHHC08 section 4.1.
    """
    return medium.diffuse_reflectance(r) * (2 * np.pi * np.asarray(r, dtype=np.float64)[..., None])


def equal_radii(medium: Medium, bound: float) -> Array:
    """Find in each channel the largest r with ``R_d(r) 2 pi r = c``: ``(3,) float``, 0 where there is none.

    Parameters
    ----------
    bound : float
        c [1 / scene unit].

    Raises
    ------
    MediumError
        For a bound that is not positive.

    Source: CLHHC08 section 4.1.
    """
    if not (np.isfinite(bound) and bound > 0):
        raise MediumError(f"importance_bound = {bound:g}: the bound c [1/mm] must be positive and finite.")
    # In each channel's own mean free paths; an r that is a column of the grid is looked up in all channels at once.
    grid = np.geomspace(NEAREST, FARTHEST, GRID)
    above = np.stack([importance(medium, grid * medium.mfp[k])[:, k] > bound for k in range(3)])
    last = GRID - 1 - np.argmax(above[:, ::-1], axis=1)
    low, high = grid[last] * medium.mfp, grid[np.minimum(last + 1, GRID - 1)] * medium.mfp
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        beyond = np.diagonal(importance(medium, middle)) < bound
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return np.where(above.any(axis=1), low, 0.0)


@lru_cache(maxsize=64)
def decompose(medium: Medium, bound: float = IMPORTANCE_BOUND, scale: float = 1.0) -> Decomposition:
    """Split the profile of a medium where its importance falls to a bound; R_p is the largest of its channels' roots.

    A medium whose importance is below the bound everywhere blurs so widely that a few samples serve all of its light:
    then nothing is local.

    Parameters
    ----------
    medium : Medium
        Per scene unit.
    bound : float
        c [1/mm]; with a smaller one more of R_d is local.
    scale : float
        Millimetres per scene unit.

    Raises
    ------
    MediumError
        For a bound that is not positive.

    Source: CLHHC08 section 4.1.
    """
    return Decomposition(float(equal_radii(medium, bound * scale).max()), STEEPNESS * scale)
