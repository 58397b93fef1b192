"""What work takes: counts, and seconds by stage, kept while somebody observes and forgotten otherwise."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np


@dataclass
class Effort:
    """Counts by name ("shadow rays", "samples", ...), and seconds by stage ("samples", "light", ...)."""

    counts: Counter[str] = field(default_factory=Counter)
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))


_observed: ContextVar[Effort | None] = ContextVar("pellucid_effort", default=None)


@contextmanager
def observing() -> Iterator[Effort]:
    """Observe everything inside.

    Examples
    --------
    ::

        with observing() as effort:
            picture = mi.render(scene)
        print(effort.counts["shadow rays"], effort.seconds)
    """
    effort = Effort()
    token = _observed.set(effort)
    try:
        yield effort
    finally:
        _observed.reset(token)


def count(name: str, number: Any) -> None:
    """Add a number, or the sum of an array of whole numbers, to a count."""
    effort = _observed.get()
    if effort is not None:
        effort.counts[name] += number if isinstance(number, int) else int(np.sum(np.asarray(number), dtype=np.int64))


@contextmanager
def timed(stage: str) -> Iterator[None]:
    """Add the time of what is inside to a stage; where somebody observes, kernels are waited for."""
    effort = _observed.get()
    begin = time.perf_counter()
    yield
    if effort is not None:
        dr.sync_thread()
        effort.seconds[stage] += time.perf_counter() - begin
