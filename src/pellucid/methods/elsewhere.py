"""The exitance at points whose samples lie on other machines: points are written down first, and known later.

A piece of a picture is traced twice. The first time `Asked` writes down the points that it asks for; parts of the samples answer those
where they lie; the second time `Known` finds the sums. Paths do not depend on the exitance. How they are cut into chunks may differ from
one time to the other, so that points are found by what they are: all of their numbers.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import EnvironmentProblem
from ..kernels.memory import columns, rows
from ..kernels.morton import morton_order
from .contract import Points


class Asked:
    """Writes down the points at which the exitance is asked for; the answer is always 0."""

    def __init__(self) -> None:
        self._found: list[NDArray[np.float32]] = []

    def exitance(self, points: Points) -> mi.Color3f:
        """Write down points."""
        self._found.append(_numbers(points))
        return dr.zeros(mi.Color3f, dr.width(points.p))

    def points(self) -> NDArray[np.float32]:
        """List the points, each once and near others: ``(n, 8) float32``, or ``(n, 11)`` where profiles are stretched.

        Position, normal, number of the body, tolerance, and the stretch in three channels.
        """
        if not self._found:
            return np.zeros((0, 8), np.float32)
        found = np.concatenate(self._found)
        _, once = np.unique(_keys(found), return_index=True)
        found = found[once]
        return found[morton_order(found[:, :3])] if len(found) else found


class Known:
    """Finds the exitance ``(n, 3) float32`` of the `Asked.points`."""

    def __init__(self, points: NDArray[np.float32], exitance: NDArray[np.float32]):
        keys = _keys(points)
        self._order = np.argsort(keys)
        self._keys, self._exitance = keys[self._order], exitance

    def exitance(self, points: Points) -> mi.Color3f:
        """Find the exitance at some of the points.

        Raises
        ------
        EnvironmentProblem
            For others.
        """
        wanted = _keys(_numbers(points))
        place = np.searchsorted(self._keys, wanted)
        if (place == len(self._keys)).any() or not np.array_equal(self._keys[place], wanted):
            raise EnvironmentProblem(
                "Tracing a tile twice gave different points, because the workers have different processors: use workers of one kind."
            )
        return mi.Color3f(*columns(self._exitance[self._order[place]]))


def points_of(numbers: NDArray[np.float32]) -> Points:
    """Make points of the rows of `Asked.points`, for methods that draw no random numbers."""
    c = columns(numbers)
    stretch = mi.Color3f(*c[8:]) if len(c) > 8 else None
    body = mi.UInt32(numbers[:, 6].astype(np.uint32))
    return Points(mi.Point3f(*c[:3]), mi.Normal3f(*c[3:6]), body, mi.Float(c[7]), mi.UInt32(0), stretch)


def _numbers(points: Points) -> NDArray[np.float32]:
    """Write points as rows of numbers."""
    parts = [rows(points.p), rows(points.n), points.body.numpy()[:, None], points.tolerance.numpy()[:, None]]
    if points.stretch is not None:
        parts.append(rows(points.stretch))
    return np.concatenate(parts, axis=1, dtype=np.float32, casting="unsafe")


def _keys(numbers: NDArray[np.float32]) -> NDArray[np.void]:
    """Take rows for what they are, bit by bit: ``(n,)``, which can be sorted and compared."""
    return np.ascontiguousarray(numbers).view(np.dtype((np.void, 4 * numbers.shape[1])))[:, 0]
