"""The plot of ``pellucid materials``: a panel with the profile of each material, and the ranges over which all of them blur."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..jobs.output import write
from ..model.medium import Medium

COLORS = ("tab:red", "tab:green", "tab:blue")
COLUMNS = 4
FARTHEST = 100.0  # [mm]


def plot_media(media: list[Medium], path: Path) -> None:
    """Draw R_d(r) of every material, and beside the profiles a bar from its mean free path to its diffuse one."""
    import matplotlib.pyplot as plt

    rows = -(-len(media) // COLUMNS)
    figure: Any = plt.figure(figsize=(4 * COLUMNS, 2.2 * rows))
    profiles, ranges = figure.subfigures(1, 2, width_ratios=(3, 1))
    axes = profiles.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    profiles.subplots_adjust(0.07, 0.045, 0.99, 0.98, wspace=0.04, hspace=0.25)
    for axis, medium in zip(axes.flat, media, strict=False):
        _draw_profile(axis, medium)
    for axis in axes.flat[len(media) :]:
        axis.set_visible(False)
    profiles.supxlabel("distance r [mm]")
    profiles.supylabel("diffuse reflectance R_d(r) [1/mm²], by photons; dotted: by the dipole")
    _draw_ranges(ranges.subplots(), media)
    ranges.subplots_adjust(0.45, 0.045, 0.97, 0.98)
    write(path, lambda beside: figure.savefig(beside, dpi=100))
    plt.close(figure)


def _draw_profile(axis: Any, medium: Medium) -> None:
    """Draw R_d(r) in the colours of the channels: by the table of photons, and dotted by the dipole."""
    r = np.geomspace(0.01, 30, 200)
    dipole = Medium(medium.sigma_s_prime, medium.sigma_a, medium.g, medium.eta, profile="dipole")
    for kind, style in ((medium, "-"), (dipole, ":")):
        for values, color in zip(kind.diffuse_reflectance(r).T, COLORS, strict=True):
            axis.loglog(r, values, style, color=color)
    axis.set(title=medium.name, ylim=(1e-7, 1e3))
    axis.minorticks_off()
    axis.grid(alpha=0.3)


def _draw_ranges(axis: Any, media: list[Medium]) -> None:
    """Draw a bar from mfp to dmfp for every channel; without absorption it has no end."""
    for place, medium in enumerate(media):
        for k, color in enumerate(COLORS):
            end = min(medium.dmfp[k], FARTHEST)
            axis.plot([medium.mfp[k], end], [place + 0.25 * (k - 1)] * 2, color=color, linewidth=2)
    axis.set(xscale="log", xlim=(None, FARTHEST), xlabel="from mfp to dmfp [mm]", ylim=(len(media) - 0.5, -0.5))
    axis.set_yticks(range(len(media)), [medium.name for medium in media])
    axis.grid(alpha=0.3, axis="x")
