"""Frames of the real-time engine against the integrators, against each other, and against what must not change."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import PellucidError, PellucidWarning, SceneError
from pellucid.model import Medium
from pellucid.realtime.engine import Engine
from pellucid.realtime.source import METHODS, Camera
from worlds.live import CAMERA, LAMP, SIZE, assemble, ball, eight_bit_rmse, floor, render

RESOLUTION = 256


def engine_of(scene, **settings):
    engine = Engine(scene, RESOLUTION)
    for name, value in settings.items():
        setattr(engine.settings, name, value)
    return engine


def linear(scene, **settings):
    return engine_of(scene, **settings).linear(CAMERA, (SIZE, SIZE))


SKY = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 0.8, 0.6]}}
SPOT = {"type": "spot", "intensity": 80.0, "cutoff_angle": 30.0}
LIGHTS = {
    "point": LAMP,
    "spot": SPOT,
    "directional": {"type": "directional", "direction": [-1.0, -1.0, -0.4], "irradiance": 2.0},
    "sky": SKY,
    "area": {"type": "sphere", "center": [4, 5, 4], "radius": 0.5, "emitter": {"type": "area", "radiance": 50.0}},
}


@pytest.mark.parametrize("name", LIGHTS)
def test_the_settled_picture_is_that_of_the_sum_over_all_samples(name):
    light = dict(LIGHTS[name])
    if name == "spot":
        light["to_world"] = mi.ScalarTransform4f().look_at([5, 4, 5], [0, 0, 0], [0, 1, 0])
    scene = assemble(light)
    truth = render(scene, "pellucid_exact", sample_count=20000, irradiance_paths=64)
    value = linear(scene, samples=8192)
    seen = np.array(scene.ray_intersect_preliminary(scene.sensors()[0].sample_ray(0, 0, [0.5, 0.5], [0, 0])[0]).t)
    assert np.isfinite(seen).all()
    body = truth.max(axis=2) > 0 if name != "sky" else np.abs(truth - [1.0, 0.8, 0.6]).max(axis=2) > 1e-6
    body &= value.max(axis=2) < 5  # not the lamp itself
    mean = truth[body].mean(axis=0)
    np.testing.assert_allclose(value[body].mean(axis=0), mean, rtol=0.01)
    assert np.sqrt(np.mean((value[body] - truth[body]) ** 2)) < 0.06 * mean.max()
    np.testing.assert_allclose(value[~body], truth[~body], rtol=1e-3, atol=1e-6)


def test_light_comes_back_from_other_surfaces():
    scene = assemble(body=ball(), floor=floor())
    truth = render(scene, "pellucid_exact", sample_count=8000, irradiance_paths=256)
    body = np.zeros((SIZE, SIZE), bool)
    body[linear(assemble(), samples=64, gi=False).max(axis=2) > 0] = True
    for gi, near in ((True, True), (False, False)):
        value = linear(scene, samples=4096, gi=gi)
        error = np.abs(value[body].mean(axis=0) / truth[body].mean(axis=0) - 1).max()
        assert (error < 0.012) == near, (gi, error)


def test_opaque_surfaces_are_those_of_a_direct_integrator():
    scene = assemble(body=ball(), floor=floor())
    truth, value = render(scene, "direct"), linear(scene, samples=64, gi=False)
    hits = linear(assemble(), samples=64, gi=False).max(axis=2) > 0
    np.testing.assert_allclose(value[~hits], truth[~hits], rtol=2e-3, atol=1e-5)
    assert (value[~hits].max(axis=1) > 0).mean() > 0.3


def test_each_side_of_an_open_surface_has_light_of_its_own():
    to_world = mi.ScalarTransform4f().rotate([1, 0, 0], -70).scale(1.5)
    bsdf = ball()["bsdf"]
    pictures = []
    for y in (5.0, -5.0):
        light = {"type": "point", "position": [0.0, y, 1.0], "intensity": 60.0}
        scene = assemble(light, body={"type": "rectangle", "to_world": to_world, "bsdf": bsdf})
        truth, value = render(scene, "pellucid_exact", sample_count=8000), linear(scene, samples=4096)
        pictures.append(value)
        np.testing.assert_allclose(value.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=0.02)
        del scene  # before the next: kernels are compiled for all scenes that are alive
    assert pictures[0].max() > 0 and pictures[1].max() == 0


def test_interpolated_frames_are_nearly_those_of_every_pixel():
    engine = engine_of(assemble(body=ball(), floor=floor()), samples=900)
    fast = engine.frame(CAMERA, (256, 256), True).pixels
    engine.settings.interpolated = False
    exact = engine.frame(CAMERA, (256, 256), True).pixels
    assert 0 < eight_bit_rmse(fast, exact) < 1.6
    assert np.abs(fast.astype(int) - exact).max() < 60


def test_the_same_scene_gives_the_same_frames():
    first, second = (
        [engine_of(assemble(), samples=100).frame(CAMERA, (40, 30), moving).pixels for moving in (True, False)]
        for _ in range(2)
    )
    for a, b in zip(first, second, strict=True):
        assert a.shape == (30, 40, 3) and a.dtype == np.uint8
        np.testing.assert_array_equal(a, b)


def until_still(engine):
    frames = [engine.frame(CAMERA, (SIZE, SIZE), True)]
    while not frames[-1].still:
        frames.append(engine.frame(CAMERA, (SIZE, SIZE), False))
        assert len(frames) < 60
    return frames


def test_frames_settle_and_come_closer():
    truth = until_still(engine_of(assemble(SKY), samples=20000))[-1]
    engine = engine_of(assemble(SKY), samples=100)
    frames = until_still(engine)
    assert engine.frame(CAMERA, (SIZE, SIZE), False) is frames[-1]
    inside = (slice(18, 30), slice(18, 30))  # away from the edge, which settled frames smooth
    errors = [eight_bit_rmse(frames[k].pixels[inside], truth.pixels[inside]) for k in (0, -1)]
    assert errors[1] < 0.5 * errors[0]
    assert not engine.frame(CAMERA, (SIZE, SIZE), True).still


def test_only_the_settled_picture_is_denoised():
    clean, raw = (
        [
            frame.pixels
            for frame in until_still(engine_of(assemble(SKY, body=ball(), floor=floor()), samples=100, **how))
        ]
        for how in ({}, {"denoised": False})
    )
    for one, other in zip(clean[:-1], raw[:-1], strict=True):
        np.testing.assert_array_equal(one, other)
    even = (slice(34, 46), slice(38, 46))  # of the floor, away from the ball
    assert clean[-1][even].std(axis=(0, 1)).max() < 0.7 * raw[-1][even].std(axis=(0, 1)).min()
    assert clean[-1].mean() == pytest.approx(raw[-1].mean(), rel=0.02)


def test_a_moved_light_is_that_of_a_fresh_engine():
    lamps = {"lamp": LAMP, "other": LIGHTS["directional"]}
    engine = engine_of(mi.load_dict({"type": "scene", "body": ball(), **lamps}, optimize=False), samples=400)
    engine.linear(CAMERA, (SIZE, SIZE))
    place = [light.name for light in engine.lights].index("lamp")
    engine.set_light(place, position=[-4.0, 3.0, 5.0], colour=[0.2, 1.0, 0.5], intensity=90.0)
    engine.set_light(1 - place, direction=[1.0, -1.0, 0.0], intensity=0.5)
    light, value = engine.lights[place], engine.linear(CAMERA, (SIZE, SIZE))
    np.testing.assert_allclose(light.position, [-4, 3, 5], atol=1e-5)
    np.testing.assert_allclose(light.colour * light.intensity, [18, 90, 45], rtol=1e-5)
    del engine, light  # kernels are compiled for all scenes that are alive
    lamps["lamp"] = LAMP | {
        "position": [-4.0, 3.0, 5.0],
        "intensity": {"type": "rgb", "value": [18.0, 90.0, 45.0]},
    }
    lamps["other"] = {"type": "directional", "direction": [1.0, -1.0, 0.0], "irradiance": 0.5}
    fresh = engine_of(mi.load_dict({"type": "scene", "body": ball(), **lamps}, optimize=False), samples=400)
    np.testing.assert_allclose(value, fresh.linear(CAMERA, (SIZE, SIZE)), rtol=2e-4, atol=1e-6)


def test_a_lamp_that_was_dark_shines_again():
    engine = engine_of(assemble(), samples=400)
    before = engine.linear(CAMERA, (SIZE, SIZE))
    engine.set_light(0, intensity=0.0)
    assert engine.linear(CAMERA, (SIZE, SIZE)).max() == 0
    assert engine.frame(CAMERA, (SIZE, SIZE), True).pixels.max() == 0
    engine.set_light(0, intensity=60.0)
    np.testing.assert_allclose(engine.linear(CAMERA, (SIZE, SIZE)), before, rtol=1e-4, atol=1e-6)


def test_an_area_light_takes_its_shape_along():
    body, lamp = ball(), LIGHTS["area"]
    engine = engine_of(assemble(lamp, body=body), samples=400)
    engine.linear(CAMERA, (SIZE, SIZE))
    engine.set_light(0, position=[-4.0, 4.0, 5.0])
    value = engine.linear(CAMERA, (SIZE, SIZE))
    del engine
    truth = linear(assemble(lamp | {"center": [-4, 4, 5]}, body=body), samples=400)
    assert np.sqrt(np.mean((value - truth) ** 2)) < 0.02 * truth.mean()


def test_a_flat_lamp_is_aimed():
    def lamp(x, y, z):
        place = mi.ScalarTransform4f().look_at([x, y, z], [0, 0, 0], [0, 1, 0]) @ mi.ScalarTransform4f().scale(0.1)
        return {"type": "disk", "to_world": place, "emitter": {"type": "area", "radiance": 5000.0}}

    body = ball()
    engine = engine_of(assemble(lamp(4, 5, 4), body=body), samples=400)
    engine.linear(CAMERA, (SIZE, SIZE))
    position = np.array([-4.0, 4.0, 5.0])
    engine.set_light(0, position=position, direction=-position)
    np.testing.assert_allclose(engine.lights[0].direction, -position / np.linalg.norm(position), atol=1e-5)
    np.testing.assert_allclose(engine.lights[0].position, position, atol=1e-4)
    value = engine.linear(CAMERA, (SIZE, SIZE))
    del engine
    truth = linear(assemble(lamp(*position), body=body), samples=400)
    assert truth.mean() > 0
    assert np.sqrt(np.mean((value - truth) ** 2)) < 0.05 * truth.mean()  # places on the two disks differ by a turn


def test_size_is_the_scale_of_the_scene():
    engine = engine_of(assemble(body=ball(scale=1.0)), samples=400)
    engine.linear(CAMERA, (SIZE, SIZE))
    engine.set_size(30.0)
    assert engine.bodies[0].size_mm == pytest.approx(30.0)
    scaled = assemble(body=ball(scale=10.0))
    np.testing.assert_allclose(engine.linear(CAMERA, (SIZE, SIZE)), linear(scaled, samples=400), rtol=1e-4, atol=1e-6)
    one, other = (render(scene, "pellucid_two_pass", sample_count=2000) for scene in (engine.scene, scaled))
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def test_a_medium_goes_into_the_scene():
    engine = engine_of(assemble(), samples=400)
    engine.linear(CAMERA, (SIZE, SIZE))
    skin = Medium.from_preset("skin1")
    engine.set_medium(0, skin)
    np.testing.assert_allclose(engine.bodies[0].medium.sigma_a, skin.sigma_a, rtol=1e-12)
    changed = assemble(body=ball("skin1"))
    np.testing.assert_allclose(engine.linear(CAMERA, (SIZE, SIZE)), linear(changed, samples=400), rtol=1e-4, atol=1e-6)
    for method in ("pellucid_two_pass", "path"):
        one, other = (render(scene, method) for scene in (engine.scene, changed))
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def test_several_bodies_keep_their_light_and_their_media_apart():
    small = ball("skin1", eta=1.4) | {"center": [2.2, 0.8, 0.8], "radius": 0.7}
    scene = assemble(body=ball(), small=small)
    engine = engine_of(scene, samples=4096)
    assert {body.name for body in engine.bodies} == {"body", "small"}
    value = engine.linear(CAMERA, (SIZE, SIZE))
    truth = render(scene, "pellucid_exact", sample_count=8000, irradiance_paths=128)
    seen = truth.max(axis=2) > 0
    np.testing.assert_allclose(value[seen].mean(axis=0), truth[seen].mean(axis=0), rtol=0.015)
    assert np.sqrt(np.mean((value - truth) ** 2)) < 0.05 * truth[seen].max()
    assert engine.frame(CAMERA, (64, 64), True).samples.shape == (2 * engine.settings.samples, 3)


def changes(engine, step):
    """Change a little of everything."""
    media = [Medium.from_preset(name) for name in ("marble", "skin1", "cream", "ketchup")]
    engine.set_light(0, position=[4 * np.cos(step), 5.0, 6 * np.sin(step)], intensity=40.0 + step)
    engine.set_medium(0, media[step % 4])
    engine.set_size(10.0 + 3 * step)
    engine.settings.samples = 100 + 37 * step
    engine.settings.exposure = 0.1 * step
    engine.settings.specular, engine.settings.shininess = 0.1 * step, 20.0 + step
    engine.settings.method = METHODS[step % 3]
    camera = Camera(
        (14 * np.sin(0.1 * step), 5.0 - step, 14 * np.cos(0.1 * step)), (0.0, 0.0, 0.1 * step), fov=24.0 + step
    )
    return camera, (48 + 8 * step, 40 + 4 * step)


def test_nothing_is_compiled_after_the_third_frame():
    engine = engine_of(assemble(body=ball(), floor=floor()))
    misses = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for step in range(12):
            dr.kernel_history_clear()
            camera, size = changes(engine, step)
            engine.frame(camera, size, moving=True)
            engine.frame(camera, size, moving=False)
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
            misses.append(sum(not entry["cache_hit"] for entry in kernels))
    assert len(kernels) > 10
    assert sum(misses[2:]) == 0, misses


def test_what_cannot_be_is_said_in_one_line():
    with pytest.raises(SceneError, match="no translucent shape"):
        Engine(assemble(body={"type": "sphere"}))
    with pytest.warns(PellucidWarning, match="no light"):
        dark = Engine(mi.load_dict({"type": "scene", "body": ball()}, optimize=False), RESOLUTION)
    assert dark.frame(CAMERA, (32, 32), True).pixels.max() == 0
    with pytest.raises(SceneError, match="power of two"):
        Engine(assemble(), 300)
    engine = engine_of(assemble())
    for change, message in (
        (lambda: engine.set_light(3, intensity=1.0), "no light number 3"),
        (lambda: engine.set_light(0, direction=[0, 0, 1]), "no direction"),
        (lambda: engine.set_light(0, position=[0, np.nan, 1]), "finite"),
        (lambda: engine.set_light(0, intensity=-1.0), "at least 0"),
        (lambda: engine.set_medium(1, Medium.from_preset("skin1")), "no body number 1"),
        (lambda: engine.set_size(0.0), "positive"),
    ):
        with pytest.raises(PellucidError, match=message):
            change()
    for name, value in (("method", "other"), ("samples", 3)):
        broken = engine_of(assemble(), **{name: value})
        with pytest.raises(PellucidError, match=name):
            broken.frame(CAMERA, (16, 16), True)
