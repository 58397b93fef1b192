"""The measured materials: twelve solids and foods by reflection, and thirty-five liquids by dilution."""

from __future__ import annotations

import csv
import re
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from ..errors import MediumError, did_you_mean

Triple = tuple[float, float, float]

CHANNELS = ("red", "green", "blue")
CLEAR = 10.0
"""A mean free path longer than this makes a material nearly clear [mm]: a glass of it can be seen through."""
MOST_FORWARD = 0.95
"""No mean cosine beyond this one is given on: it is as far as profiles are known."""
WATER = 1.33


class MeasuredMaterial(NamedTuple):
    """One measured material, each value as red, green, blue.

    Attributes
    ----------
    sigma_s, sigma_a : (3,) float
        Scattering and absorption coefficient [1/mm].
    g : (3,) float
        Mean cosine of the scattering angle. Where it was not measured it is 0, and sigma_s is the reduced coefficient.
    eta : float
        Index of refraction.
    reflectance : (3,) float or None
        As published beside the coefficients.
    """

    sigma_s: Triple
    sigma_a: Triple
    g: Triple = (0.0, 0.0, 0.0)
    eta: float = 1.3
    reflectance: Triple | None = None

    @property
    def sigma_s_prime(self) -> Triple:
        """Reduced scattering coefficient ``(1 - g) sigma_s`` of every channel by its own g [1/mm]."""
        return _triple([(1 - g) * s for s, g in zip(self.sigma_s, self.g, strict=True)])

    @property
    def mean_g(self) -> float:
        """The one g of a medium: the mean over the channels that scatter, at most `MOST_FORWARD`."""
        known = [g for g, s in zip(self.g, self.sigma_s, strict=True) if s > 0]
        return min(float(np.mean(known)), MOST_FORWARD)

    @property
    def longest_free_path(self) -> float:
        """Longest mean free path ``1 / sigma_t`` of the three channels [mm]."""
        return float(1 / np.min(np.add(self.sigma_s, self.sigma_a)))

    @property
    def is_clear(self) -> bool:
        """Tell whether one sees through a body of a usual size."""
        return self.longest_free_path > CLEAR

    @property
    def unscattered(self) -> tuple[str, ...]:
        """Name the channels without scattering."""
        return tuple(channel for channel, s in zip(CHANNELS, self.sigma_s, strict=True) if s == 0)


def _solid(sigma_s_prime: Triple, sigma_a: Triple, reflectance: Triple, eta: float = 1.3) -> MeasuredMaterial:
    """Make a row of JMLH01 figure 5, which has reduced coefficients."""
    return MeasuredMaterial(sigma_s_prime, sigma_a, eta=eta, reflectance=reflectance)


# JMLH01 figure 5. Spectralon absorbs nothing; marble alone has an index of 1.5.
SOLIDS: dict[str, MeasuredMaterial] = {
    "apple": _solid((2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046), (0.85, 0.84, 0.53)),
    "chicken1": _solid((0.15, 0.21, 0.38), (0.015, 0.077, 0.19), (0.31, 0.15, 0.10)),
    "chicken2": _solid((0.19, 0.25, 0.32), (0.018, 0.088, 0.20), (0.32, 0.16, 0.10)),
    "cream": _solid((7.38, 5.47, 3.15), (0.0002, 0.0028, 0.0163), (0.98, 0.90, 0.73)),
    "ketchup": _solid((0.18, 0.07, 0.03), (0.061, 0.97, 1.45), (0.16, 0.01, 0.00)),
    "marble": _solid((2.19, 2.62, 3.00), (0.0021, 0.0041, 0.0071), (0.83, 0.79, 0.75), 1.5),
    "potato": _solid((0.68, 0.70, 0.55), (0.0024, 0.0090, 0.12), (0.77, 0.62, 0.21)),
    "skimmilk": _solid((0.70, 1.22, 1.90), (0.0014, 0.0025, 0.0142), (0.81, 0.81, 0.69)),
    "skin1": _solid((0.74, 0.88, 1.01), (0.032, 0.17, 0.48), (0.44, 0.22, 0.13)),
    "skin2": _solid((1.09, 1.59, 1.79), (0.013, 0.070, 0.145), (0.63, 0.44, 0.34)),
    "spectralon": _solid((11.6, 20.4, 14.9), (0.0, 0.0, 0.0), (1.00, 1.00, 1.00)),
    "wholemilk": _solid((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014), (0.91, 0.88, 0.76)),
}


def spelled(name: str) -> str:
    """Spell a name as it is typed: ``Head & Shoulders Shampoo`` is ``head_shoulders_shampoo``."""
    return re.sub(r"\W+", "_", name.lower()).strip("_")


def _read_liquids() -> dict[str, MeasuredMaterial]:
    """Read the media of NGDRNJ06 from the table of the package."""
    lines = files(__package__).joinpath("narasimhan2006.csv").read_text().splitlines()
    rows = {spelled(name): [float(v) for v in values] for name, *values in csv.reader(lines[2:])}
    return {name: MeasuredMaterial(_triple(v[:3]), _triple(v[3:6]), _triple(v[6:]), WATER) for name, v in rows.items()}


def _triple(values: list[float]) -> Triple:
    """Take three values for red, green and blue."""
    red, green, blue = values
    return red, green, blue


LIQUIDS: dict[str, MeasuredMaterial] = _read_liquids()
MATERIALS: dict[str, MeasuredMaterial] = SOLIDS | LIQUIDS
PRESETS: tuple[str, ...] = tuple(name for name, row in MATERIALS.items() if not (row.is_clear or row.unscattered))
"""Those that are fit for diffusion in every channel."""


def find_material(name: str) -> MeasuredMaterial:
    """Look a material up by its name, in any spelling.

    Raises
    ------
    MediumError
        For a name that is not in the table, with the nearest one that is, and for a material with a channel that does not
        scatter.

    Source
    ------
    JMLH01 figure 5; NGDRNJ06.
    """
    key = spelled(name)
    if key not in MATERIALS:
        hint = did_you_mean(key, MATERIALS) or f"; choose one of: {', '.join(PRESETS)}"
        raise MediumError(f"There is no measured material '{name}'{hint}.")
    row = MATERIALS[key]
    if row.unscattered:
        raise MediumError(
            f"'{key}' does not scatter in its {' and '.join(row.unscattered)} channel, and light that is not scattered is not "
            "diffuse: take Mitsuba's 'dielectric' with a 'homogeneous' medium inside and 'volpath', or another material."
        )
    return row


def clear_warning(name: str) -> str | None:
    """Say what is missing of a material that is nearly clear; None for one that is not."""
    row = find_material(name)
    if not row.is_clear:
        return None
    return (
        f"'{spelled(name)}' is nearly clear: light goes {row.longest_free_path:.0f} mm before it is scattered or absorbed, and "
        "what passes straight through a body is not drawn; compare it with 'volpath'."
    )
