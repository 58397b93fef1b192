"""Give Dr.Jit an LLVM library that can compile every kernel. Imported before anything else of the package."""

from __future__ import annotations

import ctypes
import os
import platform
import site
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

from .errors import EnvironmentProblem, warn

VARIABLE = "DRJIT_LIBLLVM_PATH"

OLDEST = 17 if platform.machine() in ("x86_64", "AMD64") else 15
"""Before 17, LLVM ends the process on x86-64 where a kernel takes a minimum ("Cannot select: fminimum"); Dr.Jit needs 15."""

CAME_LATE = "drjit" in sys.modules
"""Dr.Jit was imported before pellucid, and has chosen its LLVM then."""

BACKENDS = 0b110
"""CUDA and LLVM, as the bits of ``jit_init``."""

REGISTERED = ("BSDF", "Emitter", "Medium", "PhaseFunction", "Sensor", "Shape", "Texture")
"""Classes of Mitsuba whose objects Dr.Jit keeps by number."""


def _candidates() -> list[Path]:
    """List the places where the ``karellen-llvm-core`` wheel puts its library: ``lib/`` of the environment."""
    roots = {Path(sysconfig.get_path("data")), Path(sys.prefix), Path(site.getuserbase())}
    return sorted(p for root in roots for p in (root / "lib").glob("libLLVM.so.*"))


def check_folder() -> None:
    """Make sure that there is a current folder: Mitsuba ends the process where that has been deleted.

    Raises
    ------
    EnvironmentProblem
    """
    try:
        os.getcwd()
    except FileNotFoundError:
        raise EnvironmentProblem("The folder that this runs in has been deleted: change to another one.") from None


def point_to_wheel() -> None:
    """Let Dr.Jit use the LLVM of the wheel, unless the user has set ``DRJIT_LIBLLVM_PATH`` or it has found one as good.

    Raises
    ------
    EnvironmentProblem
        When Dr.Jit was imported first, cannot change over to the wheel any more, and there is no GPU to use instead.
    """
    found = _candidates()
    if VARIABLE in os.environ or not found:
        return
    if not CAME_LATE:
        os.environ[VARIABLE] = str(found[-1])
        return
    import drjit as dr

    if _version() >= OLDEST:
        return
    os.environ[VARIABLE] = str(found[-1])
    _look_again(dr)
    if _version() < OLDEST:
        if not dr.has_backend(dr.JitBackend.CUDA):
            raise EnvironmentProblem(_problem())
        warn(_problem())


def _version() -> int:
    """Read the major version of the LLVM that Dr.Jit has found; -1 for none."""
    import drjit as dr

    return int(dr.detail.llvm_version()[0])


def _look_again(dr: ModuleType) -> None:
    """Shut Dr.Jit down and start it again, so that it reads ``DRJIT_LIBLLVM_PATH``, unless that would lose what it holds.

    Arrays in the memory of the processor outlive this; arrays on a GPU and the objects of a Mitsuba scene do not. A Dr.Jit
    that has found no LLVM at all does not look again.
    """
    core = ctypes.CDLL(str(Path(dr.__path__[0]) / "libdrjit-core.so"))
    variants = (
        [v for v in sys.modules["mitsuba"].variants() if v.startswith("llvm")] if "mitsuba" in sys.modules else []
    )
    count = core._Z21jit_registry_id_boundPKcS0_
    has_scene = any(count(variant.encode(), name.encode()) for variant in variants for name in REGISTERED)
    if has_scene or dr.detail.malloc_watermark(dr.JitBackend.CUDA):
        return
    dr.eval()  # what was scattered and not computed yet would be forgotten
    dr.sync_thread()
    threads, leak_warnings = dr.thread_count(), dr.detail.leak_warnings()
    dr.detail.set_leak_warnings(False)
    core._Z12jit_shutdowni(0)
    core._Z8jit_initj(BACKENDS)
    dr.detail.set_leak_warnings(leak_warnings)
    dr.set_thread_count(threads)


def require() -> None:
    """Check that an LLVM variant can run.

    Raises
    ------
    EnvironmentProblem
        When Dr.Jit has found no LLVM, or one that is too old, with what to do on this platform.
    """
    if _version() < OLDEST:
        raise EnvironmentProblem(_problem())


def _problem() -> str:
    """Say what is wrong with the LLVM that Dr.Jit has found, and what to do."""
    asked, wheel, version = os.environ.get(VARIABLE), [str(path) for path in _candidates()[-1:]], _version()
    found = (
        f"LLVM {version}, which is older than {OLDEST} and cannot compile every kernel" if version > 0 else "no LLVM"
    )
    if CAME_LATE and asked in wheel:
        return (
            f"Mitsuba or Dr.Jit was imported before pellucid and found {found}: import pellucid first, "
            f"or set {VARIABLE}={asked} before Python starts."
        )
    if asked is not None:
        is_wrong = f"is {found}" if version > 0 else "is no usable LLVM library"
        return f"{VARIABLE}={asked} {is_wrong}: correct it, or unset it to use the one of the package."
    system = platform.system()
    remedy = {
        "Darwin": "install it with 'brew install llvm'",
        "Windows": "install the LLVM release for Windows",
    }.get(system, f"install 'karellen-llvm-core' (Linux x86-64) or the system package 'libllvm{max(OLDEST, 19)}'")
    return (
        f"Dr.Jit found {found} on this {system} {platform.machine()}: {remedy}, "
        f"set {VARIABLE} to its shared library, or choose a CUDA variant with -m cuda_ad_rgb."
    )
