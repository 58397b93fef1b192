"""What one and two workers take, extended on paper to many, for the benchmark of clusters."""

from __future__ import annotations

from dataclasses import dataclass

NETWORK = 1e9
"""Bytes a second of the network of the model: 10 gigabits, and a little less than all of them."""

PARTS_A_WORKER = 4
"""Tasks into which light is cut for each worker."""


@dataclass
class Run:
    """What a job on workers took: seconds in all and until the first piece was back, its pieces, and the bytes that workers sent."""

    seconds: float
    first: float
    pieces: int
    sent: int


@dataclass
class Estimate:
    """How long a job takes on paper [s]: what every worker does in full, and then what takes longest of all that goes on together."""

    preparation: float
    pieces: float
    scheduler: float
    network: float

    @property
    def seconds(self) -> float:
        """The time of the whole."""
        return self.preparation + max(self.pieces, self.scheduler, self.network)

    @property
    def bottleneck(self) -> str:
        """What takes longest."""
        return max(vars(self), key=vars(self).__getitem__)


def of_pieces(one: Run, a_task: float, workers: int, times: int = 1) -> Estimate:
    """Estimate a job of frames or tiles, from what one worker took for one of ``times`` fewer pieces.

    Every worker loads and prepares the scene for itself, which takes as long as until the first piece was back, less that piece. The
    pieces are shared out. Scheduler and network have to carry all tasks and all results one after the other.
    """
    piece = (one.seconds - one.first) / max(one.pieces - 1, 1)
    count = times * one.pieces
    return Estimate(one.first - piece, -(-count // workers) * piece, count * a_task, times * one.sent / NETWORK)


def of_light(one: Run, two: Run, a_task: float, workers: int) -> Estimate:
    """Estimate a job of light that workers share: what a second one saved is half of the shared part, and the rest all do in full.

    Every worker gets the samples and all of their light, which come from the one that has spread them.
    """
    shared = min(max(2 * (one.seconds - two.seconds), 0), one.seconds)
    tasks = PARTS_A_WORKER * workers if workers > 1 else 0
    sent = two.sent / 2 * workers if workers > 1 else one.sent
    return Estimate(one.seconds - shared, shared / workers, tasks * a_task, sent / NETWORK)
