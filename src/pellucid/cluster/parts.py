"""Parts of the samples that stay on workers, and how a piece of a picture asks them for its light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from distributed import Future

from . import worker


@dataclass
class Parts:
    """Parts of the samples, by their numbers: the tasks that light them, and what stands for each where a worker keeps it."""

    lighting: dict[int, tuple[Any, ...]]
    kept: dict[int, Future]


@dataclass
class Asking:
    """Asks all parts of the samples for the exitance at the points of a piece, which another task lists, before that piece is made."""

    parts: Parts
    points: tuple[Any, ...]

    def send(self, send: Callable[..., Future]) -> dict[str, Any]:
        """Send the tasks, and give what comes of them (`worker.Answered`). A part that could not be lit anew is tried again."""
        parts, points = self.parts, send(*self.points)
        for k, task in parts.lighting.items():
            if parts.kept[k].status == "error":
                parts.kept[k] = send(*task)
        key = self.points[1]
        return {"points": points, "sums": [send(worker.exitance, key, part, points) for part in parts.kept.values()]}
