"""``pellucid compare``: several methods on one scene, their times, their errors, and where they differ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..errors import PellucidError
from ..jobs.job import Request
from ..jobs.output import PICTURES, check_file, check_folder, save_array
from ..methods import METHODS
from .options import FILE, Methods, method_options, picture_options, scene_options, session_options
from .session import session

DEFAULT_RESOLUTION = (320, 240)  # the exact sum costs samples times pixels

EXAMPLES = """\b
Examples:
  pellucid compare teapot --samples 20000
  pellucid compare scene.xml --methods two_pass,exact --max-error 0.1 -o compared/
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="FILE",
    help="Picture file; or a folder, which also gets the picture of each method.",
)
@click.option("--methods", type=Methods(), default=tuple(METHODS), help=f"Which. Default: {','.join(METHODS)}.")
@click.option(
    "--reference", metavar="NAME", help="The method to measure against. Default: exact, or else the last one."
)
@picture_options
@method_options
@session_options
def compare(output: Path | None, methods: tuple[str, ...], reference: str | None, **options: Any) -> None:
    """Render SCENE by several methods and compare them.

    All use the same camera, seed and samples a pixel. Without --resolution, the picture of a built-in scene or a mesh
    is 320x240. The picture written shows the methods side by side, in the order of the table, above their amplified
    differences to the reference.
    """
    request = Request.from_options(options)
    request.check()
    if not request.is_file:
        request.resolution = request.resolution or DEFAULT_RESOLUTION
    reference = _reference(methods, reference)
    path, folder = _destination(output, request.name)
    with session(request.session) as clock:
        from . import comparison

        with clock.stage("load"):
            job = request.load()
        results = [comparison.run(job, method, clock) for method in methods]
        truth = next(result.picture for result in results if result.method == reference)
        gains = [comparison.gain(result.picture, truth) for result in results]
        if folder is not None:
            for result in results:
                save_array(result.picture, folder / f"{result.method}.png")
                save_array(result.picture, folder / f"{result.method}.exr")
        save_array(comparison.composition(results, truth, gains), path)
    comparison.show(results, truth, gains, reference)
    click.echo(f"wrote {path}" + (f" and the pictures of the methods in {folder}" if folder else ""))


def _reference(methods: tuple[str, ...], asked: str | None) -> str:
    """Choose the method that the others are measured against."""
    if asked is None:
        return "exact" if "exact" in methods else methods[-1]
    if asked not in methods:
        raise PellucidError(f"--reference {asked}: it is not among the methods compared, {', '.join(methods)}.")
    return asked


def _destination(output: Path | None, name: str) -> tuple[Path, Path | None]:
    """Choose the file of the composition, and the folder for single pictures if there is one; both checked."""
    if output is None:
        return check_file(Path(f"{name}_compare.png")), None
    if output.suffix.lower() in PICTURES and not output.is_dir():
        return check_file(output), None
    check_folder(output, create=True)
    return check_file(output / "compare.png"), output
