"""How far one picture is from another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import PellucidError


def _pair(picture: ArrayLike, reference: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read two pictures of one shape as float64."""
    a, b = np.asarray(picture, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape or a.size == 0:
        raise PellucidError(f"Two pictures are compared when they have one shape; found {a.shape} and {b.shape}.")
    return a, b


def rmse(picture: ArrayLike, reference: ArrayLike) -> float:
    """Take the root of the mean squared difference over all pixels and channels, in the unit of the pictures.

    Parameters
    ----------
    picture, reference : (h, w, 3) float
        Linear pictures, neither tone mapped nor clipped.

    Raises
    ------
    PellucidError
        For pictures of different shapes.

    Examples
    --------
    >>> rmse([[[1.0, 1.0, 4.0]]], [[[1.0, 1.0, 1.0]]])
    1.7320508075688772
    """
    a, b = _pair(picture, reference)
    return float(np.sqrt(np.mean(np.square(a - b))))


def relative_rmse(picture: ArrayLike, reference: ArrayLike) -> float:
    """Divide `rmse` by the mean of the reference: 0.01 is an error of one percent; infinite if the reference is black.

    Parameters
    ----------
    picture, reference : (h, w, 3) float
        Linear pictures, neither tone mapped nor clipped.

    Raises
    ------
    PellucidError
        For pictures of different shapes.
    """
    a, b = _pair(picture, reference)
    mean = float(np.mean(b))
    error = rmse(a, b)
    if mean == 0:
        return 0.0 if error == 0 else float("inf")
    return error / mean
