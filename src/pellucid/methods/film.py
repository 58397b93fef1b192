"""The samples of a pass, added to a film."""

from __future__ import annotations

from math import prod
from typing import Any

import drjit as dr
import mitsuba as mi

from ..errors import EnvironmentProblem
from ..kernels.free_memory import free_memory
from .tiles import Region, film_size

PATHS_A_PASS = 1 << 24
"""Paths of a pass over a picture, in which samples of a pixel share exitances: traced in bands, and kept until they go to the film."""

BYTES_A_PATH, BYTES_KEPT, BYTES_A_PIXEL, BYTES_A_LANE = 300, 60, 60, 16
"""What a path takes while it is traced (150 to 300) and until it is added to the film, a pixel in the film and on its way to a file, and
the state of a sampler, which every path of a pass over the whole picture has, also where a tile of it is rendered."""


def check_memory(film: mi.Film, paths: int, kept: int = 0, lanes: int = 0) -> None:
    """Check that there is memory for a picture: for paths that are traced at once, those that are kept, and lanes of a sampler.

    Raises
    ------
    EnvironmentProblem
        When there is not, with what is needed and what there is.
    """
    free = free_memory() if mi.variant().startswith("llvm") else None
    width, height = film_size(film)
    needed = width * height * BYTES_A_PIXEL + paths * BYTES_A_PATH + kept * BYTES_KEPT + lanes * BYTES_A_LANE
    if free is not None and needed > free:
        share = (free / needed) ** 0.5
        raise EnvironmentProblem(
            f"A picture of {width}x{height} pixels needs about {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are "
            f"free: render at most about {int(width * share)}x{int(height * share)} pixels, or parts of it (the crop of a film)."
        )


def samples_a_pass(film: mi.Film, spp: int) -> int:
    """Divide the samples of each pixel of a whole film among as few equal passes as may be."""
    pixels = prod(film_size(film))
    return max(d for d in range(1, min(spp, max(PATHS_A_PASS // pixels, 1)) + 1) if spp % d == 0)


def check_pass(tile: mi.Film, whole: mi.Film, spp: int) -> None:
    """Check that there is memory for the passes over a tile of a film, as `check_memory` does."""
    pixels, samples = Region.around(tile, whole).pixels, samples_a_pass(whole, spp)
    check_memory(tile, pixels, pixels * samples, prod(film_size(whole)) * samples)


class Wave:
    """A few samples of every pixel of a region, put together from bands of rows.

    Attributes
    ----------
    values : list of Float
        What is known of each, ``per_pixel`` consecutive ones to a pixel, row by row; once the last band is there.
    """

    def __init__(self, region: Region, per_pixel: int):
        self.region, self.per_pixel = region, per_pixel
        self.values: list[mi.Float] = []

    def put(self, row: int, values: list[mi.Float]) -> None:
        """Put in the samples of the rows from ``row`` on."""
        dr.eval(values)
        size = self.region.pixels * self.per_pixel
        if dr.width(values) == size:
            self.values = values
            return
        if row == 0:
            self.values = [dr.empty(mi.Float, size) for _ in values]
        width = dr.width(values)
        to = dr.arange(mi.UInt32, width) + dr.opaque(mi.UInt32, row * self.region.width * self.per_pixel)
        for whole, value in zip(self.values, values, strict=True):
            dr.scatter(whole, value + dr.zeros(mi.Float, width), to)
        dr.eval(self.values)


def add_samples(
    film: mi.Film, region: Region, at: mi.Vector2f, colour: mi.Color3f, alpha: mi.Float, more: list[mi.Float]
) -> None:
    """Add samples to a film, weighted by its reconstruction filter.

    Every pixel gathers the samples around it. Where samples are scattered to pixels instead, threads add them in any order, and two
    equal renders differ in their last bits.

    Parameters
    ----------
    region : Region
        The pixels that have samples.
    at : Vector2f
        Positions of the samples [pixels]: equally many in each pixel, row by row.
    more : list of Float
        Extra channels.
    """
    with_alpha = mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
    values = [*colour, *([alpha] if with_alpha else []), *more]
    at = mi.Vector2f(at)  # where the filter is not a box, it comes as a point
    dr.eval(at, values)
    sums, weight = _gather(film, region, at, values)
    sums.insert(4 if with_alpha else 3, weight)
    dr.eval(sums)  # at once: each scatter below would walk over the samples again for its own channel
    (width, height), count = (int(n) for n in film.crop_size()), len(sums)
    data = dr.empty(mi.Float, width * height * count)
    lane = dr.arange(mi.UInt32, width * height) * count
    for channel, total in enumerate(sums):
        dr.scatter(data, total, lane + channel)
    block = mi.ImageBlock(mi.TensorXf(data, (height, width, count)), offset=film.crop_offset(), rfilter=film.rfilter())
    film.put_block(block)


def _gather(film: mi.Film, region: Region, at: mi.Vector2f, values: list[mi.Float]) -> tuple[list[mi.Float], mi.Float]:
    """Sum filter weight times value, and the filter weight, over the samples in reach of each pixel of the film."""
    width, height = (int(n) for n in film.crop_size())
    lane = dr.arange(mi.Int32, width * height)
    y = lane // dr.opaque(mi.Int32, width)
    x = lane - y * dr.opaque(mi.Int32, width)
    pixel = mi.Vector2i(x, y) + mi.Vector2i(*(dr.opaque(mi.Int32, n) for n in region.inner))
    centre = mi.Vector2f(mi.Vector2i(x, y)) + mi.Vector2f(*(dr.opaque(mi.Float, n + 0.5) for n in film.crop_offset()))
    per_pixel = dr.opaque(mi.Int32, dr.width(at) // region.pixels)
    size = mi.Vector2i(dr.opaque(mi.Int32, region.width), dr.opaque(mi.Int32, region.height))
    return _sum(film.rfilter(), at, values, pixel, centre, size, per_pixel)


@dr.syntax
def _sum(
    rfilter: mi.ReconstructionFilter,
    at: mi.Vector2f,
    values: list[mi.Float],
    pixel: mi.Vector2i,
    centre: mi.Vector2f,
    size: mi.Vector2i,
    per_pixel: mi.Int32,
) -> Any:
    """Walk over the samples of the pixels around ``pixel``, which are in reach of the filter at ``centre``."""
    reach = rfilter.border_size()
    across = 2 * reach + 1
    weight, sums = mi.Float(0), [mi.Float(0) for _ in values]
    number, sample = mi.Int32(0), mi.Int32(0)
    while dr.hint(number < across * across, label="pellucid film"):
        row = number // across
        x, y = pixel.x + number - row * across - reach, pixel.y + row - reach
        inside = (x >= 0) & (y >= 0) & (x < size.x) & (y < size.y)
        index = mi.UInt32((y * size.x + x) * per_pixel + sample)
        offset = dr.gather(mi.Vector2f, at, index, inside) - centre
        w = dr.select(inside, rfilter.eval(offset.x) * rfilter.eval(offset.y), 0)
        weight += w
        sums = [sums[k] + w * dr.gather(mi.Float, values[k], index, inside) for k in range(len(values))]
        sample += 1
        number = dr.select(sample == per_pixel, number + 1, number)
        sample = dr.select(sample == per_pixel, 0, sample)
    return sums, weight
