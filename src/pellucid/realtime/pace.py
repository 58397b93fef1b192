"""How long frames take, and when they need not be made any more."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr
import mitsuba as mi

from .source import Frame


class Clock:
    """Times the stages of a frame; only one that waits for their ends can tell them apart."""

    def __init__(self, waits: bool):
        self.waits, self.begin = waits, time.perf_counter()
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage."""
        begin = time.perf_counter()
        yield
        if self.waits:
            dr.sync_thread()
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin

    def stop(self) -> dict[str, float]:
        """Give the times of the stages, and of the whole frame."""
        return {**self.seconds, "whole": time.perf_counter() - self.begin}


class Stillness:
    """The pictures that are added up for as long as nothing changes.

    Attributes
    ----------
    key : object
        What they have in common.
    passes : int
        How many there are.
    frame : Frame or None
        The latest frame.
    """

    def __init__(self) -> None:
        self.restart(None)

    def restart(self, key: object) -> None:
        """Begin with no picture."""
        self.key, self.passes = key, 0
        self.totals: list[mi.Color3f] = []
        self.frame: Frame | None = None

    def add(self, *colours: mi.Color3f) -> list[mi.Color3f]:
        """Add the parts of a picture; return the mean of each."""
        self.totals = [a + b for a, b in zip(self.totals, colours, strict=True)] if self.totals else list(colours)
        self.passes += 1
        dr.eval(self.totals)
        return [total * dr.opaque(mi.Float, 1 / self.passes) for total in self.totals]
