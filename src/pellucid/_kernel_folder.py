"""Give Dr.Jit a folder in which it can keep compiled kernels. Imported before anything else imports Dr.Jit."""

from __future__ import annotations

import atexit
import errno
import os
import shutil
import sys
import tempfile
from pathlib import Path

VARIABLE = "DRJIT_CACHE_DIR"

LEAST, PROBE = 16 << 20, 1 << 20
"""Bytes that must be free where the folder is, and that are written to find out: kernels take 5 kB to 100 kB each."""


def usual_folder() -> Path | None:
    """Name the folder that Dr.Jit takes: ``DRJIT_CACHE_DIR``, else ``~/.drjit``; None where there is no ``HOME``."""
    chosen, home = os.environ.get(VARIABLE), os.environ.get("HOME")
    if chosen:
        return Path(chosen)
    return Path(home, ".drjit") if home else None


def obstacle(folder: Path | None) -> str | None:
    """Say why kernels cannot be kept in a folder, which is made where there is none; None where they can."""
    if folder is None:
        return "there is no HOME"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(folder).free < LEAST:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(PROBE))  # it may be read-only, or have a quota
    except OSError as error:
        return f"'{folder}': {error.strerror}"
    return None


def ensure() -> str | None:
    """Point Dr.Jit to a temporary folder, of this process alone, where its own cannot be used; say why that was.

    It lasts as long as the process. Its name cannot be foreseen, so that nobody can put kernels or links there first.
    """
    if os.name != "posix" or (reason := obstacle(usual_folder())) is None:
        return None
    for parent in (None, "/dev/shm"):
        try:
            folder = tempfile.mkdtemp(prefix="pellucid-", dir=parent)
        except OSError:
            continue
        atexit.register(_remove, folder, os.getpid())
        if obstacle(Path(folder)) is None:
            _link(usual_folder(), folder)
            os.environ[VARIABLE] = folder
            break
    return reason


def _link(source: Path | None, target: str) -> None:
    """Let kernels that have been kept be found: a folder that cannot be written may still be read."""
    try:
        for kernel in source.glob("*.bin") if source is not None else ():
            os.symlink(kernel.resolve(), Path(target, kernel.name))
    except OSError:
        return  # it cannot be read either


def _remove(folder: str, process: int) -> None:
    """Remove the folder when the process that made it ends, not with a copy of it that was forked."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)


OBSTACLE = None if "drjit" in sys.modules else ensure()
"""Why compiled kernels cannot be kept beyond this process; None where they are, or where Dr.Jit came first and has said so."""


def advice() -> str:
    """Say what becomes of compiled kernels and what to do."""
    return (
        f"Compiled kernels cannot be kept ({OBSTACLE}), so that every run compiles new ones again: "
        f"set {VARIABLE} to a folder that can be written."
    )
