"""How much memory is free, and what is too large for it."""

import subprocess
import sys

import mitsuba as mi
import pytest

from pellucid.errors import EnvironmentProblem
from pellucid.kernels import free_memory as module
from pellucid.kernels.free_memory import free_memory
from pellucid.methods import film as film_module


def test_the_least_of_machine_container_and_process(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(module, "CGROUP", tmp_path)
    assert module._of_machine() is None and module._of_container() is None
    (tmp_path / "meminfo").write_text("MemTotal:  99 kB\nMemAvailable:   4096 kB\n")
    assert free_memory() == 4096 * 1024
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("900000\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 50000\n")
    assert free_memory() == 4096 * 1024
    (tmp_path / "memory.max").write_text("1000000\n")
    assert free_memory() == 150_000


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a limit of the address space")
def test_the_limit_of_the_process():
    code = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (7 << 30, 7 << 30))\n"
        "from pellucid.kernels.free_memory import _of_process\nprint(_of_process())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 4e9 < int(done.stdout) < 7 * 2**30


def test_a_picture_that_is_too_large_is_refused_with_the_numbers(monkeypatch):
    monkeypatch.setattr(film_module, "free_memory", lambda: 7_000_000_000)
    film = mi.load_dict({"type": "hdrfilm", "width": 6000, "height": 6000})
    with pytest.raises(
        EnvironmentProblem, match=r"6000x6000 pixels needs about 13 GB of memory, and 7 GB are free: .*4409x4409"
    ):
        film_module.check_memory(film, 6000 * 6000)
    film_module.check_memory(film, 1000)
    monkeypatch.setattr(film_module, "free_memory", lambda: 500_000_000)
    # A tile: every path of the whole picture has a sampler.
    with pytest.raises(EnvironmentProblem, match=r"needs about 0\.638 GB"):
        film_module.check_pass(mi.load_dict({"type": "hdrfilm", "width": 384, "height": 384}), film, 16)
    monkeypatch.setattr(film_module, "free_memory", lambda: None)
    film_module.check_memory(film, 6000 * 6000)
