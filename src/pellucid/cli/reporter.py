"""Where the work stands: a bar on a terminal, silence in a pipe, and the time of every stage for the summary."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


@dataclass
class Lap:
    """How long something took [s], once it is over."""

    seconds: float = 0.0


class StageClock:
    """Measures how long each stage takes, without the stages inside it, and draws a bar for it when asked to.

    It is a reporter (`pellucid.progress.Reporter`). ``times`` maps the stages to seconds, in their order.
    """

    def __init__(self, bar: bool):
        self.times: dict[str, float] = {}
        self._open: list[tuple[str, float]] = []
        self._inside: list[float] = []
        self._progress = _bar() if bar else None
        self._tasks: list[Any] = []
        self._compiling = 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what happens inside as a stage, without a bar."""
        self._begin(name)
        try:
            yield
        finally:
            self._end()

    def start(self, stage: str, total: int, unit: str) -> None:
        """Begin a stage with a bar."""
        self._begin(stage)
        if self._progress is not None:
            self._progress.start()
            self._tasks.append(self._progress.add_task(stage, total=total, unit=unit))

    def advance(self, done: int) -> None:
        """Move the bar."""
        if self._progress is not None:
            self._progress.advance(self._tasks[-1], done)

    def finish(self) -> None:
        """End a stage with a bar."""
        if self._progress is not None:
            self._progress.remove_task(self._tasks.pop())
        self._end()

    @contextmanager
    def lap(self) -> Iterator[Lap]:
        """Measure what happens inside, the stages in it included."""
        began, lap = time.perf_counter(), Lap()
        yield lap
        lap.seconds = time.perf_counter() - began

    def compiling(self) -> float:
        """Add up the time [s] that Dr.Jit has spent on compiling kernels; those in its cache cost little."""
        import drjit as dr

        parts = ("codegen_time", "backend_time")  # [ms]; built-in kernels such as reductions have none
        self._compiling += sum(kernel.get(part, 0) for kernel in dr.kernel_history() for part in parts) / 1e3
        return self._compiling

    def close(self) -> None:
        """Take the bar off the terminal."""
        if self._progress is not None:
            self._progress.stop()

    def summary(self) -> str:
        """Write the times of all stages in one line."""
        parts = [f"{name} {seconds:.2f} s" for name, seconds in self.times.items()]
        compiling = self.compiling()
        note = (
            f", {compiling:.1f} s of it for compiling kernels, which the next run finds ready"
            if compiling > 0.5
            else ""
        )
        return f"{', '.join(parts)}; {sum(self.times.values()):.2f} s in all{note}"

    def _begin(self, name: str) -> None:
        self.times.setdefault(name, 0.0)
        self._open.append((name, time.perf_counter()))
        self._inside.append(0.0)

    def _end(self) -> None:
        name, began = self._open.pop()
        took = time.perf_counter() - began
        self.times[name] += took - self._inside.pop()
        if self._inside:
            self._inside[-1] += took


def wants_bar(quiet: bool) -> bool:
    """Tell whether a bar should be shown: on a terminal, unless asked to be quiet."""
    return not quiet and sys.stderr.isatty()


def _bar() -> Any:
    """Make the bar: stage, share, rate, time so far and time left."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        """Units per second."""

        def render(self, task: Task) -> Text:
            """Write the rate, once there is one."""
            return Text(f"{_short(task.speed)} {task.fields['unit']}/s" if task.speed else "", style="cyan")

    return Progress(
        TextColumn("{task.description:<10}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        Rate(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )


def _short(number: float) -> str:
    """Write a number with three digits and a prefix."""
    for limit, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= limit:
            return f"{number / limit:.3g} {prefix}"
    return f"{number:.3g}"
