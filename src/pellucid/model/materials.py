"""The twelve measured materials."""

from __future__ import annotations

from typing import NamedTuple

from ..errors import MediumError, did_you_mean

Triple = tuple[float, float, float]


class MeasuredMaterial(NamedTuple):
    """One row of the table: coefficients [1/mm] and the reflectance published beside them, as red, green, blue."""

    sigma_s_prime: Triple
    sigma_a: Triple
    reflectance: Triple
    eta: float = 1.3


# JMLH01 figure 5. Spectralon absorbs nothing; marble alone has an index of 1.5.
MATERIALS: dict[str, MeasuredMaterial] = {
    "apple": MeasuredMaterial((2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046), (0.85, 0.84, 0.53)),
    "chicken1": MeasuredMaterial((0.15, 0.21, 0.38), (0.015, 0.077, 0.19), (0.31, 0.15, 0.10)),
    "chicken2": MeasuredMaterial((0.19, 0.25, 0.32), (0.018, 0.088, 0.20), (0.32, 0.16, 0.10)),
    "cream": MeasuredMaterial((7.38, 5.47, 3.15), (0.0002, 0.0028, 0.0163), (0.98, 0.90, 0.73)),
    "ketchup": MeasuredMaterial((0.18, 0.07, 0.03), (0.061, 0.97, 1.45), (0.16, 0.01, 0.00)),
    "marble": MeasuredMaterial((2.19, 2.62, 3.00), (0.0021, 0.0041, 0.0071), (0.83, 0.79, 0.75), 1.5),
    "potato": MeasuredMaterial((0.68, 0.70, 0.55), (0.0024, 0.0090, 0.12), (0.77, 0.62, 0.21)),
    "skimmilk": MeasuredMaterial((0.70, 1.22, 1.90), (0.0014, 0.0025, 0.0142), (0.81, 0.81, 0.69)),
    "skin1": MeasuredMaterial((0.74, 0.88, 1.01), (0.032, 0.17, 0.48), (0.44, 0.22, 0.13)),
    "skin2": MeasuredMaterial((1.09, 1.59, 1.79), (0.013, 0.070, 0.145), (0.63, 0.44, 0.34)),
    "spectralon": MeasuredMaterial((11.6, 20.4, 14.9), (0.0, 0.0, 0.0), (1.00, 1.00, 1.00)),
    "wholemilk": MeasuredMaterial((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014), (0.91, 0.88, 0.76)),
}

PRESETS: tuple[str, ...] = tuple(MATERIALS)


def find_material(name: str) -> MeasuredMaterial:
    """Look a material up by its name.

    Raises
    ------
    MediumError
        For a name that is not in the table, with the nearest one that is.

    Source
    ------
    JMLH01 figure 5.
    """
    if name not in MATERIALS:
        hint = did_you_mean(name.lower(), PRESETS) or f"; choose one of: {', '.join(PRESETS)}"
        raise MediumError(f"There is no measured material '{name}'{hint}.")
    return MATERIALS[name]
