"""Whichever of pellucid, Mitsuba and Dr.Jit is imported first, kernels compile, or an exception says what to do.

Each case is a process of its own, whose home is a folder of its own: kernels of other cases are not found there compiled.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pellucid import _llvm

WHEEL = [str(path) for path in _llvm._candidates()[-1:]]
needs_wheel = pytest.mark.skipif(not WHEEL, reason="the wheel of LLVM exists for Linux x86-64 only")


def system_llvm(version):
    """Find an LLVM of the system, or skip the test."""
    found = sorted(Path("/usr/lib/x86_64-linux-gnu").glob(f"libLLVM-{version}.so*"))
    if not found:
        pytest.skip(f"libllvm{version} is not installed")
    return str(found[-1])


@pytest.fixture
def run(tmp_path):
    """Run Python code, with the LLVM that the ``system`` has where Dr.Jit looks."""

    def run(code, system, user=False):
        first = f"import os\nos.environ[{_llvm.VARIABLE!r}] = {system!r}\n"
        if not user:  # what the system has is found when Dr.Jit is imported; the user has set nothing
            first += f"import drjit\ndrjit.detail.llvm_version()\ndel os.environ[{_llvm.VARIABLE!r}]\n"
        environment = {key: value for key, value in os.environ.items() if key != _llvm.VARIABLE}
        command = [sys.executable, "-c", first + code]
        return subprocess.run(command, capture_output=True, text=True, env=environment | {"HOME": str(tmp_path)})

    return run


RENDER = """
import drjit as dr, mitsuba as mi
if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")
assert dr.all(dr.minimum(dr.arange(mi.Float, 4), 2) == [0, 1, 2, 2])
ball = {"type": "sphere", "bsdf": {"type": "pellucid_translucent"}}
scene = {"type": "scene", "ball": ball, "light": {"type": "constant"},
         "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}}}
integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": 100})
assert dr.all(mi.render(mi.load_dict(scene, optimize=False), integrator=integrator, spp=1).array > 0.1)
"""

BEFORE = {
    "drjit": "",
    "mitsuba": "import mitsuba\n",
    "a variant": "import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')\n",
    "a scene that is gone": "import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')\nmi.load_dict(mi.cornell_box())\n",
}


@needs_wheel
@pytest.mark.parametrize("before", BEFORE.values(), ids=BEFORE)
def test_pellucid_may_be_imported_last(run, before):
    done = run(before + "import pellucid\n" + RENDER, system_llvm(15))
    assert done.returncode == 0, done.stderr[-2000:]


@needs_wheel
def test_pellucid_may_be_imported_first():
    code = "import pellucid\n" + RENDER
    environment = {key: value for key, value in os.environ.items() if key != _llvm.VARIABLE}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


@needs_wheel
def test_what_dr_jit_holds_outlives_the_change(run):
    code = """
import mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_rgb")
dr.set_thread_count(3)
there, waiting, zero = dr.arange(mi.Float, 4), dr.arange(mi.Float, 4) + 1, dr.zeros(mi.Float, 2)
dr.eval(there)
dr.enable_grad(there)
square = there * there
dr.scatter(zero, 7, mi.UInt32(1))
import pellucid
assert dr.detail.llvm_version()[0] >= 17 and dr.thread_count() == 3
assert dr.all(waiting == [1, 2, 3, 4]) and dr.all(zero == [0, 7])
dr.backward(square)
assert dr.all(there.grad == [0, 2, 4, 6])
"""
    done = run(code, system_llvm(15))
    assert done.returncode == 0 and "leak" not in done.stderr, done.stderr[-2000:]


HELD = "import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')\nscene = mi.load_dict(mi.cornell_box())\n"


@needs_wheel
@pytest.mark.parametrize("code", ["import pellucid", "try:\n import pellucid\nexcept Exception:\n import pellucid"])
def test_a_scene_that_would_be_lost_is_an_exception_with_the_remedy(run, code):
    done = run(HELD + code, system_llvm(15))
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1 and last.startswith("pellucid.errors.EnvironmentProblem: ")
    assert "LLVM 15" in last and "import pellucid first" in last and WHEEL[0] in last


@needs_wheel
@pytest.mark.parametrize("first", ["import drjit", "import mitsuba"])
def test_a_system_without_llvm_is_an_exception_with_the_remedy(run, first):
    done = run(first + "\nimport pellucid", "/nowhere/libLLVM.so")
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1 and last.startswith("pellucid.errors.EnvironmentProblem: ")
    assert "found no LLVM" in last and "import pellucid first" in last and WHEEL[0] in last


@pytest.mark.parametrize("order", ["import pellucid, mitsuba as mi", "import mitsuba as mi, pellucid"])
def test_an_llvm_of_the_user_that_is_too_old_is_an_exception_at_the_variant(run, order):
    llvm = system_llvm(15)
    done = run(order + "\nmi.set_variant('scalar_rgb')\nmi.set_variant('llvm_ad_rgb')", llvm, user=True)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 1 and last.startswith("pellucid.errors.EnvironmentProblem: ")
    assert f"{_llvm.VARIABLE}={llvm}" in last and "older than 17" in last and "unset" in last


def test_a_folder_that_has_been_deleted_is_named_before_mitsuba_aborts(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    code = f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r}); import pellucid"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (
        result.returncode == 1 and "EnvironmentProblem: The folder that this runs in has been deleted" in result.stderr
    )
