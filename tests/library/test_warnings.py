"""A warning names the line that called the package, not a line inside it."""

import inspect
import re
import warnings
from pathlib import Path

import mitsuba as mi
import pytest

import pellucid
from pellucid.errors import PellucidWarning, warn
from pellucid.realtime.engine import Engine

SOURCE = Path(pellucid.__file__).parent


@pytest.fixture
def dark():
    """A scene without a light, of which every way of rendering warns."""
    ball = {"type": "sphere", "bsdf": {"type": "pellucid_translucent"}}
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = {"type": "scene", "ball": ball, "sensor": {"type": "perspective", "film": film}}
    return mi.load_dict(scene | {"integrator": {"type": "pellucid_two_pass", "sample_count": 100}}, optimize=False)


WAYS = {
    "mi.render": lambda scene: mi.render(scene, spp=1),
    "mi.render with parameters": lambda scene: mi.render(scene, params=mi.traverse(scene), spp=1),
    "integrator.render": lambda scene: scene.integrator().render(scene, spp=1),
    "prepare": lambda scene: pellucid.prepare(scene, sample_count=100),
    "Engine": lambda scene: Engine(scene, 64),
}


@pytest.mark.parametrize("call", WAYS.values(), ids=WAYS)
def test_a_warning_names_the_line_of_the_caller(dark, call):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call(dark)
    [given] = [w for w in caught if issubclass(w.category, PellucidWarning)]
    assert "no light" in str(given.message)
    assert (given.filename, given.lineno) == (__file__, inspect.getsourcelines(call)[1])


def test_a_warning_is_given_once_for_each_line():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for _ in range(2):
            warn("look")
        warn("look")
    assert len(caught) == 2


def test_warnings_are_given_in_one_place():
    for path in SOURCE.rglob("*.py"):
        assert path.name == "errors.py" or not re.search(r"warnings\.warn\b|stacklevel", path.read_text()), path
