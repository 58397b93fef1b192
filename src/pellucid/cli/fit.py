"""``pellucid fit``: a material from photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..jobs.job import Request
from ..jobs.output import check_file, write
from .options import FILE, scene_options, session_options
from .session import session

EXAMPLES = """\b
Examples:
  pellucid fit wax.xml front.exr side.exr back.exr -o wax.json
  pellucid fit wax.xml front.exr --exposure shared -o wax.json
  pellucid fit bust.xml front.exr side.exr --parameters texture -o bust.json
  pellucid render bunny.ply --material wax.json
"""


PARAMETERS = ("coefficients", "reflectance", "texture")
EXPOSURES = ("known", "free", "shared")


@click.command(epilog=EXAMPLES)
@scene_options
@click.argument("photos", metavar="PHOTO...", type=FILE, nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="FILE",
    default=Path("material.json"),
    help="Material to write (.json); beside it, each picture less its photo (.exr).  [default: material.json]",
)
@click.option(
    "--mask", "masks", type=FILE, multiple=True, metavar="FILE", help="What counts of each photo; once a photo."
)
@click.option(
    "--parameters",
    type=click.Choice(PARAMETERS),
    default="coefficients",
    show_default=True,
    help="What is found: sigma_a and sigma_s_prime; reflectance and dmfp; or the bitmap of the reflectance, whose dmfp is known.",
)
@click.option(
    "--exposure",
    type=click.Choice(EXPOSURES),
    default="known",
    show_default=True,
    help="Whether photos have the radiance of the scene, or are each or all multiplied by an unknown number.",
)
@click.option("--linearise", is_flag=True, help="Take photos of 8 bits, and undo the curve of sRGB.")
@session_options
def fit(
    photos: tuple[Path, ...],
    output: Path,
    masks: tuple[Path, ...],
    parameters: Any,
    exposure: str,
    linearise: bool,
    **options: Any,
) -> None:
    """Find the translucent medium of SCENE from photographs of it, one a camera.

    The scene has the shape of the object, its light and its cameras, and a medium to begin from.
    """
    request = Request.from_options(options)
    request.check()
    check_file(output, (".json",))
    with session(request.session) as clock:
        from ..fitting.fit import fit as find

        with clock.stage("load"):
            scene = request.load().scene
        with clock.stage("fit"):
            found = find(scene, photos, masks or None, parameters=parameters, exposure=exposure, linearise=linearise)
        write(output, found.write)
        residuals = [output.with_name(f"{output.stem}_residual_{k}.exr") for k in range(len(photos))]
        for difference, file in zip(found.differences, residuals, strict=True):
            _show(difference, file)
    if not request.session.quiet:
        for line in found.summary():
            click.echo(line)
        click.echo(f"wrote {', '.join(map(str, [output, *residuals]))}")
        click.echo(clock.summary())


def _show(difference: Any, file: Path) -> None:
    """Write a picture less a photo."""
    import mitsuba as mi

    write(file, lambda path: mi.Bitmap(difference.astype("float32")).write(str(path)))
