"""Parts of the samples that stay on workers, and how a piece of a picture asks them for its light."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from distributed import Future

from ..errors import ClusterError
from . import worker

LOOK = 1.0
"""Seconds after which it is looked again whether all workers are there."""

MOST_LOST = 4
"""Workers that may be lost before a piece comes back: as many as Dask itself allows at one piece."""

Send = Callable[..., Future]
"""Sends a task: the function, its arguments, and ``workers``, those that may do it."""


class Parts:
    """Which workers keep the parts of the samples.

    Dask does not know of them: tasks that need a part are sent to its worker, and to no other one, for lighting it there takes longer than
    waiting.

    Parameters
    ----------
    key : str
        Of the work.
    count : int
        Number of parts.
    workers : list of str
        Addresses.
    """

    def __init__(self, key: str, count: int, workers: list[str]):
        self.key = key
        self.at = dict(zip(range(count), cycle(workers), strict=False))
        """The worker of each part."""
        self.lost = 0
        """Workers that were lost since the last piece came back."""
        self._next = 0.0

    @property
    def lighting(self) -> dict[int, tuple[Any, ...]]:
        """The tasks that light the parts."""
        return {number: (worker.light_part, self.key, number) for number in self.at}

    def moved(self, workers: Callable[[], list[str]]) -> bool:
        """Give the parts of workers that are lost to others, and tell whether there were any; looks now and then only.

        Raises
        ------
        ClusterError
            When one worker after the other is lost.
        """
        if time.monotonic() < self._next:
            return False
        there = workers()
        self._next = time.monotonic() + LOOK
        lost = [number for number, address in self.at.items() if address not in there]
        if not lost or not there:
            return False
        self.lost += len({self.at[number] for number in lost})
        if self.lost >= MOST_LOST:
            raise ClusterError(
                f"{self.lost} workers that kept parts of the samples were lost, and no piece came back. Most often their memory is not "
                "enough: ask for more --sample-parts and more workers, or lower --samples."
            )
        for number in lost:
            kept = Counter(self.at.values())
            self.at[number] = min(there, key=lambda address: kept[address])
        return True


@dataclass
class Asking:
    """Asks all parts of the samples for the exitance at the points of a piece, which a task lists, before that piece is made."""

    parts: Parts
    points: tuple[Any, ...]

    def send(self, send: Send) -> dict[str, Any]:
        """Send the tasks, and give what comes of them (`worker.Answered`)."""
        points, at = send(*self.points), self.parts.at
        sums = [send(worker.exitance, self.parts.key, k, points, workers=[at[k]]) for k in sorted(at)]
        return {"points": points, "sums": sums}


def with_light(
    light: Any, make: Any, points: Any, key: str, pieces: list[tuple[int, int]]
) -> tuple[dict[int, tuple[Any, ...]], Parts | None]:
    """Write the tasks that make pieces, by number; where the light lies in parts, each asks them at the points that another task lists."""
    parts = light if isinstance(light, Parts) else None
    return {
        piece[0]: (make, key, Asking(parts, (points, key, *piece)) if parts else light, *piece) for piece in pieces
    }, parts
