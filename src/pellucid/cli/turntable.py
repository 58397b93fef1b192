"""``pellucid turntable``: the camera goes around the object; samples and light are prepared once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..errors import EnvironmentProblem, OutputError, install
from .frames import FrameFolder
from .interrupts import interruptible
from .job import Job, Request
from .options import FILE, denoise_option, method_options, one_method, picture_options, scene_options, session_options
from .output import check_file, save_film, write
from .session import session

VIDEOS = (".mp4", ".mkv", ".mov")

EXAMPLES = """\b
Examples:
  pellucid turntable teapot --frames 60 -o teapot.mp4
  pellucid turntable bunny.ply --frames 36 --resolution 640x480 -o frames/
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option(
    "--frames",
    type=click.IntRange(1, 99999),
    metavar="N",
    default=36,
    show_default=True,
    help="Pictures in a full turn.",
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    default=24,
    show_default=True,
    help="For a video.",
)
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="FILE",
    help="Folder for PNGs, or a video (.mp4 .mkv .mov). Default: the name of the scene and '_turntable'.",
)
@one_method
@picture_options
@denoise_option
@method_options
@session_options
def turntable(frames: int, fps: float, output: Path | None, **options: Any) -> None:
    """Turn the camera around SCENE, once.

    The axis is the up axis of the scene, through the middle of its translucent objects. Each frame is written when it
    is done. The frames of a video are kept as PNGs until it is complete: after Ctrl-C they are found beside it. The same
    command goes on where it was interrupted; frames of other settings are never mixed with its own.
    """
    request = Request.from_options(options)
    request.check()
    output = output or Path(f"{request.name}_turntable")
    video = output if output.suffix else None
    if video is not None:
        check_file(video, VIDEOS)
        _ffmpeg()
    folder = FrameFolder(output.with_name(f"{output.stem}_frames") if video else output, request, frames)
    missing = folder.missing() if video else folder.missing() or list(range(frames))  # what is complete is done anew
    with session(request.session) as clock:
        if missing:
            with clock.stage("load"):
                job = request.load()
            with clock.stage("preparation"):
                integrator = job.integrator()
                job.prepare(integrator)
            _render_frames(job, integrator, folder, missing)
        if video is not None:
            with clock.stage("video"):
                write(video, lambda beside: _encode(folder.paths, beside, fps))
            folder.remove()
    if not request.session.quiet:
        there = f", {frames - len(missing)} of them were there" if len(missing) < frames else ""
        click.echo(f"wrote {video or folder.folder} ({frames} frames{there})")
        click.echo(clock.summary())


def _render_frames(job: Job, integrator: Any, folder: FrameFolder, missing: list[int]) -> None:
    """Render and write the frames that are missing. All use one seed: noise stands still instead of flickering."""
    import numpy as np

    from ..progress import steps
    from .orbit import Orbit

    orbit = Orbit.around(job.sensor, integrator.prepared.bodies)
    frames = len(folder.paths)

    def left() -> str:
        return f"{frames - len(folder.missing())} of {frames} frames are in '{folder.folder}': the same command goes on"

    with interruptible(left):
        for step, _ in steps("frames", [1] * len(missing), "frames"):
            orbit.place(job.sensor, 2 * np.pi * missing[step] / frames)
            path = folder.paths[missing[step]]
            layers = job.render(integrator, [path])
            save_film(job.sensor.film(), [path], layers)


def _ffmpeg() -> Any:
    """Import the writer of videos.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError:
        raise EnvironmentProblem(
            f"A video needs imageio-ffmpeg: {install('video')}, or name a folder for PNGs with -o."
        ) from None
    return imageio_ffmpeg


def _encode(frames: list[Path], path: Path, fps: float) -> None:
    """Encode frames; sizes that the codec cannot have (odd ones) are rounded down by a row or column.

    Raises
    ------
    OutputError
        When the encoder did not take all frames: it says so nowhere else.
    """
    import numpy as np
    from PIL import Image

    pictures = (np.array(Image.open(frame).convert("RGB")) for frame in frames)
    first = next(pictures)
    height, width = (n - n % 2 for n in first.shape[:2])
    ffmpeg = _ffmpeg()
    writer = ffmpeg.write_frames(
        str(path), (width, height), fps=fps, quality=8, macro_block_size=2, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        for picture in (first, *pictures):
            writer.send(np.ascontiguousarray(picture[:height, :width]))
    finally:
        writer.close()
    if not path.stat().st_size or ffmpeg.count_frames_and_secs(str(path))[0] != len(frames):
        raise OutputError(f"The video could not be encoded; its frames are in '{frames[0].parent}'.")
