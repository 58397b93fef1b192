"""How fast the profile changes with the parameters of its medium: tables beside those of the profile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .medium import Medium
from .profiles import ProfileTable, curve_over_disc, mean_over_disc

STEP = 3e-2
"""Of the logarithm of a parameter, to both sides: a smaller one would see the least distance of the profile jump over nodes of means."""

EVERY = 8
"""So many entries lie between two for which the slope is found: it is smooth."""

BOUND = "bound"
"""Names what a curved profile depends on besides its slopes: the mean of sigma_t' over the channels, with which the largest mu grows."""


class Slopes(NamedTuple):
    """How fast a profile changes with the logarithm of one parameter theta, in the form of its tables.

    Attributes
    ----------
    value : (m, 4) float32
        ``d log R_d / d log theta`` in the middle of every entry for red, green and blue; zero where the profile is cut off.
    curve : (m, 4) float32, optional
        ``d beta / d log theta``: on a curved surface mu times this is added. None where the profile is flat.
    """

    value: NDArray[np.float32]
    curve: NDArray[np.float32] | None = None


def moved(medium: Medium, name: str, step: float) -> Medium:
    """Multiply ``sigma_a``, ``sigma_s_prime`` or ``eta`` of a medium by ``exp(step)``."""
    factor = {name: np.exp(step)}
    return Medium(
        medium.sigma_s_prime * factor.get("sigma_s_prime", 1.0),
        medium.sigma_a * factor.get("sigma_a", 1.0),
        medium.g,
        medium.eta * factor.get("eta", 1.0),
        profile=medium.profile,
    )


def log_slopes(medium: Medium, table: ProfileTable, name: str) -> Slopes:
    """Tabulate how fast the profile in a table changes.

    Factors on the profile add their own slopes to these. The largest mu is kept: it has a parameter of its own, `BOUND`.

    Parameters
    ----------
    medium : Medium
        Of which ``table`` was made, without a weight.
    name : str
        theta: ``sigma_a``, ``sigma_s_prime`` or ``eta``.
    """
    entry = np.arange(table.last, dtype=np.uint32)
    r = np.sqrt(np.maximum(table.middles(entry) - table.offset, 0) / table.inv_scale2)
    few = np.unique(np.append(entry[::EVERY], entry[-1]))
    media = [moved(medium, name, step) for step in (STEP, -STEP)]
    up, down = (mean_over_disc(each, r[few], table.disc, like=medium) for each in media)
    change = np.zeros_like(up)
    seen = (up > 0) & (down > 0)
    change[seen] = (np.log(up[seen]) - np.log(down[seen])) / (2 * STEP)
    value = np.stack([np.interp(entry, few, change[:, channel]) for channel in range(3)], axis=1)
    if table.curve is None:
        return Slopes(_rows_of(table, value))
    up, down = (curve_over_disc(each, r, table.disc, like=medium) for each in media)
    return Slopes(_rows_of(table, value), _rows_of(table, (up - down) / (2 * STEP)))


def _rows_of(table: ProfileTable, values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Lay values ``(last, 3)`` out in the form of a table, zero where that is cut off: ``(m, 4) float32``."""
    slopes = np.zeros((table.last + 1, 4), np.float32)
    slopes[: table.last, :3] = values
    return slopes
