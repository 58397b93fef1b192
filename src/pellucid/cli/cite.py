"""``pellucid cite``: the papers to cite."""

from __future__ import annotations

import click

from ..citation import PAPERS


@click.command()
@click.option("--bibtex", is_flag=True, help="As entries of a BibTeX file.")
def cite(bibtex: bool) -> None:
    """List the papers that the methods come from."""
    if bibtex:
        click.echo("\n\n".join(paper.bibtex() for paper in PAPERS))
        return
    for paper in PAPERS:
        click.echo(f"[{paper.key}] {paper.line()}\n    used for: {paper.used_for}")
