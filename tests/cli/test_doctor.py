import subprocess

import mitsuba as mi
import pytest

from pellucid.cli import doctor
from pellucid.errors import EnvironmentProblem, PellucidError
from pellucid.kernels import backend


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


def test_the_variant_taken_is_named_and_what_is_wrong_with_the_others(monkeypatch):
    reasons = {"llvm_ad_rgb": "No LLVM library was found.", "cuda_ad_rgb": None, "metal_ad_rgb": "no Metal device"}
    monkeypatch.setattr(backend, "obstacle", reasons.get)
    monkeypatch.setattr(doctor, "obstacle", reasons.get)
    text = doctor._variants()
    assert text == "cuda_ad_rgb is taken; llvm_ad_rgb: No LLVM library was found.; metal_ad_rgb: no Metal device"
    assert backend.default_variant() == "cuda_ad_rgb"
    reasons["cuda_ad_rgb"] = "no CUDA device"
    with pytest.raises(
        EnvironmentProblem, match=r"^No variant .* llvm_ad_rgb: No LLVM library .*; cuda_ad_rgb: no CUDA"
    ):
        backend.choose_variant()


def test_a_variant_that_is_named_is_taken_or_refused():
    assert backend.choose_variant("llvm_ad_rgb") == mi.variant() == "llvm_ad_rgb"
    if backend.obstacle("cuda_ad_rgb"):
        with pytest.raises(
            EnvironmentProblem, match=r"-m cuda_ad_rgb: no CUDA device and driver were found; usable are llvm_ad_rgb\."
        ):
            backend.choose_variant("cuda_ad_rgb")
