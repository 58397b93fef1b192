"""``pellucid export``: a page that shows the scene in real time, in one file for any browser."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import warn
from ..jobs.job import Request
from ..jobs.output import check_file, write
from .options import FILE, scene_options, session_options
from .session import session

EXAMPLES = """\b
Examples:
  pellucid export bunny.ply -o bunny.html
  pellucid export bunny.ply --material skin1 --size 30
  pellucid export antique_head --reflectance 0.8,0.5,0.3 --dmfp 1.5
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option(
    "-o", "--output", type=FILE, metavar="FILE", help="Page to write (.html). Default: the name of the scene, as .html."
)
@session_options
def export(output: Path | None, **options: Any) -> None:
    """Write a page that shows SCENE in real time in any browser.

    One file that needs no server and no network: it turns, lights, and changes the material and the size of one translucent
    object. What it shows otherwise than the scene has it is said.
    """
    request = Request.from_options(options)
    request.check()
    output = output or Path(f"{request.name}.html")
    check_file(output, (".html",))
    with session(request.session) as clock:
        from ..methods.thin import warn_of_thin_parts
        from ..page.assemble import page
        from ..page.scene import page_scene
        from ..page.still import still_picture

        with clock.stage("load"):
            job = request.load()
        with clock.stage("preparation"):
            contents = page_scene(job.scene, request.name, job.sensor)
            still = still_picture(job.scene, contents.camera)
        warn_of_thin_parts(contents.body, "The page")
        for note in contents.notes:
            warn(f"On the page, {note}.")
        with clock.stage("writing"):
            text = page(contents, still=still, command=shlex.join(["pellucid", *sys.argv[1:]]))
            write(output, lambda path: path.write_text(text, encoding="utf-8"))
    if not request.session.quiet:
        click.echo(f"wrote {output} ({len(text.encode()) / 1e3:.0f} kB)")
        click.echo(clock.summary())
