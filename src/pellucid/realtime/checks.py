"""What a frame can be made with: settings, cameras and sizes are refused here, in one line, before anything is computed."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from ..errors import PellucidError
from ..model.medium import Medium
from .source import METHODS, Camera, Settings

COUNTS = {"samples": (16, 1 << 24), "rings": (1, 1 << 10), "per_ring": (1, 1 << 10)}
NUMBERS = {"exposure": (-64, 64), "specular": (0, 1e6), "shininess": (0, 1e6), "importance_bound": (1e-12, 1e12)}
MOST_PIXELS = 1 << 26
FARTHEST = 1e9


def check_settings(settings: Settings) -> None:
    """Refuse settings that no frame can be made with.

    Raises
    ------
    PellucidError
    """
    if settings.method not in METHODS:
        raise PellucidError(f"method is one of {', '.join(METHODS)}; found '{settings.method}'.")
    for limits, kind, what in ((COUNTS, Integral, "a whole number"), (NUMBERS, Real, "a number")):
        for name, (least, most) in limits.items():
            value = getattr(settings, name)
            if not isinstance(value, kind) or not least <= float(value) <= most:
                raise PellucidError(f"{name} is {what} from {least:g} to {most:g}; found {value!r}.")


def check_medium(medium: Medium, size: float) -> None:
    """Refuse a medium [1/mm] whose mean free path does not go with the size of its body [mm] in any picture.

    Raises
    ------
    PellucidError
    """
    mfp = 1 / np.asarray(medium.sigma_t_prime, float)
    if not FARTHEST**-1 < mfp.min() / size <= mfp.max() / size < FARTHEST:
        raise PellucidError(
            f"A mean free path of {mfp.min():.3g} to {mfp.max():.3g} mm and a body of {size:.3g} mm are in no one picture: "
            f"one is at most {FARTHEST:g} times the other."
        )


def check_view(camera: Camera, resolution: tuple[int, int]) -> None:
    """Refuse a camera that sees nothing, and a size that no picture has.

    Raises
    ------
    PellucidError
    """
    for name in ("origin", "target", "up"):
        if not is_vector(getattr(camera, name)):
            raise PellucidError(f"The {name} of a camera is three finite numbers; found {getattr(camera, name)!r}.")
    if np.array_equal(np.asarray(camera.origin, np.float32), np.asarray(camera.target, np.float32)):
        raise PellucidError(f"A camera looks at a point other than its own; found {camera.target!r} for both.")
    if not isinstance(camera.fov, Real) or not 0 < camera.fov < 180:
        raise PellucidError(f"The angle of view of a camera lies between 0 and 180 degrees; found {camera.fov!r}.")
    if (
        not all(isinstance(n, Integral) and n >= 1 for n in resolution)
        or np.prod(resolution, dtype=float) > MOST_PIXELS
    ):
        raise PellucidError(
            f"A picture has at least one pixel and at most {MOST_PIXELS:,}; found {' x '.join(map(str, resolution))}."
        )


def is_vector(value: Any) -> bool:
    """Tell whether a value is three numbers that single precision can hold."""
    try:
        vector = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return False
    return vector.shape == (3,) and bool(np.all(np.abs(vector) < np.finfo(np.float32).max))
