"""Find the LLVM library that Dr.Jit compiles kernels with. Imported before anything imports ``drjit``."""

from __future__ import annotations

import os
import platform
import site
import sys
import sysconfig
import warnings
from pathlib import Path

from .errors import EnvironmentProblem, PellucidWarning

VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST = 16  # older ones cannot select the minimum of two vectors on AVX-512


def _candidates() -> list[Path]:
    """List the places where the ``karellen-llvm-core`` wheel puts its library: ``lib/`` of the environment."""
    roots = {Path(sysconfig.get_path("data")), Path(sys.prefix), Path(site.getuserbase())}
    return sorted(p for root in roots for p in (root / "lib").glob("libLLVM.so.*"))


def point_to_wheel() -> None:
    """Let Dr.Jit use the LLVM of the wheel, unless the user has set ``DRJIT_LIBLLVM_PATH``.

    A system LLVM 14/15 on an AVX-512 machine aborts the process in ``dr.minimum``; the wheel's does not, so it goes first.
    """
    found = _candidates()
    if VARIABLE in os.environ or not found:
        return
    os.environ[VARIABLE] = str(found[-1])
    if "drjit" in sys.modules:  # it has chosen its LLVM already, when it was imported
        _warn_of_other_llvm(found[-1])


def _warn_of_other_llvm(wheel: Path) -> None:
    """Warn when Dr.Jit was imported first and took an LLVM that is known to fail."""
    version = sys.modules["drjit"].detail.llvm_version()
    if version is None or version[0] < OLDEST:
        found = "no LLVM" if version is None else f"LLVM {version[0]}"
        warnings.warn(
            f"Mitsuba was imported before pellucid and found {found}, which cannot run every kernel: import pellucid first, "
            f"or set {VARIABLE}={wheel}.",
            PellucidWarning,
            stacklevel=4,
        )


def require() -> None:
    """Check that an LLVM variant can run.

    Raises
    ------
    EnvironmentProblem
        When Dr.Jit finds no LLVM, with what to install on this platform.
    """
    import drjit as dr

    if dr.has_backend(dr.JitBackend.LLVM):
        return
    asked = os.environ.get(VARIABLE)
    if asked is not None:
        raise EnvironmentProblem(
            f"{VARIABLE}={asked} is no usable LLVM library: correct it, or unset it to use the one of the package."
        )
    system = platform.system()
    remedy = {
        "Darwin": "install it with 'brew install llvm'",
        "Windows": "install the LLVM release for Windows",
    }.get(system, "install 'karellen-llvm-core' (Linux x86-64) or the system package 'libllvm'")
    raise EnvironmentProblem(
        f"No LLVM library was found on this {system} {platform.machine()}: {remedy}, "
        f"set {VARIABLE} to its shared library, or choose a CUDA variant with -m cuda_ad_rgb."
    )
