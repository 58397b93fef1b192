"""What workers of this machine load first: Ctrl-C in a terminal reaches them too, and is meant for the command alone."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Ignore Ctrl-C; the command takes back what it has sent, and ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
