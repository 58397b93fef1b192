"""Numbers from the host as kernels like them: aligned in memory, and inputs instead of parts of the code."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

ALIGNMENT = 64
"""Bytes. From memory that is not aligned Dr.Jit fetches packets one float at a time, three times slower; and kernels are compiled
for the alignment of what they read, again and again where it is left to chance."""


def upload(values: NDArray[Any], kind: type) -> Any:
    """Copy numbers to the device as an array of ``kind``: into aligned memory, shared where device and host are one."""
    buffer = np.empty(values.nbytes + ALIGNMENT, np.uint8)
    begin = -buffer.ctypes.data % ALIGNMENT
    aligned = buffer[begin : begin + values.nbytes].view(values.dtype)
    aligned[:] = values.ravel()
    return kind(aligned)


def rows(value: Any) -> NDArray[np.float32]:
    """Bring vectors or colours to the host: ``(n, 3) float32``."""
    # One by one: together they would be laid out by a kernel of their own for each width.
    return np.stack([np.asarray(part.numpy(), np.float32) for part in value], axis=1)


def opaque(kind: type, values: ArrayLike) -> Any:
    """Make a vector of ``kind`` that kernels read, and are not compiled for."""
    return kind(*(dr.opaque(dr.value_t(kind), float(v)) for v in np.ravel(values)))
