"""Places in a texture, drawn in proportion to its values: by descent of a pyramid of sums, or by search in rows.

Two of the three walk a cumulative sum over all texels and stop where it passes u times the total. They differ in the order of the
texels: along rows, neighbours in the sum are neighbours in one direction only; in the order of the pyramid (a quarter of
the texture after the other, in each a quarter of it, and so on) they are so in both, and numbers that are spread evenly
over [0, 1) give places that are spread evenly over what is bright. The third descends the pyramid with two numbers, one for each
direction: places then move little when the values change a little, and do not jump along a curve.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...errors import SceneError
from ...gather.source import types_of
from ...kernels.morton import deinterleave, interleave
from ...kernels.sequences import BELOW_ONE

FIXED_POINT = 40
"""Bits after the point in the cumulative sum of `Rows`: whole numbers, which are exact and never decrease."""


@dataclass
class Pyramid:
    """Sums over quarters of quarters of a texture.

    Attributes
    ----------
    values : Float of resolution^2 lanes
        The texels, row by row; not negative.
    levels : list of Floats
        From the total (1 lane) to the sums over 2x2 texels (resolution^2 / 4), each in the order in which four lanes in
        a row are the quarters of one lane of the level before: left, right, and left, right of the next row.
    resolution : int
        Texels a side.
    """

    values: Any
    levels: list[Any]
    resolution: int

    @property
    def total(self) -> Any:
        """Sum of all texels, 1 lane."""
        return self.levels[0]


@dataclass
class Rows:
    """Cumulative sum over the texels of a texture in the order of its rows.

    Attributes
    ----------
    values : Float of resolution^2 lanes
        As in `Pyramid`.
    cumulative : UInt64 of resolution^2 lanes
        Sums up to and including each texel, in units of the total over 2^`FIXED_POINT`; they end near that number.
    total : Float
        Sum of all texels, 1 lane.
    """

    values: Any
    cumulative: Any
    total: Any


def check_resolution(resolution: int) -> int:
    """Refuse a texture that cannot be halved down to one texel.

    Raises
    ------
    SceneError
        Unless ``resolution`` is a power of two, at least 2.
    """
    if resolution < 2 or resolution & (resolution - 1):
        near = 1 << max(1, resolution.bit_length() - 1)
        raise SceneError(
            f"resolution is the number of texels a side, a power of two; found {resolution}: take {near} or {2 * near}."
        )
    return resolution


def build_pyramid(values: Any, resolution: int) -> Pyramid:
    """Sum a texture level by level.

    Parameters
    ----------
    values : Float of resolution^2 lanes
        Not negative, row by row.
    resolution : int
        Texels a side, a power of two.

    Raises
    ------
    SceneError
        For another resolution, or another number of texels.

    Source: CLHHC08 section 3, figure 2b.
    """
    values = _check(values, resolution)
    UInt, _ = types_of(type(values))
    code = dr.arange(UInt, dr.width(values) // 4)
    upper, lower = _quarters(values, resolution, *deinterleave(code))
    level = upper[0] + upper[1] + lower[0] + lower[1]
    levels = [level]
    while dr.width(level) > 1:
        level = dr.block_sum(level, 4)
        levels.append(level)
    dr.eval(levels)
    return Pyramid(values, levels[::-1], resolution)


def sample_pyramid(pyramid: Pyramid, u: Any) -> tuple[Any, Any]:
    """Draw texels in proportion to their values, by descent from the total to one of four quarters again and again.

    At each level u is weighed against the sums of the four quarters themselves, then stretched to the part of the one that
    it fell in: rounding moves it by a few 1e-7 of the total at most, however many texels there are.

    Parameters
    ----------
    pyramid : Pyramid
        The texture.
    u : Float of n lanes
        In [0, 1); evenly spread numbers give evenly spread texels.

    Returns
    -------
    texel : UInt32 of n lanes
        ``y resolution + x``, never one of zero value (unless all are).
    value : Float of n lanes
        Of the texel; drawn with the probability ``value / total``.

    Source: CLHHC08 eq. 9, and section 3, figure 2b.
    """
    Float, u = type(u), dr.detach(u, preserve_type=False)
    UInt, Packet = types_of(type(u))
    code = dr.zeros(UInt, dr.width(u))
    for level in pyramid.levels[1:]:
        quarter, _, u = _choose(list(dr.gather(Packet, level, code)), u)
        code = (code << 2) | quarter
    x, y = deinterleave(code)
    upper, lower = _quarters(pyramid.values, pyramid.resolution, x, y)
    quarter, value, _ = _choose([*upper, *lower], u)
    texel = ((y << 1) | (quarter >> 1)) * dr.opaque(UInt, pyramid.resolution) + ((x << 1) | (quarter & 1))
    return types_of(Float)[0](texel), Float(value)


def warp_points(pyramid: Pyramid, u: Any, v: Any) -> tuple[Any, Any]:
    """Draw texels in proportion to their values, by descent with one number for columns and one for rows.

    At each level v chooses the upper or the lower half, and u the left or the right part of that; each is then stretched to
    the part that it fell in. Points that are spread evenly over the unit square stay so over what is bright.

    Parameters
    ----------
    pyramid : Pyramid
        The texture.
    u, v : Float of n lanes
        In [0, 1).

    Returns
    -------
    texel, value
        As of `sample_pyramid`.

    Source: hierarchical warping, P. Clarberg et al., *Wavelet importance sampling*, SIGGRAPH 2005; in place of the order of
    CLHHC08 figure 2b.
    """
    Float = type(u)
    u, v = (dr.detach(number, preserve_type=False) for number in (u, v))
    UInt, Packet = types_of(type(u))
    x, y = dr.zeros(UInt, dr.width(u)), dr.zeros(UInt, dr.width(u))
    value = type(u)(0)
    for level in [*pyramid.levels[1:], None]:
        if level is None:
            upper, lower = _quarters(pyramid.values, pyramid.resolution, x, y)
        else:
            a, b, c, d = dr.gather(Packet, level, interleave(x, y))
            upper, lower = (a, b), (c, d)
        is_low, v = _halve(upper[0] + upper[1], lower[0] + lower[1], v)
        left, right = (dr.select(is_low, low, high) for low, high in zip(lower, upper, strict=True))
        is_right, u = _halve(left, right, u)
        value = dr.select(is_right, right, left)
        x, y = (x << 1) | dr.select(is_right, UInt(1), 0), (y << 1) | dr.select(is_low, UInt(1), 0)
    return types_of(Float)[0](y * dr.opaque(UInt, pyramid.resolution) + x), Float(value)


def build_rows(values: Any, resolution: int) -> Rows:
    """Sum a texture along its rows; the twin of `build_pyramid`, with the same parameters and errors.

    Source: CLHHC08 section 3, figure 2a.
    """
    values = _check(values, resolution)
    UInt64 = dr.uint64_array_t(type(values))
    total = dr.sum(values)
    scale = dr.select(total > 0, 2.0**FIXED_POINT / total, 0)
    cumulative = dr.cumsum(UInt64(values * scale))
    dr.eval(cumulative, total)
    return Rows(values, cumulative, total)


def sample_rows(rows: Rows, u: Any) -> tuple[Any, Any]:
    """Draw texels in proportion to their values, by binary search; the twin of `sample_pyramid`, which see.

    Source: CLHHC08 eq. 9, and section 3, figure 2a.
    """
    Float, u = type(u), dr.detach(u, preserve_type=False)
    UInt, UInt64 = types_of(type(u))[0], type(rows.cumulative)
    size = dr.width(rows.cumulative)
    end = dr.gather(UInt64, rows.cumulative, dr.opaque(UInt, size - 1))
    aim = (UInt64(dr.minimum(u, BELOW_ONE) * 2.0**24) * end) >> 24  # below the end
    texel = dr.zeros(UInt, dr.width(u))
    for bit in range(size.bit_length() - 2, -1, -1):
        further = texel | (1 << bit)
        texel = dr.select(dr.gather(UInt64, rows.cumulative, further - 1) <= aim, further, texel)
    return types_of(Float)[0](texel), Float(dr.gather(type(u), rows.values, texel))


def _quarters(values: Any, resolution: int, x: Any, y: Any) -> tuple[Any, Any]:
    """Fetch the texels of column and row (2x, 2y) and around: two of the upper row, two of the lower."""
    UInt, Pair = type(x), sys.modules[type(values).__module__].Array2f
    place = y * dr.opaque(UInt, resolution) + x  # counted in pairs
    return dr.gather(Pair, values, place), dr.gather(Pair, values, place + dr.opaque(UInt, resolution // 2))


def _choose(values: list[Any], u: Any) -> tuple[Any, Any, Any]:
    """Choose one of four values with u: its number, the value, and where in its part u fell, in [0, 1) again."""
    UInt, _ = types_of(type(u))
    ends = [values[0], values[0] + values[1]]
    ends += [ends[1] + values[2]]
    ends += [ends[2] + values[3]]
    # Below the end, so that the first part that ends above is not empty.
    aim = dr.minimum(u * ends[3], dr.reinterpret_array(type(u), dr.reinterpret_array(UInt, ends[3]) - 1))
    number, value, begin = UInt(3), values[3], ends[2]
    for k in (2, 1, 0):
        here = aim < ends[k]
        number = dr.select(here, k, number)
        value = dr.select(here, values[k], value)
        begin = dr.select(here, ends[k - 1] if k else 0, begin)
    return number, value, dr.clip((aim - begin) / value, 0, 1)


def _halve(first: Any, second: Any, u: Any) -> tuple[Any, Any]:
    """Choose one of two values with u: whether it is the second, and where in its part u fell, in [0, 1) again.

    A value of zero is not chosen, unless both are.
    """
    share = first / (first + second)
    is_second = (u >= share) & (second > 0)
    stretched = dr.select(is_second, (u - share) / (1 - share), u / share)
    return is_second, dr.clip(stretched, 0, BELOW_ONE)


def _check(values: Any, resolution: int) -> Any:
    """Refuse textures that are not square with a power of two; return the others without gradients."""
    check_resolution(resolution)
    if dr.width(values) != resolution**2:
        raise SceneError(
            f"a texture of {resolution}x{resolution} has {resolution**2} texels; found {dr.width(values)}."
        )
    return dr.detach(values, preserve_type=False)
