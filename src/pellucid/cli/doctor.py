"""``pellucid doctor``: what this machine has, what it lacks, and what to do about it."""

from __future__ import annotations

import importlib.util
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import click

from .. import _kernel_folder, _llvm
from ..errors import PellucidError, install
from ..kernels.backend import CANDIDATES, default_variant, obstacle
from ..version import __version__

EXTRAS = {
    "matplotlib": f"materials --plot; {install('plot')}",
    "imageio_ffmpeg": f"videos; {install('video')}",
    "viser": f"view; {install('viewer')}",
    "MaterialX": f"material files (.mtlx); {install('materialx')}",
}
RENDER_LIMIT = 300  # seconds


def _versions() -> str:
    """Name the versions of what pictures depend on."""
    return ", ".join(f"{name} {version(name)}" for name in ("mitsuba", "drjit", "numpy"))


def _compiler() -> str:
    """Find LLVM."""
    import drjit as dr

    _llvm.require()
    major, minor, patch = dr.detail.llvm_version()
    return f"{major}.{minor}.{patch} from {os.environ.get(_llvm.VARIABLE, 'where Dr.Jit looks itself')}"


def _variants() -> str:
    """Name the variant that is taken where none is named, and say of each other whether it works and why not."""
    taken = default_variant()
    others = [(variant, obstacle(variant)) for variant in CANDIDATES if variant != taken]
    return "; ".join([f"{taken} is taken", *(f"{variant}: {reason or 'works too'}" for variant, reason in others)])


def _kernels() -> str:
    """Name the folder of compiled kernels."""
    if _kernel_folder.OBSTACLE:
        return _kernel_folder.advice()
    return str(_kernel_folder.usual_folder() or "where Dr.Jit keeps them itself")


def _threads() -> str:
    """Count threads."""
    import drjit as dr

    return f"{dr.thread_count()} (the machine has {os.cpu_count()})"


def _render() -> str:
    """Render a tiny picture in a process of its own, since an LLVM that does not fit the processor ends its process.

    Raises
    ------
    PellucidError
        When no picture comes out, with what the process said last.
    """
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "tiny.png"
        command = [sys.executable, "-m", "pellucid", "render", "teapot", "--resolution", "32x24", "--samples", "500"]
        command += ["--sampling", "uniform", "--spp", "1", "-q", "-o", str(picture)]
        began = time.perf_counter()
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=RENDER_LIMIT)
        except subprocess.TimeoutExpired:
            raise PellucidError(f"a picture of 32x24 pixels was not done after {RENDER_LIMIT} s") from None
        took = time.perf_counter() - began
        if done.returncode < 0:
            raise PellucidError(
                f"the process died of signal {-done.returncode}: the LLVM library does not fit this processor; "
                f"unset {_llvm.VARIABLE} to use the one of the package, or set it to a newer one"
            )
        if done.returncode or not picture.is_file():
            last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            raise PellucidError(f"no picture came out: {last}")
    return f"32x24 pixels in {took:.1f} s, start of the program included"


CHECKS: tuple[tuple[str, Callable[[], str]], ...] = (
    ("versions", _versions),
    ("LLVM", _compiler),
    ("variants", _variants),
    ("kernels", _kernels),
    ("threads", _threads),
    ("picture", _render),
)


@click.command()
@click.pass_context
def doctor(context: click.Context) -> None:
    """Check that this machine can render, and say what to do if not.

    The exit code is 1 if something is broken.
    """
    click.echo(f"pellucid   {__version__}")
    click.echo(f"python     {platform.python_version()} ({sys.executable}) on {platform.system()} {platform.machine()}")
    broken = 0
    for name, check in CHECKS:
        try:
            click.echo(f"{name:<10} {check()}")
        except (PellucidError, ImportError, RuntimeError) as error:
            broken += 1
            click.echo(f"{name:<10} BROKEN: {' '.join(str(error).split())}")
    for module, purpose in EXTRAS.items():
        state = "installed" if importlib.util.find_spec(module) else "not installed"
        click.echo(f"{'optional':<10} {module} {state} ({purpose})")
    click.echo(f"{broken} of {len(CHECKS)} checks failed" if broken else "all is well")
    context.exit(1 if broken else 0)
