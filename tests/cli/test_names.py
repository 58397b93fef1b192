"""Names that are not UTF-8, and terminals that know few characters: nothing ends in a traceback."""

import os
import subprocess
import sys

import pytest

BYTES = os.fsdecode(b"\xff\xfe")


def pellucid(*arguments, cwd, **environment):
    command = [sys.executable, "-m", "pellucid", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, cwd=cwd, env=os.environ | environment, timeout=240)
    assert b"Traceback" not in done.stderr
    return done


@pytest.mark.parametrize(
    "environment", [{}, {"LC_ALL": "C"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}]
)
def test_pictures_are_written_and_named(tmp_path, scene_file, environment):
    done = pellucid("render", scene_file, "-o", f"é{BYTES}.exr", cwd=tmp_path, **environment)
    assert done.returncode == 0 and done.stdout.startswith(b"wrote ")
    assert "é".encode() + b"\xff\xfe.exr" in os.listdir(os.fsencode(tmp_path))


def test_tables_and_videos(tmp_path, scene_file):
    ascii = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    options = ("--methods", "two_pass,exact", "-o", f"{BYTES}.png")
    assert pellucid("compare", scene_file, *options, cwd=tmp_path, **ascii).returncode == 0
    assert pellucid("materials", cwd=tmp_path, **ascii).returncode == 0
    assert pellucid("turntable", scene_file, "--frames", "2", "-o", f"{BYTES}.mp4", cwd=tmp_path).returncode == 0
    assert (tmp_path / f"{BYTES}.mp4").is_file()


@pytest.mark.parametrize("arguments", [[f"{BYTES}.xml"], ["teapot_env", "--envmap", f"{BYTES}.exr"], [f"{BYTES}.ply"]])
def test_what_mitsuba_cannot_open_is_refused_before_the_work(tmp_path, arguments):
    done = pellucid("render", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count(b"\n") == 1 and b"is not UTF-8" in done.stderr
