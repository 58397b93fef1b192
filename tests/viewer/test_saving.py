"""What is saved is what was seen: the file loads again, with everything that was changed."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid import load_scene
from pellucid.errors import OutputError
from pellucid.realtime.source import BodyState, Camera, Light
from pellucid.scene.bodies import find_bodies
from pellucid.viewer.saving import Origin, SceneWriter, free_name
from worlds.fake_source import FakeSource, ball_scene

CAMERA = Camera([0, -100, 20], [0, 0, 20], [0, 0, 1], 35.0)

XML = """<scene version="3.0.0">
  <default name="brightness" value="2"/>
  <integrator type="pellucid_two_pass"/>
  <sensor type="perspective"><transform name="to_world"><lookat origin="0, -20, 6" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
  <shape type="rectangle" id="lamp">
    <transform name="to_world"><translate z="9"/></transform>
    <emitter type="area"><rgb name="radiance" value="$brightness"/></emitter>
  </shape>
  <emitter type="spot"><transform name="to_world"><lookat origin="0, -9, 6" target="0, 0, 0" up="0, 0, 1"/></transform>
    <rgb name="intensity" value="3, 3, 3"/></emitter>
  <emitter type="directional"><vector name="direction" x="0" y="1" z="-1"/><rgb name="irradiance" value="1"/></emitter>
  <emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>
  <bsdf type="pellucid_translucent" id="stone"/>
  <shape type="sphere" id="ball"><ref id="stone"/></shape>
</scene>"""


class SavedSource:
    """As much of a source as saving reads."""

    def __init__(self, scene, lights):
        self.scene, self.lights = scene, lights
        self.bodies = [BodyState(body.name, body.medium, 2.0) for body in find_bodies(scene)]


def test_nothing_changed_but_the_camera(tmp_path):
    source = FakeSource()
    writer = SceneWriter(Origin(ball_scene()), source)
    path = writer.write(tmp_path / "saved", CAMERA, (40, 30))
    scene = load_scene(path)
    assert list(scene.sensors()[0].film().size()) == [40, 30]
    assert np.allclose(np.array(mi.traverse(scene.sensors()[0])["to_world"].matrix).reshape(4, 4)[:3, 3], CAMERA.origin)
    before, after = (find_bodies(s)[0].medium for s in (source.scene, scene))
    assert np.allclose(before.sigma_a, after.sigma_a) and np.allclose(before.sigma_s_prime, after.sigma_s_prime)


def test_a_scene_file_with_every_kind_of_light(tmp_path):
    mi.Bitmap(np.ones((4, 8, 3), np.float32)).write(str(tmp_path / "sky.exr"))
    (tmp_path / "scene.xml").write_text(XML)
    origin = Origin(tmp_path / "scene.xml", {"brightness": "5"})
    scene = load_scene(origin.source, origin.parameters)
    one = np.ones(3)
    before = [
        Light("", "area", np.array([0, 0, 9.0]), None, one, 5.0),
        Light("", "spot", np.array([0, -9, 6.0]), np.array([0, 0.832, -0.555]), one, 3.0),
        Light("", "directional", None, np.array([0, 1, -1]) / np.sqrt(2), one, 1.0),
        Light("", "environment", None, None, one, 1.0),
    ]
    source = SavedSource(scene, before)
    writer = SceneWriter(origin, source)
    source.lights = [
        Light("", "area", np.array([3, 0, 9.0]), None, np.array([1, 0.5, 0.25]), 8.0),
        Light("", "spot", np.array([5, 0, 0.0]), np.array([-1.0, 0, 0]), one, 3.0),
        Light("", "directional", None, np.array([1.0, 0, 0]), one, 4.0),
        Light("", "environment", None, None, one, 7.0),
    ]
    saved = load_scene(writer.write(tmp_path / "saved", CAMERA, (8, 8)))
    emitters = saved.emitters()
    numbers = [{key: np.ravel(np.array(value)) for key, value in values(e).items()} for e in emitters]
    assert np.allclose(numbers[0]["radiance.value"], [8, 4, 2])
    assert np.allclose(np.array(emitters[0].get_shape().bbox().center()).ravel(), [3, 0, 9])
    assert np.allclose(matrix(emitters[1])[:3, 3], [5, 0, 0]) and np.allclose(matrix(emitters[1])[:3, 2], [-1, 0, 0])
    assert np.allclose(matrix(emitters[2])[:3, 2], [1, 0, 0]) and np.allclose(numbers[2]["irradiance.value"], 4)
    assert np.allclose(numbers[3]["scale"], 7)


def values(emitter):
    return {key: value for key, value in mi.traverse(emitter) if "value" in key or key == "scale"}


def matrix(emitter):
    return np.array(mi.traverse(emitter)["to_world"].matrix).reshape(4, 4)


def test_material_and_size(tmp_path):
    source = FakeSource()
    writer = SceneWriter(Origin(ball_scene()), source)
    bsdf = find_bodies(source.scene)[0].bsdf
    marble = type(bsdf.medium).from_preset("marble")
    source.set_medium(0, marble)
    source.set_size(10.0)
    bsdf.scale = 0.25
    bsdf.medium = marble.scaled(0.25)
    saved = find_bodies(load_scene(writer.write(tmp_path / "saved", CAMERA, (8, 8))))[0]
    assert np.allclose(saved.medium.sigma_s_prime, 0.25 * marble.sigma_s_prime) and saved.bsdf.scale == 0.25
    assert saved.medium.eta == pytest.approx(marble.eta)


def test_meshes_and_pictures_are_written_beside(tmp_path):
    scene = load_scene("teapot", size=40)
    source = SavedSource(scene, [Light("", "area", None, None, np.ones(3), 1.0)] * 2)
    path = SceneWriter(Origin("teapot", options={"size": 40}), source).write(tmp_path / "saved", CAMERA, (8, 8))
    saved = load_scene(path)
    assert sorted(file.suffix for file in path.parent.iterdir()) == [".ply", ".ply", ".xml"]
    for a, b in zip(scene.shapes(), saved.shapes(), strict=True):
        assert np.allclose(np.array(a.bbox().max), np.array(b.bbox().max), rtol=1e-5)
        assert a.bsdf().class_name() == b.bsdf().class_name()


def test_all_or_nothing(tmp_path, monkeypatch):
    writer = SceneWriter(Origin(ball_scene()), FakeSource())

    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(mi.parser, "write_file", full)
    with pytest.raises(OutputError, match="No space left"):
        writer.write(tmp_path / "saved", CAMERA, (8, 8))
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "saved").mkdir()
    writer = SceneWriter(Origin(ball_scene()), FakeSource())
    with pytest.raises(OutputError, match="already"):
        writer.write(tmp_path / "saved", CAMERA, (8, 8))
    assert free_name(tmp_path / "saved").name == "saved_2"
