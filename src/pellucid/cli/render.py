"""``pellucid render``: one picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..errors import OutputError
from ..jobs.job import Request
from ..jobs.output import check_files, save_film
from ..jobs.tiles import tile_path
from . import on_cluster
from .options import (
    FILE,
    check_cluster,
    cluster_options,
    denoise_option,
    method_options,
    one_method,
    picture_options,
    scene_options,
    session_options,
)
from .pieces import InPieces, PieceNumber, merge_command, piece_commands, print_commands
from .reporter import StageClock
from .session import session

EXAMPLES = """\b
SCENE is a scene file of Mitsuba (.xml), a mesh (.ply .obj .stl .glb .gltf .off),
which is put on a table under a lamp, or a built-in scene: teapot, teapot_env, ...

\b
Examples:
  pellucid render teapot -o teapot.png -o teapot.exr
  pellucid render teapot --material skin1 --resolution 640x480 --spp 16
  pellucid render bunny.ply --reflectance 0.8,0.5,0.3 --dmfp 3 --size 80
  pellucid render bunny.ply --material jade.mtlx --unit 10
  pellucid render scene.xml -D key=value -s 1 --method exact
  pellucid render teapot --cluster local:4
  pellucid render teapot --tile 3/16 -o teapot_3.exr
  pellucid render teapot --print-commands 16 > commands.txt
"""


@click.command(cls=InPieces, epilog=EXAMPLES)
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
@click.option(
    "--tile",
    type=PieceNumber(),
    help="Render one tile of the picture, K of N, to a file for 'pellucid merge'; -o names that file (.exr).",
)
@print_commands
@cluster_options
@one_method
@picture_options
@denoise_option
@method_options
@session_options
def render(
    outputs: tuple[Path, ...],
    tile: tuple[int, int] | None,
    commands: int | None,
    cluster: str | None,
    **options: Any,
) -> None:
    """Render SCENE to a picture.

    PNG and JPEG show it without its noise. EXR and HDR keep it as it was traced; an EXR also holds the layers denoised, albedo, normal,
    depth and exitance (not with --no-denoise, nor by the methods exact and sampled).
    """
    request = Request.from_options(options)
    request.check()
    check_cluster(cluster, request.sample_parts)
    if commands is not None:
        _print_commands(outputs or (Path(f"{request.name}.png"),), commands)
        return
    if tile and cluster:
        raise OutputError("--tile and --cluster: a cluster renders all tiles; leave one of the two options out.")
    outputs = _tile_file(request, outputs, *tile) if tile else outputs or (Path(f"{request.name}.png"),)
    check_files(outputs)
    with session(request.session) as clock:
        if cluster is not None:
            on_cluster.render_picture(cluster, request, outputs, clock)
        else:
            _render_here(request, outputs, tile, clock)
    if not request.session.quiet:
        click.echo(f"wrote {', '.join(str(path) for path in outputs)}")
        click.echo(clock.summary())


def _render_here(request: Request, outputs: tuple[Path, ...], tile: tuple[int, int] | None, clock: StageClock) -> None:
    """Render the picture or a tile of it."""
    with clock.stage("load"):
        job = request.load()
    with clock.stage("preparation"):
        integrator = job.integrator()
        job.prepare(integrator, *(tile or (1, 1)))
    if tile:
        rendered = job.render_tile(integrator, *tile)
        with clock.stage("writing"):
            rendered.write(outputs[0])
    else:
        layers = job.render(integrator, outputs)
        with clock.stage("writing"):
            save_film(job.sensor.film(), outputs, layers)


def _tile_file(request: Request, outputs: tuple[Path, ...], number: int, count: int) -> tuple[Path]:
    """Name the file of a tile."""
    if len(outputs) > 1 or any(path.suffix.lower() != ".exr" for path in outputs):
        raise OutputError(
            "--tile: a tile is one file, whose name ends in .exr; the picture is named to 'pellucid merge'."
        )
    return (outputs[0] if outputs else tile_path(Path(request.name), number, count),)


def _print_commands(outputs: tuple[Path, ...], count: int) -> None:
    """Print the commands of all tiles, and how they are merged."""
    files = [tile_path(outputs[0], number, count) for number in range(1, count + 1)]
    piece_commands([["--tile", f"{k}/{count}", "-o", str(path)] for k, path in enumerate(files, 1)])
    for output in outputs:
        merge_command(output, files)
