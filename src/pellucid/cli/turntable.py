"""``pellucid turntable``: the camera goes around the object; samples and light are prepared once."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from ..errors import OutputError
from ..jobs.frames import FrameFolder
from ..jobs.job import Request
from ..jobs.output import check_file, save_film, write
from ..jobs.video import VIDEOS, encode, ffmpeg
from . import on_cluster
from .interrupts import interruptible
from .options import (
    FILE,
    check_cluster,
    cluster_options,
    denoise_option,
    fps_option,
    method_options,
    one_method,
    picture_options,
    scene_options,
    session_options,
)
from .pieces import FrameRange, InPieces, merge_command, piece_commands, print_commands
from .reporter import StageClock
from .session import session

EXAMPLES = """\b
Examples:
  pellucid turntable teapot --frames 60 -o teapot.mp4
  pellucid turntable bunny.ply --frames 36 --resolution 640x480 -o frames/
  pellucid turntable teapot --frames 60 --range 12-24 -o frames/
  pellucid turntable teapot --frames 60 -o teapot.mp4 --print-commands 5 > commands.txt
"""


@click.command(cls=InPieces, epilog=EXAMPLES)
@scene_options
@click.option(
    "--frames",
    type=click.IntRange(1, 99999),
    metavar="N",
    default=36,
    show_default=True,
    help="Pictures in a full turn.",
)
@fps_option
@click.option(
    "-o",
    "--output",
    type=FILE,
    metavar="FILE",
    help="Folder for PNGs, or a video (.mp4 .mkv .mov). Default: the name of the scene and '_turntable'.",
)
@click.option("--range", "part", type=FrameRange(), help="Only these frames of the turn, to a folder; the first is 0.")
@print_commands
@cluster_options
@one_method
@picture_options
@denoise_option
@method_options
@session_options
def turntable(
    frames: int,
    fps: float,
    output: Path | None,
    part: range | None,
    commands: int | None,
    cluster: str | None,
    **options: Any,
) -> None:
    """Turn the camera around SCENE, once.

    The axis is the up axis of the scene, through the middle of its translucent objects. Each frame is written when it
    is done. The frames of a video are kept as PNGs until it is complete: after Ctrl-C they are found beside it. The same
    command goes on where it was interrupted; frames of other settings are never mixed with its own. Several commands
    that render a --range each may share a folder.
    """
    request = Request.from_options(options)
    request.check()
    check_cluster(cluster, request.sample_parts)
    output = output or Path(f"{request.name}_turntable")
    video = output if output.suffix else None
    place = output.with_name(f"{output.stem}_frames") if video else output
    if commands is not None:
        _print_commands(video, place, frames, fps, commands)
        return
    if part is not None:
        _check_range(part, frames, video)
    if video is not None:
        check_file(video, VIDEOS)
        ffmpeg()
    folder = FrameFolder(place, request.settings(), frames)
    wanted = part or range(frames)
    missing = [frame for frame in folder.missing() if frame in wanted]
    if not missing and part is None and video is None:
        missing = list(wanted)  # what is complete is done anew
    with folder.unless_it_fails(), session(request.session) as clock, interruptible(folder.left):
        if missing and cluster is not None:
            on_cluster.render_frames(cluster, request, folder, missing)
        elif missing:
            _render_frames(request, folder, missing, clock)
        if video is not None:
            with clock.stage("video"):
                write(video, lambda beside: encode(folder.paths, beside, fps))
            folder.remove()
    if not request.session.quiet:
        there = f", {len(wanted) - len(missing)} of them were there" if len(missing) < len(wanted) else ""
        click.echo(f"wrote {video or folder.folder} ({len(wanted)} frames{there})")
        click.echo(clock.summary())


def _check_range(part: range, frames: int, video: Path | None) -> None:
    """Check that some frames can be rendered alone."""
    asked = f"--range {part[0]}-{part[-1]}"
    if video is not None:
        raise OutputError(
            f"{asked}: a part of the turn is no video: name a folder with -o, and merge it when all are there."
        )
    if part[-1] >= frames:
        raise OutputError(f"{asked}: the turn has {frames} frames, counted from 0: the last one is {frames - 1}.")


def _print_commands(video: Path | None, place: Path, frames: int, fps: float, count: int) -> None:
    """Print the commands of consecutive parts of the turn, as many as asked for, and how they become a video."""
    count = min(count, frames)
    bounds = [frames * k // count for k in range(count + 1)]
    piece_commands([["--range", f"{a}-{b - 1}", "-o", str(place)] for a, b in pairwise(bounds)])
    if video is not None:
        merge_command(video, [place], ["--fps", f"{fps:g}"])


def _render_frames(request: Request, folder: FrameFolder, missing: list[int], clock: StageClock) -> None:
    """Render and write the frames that are missing. All use one seed: noise stands still instead of flickering."""
    import numpy as np

    from ..jobs.orbit import Orbit
    from ..progress import steps

    with clock.stage("load"):
        job = request.load()
    with clock.stage("preparation"):
        integrator = job.integrator()
        job.prepare(integrator)
    orbit = Orbit.around(job.sensor, integrator.prepared.bodies)
    for step, _ in steps("frames", [1] * len(missing), "frames"):
        orbit.place(job.sensor, 2 * np.pi * missing[step] / len(folder.paths))
        path = folder.paths[missing[step]]
        layers = job.render(integrator, [path])
        save_film(job.sensor.film(), [path], layers)
