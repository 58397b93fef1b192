import io
import time

import pytest

from pellucid.cli import reporter
from pellucid.cli.reporter import StageClock
from pellucid.progress import reporting_to, steps


def test_stages_are_timed_without_the_stages_inside_them():
    clock = StageClock(bar=False)
    with reporting_to(clock), clock.lap() as lap, clock.stage("preparation"):
        time.sleep(0.03)
        for _ in steps("irradiance", [1, 1], "samples"):
            time.sleep(0.03)
        with clock.stage("preparation"):  # the same stage again, deeper: counted once
            time.sleep(0.02)
    assert list(clock.times) == ["preparation", "irradiance"]
    assert clock.times["preparation"] == pytest.approx(0.05, abs=0.02)
    assert clock.times["irradiance"] == pytest.approx(0.06, abs=0.02)
    assert sum(clock.times.values()) == pytest.approx(lap.seconds, abs=0.005)


def test_an_error_ends_the_stages_it_leaves():
    clock = StageClock(bar=False)
    with reporting_to(clock), pytest.raises(ValueError), clock.stage("load"):
        for _ in steps("samples", [1], "samples"):
            raise ValueError
    with clock.stage("picture"):
        pass
    assert list(clock.times) == ["load", "samples", "picture"]


def test_the_bar_shows_stage_share_and_rate_on_a_terminal(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    assert reporter.wants_bar(quiet=False) and not reporter.wants_bar(quiet=True)
    clock = StageClock(bar=True)
    with reporting_to(clock):
        for _ in steps("picture", [500_000] * 4, "paths"):
            time.sleep(0.15)
    clock.close()
    shown = terminal.getvalue()
    assert "picture" in shown and "50 %" in shown and "M paths/s" in shown


def test_a_pipe_gets_no_bar(monkeypatch):
    monkeypatch.setattr("sys.stderr", io.StringIO())
    assert not reporter.wants_bar(quiet=False)


@pytest.mark.parametrize(("number", "text"), [(3.14159, "3.14"), (12_345, "12.3 k"), (2e6, "2 M"), (3.21e9, "3.21 G")])
def test_rates_have_three_digits(number, text):
    assert reporter._short(number) == text
