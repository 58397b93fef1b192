"""Lint and types, as the rest of the tests: the gate has one command."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "command", [["ruff", "check", "src", "tests", "benchmarks", "examples"], ["mypy"]], ids=lambda c: c[0]
)
def test_clean(command):
    result = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_the_page_is_clean():
    linter = Path(sys.executable).parent / "oxlint"
    assert linter.exists(), "oxlint is not installed: pip install '.[test]'"
    command = [linter, "--deny-warnings", "src/pellucid/page/web"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
