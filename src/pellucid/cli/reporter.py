"""Where the work stands: bars on a terminal, a line for each long stage in a pipe, and the time of every stage for the summary."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from .. import _kernel_folder

LONG = 2.0
"""Seconds after which a pipe is told what is going on."""


@dataclass
class Lap:
    """How long something took [s], once it is over."""

    seconds: float = 0.0


@dataclass
class Stage:
    """A stage that is going on: its name, when it began, the time of the stages inside it [s], its bar, and who tells of it."""

    name: str
    began: float
    inside: float = 0.0
    task: Any = None
    teller: threading.Timer | None = field(default=None)


class StageClock:
    """Measures how long each stage takes, without the stages inside it, and shows where it stands when asked to.

    It is a reporter (`pellucid.progress.Reporter`). ``times`` maps the stages to seconds, in their order. With ``bar`` it draws
    bars, with ``lines`` it writes a line about every stage that takes long.
    """

    def __init__(self, bar: bool = False, lines: bool = False):
        self.times: dict[str, float] = {}
        self._open: list[Stage] = []
        self._progress = _bar() if bar else None
        self._lines, self._told = lines, set[tuple[str, ...]]()
        self._compiling = 0.0
        self._start = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure what happens inside as a stage, of which nobody knows how far it is."""
        self.start(name, None, "")
        try:
            yield
        finally:
            self.finish()

    def start(self, stage: str, total: int | None, unit: str) -> None:
        """Begin a stage."""
        self.times.setdefault(stage, 0.0)
        begun = Stage(stage, time.perf_counter())
        if self._progress is not None:
            self._progress.start()
            if self._open and self._progress.tasks[-1].total is None:  # what it is doing says more
                self._progress.update(self._open[-1].task, visible=False)
            begun.task = self._progress.add_task(stage, total=total, unit=unit, stepped=begun.began)
        self._open.append(begun)
        if self._lines:
            self._tell_later(begun, f", {total} {unit}" if total else "")

    def advance(self, done: float) -> None:
        """Move the bar."""
        if self._progress is not None:
            self._progress.update(self._open[-1].task, advance=done, stepped=time.perf_counter())

    def finish(self) -> None:
        """End a stage."""
        ended = self._open.pop()
        if ended.teller is not None:
            ended.teller.cancel()
        if self._progress is not None:
            self._progress.remove_task(ended.task)
            if self._open:
                self._progress.update(self._open[-1].task, visible=True)
        took = time.perf_counter() - ended.began
        self.times[ended.name] += took - ended.inside
        if self._open:
            self._open[-1].inside += took

    def _tell_later(self, stage: Stage, amount: str) -> None:
        """Write a line about a stage if it takes long, once for each stage inside the same ones."""
        place = tuple(other.name for other in self._open)
        if place in self._told:
            return
        since = stage.began - self._start

        def tell() -> None:
            self._told.add(place)
            print(f"{since:6.1f} s: {stage.name}{amount} ...", file=sys.stderr, flush=True)

        stage.teller = threading.Timer(LONG, tell)
        stage.teller.daemon = True
        stage.teller.start()

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
        kept = "" if _kernel_folder.OBSTACLE else ", which the next run finds ready"
        note = f", {compiling:.1f} s of it for compiling kernels{kept}" if compiling > 0.5 else ""
        return f"{', '.join(parts)}; {sum(self.times.values()):.2f} s in all{note}"


def clock_of(quiet: bool) -> StageClock:
    """Make the clock of a command: with bars on a terminal, with lines elsewhere, silent if asked to be quiet."""
    on_terminal = sys.stderr.isatty()
    return StageClock(bar=on_terminal and not quiet, lines=not on_terminal and not quiet)


def speed(task: Any) -> float | None:
    """Estimate the units a second of a bar: without its first step, in which kernels are compiled, once there are others."""
    if not task.completed:
        return None
    return task.speed or task.completed / max(task.elapsed, 1e-9)


def seconds_left(task: Any, now: float) -> float | None:
    """Estimate how long a bar has still to go [s], from its speed and the time since its last step."""
    rate = speed(task)
    return None if rate is None else max(0.0, task.remaining / rate - (now - task.fields["stepped"]))


def _bar() -> Any:
    """Make the bars: stage, share, rate, time so far and time left."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        """Units per second."""

        def render(self, task: Task) -> Text:
            """Write the rate, once there is one."""
            rate = speed(task)
            return Text(f"{_short(rate)} {task.fields['unit']}/s" if rate else "", style="cyan")

    class Share(ProgressColumn):
        """What is done of the whole."""

        def render(self, task: Task) -> Text:
            """Write it, where the whole is known."""
            return Text("" if task.total is None else f"{task.percentage:>3.0f} %")

    class Left(ProgressColumn):
        """The time left."""

        def render(self, task: Task) -> Text:
            """Write it, once there is an estimate."""
            left = seconds_left(task, time.perf_counter())
            return Text("" if left is None else f"{_clock(left)} left")

    columns = (TextColumn("{task.description:<10}"), BarColumn(), Share(), Rate(), TimeElapsedColumn(), Left())
    return Progress(*columns, console=Console(stderr=True), transient=True)


def _clock(seconds: float) -> str:
    """Write a time as hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


def _short(number: float) -> str:
    """Write a number with three digits and a prefix."""
    for limit, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= limit:
            return f"{number / limit:.3g} {prefix}"
    return f"{number:.3g}"
