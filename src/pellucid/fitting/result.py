"""What a fit has found, as a file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..model.medium import Medium

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """A medium that was measured from photographs.

    Attributes
    ----------
    medium : Medium
        Its coefficients [1/mm].
    names : tuple of str
        What was fitted, one for each row of the covariance.
    values : (k,) float
        What was found for each [mm, 1/mm].
    covariance : (k, k) float
        Of the logarithms of what was fitted: of the noise, and of the model's own error.
    exposure : (n,) float
        By which the pictures of the medium are multiplied to be the photos.
    residual : float
        Root mean square of the difference between both, over the standard deviation that was expected of it.
    condition_number : float
        Of the problem: above 1000 the photos do not tell the parameters apart.
    differences : list of (h, w, 3) float
        Picture less photo, zero where the mask is.
    evaluations : int
        How often the medium was rendered.
    """

    medium: Medium
    names: tuple[str, ...]
    values: Array
    covariance: Array
    exposure: Array
    residual: float
    condition_number: float
    differences: list[Array]
    evaluations: int

    @property
    def standard_deviation(self) -> dict[str, float]:
        """Relative standard deviations by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def write(self, path: str | Path) -> None:
        """Write a material file (.json), which ``material`` of the BSDF and ``--material`` read."""
        medium = self.medium
        coefficients = {"sigma_a": medium.sigma_a.tolist(), "sigma_s_prime": medium.sigma_s_prime.tolist()}
        about = {
            "values": dict(zip(self.names, self.values.tolist(), strict=True)),
            "relative_standard_deviation": self.standard_deviation,
            "covariance_of_logarithms": self.covariance.tolist(),
            "exposure": self.exposure.tolist(),
            "residual": self.residual,
            "condition_number": self.condition_number,
        }
        _write(Path(path), medium, coefficients, about)

    def summary(self) -> list[str]:
        """Say what was found, line by line."""
        parts = zip(self.names, self.values, self.standard_deviation.values(), strict=True)
        lines = [f"{name:<16} {value:9.4g} {_unit(name):<4}  +- {100 * off:.1f} %" for name, value, off in parts]
        quality = f"residual {self.residual:.2g} standard deviations, condition number {self.condition_number:.1e}"
        return [*lines, quality]


@dataclass(frozen=True)
class TextureFit:
    """A texture of the reflectance that was measured from photographs.

    Attributes
    ----------
    texture : (h, w, 3) float
        The reflectance.
    told : (h, w) bool
        Which texels the photos tell of; the others are like their neighbours.
    medium : Medium
        That of the mean reflectance, with the diffuse mean free path of the scene [1/mm].
    residual, differences, evaluations
        As of `Fit`.
    """

    texture: Array
    told: NDArray[np.bool_]
    medium: Medium
    residual: float
    differences: list[Array]
    evaluations: int

    def write(self, path: str | Path) -> None:
        """Write a material file (.json), and beside it the reflectance (.exr), which ``material`` of the BSDF and ``--material`` read."""
        path = Path(path)
        picture = path.with_name(f"{path.stem}_reflectance.exr")
        mi.Bitmap(self.texture.astype(np.float32)).write(str(picture))
        given = {"reflectance": picture.name, "dmfp": self.medium.dmfp.tolist()}
        _write(path, self.medium, given, {"told": float(self.told.mean()), "residual": self.residual})

    def summary(self) -> list[str]:
        """Say what was found, line by line."""
        size = f"{self.texture.shape[1]}x{self.texture.shape[0]} texels, of {self.told.mean():.0%} of which the photos tell"
        return [size, f"residual {self.residual:.2g} standard deviations"]


def _unit(name: str) -> str:
    """Give the unit of a parameter."""
    return {"sigma_a": "1/mm", "sigma_s_prime": "1/mm", "dmfp": "mm"}.get(name.split(".")[0], "")


def _write(path: Path, medium: Medium, given: dict[str, Any], about: dict[str, Any]) -> None:
    """Write a material file: what describes the medium, and about the fit."""
    values = given | {"eta": medium.eta, "g": medium.g, "profile": medium.profile, "fit": about}
    path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
