"""How long work reports where it stands: silent by default, a bar when a door (the command line) opens one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class Reporter(Protocol):
    """What a door provides: called at the start of a stage, after each step of it, and at its end."""

    def start(self, stage: str, total: int, unit: str) -> None:
        """Begin a stage of ``total`` units."""

    def advance(self, done: int) -> None:
        """Report ``done`` more units."""

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


def steps(stage: str, sizes: Iterable[int], unit: str) -> Iterator[tuple[int, int]]:
    """Walk over chunks of work and report each: yields ``(first, size)`` of every chunk."""
    sizes = list(sizes)
    reporter = _reporter.get()
    if reporter is not None:
        reporter.start(stage, sum(sizes), unit)
    first = 0
    try:
        for size in sizes:
            yield first, size
            first += size
            if reporter is not None:
                reporter.advance(size)
    finally:
        if reporter is not None:
            reporter.finish()


def chunks(total: int, largest: int) -> list[int]:
    """Cut ``total`` units into chunks of at most ``largest``."""
    return [min(largest, total - first) for first in range(0, total, largest)]
