"""Time work on a device whose kernels are compiled when they first run and may still run when a call returns."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass
class Timing:
    """What some work takes: its median [s], and by how much its first run exceeds that, which is compilation."""

    median: float
    compilation: float
    result: Any = None


def run(work: Callable[[], Any]) -> tuple[float, Any]:
    """Do some work once, wait for the device, and tell how long that took [s] and what came out."""
    import drjit as dr

    start = time.perf_counter()
    result = work()
    dr.eval(result)
    dr.sync_thread()
    return time.perf_counter() - start, result


def interleaved(works: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Timing]:
    """Time several works in turns, so that a change of the machine's speed meets all of them.

    Parameters
    ----------
    works : dict
        What to time, by name.
    repeats : int
        Timed runs of each, after a first one that compiles its kernels.
    """
    first = {name: run(work)[0] for name, work in works.items()}
    times: dict[str, list[float]] = {name: [] for name in works}
    results: dict[str, Any] = {}
    for _ in range(repeats):
        for name, work in works.items():
            seconds, results[name] = run(work)
            times[name].append(seconds)
    medians = {name: statistics.median(values) for name, values in times.items()}
    return {name: Timing(medians[name], max(0.0, first[name] - medians[name]), results[name]) for name in works}


def timed(work: Callable[[], Any], repeats: int = 3) -> Timing:
    """Time one work: a first run that compiles its kernels, then the median of a few."""
    return interleaved({"work": work}, repeats)["work"]
