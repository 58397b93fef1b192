"""``pellucid materials``: the measured materials, as a table and as a plot of their profiles."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import import_optional, install
from ..jobs.output import check_file
from .options import FILE
from .tables import print_table

if TYPE_CHECKING:
    from ..model.medium import Medium

PLOTS = (".png", ".pdf", ".svg")
HEADER = ("material", "sigma_s' [1/mm]", "sigma_a [1/mm]", "R_d", "mfp [mm]", "dmfp [mm]", "g", "eta")


@click.command()
@click.option(
    "--plot",
    type=FILE,
    metavar="FILE",
    help="Draw the profiles R_d(r), the dipole beside them, and the ranges of the free paths (.png .pdf .svg). Needs matplotlib.",
)
def materials(plot: Path | None) -> None:
    """List the measured materials.

    Coefficients and lengths are given as red, green, blue. R_d is the share of the entering light that comes out
    again; mfp and dmfp are the mean free path 1/sigma_t' and the diffuse mean free path 1/sigma_tr, the distance over
    which the material blurs; g is the mean cosine of the scattering angle, 0 where it was not measured. Names are taken in
    any spelling: 'Lowfat Milk' is lowfat_milk.
    """
    if plot is not None:
        check_file(plot, PLOTS)
        _matplotlib()
    from ..model.materials import CLEAR, LIQUIDS, MATERIALS, PRESETS, SOLIDS
    from ..model.medium import Medium

    groups = {
        "Solids and foods (Jensen et al. 2001)": [name for name in SOLIDS if name in PRESETS],
        "Liquids (Narasimhan et al. 2006)": [name for name in LIQUIDS if name in PRESETS],
        f"Nearly clear, drawn with a warning: light goes more than {CLEAR:g} mm between two events": [
            name for name, row in MATERIALS.items() if row.is_clear and not row.unscattered
        ],
    }
    for title, names in groups.items():
        click.echo(f"{title}:")
        print_table(HEADER, [_row(Medium.from_preset(name)) for name in names])
    refused = [f"{name} ({', '.join(row.unscattered)})" for name, row in MATERIALS.items() if row.unscattered]
    click.echo(f"Refused, as a channel does not scatter: {', '.join(refused)}.")
    if plot is not None:
        from .material_plot import plot_media

        plot_media([Medium.from_preset(name) for name in PRESETS], plot)
        click.echo(f"wrote {plot}")


def _row(medium: Medium) -> tuple[str, ...]:
    """Write one material."""
    return (
        medium.name or "",
        _triple(medium.sigma_s_prime),
        _triple(medium.sigma_a),
        _triple(medium.total_diffuse_reflectance, ".2f"),
        _triple(medium.mfp),
        _triple(medium.dmfp),
        f"{medium.g:.2g}",
        f"{medium.eta:g}",
    )


def _triple(values: Iterable[float], form: str = ".3g") -> str:
    """Write three numbers; a medium that absorbs nothing has an infinite dmfp."""
    return " ".join(f"{value:{form}}" for value in values)


def _matplotlib() -> None:
    """Import matplotlib.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    import_optional("matplotlib", f"--plot needs matplotlib: {install('plot')}.").use("Agg")
