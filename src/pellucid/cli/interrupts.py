"""Ctrl-C that arrives wherever it comes."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = 130
"""What shells report of a process that Ctrl-C has ended: 128 + SIGINT."""

PATIENCE = 3
"""So many times Ctrl-C ends the process at once, whatever it does."""


@contextmanager
def interruptible(left: Callable[[], str] = str, stop: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Let Ctrl-C end the block with a ``KeyboardInterrupt`` that says what is left of its work.

    Python's own exception does not always arrive: Dr.Jit turns what is raised while it records a loop or a branch into
    a ``RuntimeError``, and Python drops what is raised in a finalizer. So Ctrl-C is remembered, and every later
    exception of the block counts as its effect. ``stop`` is called at once, for loops that would go on without it.
    """
    came = False
    before = signal.getsignal(signal.SIGINT)
    if callable(before):  # it is not where the process was started with Ctrl-C ignored

        def interrupt(*signalled: Any) -> None:
            nonlocal came
            came = True
            stop()
            before(*signalled)

        signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except KeyboardInterrupt as error:
        raise KeyboardInterrupt(str(error) or left()) from None
    except Exception:
        if came:
            raise KeyboardInterrupt(left()) from None
        raise
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def ended_by_many() -> Iterator[None]:
    """Let the third Ctrl-C end the process, also while compiled code runs: Python's own handler waits until that returns."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python tells no other thread of signals
        return
    sender, receiver = socket.socketpair()
    sender.setblocking(False)
    before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_count, args=(receiver,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        sender.close()


def _count(receiver: socket.socket) -> None:
    """Count Ctrl-C until the other end is closed."""
    count = 0
    with receiver:
        while received := receiver.recv(64):
            count += received.count(signal.SIGINT)
            if count >= PATIENCE:
                os.write(2, b"interrupted three times: ended at once\n")
                os._exit(INTERRUPTED)
