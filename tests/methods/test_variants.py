"""Variants of Mitsuba: every plug-in follows every switch, and refuses those that it cannot run in. In processes of their own."""

import json
import subprocess
import sys

import pytest

from pellucid.methods import METHODS

START = f"""
import json
import numpy as np
import pellucid, mitsuba as mi
METHODS = {list(METHODS)}
SMALL = {{
    "texture_space": {{"sample_count": 100, "resolution": 32, "irradiance_paths": 2}},
    "single_pass": {{"sample_count": 100, "direct": 16, "indirect": 0}},
    "sampled": {{}},
}}
def scene():
    ball = {{"type": "sphere", "bsdf": {{"type": "pellucid_translucent", "scale": 5.0}}}}
    film = {{"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {{"type": "box"}}}}
    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    return mi.load_dict({{"type": "scene", "ball": ball, "light": {{"type": "constant"}},
        "sensor": {{"type": "perspective", "fov": 10, "to_world": look, "film": film}}}}, optimize=False)
def integrator(method):
    settings = SMALL.get(method, {{"sample_count": 100, "irradiance_paths": 4}})
    return mi.load_dict({{"type": "pellucid_" + method, **settings}})
def means():
    return {{m: float(np.mean(mi.render(scene(), integrator=integrator(m), spp=4))) for m in METHODS}}
"""


def run(code):
    """Run code in a process of its own, and read the last line that it prints."""
    result = subprocess.run([sys.executable, "-c", START + code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


def test_every_method_renders_the_same_picture_after_switches():
    """There and back: classes that derive from those of a variant belong to the one that is active."""
    first, again = run(
        "mi.set_variant('llvm_ad_rgb'); first = means()\n"
        "for variant in ('scalar_rgb', 'llvm_ad_spectral', 'llvm_ad_mono', 'llvm_ad_rgb'):\n"
        "    mi.set_variant(variant)\n"
        "print(json.dumps([first, means()]))\n"
    )
    assert list(first) == list(METHODS) and all(value > 0 for value in first.values())
    assert again == first


def test_a_scene_of_before_a_switch_still_renders_after_it():
    before, after = run(
        "mi.set_variant('llvm_ad_rgb'); old = scene(); plugins = {m: integrator(m) for m in METHODS}\n"
        "def of_old(): return [float(np.mean(mi.render(old, integrator=plugins[m], spp=4))) for m in METHODS]\n"
        "before = of_old()\n"
        "mi.set_variant('scalar_rgb'); mi.set_variant('llvm_ad_rgb')\n"
        "print(json.dumps([before, of_old()]))\n"
    )
    assert after == before


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral", "llvm_ad_spectral", "llvm_ad_mono"])
def test_every_plugin_refuses_other_variants_with_a_remedy(variant):
    lines = run(
        f"mi.set_variant('{variant}')\n"
        "found = {}\n"
        "for plugin in [*METHODS, 'translucent']:\n"
        "    try:\n"
        "        mi.load_dict({'type': 'pellucid_' + plugin})\n"
        "    except Exception as error:\n"
        "        found[plugin] = str(error)\n"
        "print(json.dumps(found))\n"
    )
    assert set(lines) == {*METHODS, "translucent"}
    for text in lines.values():
        assert variant in text and "set_variant('llvm_ad_rgb')" in text


def test_a_method_that_is_registered_late_is_there_in_the_active_variant():
    """The next variant has it too."""
    found = run(
        "from pellucid.methods import register_method\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "register_method('another', 'pellucid.methods.two_pass:TwoPass')\n"
        "now = mi.load_dict({'type': 'pellucid_another'}).method.name\n"
        "mi.set_variant('scalar_rgb'); mi.set_variant('llvm_ad_rgb')\n"
        "print(json.dumps([now, mi.load_dict({'type': 'pellucid_another'}).method.name]))\n"
    )
    assert found == ["two_pass", "two_pass"]
