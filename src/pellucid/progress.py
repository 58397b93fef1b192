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


def paced(stage: str, total: int, unit: str, row: int = 1, within: int | None = None) -> Iterator[tuple[int, int]]:
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
    """
    with stage_of(stage, total * row, unit) as advance:
        first, size = 0, max(1, FIRST_CHUNK // row)
        while first < total:
            size = min(size, total - first, (within or total) - first % (within or total))
            began = time.perf_counter()
            yield first, size
            advance(size * row)
            first += size
            size = max(1, int(size * min(MOST_GROWTH, PACE / max(time.perf_counter() - began, 1e-6))))


def chunks(total: int, largest: int) -> list[int]:
    """Cut ``total`` units into chunks of at most ``largest``."""
    return [min(largest, total - first) for first in range(0, total, largest)]
