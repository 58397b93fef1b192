"""What the boundary does to light: reflection at an angle, and its averages over diffuse light from either side."""

from __future__ import annotations

from typing import Any

import drjit as dr

# Below this index the closed form of the external reflectance loses digits, and a straight line is exact enough.
_NEARLY_MATCHED = 1.001


def fresnel_dielectric(cos_theta: Any, eta: Any) -> Any:
    """Reflect the fraction F of unpolarised light that meets a smooth dielectric boundary.

    Parameters
    ----------
    cos_theta : float or Dr.Jit float
        Cosine between the direction of the light and the normal; positive outside, negative inside the medium.
    eta : float or Dr.Jit float
        Index of the inside over the index of the outside.

    Returns
    -------
    float or Dr.Jit float
        Reflectance in [0, 1]; 1 where all light is reflected internally.

    Source
    ------
    Fresnel's equations, the mean of both polarisations.
    """
    ratio = dr.select(cos_theta >= 0, eta, dr.rcp(eta))  # far side over near side
    cos_near = dr.abs(cos_theta)
    cos_far_squared = 1 - (1 - cos_near * cos_near) / (ratio * ratio)
    cos_far = dr.sqrt(dr.maximum(cos_far_squared, 0))
    # The 1e-30 keeps 0/0 away at grazing incidence on a matched boundary.
    perpendicular = (cos_near - ratio * cos_far) / (cos_near + ratio * cos_far + 1e-30)
    parallel = (ratio * cos_near - cos_far) / (ratio * cos_near + cos_far + 1e-30)
    partial = 0.5 * (perpendicular * perpendicular + parallel * parallel)
    return dr.select(cos_far_squared > 0, partial, dr.select(ratio == 1, 0.0, 1.0))


def transmitted(cosine: Any, eta: Any) -> Any:
    """Evaluate the Fresnel transmittance into a medium: one less both reflectances, over one denominator."""
    cosine = dr.clip(cosine, 0, 1)
    within = dr.safe_sqrt(dr.fma(dr.square(cosine), dr.square(dr.rcp(eta)), 1 - dr.square(dr.rcp(eta))))
    across, along = dr.fma(eta, within, cosine), dr.fma(eta, cosine, within)
    both = dr.maximum(across * along, 1e-12)
    return 2 * eta * cosine * within * dr.square(dr.rcp(both)) * dr.fma(across, across, dr.square(along))


def fdr(eta: Any) -> Any:
    """Reflect the fraction F_dr of diffuse light that meets the boundary from *inside*.

    ``F_dr = -1.440 / eta^2 + 0.710 / eta + 0.668 + 0.0636 eta``, a fit to the exact average for eta in [1, 2].

    Source
    ------
    JB02 eq. 10. It belongs in the boundary mismatch A only; light that enters passes `external_diffuse_transmittance`.
    """
    return -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta


def boundary_mismatch(eta: Any) -> Any:
    """Relate fluence and flux at the boundary: ``A = (1 + F_dr) / (1 - F_dr)``.

    Source
    ------
    JB02, text after eq. 9 (Groenhuis et al. 1983).
    """
    reflected = fdr(eta)
    return (1 + reflected) / (1 - reflected)


def external_diffuse_transmittance(eta: float) -> float:
    """Let the fraction T_d of diffuse light pass that meets the boundary from *outside*.

    The cosine-weighted mean of ``1 - F`` over the hemisphere, in closed form. Light going the other way obeys
    ``1 - F_internal = T_d / eta^2``. The same T_d normalises the outgoing radiance:
    ``L_o = F_t(omega_o) / T_d * M_o / pi`` integrates back to the exitance ``M_o``.

    Source
    ------
    Walsh 1926; used where JB02 eqs. 13 and 14 print ``1 - F_dr`` and ``F_dr`` (see docs/theory/model.md).
    """
    if eta < _NEARLY_MATCHED:
        return 1 - (eta - 1) / (_NEARLY_MATCHED - 1) * (1 - external_diffuse_transmittance(_NEARLY_MATCHED))
    n = eta
    n2, n4 = n * n, n**4
    reflected = (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + n2 * (n2 - 1) ** 2 / (n2 + 1) ** 3 * dr.log((n - 1) / (n + 1))
        - 2 * n**3 * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1))
        + 8 * n4 * (n4 + 1) / ((n2 + 1) * (n4 - 1) ** 2) * dr.log(n)
    )
    return 1 - reflected
