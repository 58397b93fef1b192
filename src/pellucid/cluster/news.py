"""How far pieces of work are: workers tell it as they go, and the one who waits adds it up."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from math import inf
from typing import Any

from ..progress import stage_of

STAGES = {
    "scene": ("scenes", None),
    "samples": ("parts", None),
    "irradiance": ("parts", "irradiance"),
    "tiles": ("tiles", "picture"),
    "frames": ("frames", "picture"),
}
"""By what waits for workers: what its pieces are called, and the stage in which a worker makes one. What it does before, every worker does
for all pieces: it prepares for them."""


@dataclass(frozen=True)
class Listener:
    """Who wants to know of a piece: the topic that is listened to, the stage that it is a piece of, and the seconds between news."""

    topic: str
    stage: str
    every: float


@dataclass
class News:
    """Where a worker is: in stage ``number`` of all that it has begun for the piece with a key, of which ``done`` of ``total`` is done."""

    key: str
    number: int
    stage: str
    unit: str
    total: int
    done: float = 0

    @classmethod
    def of(cls, event: tuple[float, dict[str, Any]]) -> News:
        """Read an event of Dask, which adds to it."""
        return cls(**{name: event[1][name] for name in cls.__dataclass_fields__})


class Teller:
    """Tells a listener where the work on a piece stands (a `progress.Reporter`).

    Of the stages that are open it tells of the piece's own, or else of the innermost one.
    """

    def __init__(self, listener: Listener, key: str, send: Callable[[str, dict[str, Any]], None]):
        self._listener, self._key, self._send = listener, key, send
        self._open: list[News] = []
        self._begun, self._next = 0, -inf

    def start(self, stage: str, total: int, unit: str) -> None:
        """Begin a stage."""
        self._begun += 1
        self._open.append(News(self._key, self._begun, stage, unit, total))
        self._tell()

    def advance(self, done: float) -> None:
        """Count."""
        self._open[-1].done += done
        self._tell()

    def finish(self) -> None:
        """End a stage."""
        self._open.pop()

    def _tell(self) -> None:
        """Tell, unless that was done a moment ago."""
        if time.monotonic() < self._next:
            return
        _, own = STAGES[self._listener.stage]
        self._send(self._listener.topic, asdict(next((s for s in self._open if s.stage == own), self._open[-1])))
        self._next = time.monotonic() + self._listener.every


class Watch:
    """Shows how far pieces are: adds up the parts that workers have done of them.

    Until the first of them is begun, what workers prepare is shown, of the one that is ahead: all do the same.

    Parameters
    ----------
    stage : str
        One of `STAGES`.
    keys : iterable of str
        Of all pieces.
    wanted : int
        How many of them are waited for.
    """

    def __init__(self, stage: str, keys: Iterable[str], wanted: int):
        self._stage, self._wanted, (self._unit, self._own) = stage, wanted, STAGES[stage]
        self._parts = dict.fromkeys(keys, 0.0)
        self._shown, self._within = ExitStack(), ExitStack()
        self._ahead, self._begun = (0, 0.0), False
        if self._own is None:
            self._advance = self._show()
        else:
            self._shown.enter_context(stage_of("preparation", 1, "scenes"))

    def hear(self, news: News) -> None:
        """Take in what a worker tells; of pieces that are not ours it is old."""
        if news.key not in self._parts:
            return
        if news.stage == self._own:
            self._reach(news.key, news.done / news.total)
        elif not self._begun and (news.number, news.done) > self._ahead:
            number, done = self._ahead
            if news.number > number:
                self._within.close()
                self._prepare, done = self._within.enter_context(stage_of(news.stage, news.total, news.unit)), 0
            self._prepare(news.done - done)
            self._ahead = news.number, news.done

    def complete(self, key: str) -> None:
        """Note that a piece is back."""
        self._reach(key, 1.0)

    def begin_again(self, key: str, other: str) -> None:
        """Give a piece another key."""
        self._parts[other] = self._parts.pop(key)

    def close(self) -> None:
        """End what is shown."""
        self._within.close()
        self._shown.close()

    def _show(self) -> Callable[[float], None]:
        """Begin to show the pieces."""
        self.close()
        return self._shown.enter_context(stage_of(self._stage, self._wanted, self._unit))

    def _reach(self, key: str, part: float) -> None:
        """Note how much of a piece is done; a worker that does it again starts with less, and counts from where the first one was."""
        if not self._begun:
            self._begun = True
            self._within.close()
            if self._own is not None:
                self._advance = self._show()
        if part > self._parts[key]:
            self._advance(part - self._parts[key])
            self._parts[key] = part
