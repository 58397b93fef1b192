"""Which versions a machine has: workers that differ would give other bits, and are refused by name."""

from __future__ import annotations

import platform
from collections.abc import Mapping

from ..errors import ClusterError
from ..version import __version__


def versions() -> dict[str, str]:
    """List what the bits of a picture depend on, and what has to be alike for machines to understand each other."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np
    import scipy

    return {
        "pellucid": __version__,
        "Mitsuba": mi.__version__,
        "Dr.Jit": dr.__version__,
        "LLVM": ".".join(map(str, dr.detail.llvm_version())),
        "NumPy": np.__version__,
        "SciPy": scipy.__version__,
        "Python": ".".join(platform.python_version_tuple()[:2]),
        "processor": platform.machine(),
    }


def difference(ours: Mapping[str, str], theirs: Mapping[str, str]) -> str | None:
    """Write down what a worker has in other versions; None if nothing."""
    names = [name for name in ours if theirs.get(name) != ours[name]]
    return ", ".join(f"{name} {theirs.get(name, 'none')} instead of {ours[name]}" for name in names) or None


class UnfitWorker(ClusterError):
    """A worker that has come later, and has other versions; ``address`` is where it is."""

    def __init__(self, name: str, told: str, address: str):
        super().__init__(name, told, address)  # all of them, so that it can travel
        self.address = address

    def __str__(self) -> str:
        return f"The worker {self.args[0]} does not fit this machine: {self.args[1]}. Install the same there."


def refuse_others(ours: Mapping[str, str], workers: Mapping[str, Mapping[str, str] | Exception]) -> None:
    """Check the versions of all workers, or what kept them from telling.

    Raises
    ------
    ClusterError
        With the names of those that differ, and in what.
    """
    wrong = []
    for name, found in workers.items():
        if isinstance(found, Exception):
            wrong.append(f"{name} ({type(found).__name__}: {' '.join(str(found).split())})")
        elif told := difference(ours, found):
            wrong.append(f"{name} ({told})")
    if wrong:
        raise ClusterError(
            f"Workers that do not fit this machine: {'; '.join(wrong)}. Install the same there, or end them."
        )
