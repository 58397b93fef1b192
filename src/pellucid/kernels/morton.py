"""Morton order: positions as numbers whose leading digits name the cells around them, octal in space and in base 4 in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LEVELS = 21  # octal digits in a 63-bit code

# Shift and mask of each step that spreads 21 bits so that two zeros follow each.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_codes(p: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Interleave the bits of positions ``(n, 3)`` within their bounding cube, 21 for each axis: ``(n,) uint64``."""
    low = p.min(axis=0).astype(np.float64)
    size = float((p.max(axis=0) - low).max()) or 1.0
    codes = np.zeros(len(p), np.uint64)
    for axis in range(3):
        cell = (p[:, axis] - low[axis]) * (2.0**LEVELS / size)
        bits = np.minimum(cell, 2**LEVELS - 1).astype(np.uint64)
        for shift, mask in _SPREAD:
            bits |= bits << np.uint64(shift)
            bits &= np.uint64(mask)
        codes |= bits << np.uint64(2 - axis)
    return codes


def morton_order(p: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Number the points ``(n, 3)`` along the Morton curve, to a ten-bit grid: the ``(n,) uint32`` that sorts them."""
    keys = morton_codes(p) >> np.uint64(31) << np.uint64(32) | np.arange(len(p), dtype=np.uint64)
    keys.sort()  # of plain numbers, without ties: many times faster than argsort
    return keys.astype(np.uint32)


def shared_digits(codes: NDArray[np.uint64]) -> NDArray[np.int8]:
    """Count the leading octal digits each sorted code shares with the one before: ``(n + 1,)``, -1 at both ends.

    The voxels of level l are the ranges between entries below l.
    """
    differing = codes[1:] ^ codes[:-1]
    shared = np.full(len(codes) + 1, -1, np.int8)
    shared[1:-1] = 0
    for level in range(1, LEVELS + 1):
        shared[1:-1] += differing < np.uint64(1 << 3 * (LEVELS - level))
    return shared


def interleave(x: Any, y: Any) -> Any:
    """Number the cells of a plane along the Morton curve: the bits of x at even places, those of y at odd ones.

    Works on arrays of the host and of the device alike.

    Parameters
    ----------
    x, y : (n,) uint32, or UInt32 of n lanes
        Column and row, below 2^16.
    """
    return _spread_bits(x) | (_spread_bits(y) << 1)


def deinterleave(code: Any) -> tuple[Any, Any]:
    """Find column and row of the cells of a plane from their numbers, the inverse of `interleave`."""
    return _even_bits(code), _even_bits(code >> 1)


def _spread_bits(x: Any) -> Any:
    """Move the lower 16 bits to 0, 2, 4, ..."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = (x | (x << shift)) & mask
    return x


def _even_bits(code: Any) -> Any:
    """Move bits 0, 2, 4, ... next to each other."""
    code = code & 0x55555555
    for shift, mask in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
        code = (code | (code >> shift)) & mask
    return code
