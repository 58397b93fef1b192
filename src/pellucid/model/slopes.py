"""How fast the profile changes with the parameters of its medium: a table beside that of the profile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .medium import Medium
from .profiles import ProfileTable, mean_over_disc

STEP = 3e-2
"""Of the logarithm of a parameter, to both sides: a smaller one would see the least distance of the profile jump over nodes of means."""

EVERY = 8
"""So many entries lie between two for which the slope is found: it is smooth."""


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


def log_slopes(medium: Medium, table: ProfileTable, name: str) -> NDArray[np.float32]:
    """Tabulate ``d log R_d / d log theta`` in the middle of every entry of a table.

    Factors on the profile add their own slopes to these.

    Parameters
    ----------
    medium : Medium
        Of which ``table`` was made, without a weight.
    name : str
        theta: ``sigma_a``, ``sigma_s_prime`` or ``eta``.

    Returns
    -------
    (m, 4) float32
        For red, green and blue, in the form of ``table.values``; zero where the profile is cut off.
    """
    entry = np.unique(np.append(np.arange(0, table.last, EVERY), table.last - 1)).astype(np.uint32)
    r = np.sqrt(np.maximum(table.middles(entry) - table.offset, 0) / table.inv_scale2)
    up, down = (mean_over_disc(moved(medium, name, step), r, table.disc, like=medium) for step in (STEP, -STEP))
    change = np.zeros_like(up)
    seen = (up > 0) & (down > 0)
    change[seen] = (np.log(up[seen]) - np.log(down[seen])) / (2 * STEP)
    slopes = np.zeros((len(table.values), 4), np.float32)
    for channel in range(3):
        slopes[: table.last, channel] = np.interp(np.arange(table.last), entry, change[:, channel])
    return slopes
