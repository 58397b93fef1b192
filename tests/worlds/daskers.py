"""A scheduler and workers of Dask on the loopback, each a process of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ENDS = 20.0


@dataclass
class Dask:
    """A scheduler with workers of one thread each; they end by themselves after a while, if nobody ends them."""

    address: str
    folder: Path
    scheduler: subprocess.Popen
    environment: dict[str, str]
    workers: list[subprocess.Popen] = field(default_factory=list)

    def add_worker(self, *options: str, nanny: bool = False) -> subprocess.Popen:
        """Start another worker; without a nanny, its process is the one that computes."""
        name = f"w{len(self.workers)}"
        command = [
            "worker",
            self.address,
            "--nanny" if nanny else "--no-nanny",
            "--nthreads",
            "1",
            "--host",
            "127.0.0.1",
            "--no-dashboard",
        ]
        place = ["--name", name, "--local-directory", str(self.folder / name), "--lifetime", "10m"]
        self.workers.append(start(self.folder, name, [*command, *place, *options], self.environment))
        return self.workers[-1]

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait(ENDS)


def start(folder: Path, name: str, arguments: list[str], environment: dict[str, str]) -> subprocess.Popen:
    """Start a command of Dask, whose output goes to a file."""
    with open(folder / f"{name}.log", "w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]],
            stdout=log,
            stderr=log,
            env={**os.environ, **environment},
        )


@contextmanager
def dask_of(folder: Path, workers: int, environment: dict[str, str] | None = None, protocol: str = "tcp"):
    """Run a scheduler with workers."""
    environment = environment or {}
    contact = folder / "scheduler.json"
    arguments = [
        "scheduler",
        "--host",
        f"{protocol}://127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--idle-timeout",
        "10m",
    ]
    scheduler = start(folder, "scheduler", [*arguments, "--scheduler-file", str(contact)], environment)
    deadline = time.monotonic() + 60
    while not contact.is_file() or not contact.read_text():
        assert scheduler.poll() is None and time.monotonic() < deadline, (folder / "scheduler.log").read_text()
        time.sleep(0.05)
    dask = Dask(json.loads(contact.read_text())["address"], folder, scheduler, environment)
    try:
        for _ in range(workers):
            dask.add_worker()
        yield dask
    finally:
        dask.end()


def stop(process: subprocess.Popen) -> None:
    """Take a process away as a machine that fails does."""
    process.send_signal(signal.SIGKILL)
    process.wait(ENDS)
