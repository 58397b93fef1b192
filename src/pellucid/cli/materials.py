"""``pellucid materials``: the measured materials, as a table and as a plot of their profiles."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from ..errors import EnvironmentProblem, install
from .options import FILE
from .output import check_file, write
from .tables import print_table

PLOTS = (".png", ".pdf", ".svg")


@click.command()
@click.option(
    "--plot", type=FILE, metavar="FILE", help="Draw the profiles R_d(r) to a file (.png .pdf .svg). Needs matplotlib."
)
def materials(plot: Path | None) -> None:
    """List the measured materials.

    Coefficients and lengths are given as red, green, blue. R_d is the share of the entering light that comes out
    again; mfp and dmfp are the mean free path 1/sigma_t' and the diffuse mean free path 1/sigma_tr, the distance over
    which the material blurs.
    """
    if plot is not None:
        check_file(plot, PLOTS)
        _matplotlib()
    from ..model.materials import MATERIALS
    from ..model.medium import Medium

    media = {name: Medium.from_preset(name) for name in MATERIALS}
    header = ("material", "sigma_s' [1/mm]", "sigma_a [1/mm]", "R_d", "mfp [mm]", "dmfp [mm]", "eta")
    rows = [
        (
            name,
            _triple(medium.sigma_s_prime),
            _triple(medium.sigma_a),
            _triple(medium.total_diffuse_reflectance, ".2f"),
            _triple(medium.mfp),
            _triple(medium.dmfp),
            f"{medium.eta:g}",
        )
        for name, medium in media.items()
    ]
    print_table(header, rows)
    if plot is not None:
        _plot(media, plot)
        click.echo(f"wrote {plot}")


def _triple(values: Iterable[float], form: str = ".3g") -> str:
    """Write three numbers; a medium that absorbs nothing has an infinite dmfp."""
    return " ".join(f"{value:{form}}" for value in values)


def _matplotlib() -> Any:
    """Import matplotlib.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise EnvironmentProblem(f"--plot needs matplotlib: {install('plot')}.") from None
    matplotlib.use("Agg")
    return matplotlib


def _plot(media: dict[str, Any], path: Path) -> None:
    """Draw R_d(r) of every material, a panel each, in the colours of the channels."""
    _matplotlib()
    import matplotlib.pyplot as plt
    import numpy as np

    r = np.geomspace(0.01, 30, 200)
    figure, axes = plt.subplots(3, 4, figsize=(12, 8), sharex=True, sharey=True, layout="constrained")
    for axis, (name, medium) in zip(axes.flat, media.items(), strict=True):
        for channel, color in enumerate(("tab:red", "tab:green", "tab:blue")):
            axis.loglog(r, medium.diffuse_reflectance(r)[:, channel], color=color)
        axis.set(title=name, ylim=(1e-7, 1e3))
        axis.grid(alpha=0.3)
    figure.supxlabel("distance r [mm]")
    figure.supylabel("diffuse reflectance R_d(r) [1/mm²]")
    write(path, lambda beside: figure.savefig(beside, dpi=120))
    plt.close(figure)
