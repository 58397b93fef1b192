"""How a medium depends on what ``mi.traverse`` shows of it: every quantity that light depends on, with gradients to the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import MediumError
from ..kernels.memory import opaque
from ..model.fresnel import external_diffuse_transmittance
from ..model.slopes import BOUND
from .material import COEFFICIENTS, REFLECTANCE, Description

STEP = 1e-4
"""Of parameters, relative, to both sides: the model is evaluated in double precision."""

Quantities = dict[str, NDArray[np.float64]]


@dataclass
class DifferentiatedMedium:
    """What light depends on, in scene units.

    Attributes
    ----------
    sigma_a, sigma_s_prime, reflectance : Color3f
    eta, t_d : Float
        Index of refraction, and diffuse transmittance from outside.
    is_curved : bool
        Whether the profile knows of the curve.
    """

    sigma_a: mi.Color3f
    sigma_s_prime: mi.Color3f
    reflectance: mi.Color3f
    eta: mi.Float
    t_d: mi.Float
    is_curved: bool

    def theta(self) -> dict[str, mi.Color3f]:
        """Name the logarithms that the profile depends on, where they have gradients."""
        found = {name: getattr(self, name) for name in (*COEFFICIENTS, "eta")}
        enabled = {name: v for name, v in found.items() if dr.grad_enabled(v)}
        if self.is_curved and enabled:
            enabled[BOUND] = dr.sum(self.sigma_a + self.sigma_s_prime)  # a factor changes no slope of a logarithm
        return {name: mi.Color3f(dr.log(dr.maximum(v, 1e-20))) for name, v in enabled.items()}


def differentiate(description: Description, scale: float, shown: dict[str, Any]) -> DifferentiatedMedium:
    """Follow the gradients of parameters to what light depends on.

    Parameters
    ----------
    description : Description
        The medium [1/mm].
    scale : float
        Millimetres to one scene unit.
    shown : dict
        The parameters, variables of Dr.Jit: of the description, and ``scale``.

    Raises
    ------
    MediumError
        For gradients of two descriptions at once, and for those of an absorption of 0.
    """
    enabled = [name for name in (*COEFFICIENTS, *REFLECTANCE, "eta", "scale") if dr.grad_enabled(shown[name])]
    _check(enabled, description)
    values = description.values(description.medium()) | {"scale": scale}
    kinds = {name: mi.Float if name in ("eta", "t_d") else mi.Color3f for name in quantities(description, scale)}
    results = {name: opaque(kinds[name], v) for name, v in quantities(description, scale).items()}
    for name in enabled:
        step = STEP * np.abs(np.asarray(values[name], float))
        up, down = (_changed(description, scale, name, values[name] + h) for h in (step, -step))
        change = shown[name] - dr.detach(shown[name])
        for key, kind in kinds.items():
            slope = (up[key] - down[key]) / (2 * step)
            if slope.any():
                results[key] = results[key] + opaque(kind, slope) * change
    return DifferentiatedMedium(**results, is_curved=description.medium().flat_profile.is_curved)


def quantities(description: Description, scale: float) -> Quantities:
    """Evaluate everything that light depends on, in scene units."""
    medium = description.medium().scaled(scale)
    return {
        "sigma_a": medium.sigma_a,
        "sigma_s_prime": medium.sigma_s_prime,
        "reflectance": medium.total_diffuse_reflectance,
        "eta": np.array([medium.eta]),
        "t_d": np.array([external_diffuse_transmittance(medium.eta)]),
    }


def _changed(description: Description, scale: float, name: str, value: Any) -> Quantities:
    """Evaluate everything for another value of one parameter."""
    if name == "scale":
        return quantities(description, float(value))
    return quantities(description.changed({name: float(value) if name == "eta" else value}), scale)


def _check(enabled: list[str], description: Description) -> None:
    """Refuse what has no gradient."""
    ways = [[name for name in names if name in enabled] for names in (COEFFICIENTS, REFLECTANCE)]
    if all(ways):
        raise MediumError(
            f"Gradients of {' and '.join(enabled)} were asked for at once: the ones follow from the others, keep one description."
        )
    if enabled and not description.medium().sigma_a.all():
        raise MediumError(
            "sigma_a = 0 in a channel has no gradient: the reflectance falls with its square root there; give a small value."
        )
