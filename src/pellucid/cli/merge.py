"""``pellucid merge``: one picture of its tiles, or one video of its frames."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import OutputError
from ..jobs.frames import FrameFolder
from ..jobs.job import SessionOptions
from ..jobs.output import PICTURES, check_file, save_film, shows_denoised, write
from ..jobs.video import VIDEOS, encode, ffmpeg
from .options import FILE, fps_option
from .session import session

EXAMPLES = """\b
Examples:
  pellucid merge teapot.png teapot_tile_*.exr
  pellucid merge teapot.mp4 teapot_frames/
"""


@click.command(epilog=EXAMPLES)
@click.argument("output", type=FILE, metavar="OUT")
@click.argument("pieces", type=FILE, metavar="PIECES...", nargs=-1, required=True)
@fps_option
@click.option(
    "--denoise/--no-denoise", default=True, help="Take the noise out, as 'pellucid render' does. Default: yes."
)
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
def merge(output: Path, pieces: tuple[Path, ...], fps: float, denoise: bool, quiet: bool) -> None:
    """Put the picture or video OUT together from PIECES.

    A picture is made of the tiles of 'pellucid render --tile', and equals that of one run bit for bit. A video is made of folders
    of frames of 'pellucid turntable --range'.
    """
    check_file(output, (*PICTURES, *VIDEOS))
    if output.suffix.lower() in VIDEOS:
        ffmpeg()
        frames = _frames(pieces)
        write(output, lambda beside: encode(frames, beside, fps))
    else:
        with session(SessionOptions(quiet=quiet)):
            _merge_tiles(output, pieces, denoise)
    if not quiet:
        click.echo(f"wrote {output} ({len(pieces)} pieces)")


def _merge_tiles(output: Path, pieces: tuple[Path, ...], denoise: bool) -> None:
    """Read tiles and write their picture."""
    from ..jobs import tiles
    from ..methods.denoising import can_denoise

    film, layers = tiles.merge([tiles.Tile.read(path) for path in pieces])
    shown = layers if denoise and layers is not None and shows_denoised(output) and can_denoise() else None
    save_film(film, [output], shown)


def _frames(folders: tuple[Path, ...]) -> list[Path]:
    """Find all frames of a turn, which may lie in several folders of equal settings.

    Raises
    ------
    OutputError
        When one is missing, with its number.
    """
    opened = [FrameFolder.open(folder) for folder in folders]
    for other in opened[1:]:
        other.compare(opened[0].settings)
    found = [
        next((path for path in paths if path.is_file()), None) for paths in zip(*(f.paths for f in opened), strict=True)
    ]
    missing = [number for number, path in enumerate(found) if path is None]
    if missing:
        raise OutputError(
            f"{len(missing)} of {len(found)} frames are missing, the first is number {missing[0]}: render them."
        )
    return [path for path in found if path is not None]
