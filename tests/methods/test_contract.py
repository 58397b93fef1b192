"""What every method promises: results that depend on the point alone, states that are never stale, parameters, one registration."""

import inspect
import sys

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.methods import METHODS, method_class, register_method
from pellucid.methods.contract import Method
from pellucid.scenes.loading import load_scene
from worlds.balls import T, looking_at, scene, translucent

FEW = {
    "two_pass": {"sample_count": 1500, "irradiance_paths": 4},
    "exact": {"sample_count": 600, "irradiance_paths": 4},
    "sampled": {},
    "texture_space": {"sample_count": 600, "resolution": 64},
    "single_pass": {"sample_count": 600, "direct": 64, "indirect": 200},
}
CASES = [(name, FEW[name]) for name in METHODS] + [
    ("texture_space", FEW["texture_space"] | {"hybrid": True}),
    *(("single_pass", FEW["single_pass"] | {"mode": mode}) for mode in ("cut", "two_pass", "exact")),
]
every_method = pytest.mark.parametrize(
    ("method", "settings"), CASES, ids=lambda v: v if isinstance(v, str) else v.get("mode", "hybrid" * ("hybrid" in v))
)
CENTRES = np.array([[-6.0, 0, 0], [6.0, 1, 0]])


def two_balls(**light):
    """A ball of marble and one of cream under a lamp and a dim sky."""
    lamp = {"type": "point", "position": [0, -30, 20], "intensity": 900.0} | light
    balls = [
        {"type": "sphere", "radius": 5.0, "center": c.tolist(), "bsdf": translucent(material=m)}
        for c, m in zip(CENTRES, ("marble", "cream"), strict=True)
    ]
    sensor = looking_at([0, 0, 0], [0, -20, 60], fov=25)
    return scene(*balls, light=lamp, sky={"type": "constant", "radiance": 0.1}, sensor=sensor)


def points_on_both(count=150):
    n = np.random.default_rng(0).normal(size=(2 * count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return (5 * n + np.repeat(CENTRES, count, axis=0)).astype(np.float32), n.astype(np.float32)


# ------------------------------------------------------------------ the point alone


@every_method
def test_the_exitance_depends_on_the_point_alone(method, settings):
    """Two bodies in both orders, shuffled, in chunks, before and after others: equal bits."""
    points, _ = points_on_both()
    half, order = len(points) // 2, np.random.default_rng(1).permutation(len(points))
    whole = pellucid.prepare(two_balls(), method, **settings).exitance(points)
    assert np.isfinite(whole).all() and whole[:half].max() > 0 and whole[half:].max() > 0
    other = pellucid.prepare(two_balls(), method, **settings)
    swapped = other.exitance(np.concatenate([points[half:], points[:half]]))
    assert np.array_equal(swapped[half:], whole[:half]) and np.array_equal(swapped[:half], whole[half:])
    for part in np.array_split(order, 5):
        assert np.array_equal(other.exitance(points[part]), whole[part])


# ------------------------------------------------------------------ bodies and normals


def test_the_body_of_each_point_is_found():
    points, _ = points_on_both()
    prepared = pellucid.prepare(two_balls(), **FEW["two_pass"])
    half, found = len(points) // 2, prepared.exitance(points)
    assert np.array_equal(found[:half], prepared.exitance(points[:half], body=0))
    assert np.array_equal(found[half:], prepared.exitance(points[half:], body=prepared.bodies[1]))
    assert not np.array_equal(found[half:], prepared.exitance(points[half:], body=0))


def test_missing_normals_are_those_of_the_surface():
    points, normals = points_on_both()
    prepared = pellucid.prepare(two_balls(), "sampled")
    given, found = prepared.exitance(points, normals=normals), prepared.exitance(points)
    # Frames around normals that differ in their last bits are the same but for these.
    assert found == pytest.approx(given, rel=1e-2, abs=1e-5)
    upwards = prepared.exitance(points, normals=np.broadcast_to([0, 0, 1.0], points.shape))
    assert np.mean(np.isclose(upwards, given, rtol=1e-2)) < 0.5


def test_shapes_without_an_id_have_usable_names():
    ball = '<shape type="sphere"><bsdf type="pellucid_translucent"/></shape>'
    text = f'<scene version="3.0.0">{ball}{ball}<emitter type="constant"/></scene>'
    prepared = pellucid.prepare(mi.load_string(text, optimize=False), sample_count=300)
    assert prepared.bodies == ["body0", "body1"]
    assert prepared.exitance([[0, 0, 1.0]], body="body1").min() > 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"body": 2}, ["no body 2", "scene has"]),
        ({"body": "shape_O"}, ["shape_O", "did you mean"]),
        ({"body": True}, ["True"]),
        ({"normals": [[0, 0, 1.0]] * 3}, ["normals", "(2, 3)"]),
        ({"normals": [[0, 0, np.nan]] * 2}, ["normals", "finite"]),
    ],
)
def test_what_is_asked_for_must_be_there(arguments, words):
    prepared = pellucid.prepare(two_balls(), **FEW["two_pass"])
    with pytest.raises(pellucid.PellucidError) as caught:
        prepared.exitance([[-6, 0, 5.0], [6, 1, 5.0]], **arguments)
    assert all(word in str(caught.value) for word in words) and "\n" not in str(caught.value)


def test_what_follows_the_points_is_named():
    prepared = pellucid.prepare(two_balls(), **FEW["two_pass"])
    with pytest.raises(TypeError):
        prepared.exitance([[-6, 0, 5.0]], [[0, 0, 1.0]])


# ------------------------------------------------------------------ what has become stale


def change(content, key, value):
    parameters = mi.traverse(content)
    (name,) = (name for name in parameters.keys() if key in name)  # noqa: SIM118
    parameters[name] = value
    parameters.update()


@pytest.mark.parametrize("method", METHODS)
def test_a_changed_light_is_noticed(method):
    """Pictures are prepared for again, and the exitance is refused: old light is never mixed with new."""
    points, _ = points_on_both(20)
    settings = FEW[method]
    lit = two_balls()
    prepared = pellucid.prepare(lit, method, **settings)
    before = prepared.exitance(points)
    old = np.array(prepared.integrator.render(lit, spp=2))
    change(lit, "intensity", 90.0)
    with pytest.raises(pellucid.PellucidError, match=r"changed.*intensity.*prepare"):
        prepared.exitance(points)
    new = np.array(prepared.integrator.render(lit, spp=2))
    assert new.max() < 0.8 * old.max()
    assert prepared.exitance(points).mean() < 0.7 * before.mean()  # prepared again by the picture
    del lit, prepared  # kernels are compiled for all scenes that are alive
    fresh = two_balls(intensity=90.0)
    expected = np.array(mi.load_dict({"type": f"pellucid_{method}", **settings}).render(fresh, spp=2))
    assert new == pytest.approx(expected, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("what", ["to_world", "reflectance"])
def test_a_moved_shape_and_another_floor_are_noticed(what):
    floor = {
        "type": "rectangle",
        "to_world": T.translate([0, 0, -6]).scale(30),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.2}},
    }
    ball = {"type": "sphere", "radius": 5.0, "bsdf": translucent(material="marble")}
    lit = scene(ball, floor)
    prepared = pellucid.prepare(lit, **FEW["two_pass"])
    prepared.exitance([[0, 0, 5.0]])
    parameters = mi.traverse(lit)
    (name,) = (key for key in parameters.keys() if "shape1" in key and what in key)  # noqa: SIM118
    if what == "to_world":
        parameters[name] = mi.AffineTransform4f().translate([0, 0, -8]).scale(30)
    else:
        parameters[name] = mi.Color3f(0.9)
    parameters.update()
    with pytest.raises(pellucid.PellucidError, match="changed"):
        prepared.exitance([[0, 0, 5.0]])


def test_a_picture_from_elsewhere_changes_nothing_of_what_was_prepared():
    points, _ = points_on_both(40)
    lit = two_balls()
    prepared = pellucid.prepare(lit, "single_pass", **FEW["single_pass"])
    before = prepared.exitance(points)
    elsewhere = mi.load_dict(looking_at([0, 0, 0], [60, 0, 10], fov=25))
    pictures = [np.array(prepared.integrator.render(lit, elsewhere, spp=1)) for _ in range(2)]
    assert pictures[0] == pytest.approx(pictures[1], rel=1e-6)
    assert np.array_equal(prepared.exitance(points), before)


def test_cameras_may_move():
    lit = two_balls()
    prepared = pellucid.prepare(lit, **FEW["two_pass"])
    state = prepared.integrator.prepared
    parameters = mi.traverse(lit.sensors()[0])
    parameters["to_world"] = mi.AffineTransform4f().look_at([60, 0, 0], [0, 0, 0], [0, 0, 1])
    parameters.update()
    prepared.integrator.render(lit, spp=1)
    assert prepared.integrator.prepared is state


# ------------------------------------------------------------------ classes and parameters


def subclasses(cls):
    return {cls} | {sub for child in cls.__subclasses__() for sub in subclasses(child)}


def test_classes_are_abstract_or_final():
    found = {method_class(name) for name in METHODS}
    for cls in (each for each in subclasses(Method) if each.__module__.startswith("pellucid.")):
        abstract, final = inspect.isabstract(cls), getattr(cls, "__final__", False)
        assert abstract != final, f"{cls.__name__} is {'both' if final else 'neither'}"
        assert final == (cls in found), cls


@pytest.mark.parametrize("method", METHODS)
def test_parameters_make_another_method_like_it(method):
    settings = FEW[method] | {"seed": 3, "max_depth": -1, "hide_emitters": True}
    one = mi.load_dict({"type": f"pellucid_{method}", **settings}).method
    assert settings.items() <= one.parameters().items()
    assert mi.load_dict({"type": f"pellucid_{method}", **one.parameters()}).method == one


TOY = '''
"""A method in one file: every body shines as brightly as the sky over a white table would make it."""

from dataclasses import dataclass
from typing import final

import drjit as dr
import mitsuba as mi

from pellucid.methods.contract import Method
from pellucid.methods.parameters import parameter


@final
@dataclass
class Toy(Method):
    """Constant exitance."""

    name = "toy"
    glow: float = parameter(1.0, "an exitance", at_least=0)

    def prepare(self, scene, opened):
        return opened

    def exitance(self, scene, state, points):
        return mi.Color3f(self.glow) + dr.zeros(mi.Color3f, dr.width(points.p))
'''


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A sixth method: one file, one registration."""
    (tmp_path / "toy.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    register_method("toy", "toy:Toy")
    yield "toy"
    del METHODS["toy"]
    sys.modules.pop("toy")


def test_a_sixth_method_is_one_file_and_one_registration(toy, tmp_path):
    lit = two_balls()
    assert pellucid.prepare(lit, toy, glow=0.7).exitance([[-6, 0, 5.0]]) == pytest.approx(np.full((1, 3), 0.7))
    image = np.array(mi.render(lit, integrator=mi.load_dict({"type": "pellucid_toy", "glow": 3.0}), spp=4))
    darker = np.array(mi.render(lit, integrator=mi.load_dict({"type": "pellucid_toy", "glow": 0.0}), spp=4))
    assert image.mean() > darker.mean() + 0.01
    with pytest.raises(RuntimeError, match="glow is an exitance, at least 0; found -1"):
        mi.load_dict({"type": "pellucid_toy", "glow": -1.0})
    xml = '<integrator type="pellucid_toy"/><emitter type="constant"/>'
    xml += '<shape type="sphere"><bsdf type="pellucid_translucent"/></shape>'
    (tmp_path / "toy.xml").write_text(f'<scene version="3.0.0">{xml}</scene>')
    mi.set_variant("llvm_ad_rgb")
    assert load_scene(tmp_path / "toy.xml").integrator().method.parameters()["glow"] == 1.0


def test_the_command_line_knows_a_sixth_method(toy, tmp_path):
    from pellucid.jobs.job import Request

    job = Request.from_options({"source": "teapot", "method": "toy", "seed": 5, "resolution": (8, 8)}).load()
    assert job.integrator().method.seed == 5
    with pytest.raises(pellucid.PellucidError, match="--max-error belongs to the method two_pass or single_pass"):
        Request.from_options(
            {"source": "teapot", "method": "toy", "max_error": 0.1, "resolution": (8, 8)}
        ).load().integrator()
