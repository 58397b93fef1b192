"""Ctrl-C that arrives wherever it comes."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


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
