"""What other formats mean by the colour and the radius of subsurface scattering, as media.

They share three definitions, and differ in the boundary that these leave out.

- The mean free path ``1 / sigma_t`` and a colour from which van de Hulst's formula gives the albedo: OpenPBR, the standard
  surface of MaterialX, glTF. The formula is that of a half space behind a boundary that reflects nothing. Behind their own
  boundary less comes back: of a colour of .5, .26 at an index of 1.5.
- A radius from which the free path follows, and a colour that comes back as it is, since the renderer scatters behind no
  boundary: the principled BSDF of Blender.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MediumError
from .medium import MIN_REFLECTANCE, Medium, _refuse

Array = NDArray[np.float64]

PRINCIPLED_METHODS = ("random_walk", "random_walk_skin", "burley")
LEAST_ALBEDO, MOST_ALBEDO = 0.2, 0.999999
"""Of the random walk of the principled BSDF."""

# A, the exponent of B, K, D, the exponent of E and L of `principled_albedo`, by powers of g from 0 to 7.
_WALK = np.array([
    [1.8260523782, -1.28451056436, -1.79904629312, 9.19393289202, -22.8215585862, 32.0234874259, -23.6264803333, 7.21067002658],
    [0, 31.1491581433, -201.847017512, 841.576016723, -2018.09288505, 2731.71560286, -1935.41424244, 559.009054474],
    [1.09686102424, -0.394704063468, 1.05258115941, -8.83963712726, 28.8643230661, -46.8802913581, 38.5402837518, -12.7181042538],
    [0.496310210422, 0.360146581622, -2.15139309747, 17.8896899217, -55.2984010333, 82.065982243, -58.5106008578, 15.8478295021],
    [0, 76.7316253952, -594.356773233, 2448.8834203, -5576.68528998, 7116.60171912, -4763.54467887, 1303.5318055],
    [2.40602999408, -2.51814844609, 9.18494908356, -79.2191708682, 259.082868209, -403.613804597, 302.85712436, -87.4370473567],
])  # fmt: skip


def colour_to_albedo(colour: ArrayLike, g: float = 0.0) -> Array:
    """Find the albedo of a half space behind matched indices that sends a colour back, by van de Hulst's formula.

    ``albedo = (1 - s^2) / (1 - g s^2)`` with ``s = 4.09712 + 4.20863 C - sqrt(9.59217 + 41.6808 C + 17.7126 C^2)``.

    Parameters
    ----------
    colour : (3,) float
        In [0, 1].
    g : float
        Mean cosine of the scattering angle.

    Returns
    -------
    (3,) float
        Albedo ``sigma_s / sigma_t``, at least 1e-7 as a channel must scatter.

    Source
    ------
    OpenPBR Surface 1.1, section Subsurface; KHR_materials_scatter, section Multi-Scatter Color.
    """
    c = np.asarray(colour, float)
    s2 = np.square(4.09712 + 4.20863 * c - np.sqrt(9.59217 + 41.6808 * c + 17.7126 * c * c))
    return np.clip((1 - s2) / (1 - g * s2), MIN_REFLECTANCE, 1.0)


def medium_of_colour(
    colour: ArrayLike, radius: ArrayLike, eta: float, g: float = 0.0, is_diffuse: bool = False
) -> Medium:
    """Make the medium of a colour and a mean free path.

    Parameters
    ----------
    colour : (3,) float
        As in `colour_to_albedo`.
    radius : (3,) float
        Mean free path ``1 / sigma_t`` [mm].
    eta, g : float
        Index of refraction, and mean cosine of the scattering angle.
    is_diffuse : bool
        The radius is the diffuse mean free path instead.

    Raises
    ------
    MediumError
        For a colour outside [0, 1], a radius that is not positive, and a diffuse mean free path without absorption.
    """
    colour, radius = (np.broadcast_to(np.asarray(v, float), 3) for v in (colour, radius))
    _refuse(~((colour >= 0) & (colour <= 1)), "colour", colour, "a colour lies between 0 and 1")
    _refuse(~((radius > 0) & np.isfinite(radius)), "radius", radius, "light must go some way: give a small length")
    _refuse(
        (colour == 1) & is_diffuse, "colour", colour, "without absorption there is no diffuse mean free path; give .99"
    )
    albedo = colour_to_albedo(colour, g)
    one = Medium((1 - g) * albedo, 1 - albedo, g, eta)  # in units of its mean free path
    length = one.dmfp if is_diffuse else np.ones(3)
    return Medium(one.sigma_s_prime * length / radius, one.sigma_a * length / radius, g, eta)


def principled_albedo(colour: ArrayLike, g: float = 0.0) -> Array:
    """Find the albedo that the principled BSDF's random walk has for a colour.

    ``albedo = (1 - q) A atan(B C)^K + q D atan(E C)^L`` with ``q = C^(1/4)``: Chiang, Kutz and Burley (2016), with the
    dependence on g of Wrenninge, Villemin and Hery (2017).

    Parameters
    ----------
    colour : (3,) float
    g : float
        In [0, .9].

    Returns
    -------
    (3,) float
        Albedo ``sigma_s / sigma_t``.
    """
    c = np.asarray(colour, float)
    a, b, k, d, e, f = np.polynomial.polynomial.polyval(g, _WALK.T)
    b, e = 4.98511194385 + 0.127355959438 * np.exp(b), 4.23190299701 + 0.00310603949088 * np.exp(e)
    q = c**0.25
    albedo = (1 - q) * a * np.arctan(b * c) ** k + q * d * np.arctan(e * c) ** f
    return np.clip(albedo, 0, MOST_ALBEDO)


def principled_dmfp(colour: ArrayLike, radius: ArrayLike, g: float = 0.0, method: str = "random_walk") -> Array:
    """Find the diffuse mean free path of a principled BSDF.

    For ``random_walk_skin`` the radius is that length. For the others ``sigma_t = 4 pi / ((1 - g) radius)``, with the albedo of
    `principled_albedo`, which is at least .2.

    Parameters
    ----------
    colour, radius : (3,) float
        Base colour; radius times scale, in any unit.
    g : float
        Anisotropy, in [0, .9].
    method : {"random_walk", "random_walk_skin", "burley"}

    Returns
    -------
    (3,) float
        In the unit of the radius.

    Raises
    ------
    MediumError
        For an unknown method, and for an anisotropy out of range.

    Source
    ------
    Blender's Cycles: the principled BSDF's random walk.
    """
    if method not in PRINCIPLED_METHODS:
        raise MediumError(f"subsurface_method = '{method}': it is one of {', '.join(PRINCIPLED_METHODS)}.")
    if not 0 <= g <= 0.9:
        raise MediumError(f"subsurface_anisotropy = {g:g}: it lies between 0 and 0.9.")
    if method == "random_walk_skin":
        return np.broadcast_to(np.asarray(radius, float), 3).copy()
    albedo = np.maximum(principled_albedo(colour, g), LEAST_ALBEDO)
    sigma_t = 4 * np.pi / ((1 - g) * np.asarray(radius, float))
    return Medium((1 - g) * albedo * sigma_t, (1 - albedo) * sigma_t, g, 1.0).dmfp
