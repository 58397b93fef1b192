"""Where diffusion holds: warnings for media in which it is measurably wrong."""

from __future__ import annotations

import numpy as np

from ..errors import SampleCountError
from .dipole import Dipole
from .medium import CHANNELS, Medium

BRIGHT = 20.0
"""Diffuse mean free paths of so many mean free paths belong to media that hardly absorb."""

# Error of the dipole's total reflectance against photons, relative to the photons: the larger of g = 0 and g = 0.9.
# Measured by `python benchmarks/dipole_accuracy.py`; rows by index, columns by reduced albedo.
_ETAS = (1.0, 1.15, 1.3, 1.5, 1.8)
_ALBEDOS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
_ERRORS = np.array(
    [
        [0.51, 0.46, 0.40, 0.32, 0.27, 0.19, 0.14, 0.09, 0.06, 0.04, 0.02],
        [0.62, 0.24, 0.17, 0.15, 0.14, 0.12, 0.09, 0.07, 0.05, 0.04, 0.02],
        [1.61, 0.90, 0.50, 0.23, 0.11, 0.03, 0.04, 0.05, 0.04, 0.03, 0.02],
        [3.11, 1.94, 1.22, 0.70, 0.45, 0.20, 0.08, 0.01, 0.02, 0.02, 0.01],
        [6.41, 3.90, 2.51, 1.62, 1.17, 0.66, 0.35, 0.12, 0.04, 0.01, 0.01],
    ]
)
TOLERATED = 0.10
INVISIBLE = 0.01  # a channel that is off by less than this much reflectance is dark in truth and in the picture


def reflectance_error(albedo_prime: float, eta: float) -> float:
    """Estimate how far the dipole's total reflectance is off, relative to photons, whichever g the medium has.

    Interpolates the measured table; beyond its ends (reduced albedo below 0.1, index above 1.8) the last value stands.
    """
    by_eta = [np.interp(albedo_prime, _ALBEDOS, row) for row in _ERRORS]
    return float(np.interp(eta, _ETAS, by_eta))


def validity(medium: Medium) -> list[str]:
    """Say for which channels of a medium the dipole is off by more than 10 % in total reflectance, and what a table does not reach.

    Parameters
    ----------
    medium : Medium
        The medium about to be rendered.

    Returns
    -------
    list of str
        One warning a channel; empty where diffusion holds, or where the channel is too dark for the error to be seen. The tabulated
        profile has no such error: one warning for each of g and eta that lies beyond the table.
    """
    what = f"'{medium.name}'" if medium.name else "the medium"
    warnings = [
        f"{name} = {getattr(medium, name):g} of {what}: profiles are tabulated from {low:g} to {high:g}, and the nearest is taken, with "
        "the reduced coefficients as they are."
        for name, (low, high) in medium.flat_profile.known.items()
        if not low <= getattr(medium, name) <= high
    ]
    if not isinstance(medium.flat_profile, Dipole):
        return warnings
    rows = zip(CHANNELS, medium.albedo_prime, medium.total_diffuse_reflectance, strict=True)
    for channel, albedo_prime, reflectance in rows:
        error = reflectance_error(albedo_prime, medium.eta)
        if error > TOLERATED and error * reflectance > INVISIBLE:
            warnings.append(
                f"The {channel} channel of {what} absorbs too much for diffusion: at reduced albedo {albedo_prime:.2g} "
                f"and index {medium.eta:g} its reflectance can be off by {error:.0%}; compare it with 'volpathmis'."
            )
    return warnings


def check_reflectance(name: str, medium: Medium, shortest: float, samples: int) -> None:
    """Refuse a medium whose light is scattered so often because so little of it is absorbed that no sampling follows.

    Parameters
    ----------
    name : str
        The body, for the message.
    medium : Medium
        Per any unit of length.
    shortest : float
        The shortest mean free path for which there are samples enough, in that unit.
    samples : int
        How many the medium asks for.

    Raises
    ------
    SampleCountError
        When the reflectance is what is too high, with the largest one that works with the diffuse mean free path the same.
    """
    channel = int(np.argmin(medium.mfp))
    free, diffuse = float(medium.mfp[channel]), float(medium.dmfp[channel])
    if not (np.isfinite(diffuse) and diffuse > BRIGHT * free):
        return
    low, high = 0.0, float(medium.total_diffuse_reflectance[channel])
    for _ in range(30):
        middle = 0.5 * (low + high)
        works = Medium.from_reflectance(middle, diffuse, medium.eta, medium.g, medium.profile).mfp[0] >= shortest
        low, high = (middle, high) if works else (low, middle)
    if low > 0:
        raise SampleCountError(
            f"body '{name}' needs {samples:.2g} surface samples: with the reflectance "
            f"{medium.total_diffuse_reflectance[channel]:.4g} of its {CHANNELS[channel]} channel hardly any light is absorbed, "
            f"and it is scattered {diffuse / free:.0f} times within its diffuse mean free path. "
            f"Give a reflectance of at most {np.floor(low * 1000) / 1000:.3f}, a longer dmfp, or sample_count."
        )
