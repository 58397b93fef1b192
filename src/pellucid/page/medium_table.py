"""Profiles of all media as one small table, from which the page makes that of any slider position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.fresnel import external_diffuse_transmittance
from ..model.medium import Medium
from .packing import Planes

ETA = np.linspace(1.0, 2.0, 11)
"""Indices of refraction."""

STEEPEST = float(np.sqrt(3))
ABSORPTION = STEEPEST * np.linspace(0, 1, 17) ** 2
"""``s = sqrt(3 (1 - a'))`` for reduced albedos a' from 1 to 0: closer together where media hardly absorb."""

LEVELS = 65535
"""Of the logarithms of profiles: steps of 3e-4."""

OCTAVES = (-8.0, 10.0)
PER_OCTAVE = 3
DISTANCE = 2.0 ** np.arange(OCTAVES[0], OCTAVES[1] + 1e-9, 1 / PER_OCTAVE)
"""Distances from where light enters [reduced mean free paths]."""

BLACKEST = 1e-6
"""The smallest reduced albedo: at 0 nothing comes back, and the profile over a' has a limit."""

NOTHING = 1e-18
"""Of the largest value of a profile: what is less adds nothing to any sum."""


@dataclass(frozen=True)
class MediumTable:
    """What a medium does with light, for e indices of refraction and s albedos, per reduced albedo a'.

    In units of the reduced mean free path a medium is its albedo and its index alone. All entries are smooth, so that a
    cubic through four neighbours along each axis is exact to about 1e-3.

    Attributes
    ----------
    profile : (e, s, d) float32
        ``log(R_d / a') + s d`` at the distances d, R_d over the square of the reduced extinction.
    reflectance : (e, s) float32
        ``R / a'``, R the total diffuse reflectance.
    decay : (e, s) float32
        The reduced mean free path over the diffuse mean free path.
    transmittance : (e,) float32
        T_d of diffuse light from outside.
    """

    profile: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    decay: NDArray[np.float32]
    transmittance: NDArray[np.float32]

    @classmethod
    def make(cls, g: float = 0.0) -> MediumTable:
        """Tabulate media with the mean cosine g of the scattering angle."""
        shape = (len(ETA), len(ABSORPTION))
        profile, reflectance, decay = np.zeros((*shape, len(DISTANCE))), np.zeros(shape), np.zeros(shape)
        albedo = np.clip(1 - ABSORPTION**2 / 3, BLACKEST, 1)
        for e, eta in enumerate(ETA):
            for first in range(0, len(albedo), 3):  # a medium has three channels
                some = np.minimum(np.arange(first, first + 3), len(albedo) - 1)
                medium = Medium(albedo[some], 1 - albedo[some], g, float(eta))
                value = medium.diffuse_reflectance(DISTANCE) / albedo[some]
                profile[e, some] = _without_decay(value.T, ABSORPTION[some])
                reflectance[e, some] = medium.total_diffuse_reflectance / albedo[some]
                decay[e, some] = 1 / medium.dmfp
        transmittance = [external_diffuse_transmittance(float(eta)) for eta in ETA]
        return cls(*(np.asarray(values, np.float32) for values in (profile, reflectance, decay, transmittance)))

    def add_to(self, planes: Planes) -> dict[str, float]:
        """Add all numbers to the planes of a page; return how it reads them, with the axes."""
        low = float(self.profile.min())
        step = (float(self.profile.max()) - low) / LEVELS
        planes.add("table.profile", np.rint((self.profile - low) / step).astype(np.uint16), "delta")
        for name in ("reflectance", "decay", "transmittance"):
            planes.add(f"table.{name}", getattr(self, name))
        return self.axes() | {"low": low, "step": step}

    @staticmethod
    def axes() -> dict[str, float]:
        """Describe the axes to the page."""
        return {
            "etas": len(ETA),
            "firstEta": float(ETA[0]),
            "etaStep": float(ETA[1] - ETA[0]),
            "albedos": len(ABSORPTION),
            "steepest": STEEPEST,
            "distances": len(DISTANCE),
            "firstOctave": OCTAVES[0],
            "perOctave": PER_OCTAVE,
        }


def _without_decay(value: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take the logarithm of profiles ``(k, d)`` less their exponential decay; where nothing is left it stays as it is."""
    seen = value > NOTHING * value.max(axis=1, keepdims=True)
    last = np.where(seen, np.arange(value.shape[1]), 0).max(axis=1, keepdims=True)
    smooth = np.log(np.where(seen, value, 1)) + s[:, None] * DISTANCE
    return np.where(seen, smooth, np.take_along_axis(smooth, last, axis=1))
