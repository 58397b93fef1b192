"""Ctrl-C where Python's own exception does not arrive."""

import signal
import subprocess
import sys
import threading
import time

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


def test_the_third_control_c_ends_what_hears_none():
    code = (
        "import time, threading, signal, os\n"
        "from pellucid.cli.interrupts import ended_by_many\n"
        "signal.signal(signal.SIGINT, lambda *_: None)\n"
        "with ended_by_many():\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    for number in range(3):
        assert process.poll() is None, number
        process.send_signal(signal.SIGINT)
        time.sleep(0.3)
    _, errors = process.communicate(timeout=10)
    assert (process.returncode, errors) == (130, "interrupted three times: ended at once\n")
