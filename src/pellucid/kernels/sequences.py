"""Numbers that fill an interval, a square or a disc evenly, and which of them to use when.

- `hammersley_set`, and `even_numbers` in one dimension: how many there are is known, and all of them are used. The most even.
- `hammersley`: the same point by point, where every lane has a shift of its own.
- `fibonacci_lattice`: of many small sets with sizes of their own, such as the points of each triangle of a mesh. Hammersley's set is
  even for powers of two, the golden ratio for any number.
- `kronecker`, `r2`: nobody knows yet how many there will be; every further one falls into a wide gap.
- `owen_square`: every run of them is even, and so is every run of runs: for points of neighbours that are to be even together.
- `independent_points`: each for itself, to compare with.
- `fibonacci_disc`: a disc, few points, on the host.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

GOLDEN = 0.5 * (5**0.5 - 1)
"""Multiples of the inverse of the golden ratio, modulo one, fill the unit interval evenly."""

R2 = (0.7548776662466927, 0.5698402909980532)
R3 = tuple(1.22074408460575947536**-k for k in (1, 2, 3))
"""The same for the unit square and the unit cube (Roberts 2018)."""

STREAM = 0x9E3779B1
"""An odd number, by which streams of random numbers are kept apart."""

ROUNDS = 8
"""Of the cipher that makes numbers random: after the usual 4, those of consecutive streams are not even uniform."""

BELOW_ONE = 1 - 2.0**-24


def even_numbers(Float: type, count: int, seed: int = 0) -> Any:
    """Spread ``count`` numbers over [0, 1) at equal distances, shifted together at random.

    Returns
    -------
    Float of ``count`` lanes
        Ascending, the same for the same seed.
    """
    return hammersley_set(Float, count, seed)[0]


def hammersley_set(Float: type, count: int, seed: int = 0) -> tuple[Any, Any]:
    """Spread ``count`` points over the unit square (Hammersley's set), shifted together at random.

    Returns
    -------
    Float, Float of ``count`` lanes
        The same for the same seed.
    """
    index = dr.arange(dr.uint32_array_t(Float), count)
    shift = [dr.opaque(Float, value) for value in np.random.default_rng(seed).random(2)]
    return hammersley(index, dr.opaque(Float, count), shift)


def hammersley(index: Any, count: Any, shift: Any) -> tuple[Any, Any]:
    """Find point number ``index`` of Hammersley's set of ``count`` points in the unit square, moved by a shift in [0, 1)^2.

    The first coordinate moves only within its ``count`` strata, the second goes around.
    """
    y = radical_inverse(index) + shift[1]
    x = (type(y)(index) + shift[0]) / count
    return dr.minimum(x, BELOW_ONE), dr.minimum(y - dr.floor(y), BELOW_ONE)


def radical_inverse(index: Any) -> Any:
    """Mirror the bits of a number behind the point (van der Corput's sequence in base 2)."""
    return dr.float32_array_t(type(index))(dr.brev(index)) * 2.0**-32


def fibonacci_lattice(index: mi.UInt32, count: mi.UInt32, stream: mi.UInt32, seed: int) -> mi.Point2f:
    """Find point number ``index`` of ``count`` in the unit square: one in each of ``count`` strips, golden-ratio steps across.

    It lies at random within its strip; every ``stream`` is shifted by itself.
    """
    salt = dr.opaque(mi.UInt32, seed & 0x7FFFFFFF)
    jitter = mi.sample_tea_float32(index + stream * STREAM, salt, ROUNDS)
    (across,) = kronecker(index, [GOLDEN], [mi.sample_tea_32(stream, salt + 1, ROUNDS)[0]])
    return mi.Point2f(dr.minimum((mi.Float(index) + jitter) / mi.Float(count), BELOW_ONE), fraction(across))


def owen_square(index: mi.UInt32, key: mi.UInt32) -> mi.Point2f:
    """Find a point of the first two dimensions of Sobol's sequence, shuffled and scrambled as a whole (Owen) by a key.

    The points of any aligned run of 2^k indices are even in the unit square, whatever the key; those of different keys are independent.

    Source
    ------
    B. Burley, *Practical hash-based Owen scrambling*, JCGT 9(4), 2020.
    """
    shuffle, *digits = (_hash(_hash(key) ^ salt) for salt in (0, 0x51633E2D, 0x68BC21EB))
    x = dr.brev(_scrambled(index, shuffle))
    return mi.Point2f(fraction(_scrambled(x, digits[0])), fraction(_scrambled(_pascal(x), digits[1])))


def _scrambled(bits: mi.UInt32, key: mi.UInt32) -> mi.UInt32:
    """Permute numbers so that those which share their leading digits still do (Laine and Karras, by the mirrored bits)."""
    x = dr.brev(bits) + key
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x ^= x * mi.UInt32(factor)
    return dr.brev(x)


def _pascal(x: mi.UInt32) -> mi.UInt32:
    """Multiply the digits of a number of van der Corput's sequence by Pascal's triangle: Sobol's second dimension."""
    x = mi.UInt32(x)
    x ^= x << 16
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x ^= (x & mask) << shift
    return x


def _hash(x: mi.UInt32) -> mi.UInt32:
    """Mix the bits of a number."""
    x = mi.UInt32(x)
    for shift, factor in ((16, 0x21F0AAAD), (15, 0xD35A2D97)):
        x = (x ^ (x >> shift)) * mi.UInt32(factor)
    return x ^ (x >> 15)


def independent_points(index: mi.UInt32, count: mi.UInt32, stream: mi.UInt32, seed: int) -> mi.Point2f:
    """Place points in the unit square independently of each other; parameters as for `fibonacci_lattice`."""
    salt = dr.opaque(mi.UInt32, seed & 0x7FFFFFFF)
    key = index + stream * STREAM
    return mi.Point2f(mi.sample_tea_float32(key, salt, ROUNDS), mi.sample_tea_float32(key, salt + 0x80000000, ROUNDS))


def kronecker(number: Any, steps: Sequence[float], shift: Sequence[Any]) -> list[Any]:
    """Take multiples of ``steps``, such as `R2` or `R3`, modulo one, as 32-bit numbers behind the point.

    Parameters
    ----------
    number : UInt32
        Which point; none is known to be the last.
    steps, shift : (d,) float, (d,) int or UInt32
        By dimension; the shift in 32 bits.
    """
    return [shift + number * _in_32_bits(step) for step, shift in zip(steps, shift, strict=True)]


def fraction(bits: Any) -> Any:
    """Turn 32-bit numbers behind the point into floats in [0, 1)."""
    return dr.float32_array_t(type(bits))(bits >> 8) * 2.0**-24


def r2(turn: int) -> tuple[float, float]:
    """Find point number ``turn`` of a sequence that fills the unit square evenly, on the host; the first one is (0, 0)."""
    return turn * R2[0] % 1, turn * R2[1] % 1


def r2_points(number: mi.UInt32, turn: int) -> mi.Point2f:
    """Give each lane a place of its own in the unit square, moved on from turn to turn so that they fill it evenly."""
    place = (mi.sample_tea_float32(number, 1, ROUNDS), mi.sample_tea_float32(number, 2, ROUNDS))
    x, y = (value + dr.opaque(mi.Float, step) for value, step in zip(place, r2(turn), strict=True))
    return mi.Point2f(x - dr.floor(x), y - dr.floor(y))


def fibonacci_disc(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spread points over the unit disc along Fibonacci's spiral: radius and angle, ``(count,) float`` both."""
    k = np.arange(count, dtype=float)
    return np.sqrt((k + 0.5) / count), 2 * np.pi * (1 - GOLDEN) * k


def _in_32_bits(step: float) -> int:
    return int(2**32 * step)
