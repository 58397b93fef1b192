"""Light that scatters once: as a BRDF, and exactly along the refracted ray."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from .fresnel import fresnel_dielectric
from .medium import Medium


def henyey_greenstein(cos_theta: Any, g: float) -> Any:
    """Scatter into directions that enclose an angle with the old one; integrates to 1 over the sphere [1/sr].

    Source
    ------
    Henyey and Greenstein 1941; ``cos_theta`` is 1 for light that goes straight on, and its mean is g (JB02 eq. 3).
    """
    squared = 1 + g * g - 2 * g * cos_theta
    return (1 - g * g) / (4 * dr.pi * squared * dr.sqrt(squared))


def _inside(cos_theta: Any, eta: float) -> Any:
    """Cosine to the normal of the refracted direction inside (Snell)."""
    return dr.sqrt(dr.maximum(1 - (1 - cos_theta * cos_theta) / (eta * eta), 0))


def _boundary(medium: Medium, omega_in: Any, omega_out: Any) -> tuple[Any, Any, Any]:
    """Refract both directions: the phase function between them, and the cosine inside of each."""
    eta = medium.eta
    mu_in, mu_out = _inside(omega_in.z, eta), _inside(omega_out.z, eta)
    cos_scatter = -(omega_in.x * omega_out.x + omega_in.y * omega_out.y) / (eta * eta) - mu_in * mu_out
    return henyey_greenstein(cos_scatter, medium.g), mu_in, mu_out


def brdf(medium: Medium, omega_in: Any, omega_out: Any) -> tuple[Any, Any, Any]:
    """Reflect light that scatters once in a half space, as if it left where it entered.

    ``f = alpha F_t(omega_in) F_t(omega_out) p(cos) / (eta^2 (mu_in + mu_out))``, with mu the cosines after refraction.
    The ``1 / eta^2`` is what radiance loses on leaving the denser side; the papers leave it out, energy asks for it.

    Parameters
    ----------
    medium : Medium
        Its unreduced albedo and its g count here.
    omega_in, omega_out : Dr.Jit 3-vector
        Directions to the light and to the eye in the frame of the surface, both unit length.

    Returns
    -------
    tuple of three Dr.Jit floats
        The BRDF for red, green and blue [1/sr], without the cosine; zero where a direction lies below the surface.

    Source
    ------
    Hanrahan and Krueger 1993 (semi-infinite slab); JMLH01, single scattering as a BRDF.
    """
    phase, mu_in, mu_out = _boundary(medium, omega_in, omega_out)
    transmitted = 1 - fresnel_dielectric(omega_in.z, medium.eta)
    transmitted *= 1 - fresnel_dielectric(omega_out.z, medium.eta)
    above = (omega_in.z > 0) & (omega_out.z > 0)
    shape = transmitted * phase / (medium.eta**2 * dr.maximum(mu_in + mu_out, 1e-20))
    shape = dr.select(above, shape, 0)
    red, green, blue = (float(albedo) * shape for albedo in medium.albedo)
    return red, green, blue


def exact_radiance(
    medium: Medium,
    channel: int,
    omega_in: Any,
    omega_out: Any,
    irradiance: Callable[[Any, Any], Any],
    node_count: int = 64,
) -> Any:
    """Follow the refracted outgoing ray into a half space and gather, at every depth, the light that scatters into it.

    ``L_o = sigma_s F_t F_t / eta^2 p / mu_in int_0^inf exp(-sigma_t (s + s_in)) E(x_in(s)) ds``, with E the irradiance
    where the light that reaches depth ``s mu_out`` has entered, and ``s_in = s mu_out / mu_in`` its way inside.

    Parameters
    ----------
    medium : Medium
        Coefficients [1/mm].
    channel : int
        0, 1, 2 for red, green, blue.
    omega_in, omega_out : Dr.Jit 3-vector
        Directions to the light and to the eye, unit length, both above the surface; the eye sees the origin.
    irradiance : callable
        Irradiance on the surface from ``omega_in`` as a function of its coordinates ``(x, y)`` [mm].
    node_count : int
        Nodes of the Gauss-Laguerre quadrature over optical depth.

    Returns
    -------
    Dr.Jit float
        Radiance that leaves the origin towards ``omega_out``; over a uniform irradiance it equals `brdf` times it.

    Source
    ------
    JMLH01, single-scattering term. The light is refracted exactly here, which is possible because the surface is flat.
    """
    eta = medium.eta
    sigma_s, sigma_t = float(medium.sigma_s[channel]), float(medium.sigma_t[channel])
    phase, mu_in, mu_out = _boundary(medium, omega_in, omega_out)
    transmitted = 1 - fresnel_dielectric(omega_in.z, eta)
    transmitted *= 1 - fresnel_dielectric(omega_out.z, eta)

    decay = sigma_t * (1 + mu_out / mu_in)  # both ways grow with s, so that one exponential covers them
    gathered = dr.zeros(type(omega_in.z))
    for node, weight in zip(*np.polynomial.laguerre.laggauss(node_count), strict=True):
        s = float(node) / decay
        way_in = s * mu_out / mu_in
        x = (omega_in.x * way_in - omega_out.x * s) / eta
        y = (omega_in.y * way_in - omega_out.y * s) / eta
        gathered += float(weight) * irradiance(x, y)
    return sigma_s * transmitted * phase / (eta * eta * mu_in * decay) * gathered
