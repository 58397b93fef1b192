"""How much memory is free: of the machine, of the container, and within the limit of the process."""

from __future__ import annotations

import sys
from pathlib import Path

MEMINFO, STATUS, CGROUP = Path("/proc/meminfo"), Path("/proc/self/status"), Path("/sys/fs/cgroup")


watched_limit: int | None = None
"""Bytes that this process may hold, where another one watches it and ends it at more."""


def free_memory() -> int | None:
    """Find the number of bytes that can still be had; None where the system does not tell (it is asked on Linux only)."""
    limits = (_of_machine(), _of_container(), _of_process(), _of_watched())
    found = [bytes for bytes in limits if bytes is not None]
    return min(found, default=None)


def _table(path: Path) -> dict[str, int]:
    """Read lines of a name and a number [kB, or bytes], as the kernel writes them; none of a file that is not there."""
    try:
        rows = [line.replace(":", " ").split() for line in path.read_text().splitlines()]
    except OSError:
        return {}
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdecimal()}


def _of_machine() -> int | None:
    """Read what the kernel takes for available."""
    available = _table(MEMINFO).get("MemAvailable")
    return None if available is None else 1024 * available


def _of_container() -> int | None:
    """Subtract from the limit of the control group (version 2) what is in use, files that can be dropped left out."""
    try:
        limit = int((CGROUP / "memory.max").read_text())
        used = int((CGROUP / "memory.current").read_text())
    except (OSError, ValueError):  # no control group, or no limit ("max")
        return None
    return max(0, limit - used + _table(CGROUP / "memory.stat").get("inactive_file", 0))


def _of_process() -> int | None:
    """Subtract from the limit of the address space (``ulimit -v``) what is mapped."""
    if sys.platform != "linux":
        return None
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return None
    return max(0, limit - 1024 * _table(STATUS).get("VmSize", 0))


def _of_watched() -> int | None:
    """Subtract from the limit that is watched what the process holds."""
    return None if watched_limit is None else max(0, watched_limit - 1024 * _table(STATUS).get("VmRSS", 0))
