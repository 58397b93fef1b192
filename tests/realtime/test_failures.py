"""A value that no frame can be made with is refused in one line, and the next frame is as if it had never been."""

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid import Camera, Medium
from worlds.live import CAMERA, assemble

SIZE = (24, 24)
T = mi.ScalarTransform4f()


@pytest.fixture(scope="module")
def engine():
    made = pellucid.Engine(assemble(), 128)
    made.settings.samples, made.settings.denoised = 100, False
    made.first = made.frame(CAMERA, SIZE, True).pixels
    return made


def grey(value):
    return np.full(3, value)


EDITS = {
    "a size beyond all numbers": lambda e: e.set_size(1e300),
    "a size next to nothing": lambda e: e.set_size(1e-300),
    "a size that is a word": lambda e: e.set_size("large"),
    "coefficients beyond all numbers": lambda e: e.set_medium(0, Medium(grey(1e300), grey(1.0))),
    "a place beyond all numbers": lambda e: e.set_light(0, position=[1e300, 0, 0]),
    "a place that is none": lambda e: e.set_light(0, position=[np.nan, 0, 0]),
    "an intensity beyond all numbers": lambda e: e.set_light(0, intensity=1e300),
    "an intensity that is a word": lambda e: e.set_light(0, intensity="bright"),
    "a colour that is a word": lambda e: e.set_light(0, colour="red"),
    "a colour beyond all numbers": lambda e: e.set_light(0, colour=[1e300, np.inf, 1]),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_that_fails_is_taken_back(engine, edit):
    before = repr(engine)
    with pytest.raises(pellucid.PellucidError) as caught:
        EDITS[edit](engine)
    assert "\n" not in str(caught.value)
    assert repr(engine) == before
    np.testing.assert_array_equal(engine.frame(CAMERA, SIZE, True).pixels, engine.first)
    np.testing.assert_array_equal(engine.frame(CAMERA, SIZE, True).pixels, engine.first)


SETTINGS = {
    "samples": [10**12, -5, 2.5, np.nan, "many"],
    "exposure": [np.nan, 1e6, None],
    "specular": [np.nan, -1.0],
    "shininess": [-1e30],
    "importance_bound": [np.nan, 0.0, -1.0],
    "rings": [10**9, 0],
    "per_ring": [-1],
    "method": ["magic"],
}


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_that_fail_are_those_of_the_frame_before(engine, name):
    for value in SETTINGS[name]:
        before = getattr(engine.settings, name)
        setattr(engine.settings, name, value)
        with pytest.raises(pellucid.PellucidError, match=name):
            engine.frame(CAMERA, SIZE, True)
        assert getattr(engine.settings, name) == before
        np.testing.assert_array_equal(engine.frame(CAMERA, SIZE, True).pixels, engine.first)


CAMERAS = {
    "origin": Camera((np.nan, 0, 0), (0, 0, 0)),
    "origin far": Camera((1e300, 0, 0), (0, 0, 0)),
    "its own": Camera((1, 2, 3), (1, 2, 3)),
    "0 and 180": Camera((3, 5, 14), (0, 0, 0), fov=180.0),
    "up": Camera((3, 5, 14), (0, 0, 0), (0, 0, np.inf)),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_a_camera_that_sees_nothing_is_refused(engine, case):
    with pytest.raises(pellucid.PellucidError, match=case.split(" far")[0]):
        engine.frame(CAMERAS[case], SIZE, True)


@pytest.mark.parametrize("size", [(10**7, 80), (0, 8), (40.5, 30)])
def test_a_size_that_no_picture_has_is_refused(engine, size):
    with pytest.raises(pellucid.PellucidError, match="pixel"):
        engine.frame(CAMERA, size, True)


STAGES = [("draw", "_bodies"), ("update_light", "_bodies"), ("look", "_eye"), ("to_host", "_eye")]


@pytest.mark.parametrize(("stage", "of"), STAGES)
@pytest.mark.parametrize("warm", [True, False])
def test_after_a_frame_that_fails_the_next_is_right(engine, monkeypatch, stage, of, warm):
    """Whatever fails, in the first frame or in a later one: a kernel, or the memory."""
    used = engine if warm else pellucid.Engine(assemble(), 128)
    used.settings.samples, used.settings.denoised = 100, False

    def fail(*_):
        raise MemoryError("no memory")

    failing = getattr(used, of)
    failing = failing[0] if isinstance(failing, list) else failing
    with monkeypatch.context() as patch:
        patch.setattr(failing, stage, fail)
        used.set_light(0, intensity=30.0)
        used.settings.samples = 400
        with pytest.raises(MemoryError):
            used.frame(CAMERA, SIZE, True)
    assert used.settings.samples != 400 and used.settings.method == "texture_space"
    used.settings.samples, used.settings.denoised = 100, False
    used.set_light(0, intensity=60.0)
    difference = np.abs(used.frame(CAMERA, SIZE, True).pixels.astype(int) - engine.first)
    assert difference.max() <= 1
