"""Numbers from the host as kernels like them: aligned in memory, and inputs instead of parts of the code."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

ALIGNMENT = 64
"""Bytes. From memory that is not aligned Dr.Jit fetches packets one float at a time, three times slower; and kernels are compiled
for the alignment of what they read, again and again where it is left to chance."""


def upload(values: NDArray[Any], kind: type | None = None) -> Any:
    """Copy numbers to the device: into aligned memory, shared where device and host are one.

    ``kind`` is the type of the array; by default ``mi.UInt32`` for whole numbers of 32 bits, and ``mi.Float`` for all others.
    """
    copy = aligned(values.size, values.dtype)
    copy[:] = values.ravel()
    return hand_over(copy, kind or (mi.UInt32 if values.dtype == np.uint32 else mi.Float))


def columns(values: ArrayLike) -> list[Any]:
    """Copy vectors ``(n, k)`` to the device, as k arrays."""
    return [upload(np.asarray(column, np.float32)) for column in np.asarray(values).T]


def aligned(shape: int | tuple[int, ...], dtype: Any = np.float32) -> NDArray[Any]:
    """Get memory for an array that is to be handed over to the device, with anything in it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    buffer = np.empty(size + ALIGNMENT, np.uint8)
    begin = -buffer.ctypes.data % ALIGNMENT
    return buffer[begin : begin + size].view(dtype).reshape(shape)


def hand_over(values: NDArray[Any], kind: type) -> Any:
    """Make an array of ``kind`` of one from `aligned`, which must not be changed any more."""
    return kind(values.reshape(-1))


def lanes_where(mask: Any) -> Any:
    """List the numbers of the lanes in which a mask is set: ``UInt32``.

    `dr.compress` waits for the mask and lets no other thread of Python run meanwhile, as Dr.Jit does wherever else it waits: progress
    would stand still.
    """
    dr.eval(mask)
    dr.sync_thread()
    return dr.compress(mask)


def rows(value: Any) -> NDArray[np.float32]:
    """Bring vectors or colours to the host: ``(n, k) float32``."""
    dr.eval(value)  # by one kernel; laid out one by one: together they would need another kernel for each width
    parts = [np.asarray(part.numpy(), np.float32) for part in value]
    return np.stack(np.broadcast_arrays(*parts), axis=1)


def opaque(kind: type, values: ArrayLike) -> Any:
    """Make a number or a vector of ``kind`` that kernels read, and are not compiled for."""
    if dr.depth_v(kind) == 1:
        return dr.opaque(kind, float(np.ravel(values)[0]))
    return kind(*(dr.opaque(dr.value_t(kind), float(v)) for v in np.ravel(values)))
