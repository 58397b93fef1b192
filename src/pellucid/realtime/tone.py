"""From radiance to the screen."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


def tone_map(linear: Any, average: Any, exposure: Any = 0.0) -> Any:
    """Compress radiance into [0, 1): ``scaled / (1 + scaled)`` with ``scaled = 2^exposure L / average``.

    The result goes to the screen as it is: the curve takes the place of the screen's own.

    Parameters
    ----------
    linear : float, array or colour
        Radiance L, not negative. NumPy and Dr.Jit alike.
    average : float or Float
        Radiance that becomes one half, positive.
    exposure : float or Float
        Stops.

    Source: CLHHC08 section 3, where the fraction is printed upside down.
    """
    scaled = linear * (2.0**exposure / average)
    return scaled / (1 + scaled)


def average_radiance(flux: Any, area: Any) -> Any:
    """Estimate the average radiance of the picture: that of a white surface under the average irradiance.

    ``E'avg / (pi A)``: the paper takes E'avg itself, the integral of E', for a body of about unit area. Where no light
    enters at all the result is one.

    Parameters
    ----------
    flux : Float
        E'avg, the light that enters all bodies [W].
    area : float or Float
        Their surface A.

    Source: CLHHC08 section 3.
    """
    return dr.select(flux > 0, flux / (dr.pi * area), 1)


def to_bytes(colour: mi.Color3f) -> list[Any]:
    """Round a colour to three bytes; more than 1 is 1."""
    kind = dr.uint8_array_t(mi.Float)
    return [kind(mi.UInt32(dr.fma(dr.clip(c, 0, 1), 255, 0.5))) for c in colour]
