import subprocess

import pytest

from pellucid.cli import doctor
from pellucid.errors import EnvironmentProblem, PellucidError


def test_a_healthy_machine(run):
    result = run("doctor")
    for word in ("python", "mitsuba 3.9", "drjit", "LLVM", "llvm_ad_rgb", "threads", "32x24 pixels in", "all is well"):
        assert word in result.output


def test_what_is_wrong_is_said_and_counted(run, monkeypatch):
    def missing():
        raise EnvironmentProblem("No LLVM library was found: install it.")

    monkeypatch.setattr(doctor, "CHECKS", (("LLVM", missing), ("threads", doctor._threads)))
    result = run("doctor", code=1)
    assert "BROKEN: No LLVM library was found: install it." in result.output
    assert "threads    " in result.output and "1 of 2 checks failed" in result.output


@pytest.mark.parametrize(
    ("code", "stderr", "expected"),
    [
        (-6, "", "does not fit this processor"),
        (2, "noise\nerror: out of luck\n", "error: out of luck"),
        (0, "", "nothing"),
    ],
)
def test_a_render_that_fails_is_diagnosed(monkeypatch, code, stderr, expected):
    done = subprocess.CompletedProcess([], code, "", stderr)
    monkeypatch.setattr(doctor.subprocess, "run", lambda *_, **__: done)
    with pytest.raises(PellucidError, match=expected):
        doctor._render()
