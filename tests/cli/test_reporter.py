import io
import threading
import time

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid import progress
from pellucid.cli import reporter
from pellucid.cli.reporter import StageClock
from pellucid.kernels.memory import lanes_where
from pellucid.progress import reporting_to, steps


def test_stages_are_timed_without_the_stages_inside_them():
    clock = StageClock()
    with reporting_to(clock), clock.lap() as lap, clock.stage("preparation"):
        time.sleep(0.12)
        for _ in steps("irradiance", [1, 1], "samples"):
            time.sleep(0.12)
        with clock.stage("preparation"):  # the same stage again, deeper: counted once
            time.sleep(0.08)
    assert list(clock.times) == ["preparation", "irradiance"]
    assert clock.times["preparation"] == pytest.approx(0.2, abs=0.1)
    assert clock.times["irradiance"] == pytest.approx(0.24, abs=0.1)
    assert sum(clock.times.values()) == pytest.approx(lap.seconds, abs=0.02)


def test_an_error_ends_the_stages_it_leaves():
    clock = StageClock()
    with reporting_to(clock), pytest.raises(ValueError), clock.stage("load"):
        for _ in steps("samples", [1], "samples"):
            raise ValueError
    with clock.stage("picture"):
        pass
    assert list(clock.times) == ["load", "samples", "picture"]


def a_terminal(monkeypatch):
    """Put a terminal in place of standard error."""
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    return terminal


def test_the_bar_shows_stage_share_and_rate_on_a_terminal(monkeypatch):
    terminal = a_terminal(monkeypatch)
    clock = reporter.clock_of(quiet=False)
    with reporting_to(clock):
        for _ in steps("picture", [500_000] * 4, "paths"):
            time.sleep(0.15)
    clock.close()
    shown = terminal.getvalue()
    assert "picture" in shown and "50 %" in shown and "M paths/s" in shown and "left" in shown


def test_a_stage_of_one_step_and_one_without_steps_show_a_running_clock(monkeypatch):
    terminal = a_terminal(monkeypatch)
    clock = reporter.clock_of(quiet=False)
    with reporting_to(clock), clock.stage("load"):
        time.sleep(1.3)
    assert "load" in terminal.getvalue() and "0:00:01" in terminal.getvalue()
    for _ in steps("samples", [1], "bodies"):
        time.sleep(1.3)
    clock.close()


def test_other_threads_run_while_lanes_are_waited_for():
    """Else the clock of a bar stands still."""

    def slow_mask(rounds):
        size, count = 1 << 20, dr.opaque(mi.UInt32, rounds)
        _, total = dr.while_loop(
            (dr.zeros(mi.UInt32, size), dr.arange(mi.UInt32, size)),
            lambda index, total: index < count,
            lambda index, total: (index + 1, total * 7 + index),
        )
        return total > 9

    def ticks_while_waiting(rounds):
        ticks, done = [time.perf_counter()], threading.Event()

        def tick():
            while not done.wait(0.02):
                ticks.append(time.perf_counter())

        thread = threading.Thread(target=tick)
        thread.start()
        try:
            lanes_where(slow_mask(rounds))
        finally:
            done.set()
            thread.join()
        return np.array([*ticks, time.perf_counter()])

    rounds = 2_000
    ticks = ticks_while_waiting(rounds)
    while np.ptp(ticks) < 0.6:  # too fast to tell
        rounds *= 3
        ticks = ticks_while_waiting(rounds)
    assert np.diff(ticks).max() < 0.5 * np.ptp(ticks)


def test_the_time_left_holds_after_a_quarter(monkeypatch):
    a_terminal(monkeypatch)
    clock = reporter.clock_of(quiet=False)
    sizes = [100, 300, 200, 100, 400, 300, 200, 400]
    with reporting_to(clock):
        began = None
        for first, size in steps("picture", sizes, "paths"):
            if first == 600:
                task, began = clock._progress.tasks[0], time.perf_counter()
                left = reporter.seconds_left(task, began)
            time.sleep(0.002 * size + (0.4 if first == 0 else 0))  # the first step compiles
    assert left == pytest.approx(time.perf_counter() - began, rel=0.3)
    clock.close()


def test_a_pipe_gets_one_line_for_each_long_stage(monkeypatch):
    pipe = io.StringIO()
    monkeypatch.setattr("sys.stderr", pipe)
    monkeypatch.setattr(reporter, "LONG", 0.2)
    clock = reporter.clock_of(quiet=False)
    with reporting_to(clock), clock.stage("preparation"):
        time.sleep(0.1)  # so that it is told of first
        for _ in range(2):
            for _ in steps("irradiance", [20, 20], "samples"):
                time.sleep(0.25)
        for _ in steps("tree", [1], "bodies"):
            pass
    lines = pipe.getvalue().splitlines()
    assert [line.split(": ")[1] for line in lines] == ["preparation ...", "irradiance, 40 samples ..."]
    assert float(lines[1].split(" s:")[0]) == pytest.approx(0.0, abs=0.2)


def test_kernels_are_said_to_be_kept_only_where_they_are(monkeypatch):
    clock = StageClock()
    monkeypatch.setattr(clock, "compiling", lambda: 3.0)
    for obstacle, kept in ((None, True), ("there is no HOME", False)):
        monkeypatch.setattr("pellucid._kernel_folder.OBSTACLE", obstacle)
        assert "3.0 s of it for compiling kernels" in clock.summary()
        assert ("the next run finds" in clock.summary()) is kept


def test_quiet_is_silent(monkeypatch):
    terminal = a_terminal(monkeypatch)
    clock = reporter.clock_of(quiet=True)
    with reporting_to(clock), clock.stage("load"):
        for _ in steps("picture", [1, 1], "paths"):
            time.sleep(0.2)
    assert not terminal.getvalue()


def test_chunks_follow_the_clock(monkeypatch):
    monkeypatch.setattr(progress, "FIRST_CHUNK", 100)
    monkeypatch.setattr(progress, "PACE", 0.05)
    found = []
    for first, size in progress.paced("exitance", 20_000, "points"):
        found.append((first, size))
        time.sleep(size * 2e-5)  # 2,500 points in 0.05 s
    assert [first for first, _ in found] == [0, *np.cumsum([size for _, size in found])[:-1]]
    assert sum(size for _, size in found) == 20_000
    assert 1_000 < found[-2][1] < 4_000
    assert list(progress.paced("exitance", 0, "points")) == []


def test_chunks_grow_where_most_of_their_time_does_not_depend_on_their_size(monkeypatch):
    monkeypatch.setattr(progress, "FIRST_CHUNK", 100)
    monkeypatch.setattr(progress, "PACE", 0.02)
    sizes = []
    for _, size in progress.paced("picture", 100_000, "paths"):
        sizes.append(size)
        time.sleep((0.3 if len(sizes) == 1 else 0.05) + size * 1e-6)  # the first is compiled
    assert len(sizes) < 10
    assert max(sizes) > 20_000


@pytest.mark.parametrize(("number", "text"), [(3.14159, "3.14"), (12_345, "12.3 k"), (2e6, "2 M"), (3.21e9, "3.21 G")])
def test_rates_have_three_digits(number, text):
    assert reporter._short(number) == text
