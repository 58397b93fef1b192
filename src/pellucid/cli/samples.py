"""``pellucid samples``: where the surface samples lie, and the light on them."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import Any

import click

from ..jobs.job import Request
from ..jobs.output import check_file, save_array
from .options import FILE, Resolution, method_options, scene_options, session_options
from .session import session

EXAMPLES = """\b
Examples:
  pellucid samples teapot
  pellucid samples bunny.ply --size 80 --material skin1 --sampling uniform -o uniform.png
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="FILE",
    help="Picture to write. Default: the name of the scene and '_samples.png'.",
)
@click.option("--resolution", type=Resolution(), help="Size of each of the two pictures.")
@method_options
@session_options
def samples(output: Path | None, **options: Any) -> None:
    """Draw the surface samples of SCENE.

    On the left every visible sample is a dot on the shaded object; on the right the object is coloured by the
    irradiance of the nearest sample.
    """
    request = Request.from_options(options)
    request.check()
    path = check_file(output or Path(f"{request.name}_samples.png"))
    with session(request.session) as clock:
        import numpy as np

        from ..methods.film import check_memory
        from ..methods.tiles import film_size
        from . import sample_picture as draw

        with clock.stage("load"):
            job = request.load()
            film = job.sensor.film()
            check_memory(film, prod(film_size(film)) * draw.SUPERSAMPLING**2)
        with clock.stage("preparation"):
            prepared = job.integrator("two_pass").prepare_scene(job.scene)
        with clock.stage("picture"):
            hits = draw.look(job.scene, job.sensor, prepared.lookup)
            dots = draw.dot_picture(job.scene, job.sensor, hits, prepared.bodies)
            light = draw.irradiance_picture(hits, prepared.bodies)
        save_array(np.concatenate([dots, light], axis=1), path)
    if not request.session.quiet:
        for lit in prepared.bodies:
            area = float(np.sum(lit.samples.area, dtype=float))
            click.echo(f"{lit.body.name}: {len(lit.samples.p)} samples on {area:.4g} square scene units")
        click.echo(f"wrote {path}")
        click.echo(clock.summary())
