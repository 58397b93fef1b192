"""``pellucid cite``: the package and the papers to cite."""

from __future__ import annotations

import click

from ..citation import PAPERS, software_bibtex, software_line


@click.command()
@click.option("--bibtex", is_flag=True, help="As entries of a BibTeX file.")
def cite(bibtex: bool) -> None:
    """List the package and the papers that the methods come from."""
    if bibtex:
        click.echo("\n\n".join([software_bibtex(), *(paper.bibtex() for paper in PAPERS)]))
        return
    click.echo(software_line())
    for paper in PAPERS:
        click.echo(f"[{paper.key}] {paper.line()}\n    used for: {paper.used_for}")
