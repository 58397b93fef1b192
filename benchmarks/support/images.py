"""Pictures for the documents: linear colours become 8-bit PNGs, alone or side by side with captions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

CAPTION, GAP = 26, 6  # [pixels]
LARGEST = 900_000  # [bytes]


def to_srgb(picture: np.ndarray) -> np.ndarray:
    """Apply the sRGB curve to linear colours and round them to 8 bits, ``(h, w, 3) uint8``."""
    x = np.clip(np.nan_to_num(np.asarray(picture, float)), 0, 1)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def enlarged(picture: np.ndarray, factor: int) -> np.ndarray:
    """Repeat pixels, so that a coarse picture shows them."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def save_png(path: Path, picture: np.ndarray) -> Path:
    """Write a linear picture."""
    return _write(path, to_srgb(picture))


def save_jpeg(path: Path, picture: np.ndarray) -> Path:
    """Write a linear picture that would be too large as PNG."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(to_srgb(picture)).save(path, quality=90)
    return path


def save_rows(path: Path, rows: Sequence[Sequence[tuple[str, np.ndarray]]]) -> Path:
    """Write linear pictures in rows, each under its caption; all rows have one width."""
    return _write(path, np.concatenate([_row(row) for row in rows]))


def save_row(path: Path, pictures: Sequence[tuple[str, np.ndarray]]) -> Path:
    """Write linear pictures of one height side by side, each under its caption."""
    return save_rows(path, [pictures])


def save_animation(path: Path, frames: Sequence[Sequence[Sequence[tuple[str, np.ndarray]]]], milliseconds: int) -> Path:
    """Write frames, each of them rows of linear pictures as in `save_rows`, as an animated WebP that stays at its end for a while."""
    from PIL import Image

    first, *others = (Image.fromarray(np.concatenate([_row(row) for row in rows])) for rows in frames)
    durations = [milliseconds] * len(others) + [4 * milliseconds]
    path.parent.mkdir(parents=True, exist_ok=True)
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, quality=80, method=5)
    return path


def _row(pictures: Sequence[tuple[str, np.ndarray]]) -> np.ndarray:
    from PIL import Image, ImageDraw, ImageFont

    height = pictures[0][1].shape[0]
    width = sum(picture.shape[1] for _, picture in pictures) + GAP * (len(pictures) - 1)
    canvas = Image.new("RGB", (width, height + CAPTION), "white")
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(15)
    x = 0
    for caption, picture in pictures:
        canvas.paste(Image.fromarray(to_srgb(picture)), (x, CAPTION))
        draw.text((x + picture.shape[1] / 2, CAPTION / 2), caption, "black", font, anchor="mm")
        x += picture.shape[1] + GAP
    return np.asarray(canvas)


def _write(path: Path, eight_bit: np.ndarray) -> Path:
    """Write a PNG, with a palette of 256 colours where it would be too large for a page without."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(eight_bit)
    picture.save(path, optimize=True)
    if path.stat().st_size > LARGEST:
        picture.quantize(256, Image.Quantize.MEDIANCUT).save(path, optimize=True)
    return path
