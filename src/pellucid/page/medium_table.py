"""Profiles of all media as one small table, from which the page makes that of any slider position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.flat_profile import FlatProfile
from ..model.fresnel import external_diffuse_transmittance
from ..model.tabulated import NEAREST, read_curves
from .packing import Planes

G = np.array([-0.5, 0.0, 0.4, 0.7, 0.85, 0.95])
"""Mean cosines of the scattering angle: closer together where light is scattered forwards."""

ETA = np.linspace(1.0, 2.0, 11)
"""Indices of refraction."""

STEEPEST = float(np.sqrt(3))
ABSORPTION = STEEPEST * np.linspace(0, 1, 15) ** 2
"""``s = sqrt(3 (1 - a'))`` for reduced albedos a' from 1 to 0: closer together where media hardly absorb."""

LEVELS = 8191
"""Of the logarithms of profiles, in steps of 0.003, and of beta, in steps of 0.001."""

OCTAVES = (-7.0, 10.0)
PER_OCTAVE = 2
DISTANCE = 2.0 ** np.arange(OCTAVES[0], OCTAVES[1] + 1e-9, 1 / PER_OCTAVE)
"""Distances from where light enters [reduced mean free paths]; nearer, profiles go on as powers down to `NEAREST`."""

BLACKEST = 1e-4
"""The smallest reduced albedo: at 0 nothing comes back, and what is tabulated over a' has a limit."""

NOTHING = 1e-18
"""Of the largest value of a profile: what is less adds nothing to any sum."""


@dataclass(frozen=True)
class MediumTable:
    """What media do with light, for m mean cosines g, e indices of refraction and s albedos, per reduced albedo a'.

    In units of the reduced mean free path a medium is its albedo, its index and g. All entries are smooth, so that a polynomial through
    all of g and cubics through four neighbours along the other axes are exact to a few thousandths, where g is not negative.

    Attributes
    ----------
    profile : (m, e, s, d) float32
        ``log(R_d / a') + k d`` at the distances d, R_d over the square of the reduced extinction, k the decay.
    reflectance : (m, e, s) float32
        ``R / a'``, R the total diffuse reflectance.
    decay : (m, s) float32
        k, the reduced mean free path over the diffuse mean free path.
    transmittance : (e,) float32
        T_d of diffuse light from outside.
    curve : (e, s, c) float32, optional
        Beta, which does not depend on g, at the c distances at which it was measured, one an octave; between them it is a straight line.
        None where the profile knows of no curve.
    """

    profile: NDArray[np.float32]
    reflectance: NDArray[np.float32]
    decay: NDArray[np.float32]
    transmittance: NDArray[np.float32]
    curve: NDArray[np.float32] | None

    @classmethod
    def make(cls, flat: FlatProfile) -> MediumTable:
        """Tabulate media with one kind of profile."""
        absorption = np.minimum(ABSORPTION, np.sqrt(3 * (1 - BLACKEST)))
        albedo = 1 - absorption**2 / 3
        decay = np.array([[flat.decay(s, g) for s in absorption] for g in G])
        reflectance = np.array([[[flat.total(s, g, eta) for s in absorption] for eta in ETA] for g in G]) / albedo
        value = np.array([[[flat.density(DISTANCE, s, g, eta) for s in absorption] for eta in ETA] for g in G])
        profile = _without_decay(value / albedo[:, None], decay[:, None, :, None])
        transmittance = np.array([external_diffuse_transmittance(float(eta)) for eta in ETA])
        return cls(
            profile.astype(np.float32),
            reflectance.astype(np.float32),
            decay.astype(np.float32),
            transmittance.astype(np.float32),
            _curve(flat) if flat.is_curved else None,
        )

    def add_to(self, planes: Planes) -> dict[str, Any]:
        """Add all numbers to the planes of a page; return how it reads them, with the axes."""
        axes, levels = self.axes(), {"profile": _add_levels(planes, "table.profile", self.profile)}
        for name in ("reflectance", "decay", "transmittance"):
            planes.add(f"table.{name}", getattr(self, name))
        if self.curve is not None:
            levels["curve"] = _add_levels(planes, "table.curve", self.curve)
            octave = read_curves().octave
            axes |= {"bends": len(octave), "firstBend": float(octave[0])}
        return axes | {"levels": levels}

    @staticmethod
    def axes() -> dict[str, Any]:
        """Describe the axes to the page."""
        return {
            "g": G.tolist(),
            "nearest": NEAREST,
            "etas": len(ETA),
            "firstEta": float(ETA[0]),
            "etaStep": float(ETA[1] - ETA[0]),
            "albedos": len(ABSORPTION),
            "steepest": STEEPEST,
            "distances": len(DISTANCE),
            "firstOctave": OCTAVES[0],
            "perOctave": PER_OCTAVE,
        }


def _curve(flat: FlatProfile) -> NDArray[np.float32]:
    """Tabulate beta."""
    x = 2.0 ** read_curves().octave
    return np.array([[flat.curve(x, s, 0.0, eta) for s in ABSORPTION] for eta in ETA], np.float32)


def _add_levels(planes: Planes, name: str, values: NDArray[np.float32]) -> dict[str, float]:
    """Add numbers in `LEVELS` even steps; return where they begin, and the step."""
    low = float(values.min())
    step = (float(values.max()) - low) / LEVELS
    planes.add(name, np.rint((values - low) / step).astype(np.uint16), "delta")
    return {"low": low, "step": step}


def _without_decay(value: NDArray[np.float64], decay: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take the logarithm of profiles ``(..., d)`` less their exponential decay; where nothing is left it stays as it is."""
    seen = value > NOTHING * value.max(axis=-1, keepdims=True)
    last = np.where(seen, np.arange(value.shape[-1]), 0).max(axis=-1, keepdims=True)
    smooth = np.log(np.where(seen, value, 1)) + decay * DISTANCE
    return np.where(seen, smooth, np.take_along_axis(smooth, last, axis=-1))
