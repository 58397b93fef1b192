"""What importing the package does and does not do, in processes of their own."""

import subprocess
import sys


def run(code, **env):
    import os

    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | env)
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_import_sets_no_variant_and_registers_when_one_becomes_active():
    run(
        "import pellucid, mitsuba as mi\n"
        "assert mi.variant() is None\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "assert mi.load_dict({'type': 'pellucid_translucent'}).medium.name == 'marble'\n"
    )


def test_import_leaves_the_active_variant_alone_and_registers_with_it():
    run(
        "import pellucid._llvm, mitsuba as mi\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "import pellucid\n"
        "assert mi.variant() == 'llvm_ad_rgb'\n"
        "mi.load_dict({'type': 'pellucid_two_pass'})\n"
    )


def test_a_library_path_of_the_user_is_respected():
    out = run(
        "import pellucid, os; print(os.environ['DRJIT_LIBLLVM_PATH'])", DRJIT_LIBLLVM_PATH="/somewhere/libLLVM.so"
    )
    assert out.strip() == "/somewhere/libLLVM.so"


def test_a_missing_llvm_is_one_clear_line():
    out = run(
        "import pellucid\n"
        "from pellucid import _llvm\n"
        "try:\n"
        "    _llvm.require()\n"
        "except pellucid.PellucidError as error:\n"
        "    print(error)\n",
        DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so",
    )
    assert out.count("\n") == 1 and "/nowhere/libLLVM.so" in out and "unset" in out


def test_a_rendered_scene_is_freed_without_the_garbage_collector():
    """A scene in a reference cycle dies when the collector runs, which may be while a kernel is traced: Dr.Jit aborts."""
    run(
        "import gc, pellucid, mitsuba as mi\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "ball = {'type': 'sphere', 'bsdf': {'type': 'pellucid_translucent'}}\n"
        "scene = {'type': 'scene', 'ball': ball, 'light': {'type': 'constant'},\n"
        "    'sensor': {'type': 'perspective', 'film': {'type': 'hdrfilm', 'width': 4, 'height': 4}}}\n"
        "def render(method):\n"
        "    mi.render(mi.load_dict(scene, optimize=False), integrator=mi.load_dict({'type': 'pellucid_' + method}), spp=1)\n"
        "for method in ('two_pass', 'exact', 'sampled'):\n"
        "    render(method)\n"
        "gc.collect(); gc.disable()\n"
        "for method in ('two_pass', 'exact', 'sampled'):\n"
        "    render(method)\n"
        "gc.set_debug(gc.DEBUG_SAVEALL)\n"
        "gc.collect()\n"
        "assert not [o for o in gc.garbage if isinstance(o, mi.Object)]\n"
    )


def test_plugins_are_imported_by_one_thread_at_a_time():
    """Mitsuba makes the plug-ins of a scene in several threads; modules of one package that two of them import can fail half done."""
    run(
        "import importlib, time, threading, pellucid, mitsuba as mi\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "inside, together, load = [], [], importlib.import_module\n"
        "def slow(name):\n"
        "    me = threading.get_ident()\n"
        "    together.extend(other for other in inside if other != me)\n"
        "    inside.append(me)\n"
        "    time.sleep(0.1)\n"
        "    module = load(name)\n"
        "    inside.remove(me)\n"
        "    return module\n"
        "importlib.import_module = slow\n"
        "plugins = ('pellucid_translucent', 'pellucid_two_pass', 'pellucid_exact')\n"
        "threads = [threading.Thread(target=mi.load_dict, args=({'type': plugin},)) for plugin in plugins]\n"
        "[thread.start() for thread in threads]\n"
        "[thread.join() for thread in threads]\n"
        "assert not together, together\n"
    )
