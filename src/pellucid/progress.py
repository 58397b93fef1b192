"""How long work reports where it stands: silent by default, a bar when a door (the command line) opens one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol

FIRST_CHUNK = 1 << 14
PACE, MOST_GROWTH = 0.5, 4.0
"""Seconds that a chunk of `paced` should take, and how many times larger than the one before it may be."""

DIFFERENT, LEAST_WORK = 1.5, 4.0
"""By how much sizes of chunks differ that tell which part of their time is fixed, and how many times that part the rest takes at least."""


class Reporter(Protocol):
    """What a door provides: called at the start of a stage, after each step of it, and at its end."""

    def start(self, stage: str, total: int, unit: str) -> None:
        """Begin a stage of ``total`` units."""

    def advance(self, done: float) -> None:
        """Report ``done`` more units, which may be parts of one."""

    def finish(self) -> None:
        """End the stage."""


_reporter: ContextVar[Reporter | None] = ContextVar("pellucid_reporter", default=None)


@contextmanager
def reporting_to(reporter: Reporter) -> Iterator[None]:
    """Send the progress of everything inside to a reporter."""
    token = _reporter.set(reporter)
    try:
        yield
    finally:
        _reporter.reset(token)


@contextmanager
def stage_of(stage: str, total: int, unit: str) -> Iterator[Callable[[float], None]]:
    """Report a stage, if anyone wants to know; gives the function that reports more of it done. Nothing to do is no stage."""
    reporter = _reporter.get()
    if reporter is None or not total:
        yield lambda done: None
        return
    reporter.start(stage, total, unit)
    try:
        yield reporter.advance
    finally:
        reporter.finish()


def steps(stage: str, sizes: Iterable[int], unit: str) -> Iterator[tuple[int, int]]:
    """Walk over chunks of work and report each: yields ``(first, size)`` of every chunk."""
    sizes = list(sizes)
    with stage_of(stage, sum(sizes), unit) as advance:
        first = 0
        for size in sizes:
            yield first, size
            first += size
            advance(size)


def paced(
    stage: str, total: int, unit: str, row: int = 1, within: int | None = None, most: int | None = None
) -> Iterator[tuple[int, int]]:
    """Walk over chunks of work that take about as long as the steps of a clock, as `steps` does over chunks of given sizes.

    For work whose result does not depend on how it is cut: the sizes follow the time that the chunk before has taken.

    Parameters
    ----------
    total : int
        How much there is to walk over.
    row : int
        How many units each of it is.
    within : int, optional
        No chunk crosses a multiple of this.
    most : int, optional
        Units of a chunk at most, unless one of them is more.
    """
    with stage_of(stage, total * row, unit) as advance:
        first, wanted, pace = 0, max(1, FIRST_CHUNK // row), _Pace()
        largest = max(1, (most or total * row) // row)
        while first < total:
            size = min(wanted, largest, total - first, (within or total) - first % (within or total))
            began = time.perf_counter()
            yield first, size
            advance(size * row)
            first += size
            wanted = pace.next_size(size, time.perf_counter() - began)


class _Pace:
    """Chooses the size of a chunk from the times of those before.

    A part of the time does not depend on the size: tracing and assembling a kernel takes a second where a scene has a hundred instances.
    That part is told by two chunks that differ in size, and chunks are so large that it stays below a fifth of the whole.
    """

    def __init__(self) -> None:
        self._before: tuple[int, float] | None = None
        self._fixed: float | None = None
        self._is_first = True

    def next_size(self, size: int, took: float) -> int:
        """Choose the size of the next chunk, after one that took so many seconds."""
        if self._is_first:  # it may have been compiled, too
            self._is_first = False
            return 2 * size if took < PACE else size
        if self._before and max(size, self._before[0]) >= DIFFERENT * min(size, self._before[0]):
            rate = (took - self._before[1]) / (size - self._before[0])
            self._fixed = max(took - max(rate, 0) * size, 0.0)
        self._before = size, took
        if self._fixed is None:
            return 2 * size
        rate = max(took - self._fixed, took / MOST_GROWTH) / size
        return max(1, int(size * min(MOST_GROWTH, max(PACE - self._fixed, LEAST_WORK * self._fixed) / (rate * size))))


def chunks(total: int, largest: int) -> list[int]:
    """Cut ``total`` units into chunks of at most ``largest``."""
    return [min(largest, total - first) for first in range(0, total, largest)]
