"""Tiles of a picture: which pixels they are made of, and which samples reach into them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError


def film_size(film: mi.Film) -> tuple[int, int]:
    """Give the width and height of a film in pixels, with the border in which samples are drawn."""
    width, height = (int(n) + 2 * border(film) for n in film.crop_size())
    return width, height


def border(film: mi.Film) -> int:
    """Give the number of rows and columns around a film in which samples are drawn."""
    return film.rfilter().border_size() if film.sample_border() else 0


@dataclass(frozen=True)
class Region:
    """The pixels whose samples reach into a film: ``width`` x ``height`` of those that are sampled of the whole, from ``(x, y)`` on.

    The pixels of the film itself begin at ``inner`` among them.
    """

    x: int
    y: int
    width: int
    height: int
    inner: tuple[int, int]

    @classmethod
    def around(cls, film: mi.Film, whole: mi.Film) -> Region:
        """Find the pixels around a tile that the filter reaches, as far as the whole has samples there."""
        reach = whole.rfilter().border_size()
        corner = [int(a - b) + border(whole) for a, b in zip(film.crop_offset(), whole.crop_offset(), strict=True)]
        x, y = (max(c - reach, 0) for c in corner)
        sizes = zip(corner, film.crop_size(), film_size(whole), strict=True)
        right, bottom = (min(c + int(size) + reach, most) for c, size, most in sizes)
        return cls(x, y, right - x, bottom - y, (corner[0] - x, corner[1] - y))

    @property
    def pixels(self) -> int:
        """How many pixels there are."""
        return self.width * self.height

    def rows(self, first: int, count: int) -> Region:
        """Take some of the rows of pixels."""
        return replace(self, y=self.y + first, height=count)

    def samples(self, whole_width: int, per_pixel: int) -> tuple[mi.Vector2i, mi.UInt32]:
        """List the samples of all pixels, pixel by pixel: the place of its pixel, and its number, both in the whole."""
        lane = dr.arange(mi.UInt32, self.pixels * per_pixel)
        count, width = dr.opaque(mi.UInt32, per_pixel), dr.opaque(mi.UInt32, self.width)
        pixel = lane // count
        row = pixel // width
        y = row + dr.opaque(mi.UInt32, self.y)
        x = pixel - row * width + dr.opaque(mi.UInt32, self.x)
        number = (y * dr.opaque(mi.UInt32, whole_width) + x) * count + (lane - pixel * count)
        return mi.Vector2i(x, y), number


def describe_film(film: mi.Film) -> dict[str, Any]:
    """Write down what makes another film like this one, for ``mi.load_dict``, but for its filter.

    Mitsuba tells the formats in its description only, where luminance is y.
    """
    formats = dict(re.findall(r"(pixel_format|component_format) = (\w+)", str(film)))
    formats["pixel_format"] = {"y": "luminance", "ya": "luminance_alpha"}.get(
        formats["pixel_format"], formats["pixel_format"]
    )
    (width, height), (x, y), (columns, rows) = film.size(), film.crop_offset(), film.crop_size()
    crop = {"crop_offset_x": int(x), "crop_offset_y": int(y), "crop_width": int(columns), "crop_height": int(rows)}
    return {"type": "hdrfilm", "width": int(width), "height": int(height), **crop, **formats}


def make_tile(film: mi.Film, number: int, count: int) -> mi.Film:
    """Make a film of its own for a tile of another.

    Parameters
    ----------
    number, count : int
        Tile number 1 to ``count`` of a grid, row by row. It has as many rows and columns as make the cells most nearly square.

    Raises
    ------
    SceneError
        When there are fewer pixels than such tiles.
    """
    width, height = (int(n) for n in film.crop_size())
    columns = min((c for c in range(1, count + 1) if count % c == 0), key=lambda c: height * c + width * count // c)
    rows = count // columns
    if columns > width or rows > height:
        raise SceneError(f"A picture of {width}x{height} pixels has no {columns} x {rows} tiles: ask for fewer.")
    row, column = divmod(number - 1, columns)
    whole = describe_film(film)
    left, right = (width * k // columns for k in (column, column + 1))
    top, bottom = (height * k // rows for k in (row, row + 1))
    whole["crop_offset_x"] += left
    whole["crop_offset_y"] += top
    return mi.load_dict({**whole, "crop_width": right - left, "crop_height": bottom - top, "rfilter": film.rfilter()})


def sums_of(film: mi.Film) -> NDArray[np.float32]:
    """Read the weighted sums that a film holds, ``(h, w, channels)``, before it divides them by their weights."""
    return np.array(film.bitmap(raw=True), np.float32)


def put_sums(film: mi.Film, sums: NDArray[np.float32], offset: tuple[int, int]) -> None:
    """Put weighted sums into a film at the place of a tile, given as the crop offset of its film."""
    film.put_block(mi.ImageBlock(mi.TensorXf(sums), offset=offset, rfilter=film.rfilter()))
