"""Numbers that are none are refused by name: parameters of a scene, pixels of its pictures."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.scenes.loading import load_scene

SCENE = """<scene version="3.0.0">
  <default name="fov" value="40"/>
  <sensor type="perspective"><float name="fov" value="$fov"/></sensor>
  <emitter type="point"><rgb name="intensity" value="{intensity}"/><point name="position" x="0" y="{y}" z="5"/></emitter>
  <shape type="sphere"><float name="radius" value="{radius}"/>
    <transform name="to_world"><translate x="{x}"/></transform><bsdf type="pellucid_translucent"/></shape>
</scene>"""
GOOD = {"intensity": "1, 2, 3", "y": "0", "radius": "1", "x": "0"}


def write(path, **values):
    path.write_text(SCENE.format(**GOOD | values))
    return path


def test_sound_numbers_pass(tmp_path):
    load_scene(write(tmp_path / "a.xml"))


@pytest.mark.parametrize(
    "values, text",
    [
        ({"intensity": "1, nan, 3"}, r"intensity of 'point'.*line 4"),
        ({"intensity": "1, inf, 3"}, "intensity of 'point'"),
        ({"y": "nan"}, "position of 'point'"),
        ({"radius": "nan"}, "radius of 'sphere'"),
        ({"x": "inf"}, "to_world of 'sphere'"),
    ],
)
def test_a_parameter_is_refused_by_its_name(tmp_path, values, text):
    with pytest.raises(SceneError, match=text):
        load_scene(write(tmp_path / "a.xml", **values))


def test_a_value_from_outside_is_refused_too(tmp_path):
    with pytest.raises(SceneError, match="fov of 'perspective'"):
        load_scene(write(tmp_path / "a.xml"), {"fov": "nan"})


def test_a_dictionary_is_refused_by_the_way_to_the_parameter():
    scene = {"type": "scene", "camera": {"type": "perspective", "fov": float("nan")}}
    with pytest.raises(SceneError, match=r"fov of 'perspective'.*'camera.fov'"):
        load_scene(scene)
    lamp = {"type": "point", "intensity": {"type": "rgb", "value": [1.0, float("nan"), 0.0]}}
    with pytest.raises(SceneError, match=r"'lamp.intensity.value'"):
        load_scene({"type": "scene", "lamp": lamp})


def picture(path, bad):
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[1, 2] = bad
    mi.Bitmap(pixels).write(str(path))
    return path


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_picture_is_refused_by_its_file(tmp_path, bad):
    good, broken = picture(tmp_path / "good.exr", 2.0), picture(tmp_path / "broken.exr", bad)
    xml = """<scene version="3.0.0"><emitter type="envmap"><string name="filename" value="{}"/></emitter>
      <shape type="sphere"><bsdf type="pellucid_translucent"><float name="dmfp" value="1"/>
      <texture type="bitmap" name="reflectance"><string name="filename" value="{}"/></texture></bsdf></shape></scene>"""
    for names in (("good.exr", "broken.exr"), ("broken.exr", "good.exr")):
        (tmp_path / "a.xml").write_text(xml.format(*names))
        with pytest.raises(SceneError, match=r"broken.exr' has 1 pixel"):
            load_scene(tmp_path / "a.xml")
    with pytest.raises(SceneError, match=r"broken.exr' has 1 pixel"):
        load_scene("teapot_env", environment=broken, resolution=(16, 12))
    load_scene("teapot_env", environment=good, resolution=(16, 12))


def test_a_parameter_that_nobody_reads_is_still_refused(tmp_path):
    path = write(tmp_path / "a.xml")
    path.write_text(path.read_text().replace('name="radius"', 'name="raduis"'))
    with pytest.raises(SceneError, match="raduis"):
        load_scene(path)


def test_a_scale_of_0_is_refused(tmp_path):
    """It gave a picture of NaN."""
    scale = '<transform name="to_world"><scale x="3" y="0" z="3"/></transform>'
    (tmp_path / "flat.xml").write_text(f'<scene version="3.0.0"><shape type="sphere">{scale}</shape></scene>')
    with pytest.raises(SceneError, match=r"to_world of 'sphere' leaves nothing of an axis, at .*flat.xml"):
        load_scene(tmp_path / "flat.xml")
    flat = mi.ScalarTransform4f().scale([3, 0, 3])
    with pytest.raises(SceneError, match=r"to_world of 'sphere' .* at 'ball.to_world'"):
        load_scene({"type": "scene", "ball": {"type": "sphere", "to_world": flat}})
