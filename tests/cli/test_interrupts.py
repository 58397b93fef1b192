"""Ctrl-C where Python's own exception does not arrive."""

import signal
import threading

import pytest

from pellucid.cli.interrupts import interruptible
from pellucid.viewer.loop import RenderLoop
from worlds.terminal import control_c, control_c_while_recording


class Finalized:
    """Is interrupted where Python drops exceptions."""

    __del__ = control_c


def test_while_a_loop_is_recorded():
    with pytest.raises(RuntimeError):
        control_c_while_recording()
    with pytest.raises(KeyboardInterrupt, match="one frame is left"), interruptible(lambda: "one frame is left"):
        control_c_while_recording()


def test_the_innermost_says_what_is_left():
    outer, inner = interruptible(lambda: "outer"), interruptible(lambda: "inner")
    with pytest.raises(KeyboardInterrupt, match="inner"), outer, inner, interruptible():
        control_c_while_recording()


def test_other_errors_stay_what_they_are_and_the_handler_goes():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), interruptible():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("lost", [control_c_while_recording, lambda source: Finalized()])
def test_a_loop_that_never_sees_the_exception_stops(lost):
    loop = RenderLoop(None)
    rescue = threading.Timer(10, loop.stop)
    rescue.start()
    loop.edit("interrupted", lost)
    with interruptible(stop=loop.stop):
        loop.run()
    assert rescue.is_alive()
    rescue.cancel()
