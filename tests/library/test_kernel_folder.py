"""Compiled kernels go to the folder of Dr.Jit, or to one that nobody else can know: never a raw line about it."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from pellucid import _kernel_folder


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Set a home that Dr.Jit has kept one kernel in."""
    monkeypatch.delenv(_kernel_folder.VARIABLE, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".drjit").mkdir()
    (tmp_path / ".drjit" / "old.bin").write_text("kernel")
    return tmp_path


def test_a_home_that_can_be_written_is_left_to_dr_jit(home):
    assert _kernel_folder.ensure() is None and _kernel_folder.VARIABLE not in os.environ
    assert [path.name for path in (home / ".drjit").iterdir()] == ["old.bin"]


def test_a_full_disk_is_replaced_by_a_private_folder_that_finds_what_was_kept(home, monkeypatch):
    free = _kernel_folder.shutil.disk_usage
    monkeypatch.setattr(
        _kernel_folder.shutil, "disk_usage", lambda p: free(p)._replace(free=9) if home in p.parents else free(p)
    )
    assert _kernel_folder.ensure() == f"'{home / '.drjit'}': No space left on device"
    folders = [Path(os.environ[_kernel_folder.VARIABLE])]
    assert stat.S_IMODE(folders[0].stat().st_mode) == 0o700
    assert (folders[0] / "old.bin").read_text() == "kernel"
    monkeypatch.delenv(_kernel_folder.VARIABLE)
    assert _kernel_folder.ensure() and os.environ[_kernel_folder.VARIABLE] not in map(str, folders)
    _kernel_folder._remove(str(folders[0]), os.getpid() + 1)
    assert folders[0].is_dir()  # a forked copy ends
    _kernel_folder._remove(str(folders[0]), os.getpid())
    assert not folders[0].exists() and (home / ".drjit" / "old.bin").exists()


@pytest.mark.parametrize("where", [{}, {"HOME": "{}/file"}, {"HOME": "/proc"}, {"DRJIT_CACHE_DIR": "{}/file/deep"}])
def test_no_home_is_needed_and_dr_jit_says_nothing_about_it(tmp_path, where):
    (tmp_path / "file").touch()
    code = "import pellucid, drjit as dr, os; dr.eval(dr.llvm.Float(1, 2) + 3); print(os.environ['DRJIT_CACHE_DIR'])"
    environment = {key: value for key, value in os.environ.items() if key not in ("HOME", _kernel_folder.VARIABLE)}
    environment |= {key: value.format(tmp_path) for key, value in where.items()}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and done.stderr == ""
    assert not Path(done.stdout.strip()).exists()  # it is gone with the process
