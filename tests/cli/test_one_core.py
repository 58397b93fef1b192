"""One core: everything works there too."""

import os
import subprocess
import sys

import pytest

ALONE = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be bound to a core here")
EXR = """
import {first}
import {second}
import numpy as np, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
mi.Bitmap(np.ones((40, 30, 3), np.float32)).write("a.exr")
assert np.array(mi.Bitmap("a.exr")).sum() == 3600
"""


def on_one_core(*command, cwd, timeout=240):
    return subprocess.run(
        [sys.executable, *command],
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}),
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=cwd,
    )


@ALONE
@pytest.mark.parametrize("order", [("pellucid", "mitsuba"), ("mitsuba", "pellucid")])
def test_pictures_are_written_and_read(tmp_path, order):
    done = on_one_core("-c", EXR.format(first=order[0], second=order[1]), cwd=tmp_path, timeout=60)
    assert done.returncode == 0, done.stderr


@ALONE
@pytest.mark.parametrize("threads", [(), ("-t", "1")])
def test_the_command_ends(tmp_path, scene_file, threads):
    done = on_one_core("-m", "pellucid", "render", scene_file, *threads, "-o", "r.exr", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "r.exr").is_file()


def test_one_thread_is_not_too_few(tmp_path, scene_file):
    command = [sys.executable, "-m", "pellucid", "render", str(scene_file), "-t", "1", "-o", "r.exr"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
