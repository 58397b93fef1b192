"""``pellucid render``: one picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .job import Request
from .options import FILE, denoise_option, method_options, one_method, picture_options, scene_options, session_options
from .output import check_files, save_film
from .session import session

EXAMPLES = """\b
SCENE is a scene file of Mitsuba (.xml), a mesh (.ply .obj .stl .glb .gltf .off),
which is put on a table under a lamp, or a built-in scene: teapot, teapot_env, ...

\b
Examples:
  pellucid render teapot -o teapot.png -o teapot.exr
  pellucid render teapot --material skin1 --resolution 640x480 --spp 16
  pellucid render bunny.ply --reflectance 0.8,0.5,0.3 --dmfp 3 --size 80
  pellucid render scene.xml -D key=value -s 1 --method exact
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option(
    "-o",
    "--output",
    "outputs",
    type=FILE,
    metavar="FILE",
    multiple=True,
    help="Picture to write (.png .jpg .exr .hdr), several times if wanted. Default: the name of the scene, as .png.",
)
@one_method
@picture_options
@denoise_option
@method_options
@session_options
def render(outputs: tuple[Path, ...], **options: Any) -> None:
    """Render SCENE to a picture.

    PNG and JPEG show it without its noise. EXR and HDR keep it as it was traced; an EXR also holds the layers denoised, albedo, normal,
    depth and exitance.
    """
    request = Request.from_options(options)
    request.check()
    outputs = outputs or (Path(f"{request.name}.png"),)
    check_files(outputs)
    with session(request.session) as clock:
        with clock.stage("load"):
            job = request.load()
        with clock.stage("preparation"):
            integrator = job.integrator()
            job.prepare(integrator)
        layers = job.render(integrator, outputs)
        with clock.stage("writing"):
            save_film(job.sensor.film(), outputs, layers)
    if not request.session.quiet:
        click.echo(f"wrote {', '.join(str(path) for path in outputs)}")
        click.echo(clock.summary())
