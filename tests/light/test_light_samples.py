"""Point lights for emitters: against closed forms, against Mitsuba's own emitters, and against the law in the docstring."""

import warnings

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import PellucidWarning
from pellucid.light.points.discretise import discretise, irradiance_of_all
from pellucid.light.points.records import DIRECTIONAL, OMNI, ORIENTED, LightSamples, to_device
from pellucid.model.fresnel import external_diffuse_transmittance, transmitted
from worlds.balls import T

DOWN = T.translate([0, 0, 2]).rotate([1, 0, 0], 180)
ABOVE = T.translate([0, 0, 3])
RGB = {"type": "rgb", "value": [1.0, 2.0, 3.0]}


def bitmap(height, width):
    texels = np.random.default_rng(5).random((height, width, 3)).astype(np.float32) ** 4
    return mi.Bitmap(texels)


def emitter(kind):
    texture = {"type": "bitmap", "bitmap": bitmap(8, 8), "raw": True}
    return {
        "rectangle": {"type": "rectangle", "to_world": DOWN, "light": {"type": "area", "radiance": RGB}},
        "sphere": {"type": "sphere", "to_world": ABOVE, "light": {"type": "area", "radiance": 1.0}},
        "cube": {"type": "cube", "to_world": ABOVE, "light": {"type": "area", "radiance": 1.0}},
        "disk": {"type": "disk", "to_world": DOWN, "light": {"type": "area", "radiance": 1.0}},
        "textured": {"type": "rectangle", "to_world": DOWN, "light": {"type": "area", "radiance": texture}},
        "point": {"type": "point", "position": [0.3, 0.2, 2.0], "intensity": RGB},
        "spot": {
            "type": "spot",
            "intensity": RGB,
            "cutoff_angle": 40.0,
            "beam_width": 10.0,
            "to_world": T.look_at([1, 2, 3], [0, 0, 0], [0, 1, 0]),
        },
        "directional": {"type": "directional", "direction": [0.3, 0.0, -1.0]},
        "constant": {"type": "constant", "radiance": 0.5},
        "envmap": {"type": "envmap", "bitmap": bitmap(8, 16), "to_world": T.rotate([1, 0, 0], 90)},
        "sunsky": {"type": "sunsky", "sun_direction": [0.3, 0.1, 1.0]},
        "sky": {"type": "sunsky", "sun_scale": 0.0, "sun_direction": [0.3, 0.1, 1.0]},
        "sun": {"type": "sunsky", "sky_scale": 0.0, "sun_direction": [0.3, 0.1, 1.0]},
    }[kind]


def plane_scene(*emitters):
    """A plane of side 4 with a ball that throws a shadow on it."""
    scene = {
        "type": "scene",
        "plane": {"type": "rectangle", "to_world": T.scale(2)},
        "ball": {"type": "sphere", "center": [0.5, 0.5, 0.6], "radius": 0.3},
    }
    return mi.load_dict(scene | {f"light{k}": spec for k, spec in enumerate(emitters)}, optimize=False)


def on_plane(xy, repeat=1):
    si = dr.zeros(mi.SurfaceInteraction3f, xy.shape[1] * repeat)
    x, y = np.repeat(xy.astype(np.float32), repeat, axis=1)
    si.p, si.n = mi.Point3f(x, y, 0), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    return si


def somewhere(count=100):
    return np.random.default_rng(0).random((2, count)) * 3 - 1.5


def summed(scene, lights, xy, eta=1.5):
    falling, entering = irradiance_of_all(scene, to_device(lights), len(lights), on_plane(xy), eta)
    return falling.numpy(), entering.numpy()


def by_mitsuba(scene, xy, eta=1.5, paths=4096):
    """The same by Mitsuba's own emitter sampling, with random numbers."""
    si, shape = on_plane(xy, paths), (3, xy.shape[1], paths)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, dr.width(si))
    ds, weight = scene.emitters()[0].sample_direction(si, sampler.next_2d())
    cosine = dr.maximum(ds.d.z, 0)
    hidden = scene.ray_test(si.spawn_ray_to(ds.p)) | (ds.pdf == 0)
    falling = dr.select(hidden, 0, weight * cosine)
    entering = falling * transmitted(cosine, eta)
    return falling.numpy().reshape(shape).mean(axis=-1), entering.numpy().reshape(shape).mean(axis=-1)


EXACT = ["point", "spot", "directional"]
# Shadows have steps as large as one light sample: an area light of 3072 points is off by a few of them at single points.
EXTENDED = ["rectangle", "sphere", "cube", "disk", "textured", "constant", "envmap", "sunsky", "sky", "sun"]


@pytest.mark.parametrize("kind", EXACT + EXTENDED)
def test_every_emitter_lights_a_plane_as_mitsubas_does(kind):
    scene, xy = plane_scene(emitter(kind)), somewhere()
    lights = discretise(scene, indirect=0)
    assert len(lights) == (1 if kind in EXACT else 3072)
    for ours, reference in zip(summed(scene, lights, xy), by_mitsuba(scene, xy), strict=True):
        scale = reference.mean()
        tolerance, spread = (1e-5, 1e-5) if kind in EXACT else (8e-3, 0.05)
        assert ours.mean() == pytest.approx(scale, rel=tolerance)
        assert np.sqrt(np.mean((ours - reference) ** 2)) < spread * scale


def test_a_constant_sky_gives_pi_and_the_diffuse_transmittance():
    scene = mi.load_dict(
        {"type": "scene", "sky": {"type": "constant"}, "far": {"type": "sphere", "center": [0, 0, -9]}}
    )
    falling, entering = summed(scene, discretise(scene, indirect=0), somewhere(10))
    assert falling == pytest.approx(np.pi, rel=2e-3)
    assert entering == pytest.approx(np.pi * external_diffuse_transmittance(1.5), rel=3e-3)


def test_a_disk_lights_the_points_on_its_axis_by_the_closed_form():
    scene = mi.load_dict({"type": "scene", "disk": emitter("disk")})
    falling, _ = summed(scene, discretise(scene, indirect=0), np.zeros((2, 1)))
    assert falling == pytest.approx(np.pi / (1 + 2**2), rel=1e-3)  # pi L r^2 / (r^2 + h^2)


def test_the_fall_off_of_a_spot_is_mitsubas_at_every_angle():
    scene = mi.load_dict({"type": "scene", "spot": emitter("spot"), "far": {"type": "sphere", "center": [0, 0, -9]}})
    xy = np.random.default_rng(2).random((2, 4000)) * 8 - 4
    falling, _ = summed(scene, discretise(scene, indirect=0), xy)
    reference, _ = by_mitsuba(scene, xy, paths=1)
    assert np.mean(reference == 0) > 0.2
    assert np.max(np.abs(falling - reference)) < 1e-5 * reference.max()
    assert np.mean((falling > 0) == (reference > 0)) > 0.999


def test_intensities_add_up_to_the_power_of_the_emitters():
    scene = plane_scene(emitter("rectangle"), emitter("constant"), emitter("sphere"))
    lights = discretise(scene, direct=300, indirect=0)
    area, sky = lights.take(lights.kind == ORIENTED), lights.take(lights.kind == DIRECTIONAL)
    assert len(area) == 200 and len(sky) == 100
    assert area.intensity.sum(axis=0) == pytest.approx(4 * np.array([1, 2, 3]) + 4 * np.pi, rel=1e-4)
    assert sky.intensity.sum(axis=0) == pytest.approx(0.5 * 4 * np.pi, rel=1e-4)


def test_no_emitter_gets_fewer_than_64_points():
    lights = discretise(plane_scene(emitter("rectangle"), emitter("constant"), emitter("point")), direct=1, indirect=0)
    assert np.bincount(lights.kind).tolist() == [1, 64, 64]


@pytest.mark.parametrize("kind", ["projector", "directionalarea", "textured spot"])
def test_what_cannot_be_point_lights_is_named_and_left_out(kind):
    texture = {"type": "bitmap", "bitmap": bitmap(8, 8), "raw": True}
    odd = {
        "projector": {"type": "projector", "irradiance": 1.0},
        "directionalarea": {"type": "rectangle", "light": {"type": "directionalarea", "radiance": 1.0}},
        "textured spot": {"type": "spot", "texture": texture},
    }[kind]
    with pytest.warns(PellucidWarning, match=r"(Projector|DirectionalArea|SpotLight).*left out") as caught:
        lights = discretise(plane_scene(odd, emitter("point")), indirect=64, max_depth=3)
    assert len(caught) == 1
    assert np.count_nonzero(~lights.indirect) == 1


def test_a_scene_without_light_has_no_light_samples():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lights = discretise(plane_scene())
    assert len(lights) == 0
    falling, entering = summed(plane_scene(), lights, somewhere(4))
    assert not falling.any() and not entering.any()


def many_lights(count, spots):
    rng = np.random.default_rng(3)

    def unit(n):
        v = rng.normal(size=(n, 3))
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    def above(n):
        return rng.random((n, 3)) * [4, 4, 2] + [-2, -2, 0.05]

    omni = {"cutoff": 1.2, "beam": 0.4} if spots else {}
    return LightSamples.join(
        [
            LightSamples.make(OMNI, above(count), unit(count), rng.random((count, 3)), **omni),
            LightSamples.make(ORIENTED, above(count), unit(count), rng.random((count, 3)), near2=0.3),
            LightSamples.make(DIRECTIONAL, 0, unit(count), rng.random((count, 3))),
        ]
    )


@pytest.mark.parametrize("spots", [False, True])
def test_the_records_follow_the_law(spots):
    """Without shadows, against the formulas in the docstring of `LightSamples` in double precision."""
    lights, xy = many_lights(20, spots), somewhere(7)
    p = np.concatenate([xy, np.zeros((1, 7))]).T[:, None, :]
    way = lights.p.astype(float) - p
    distance = np.linalg.norm(way, axis=2, keepdims=True)
    directional, oriented = (lights.kind == kind for kind in (DIRECTIONAL, ORIENTED))
    direction = np.where(directional[:, None], lights.n, way / distance)
    cos_light = -np.sum(direction * lights.n, axis=2)
    factor = 1 / np.maximum(distance[..., 0] ** 2, lights.near2)
    factor = np.where(oriented, factor * np.maximum(cos_light, 0), factor)
    if spots:
        ramp = np.clip((1.2 - np.arccos(np.clip(cos_light, -1, 1))) / 0.8, 0, 1)
        factor = np.where(lights.kind == OMNI, factor * ramp, factor)
    factor = np.where(directional, 1, factor) * np.maximum(direction[..., 2], 0)
    expected = np.sum(factor[..., None] * lights.intensity, axis=1)
    scene = mi.load_dict({"type": "scene", "far": {"type": "sphere", "center": [0, 0, -9]}})
    falling, _ = summed(scene, lights, xy)
    np.testing.assert_allclose(falling.T, expected, rtol=1e-4)


def test_a_light_on_a_surface_does_not_shadow_itself():
    """Scene units far from 1, and a receiver almost in the plane of the light."""
    for scale in (1e-3, 1.0, 1e3):
        scene = mi.load_dict({"type": "scene", "lamp": {"type": "cube", "to_world": T.scale(scale)}})
        centre, normal = np.array([[0.3, 0.2, 1.0]]) * scale, [0, 0, 1]
        hair = 1e-4 * (1 + scale)
        lights = LightSamples.make(ORIENTED, centre + hair * np.array(normal), normal, np.ones(3), near2=0)
        si = dr.zeros(mi.SurfaceInteraction3f, 1)
        si.p, si.n = mi.Point3f(0.9 * scale, 0.2 * scale, 1.05 * scale + hair), mi.Normal3f(-1, 0, 0)
        si.sh_frame = mi.Frame3f(mi.Vector3f(-1, 0, 0))
        falling, _ = irradiance_of_all(scene, to_device(lights), 1, si, 1.5)
        assert falling.numpy().min() > 0


def test_lights_can_be_reordered():
    lights = many_lights(5, True)
    order = np.random.default_rng(0).permutation(len(lights))
    taken = lights.take(order)
    assert np.array_equal(taken.p, lights.p[order]) and np.array_equal(taken.cutoff, lights.cutoff[order])
    assert len(lights.take(lights.kind == DIRECTIONAL)) == 5


def test_the_same_seed_gives_the_same_lights_and_another_seed_others():
    scene = plane_scene(emitter("rectangle"), emitter("sunsky"))
    first, again, other = (discretise(scene, direct=200, indirect=200, seed=seed) for seed in (1, 1, 2))
    for key, value in vars(first).items():
        assert np.array_equal(value, getattr(again, key)), key
    assert not np.array_equal(first.p, other.p)


def test_another_number_of_lights_needs_no_other_kernel():
    scene = plane_scene(emitter("point"))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for count in (5, 5, 9):
            dr.kernel_history_clear()
            summed(scene, many_lights(count, False), somewhere(9))
        compiled = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    assert not compiled
