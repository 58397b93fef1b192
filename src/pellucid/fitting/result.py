"""What a fit has found, as a file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
        values: dict[str, Any] = {
            "sigma_a": medium.sigma_a.tolist(),
            "sigma_s_prime": medium.sigma_s_prime.tolist(),
            "eta": medium.eta,
            "g": medium.g,
            "profile": medium.profile,
            "fit": {
                "relative_standard_deviation": self.standard_deviation,
                "covariance_of_logarithms": self.covariance.tolist(),
                "exposure": self.exposure.tolist(),
                "residual": self.residual,
                "condition_number": self.condition_number,
            },
        }
        Path(path).write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
