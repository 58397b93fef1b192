"""Frames become a video."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import OutputError, import_optional, install

VIDEOS = (".mp4", ".mkv", ".mov")


def ffmpeg() -> Any:
    """Import the writer of videos.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    return import_optional(
        "imageio_ffmpeg", f"A video needs imageio-ffmpeg: {install('video')}, or name a folder for PNGs with -o."
    )


def encode(frames: list[Path], path: Path, fps: float) -> None:
    """Encode frames to a video; sizes that the codec cannot have (odd ones) are rounded down by a row or column.

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
    encoder = ffmpeg()
    writer = encoder.write_frames(
        str(path), (width, height), fps=fps, quality=8, macro_block_size=2, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        for picture in (first, *pictures):
            writer.send(np.ascontiguousarray(picture[:height, :width]))
    finally:
        writer.close()
    if not path.stat().st_size or encoder.count_frames_and_secs(str(path))[0] != len(frames):
        raise OutputError(f"The video could not be encoded; its frames are in '{frames[0].parent}'.")
