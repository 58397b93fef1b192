"""The path tracer against Mitsuba's own, and the irradiance against closed forms."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.light import irradiance
from pellucid.light.irradiance import gather_irradiance
from pellucid.light.transport import Limits, Start, trace
from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.scene.samples.surface import sample_surface


def cornell(**boxes):
    scene = mi.cornell_box()
    scene["sensor"]["film"]["width"] = scene["sensor"]["film"]["height"] = 48
    scene |= {key: scene[key] | value for key, value in boxes.items()}
    return mi.load_dict(scene, optimize=False)


def camera_rays(scene, spp):
    sensor = scene.sensors()[0]
    sampler = sensor.sampler().clone()
    width = 48 * 48 * spp
    sampler.seed(3, width)
    index = dr.arange(mi.UInt32, width) // spp
    position = (mi.Point2f(mi.Float(index % 48), mi.Float(index // 48)) + sampler.next_2d()) / 48
    return sensor.sample_ray(0, 0, position, mi.Point2f(0.5))[0], sampler


def test_without_translucency_it_is_mitsubas_path_tracer():
    scene = cornell()
    ray, sampler = camera_rays(scene, 512)
    radiance, seen, _, _ = trace(scene, sampler, Start.camera(ray), Limits(5, 5), None, mi.Bool(True))
    ours = radiance + seen
    mitsuba = mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 5}), spp=512)
    assert np.mean(ours.numpy(), axis=1) == pytest.approx(np.mean(np.array(mitsuba), axis=(0, 1)), rel=0.02)


def test_other_integrators_render_the_material_as_a_diffuse_base_under_a_coat():
    """`path` and our tracer agree on the stand-in, so the BSDF's eval, pdf and sample agree with each other."""
    translucent = {"bsdf": {"type": "pellucid_translucent", "material": "wholemilk", "scale": 50.0}}
    scene = cornell(**{"small-box": translucent, "large-box": translucent | {}})
    ray, sampler = camera_rays(scene, 512)
    radiance, seen, _, _ = trace(scene, sampler, Start.camera(ray), Limits(5, 5), None, mi.Bool(True))
    ours = radiance + seen
    mitsuba = mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 5}), spp=512)
    assert np.mean(ours.numpy(), axis=1) == pytest.approx(np.mean(np.array(mitsuba), axis=(0, 1)), rel=0.02)


@pytest.mark.parametrize("alpha", [0.0, 0.05, 0.4])
@pytest.mark.parametrize("cosine", [0.2, 0.9])
def test_sampling_the_bsdf_and_integrating_it_agree(alpha, cosine):
    bsdf = mi.load_dict(
        {
            "type": "pellucid_translucent",
            "material": "skin1",
            "alpha": alpha,
            "profile": "dipole",
            "single_scattering": True,
        }
    )
    n = 1 << 18
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0, cosine)
    sample, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
    smooth = ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    albedo = np.mean(dr.select(smooth, weight, 0).numpy(), axis=1)
    wo = mi.warp.square_to_uniform_hemisphere(sampler.next_2d())
    integral = np.mean(bsdf.eval(mi.BSDFContext(), si, wo).numpy(), axis=1) * 2 * np.pi
    assert albedo == pytest.approx(integral, rel=0.05)
    # and pdf is the density of sample: the mean of 1/pdf over its directions is the solid angle it covers
    wo_pdf = np.mean(bsdf.pdf(mi.BSDFContext(), si, wo).numpy()) * 2 * np.pi
    assert wo_pdf == pytest.approx(np.mean(dr.select(smooth & (sample.wo.z > 0), 1.0, 0.0).numpy()), rel=0.03)


def sphere_scene(emitter, **shape):
    return mi.load_dict({"type": "scene", "body": {"type": "sphere", **shape}, "light": emitter}, optimize=False)


def irradiance_of(scene, count=2000, paths=64, eta=1.5, outside=1, depth=2):
    samples = sample_surface([(scene.shapes()[0], None)], count, "uniform", 0)
    samples = replace(samples, outside=outside)
    return samples, gather_irradiance(scene, samples, eta, Limits(depth, 5), paths, 0)


def test_a_constant_sky_of_radiance_one_gives_pi_and_the_diffuse_transmittance():
    _, light = irradiance_of(sphere_scene({"type": "constant", "radiance": 1.0}))
    assert light.total.mean() == pytest.approx(np.pi, rel=2e-3)
    assert light.entering.mean() == pytest.approx(np.pi * external_diffuse_transmittance(1.5), rel=2e-3)


@pytest.mark.parametrize("kind", ["directional", "point", "spot"])
def test_delta_lights_follow_the_cosine_law(kind):
    emitter = {
        "directional": {"type": "directional", "direction": [0, 0, -1], "irradiance": 3.0},
        "point": {"type": "point", "position": [0, 0, 5], "intensity": 75.0},
        "spot": {
            "type": "spot",
            "intensity": 75.0,
            "cutoff_angle": 60.0,
            "beam_width": 59.0,
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
        },
    }[kind]
    samples, light = irradiance_of(sphere_scene(emitter), paths=1)
    p = samples.p.astype(float)
    if kind == "directional":
        expected = 3 * np.maximum(p[:, 2], 0)
    else:
        way = np.array([0, 0, 5]) - p
        distance = np.linalg.norm(way, axis=1)
        expected = 75 / distance**2 * np.maximum(np.sum(way * p, axis=1) / distance, 0)
    assert light.total[:, 0] == pytest.approx(expected, rel=1e-3, abs=2e-3)


def test_each_side_of_an_open_surface_has_light_of_its_own():
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": {"type": "rectangle"},
            "up": {"type": "directional", "direction": [0, 0, 1], "irradiance": 2.0},
            "down": {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
        },
        optimize=False,
    )
    for side, expected in ((1, 1.0), (-1, 2.0)):
        _, light = irradiance_of(scene, paths=256, outside=side)
        assert light.total.mean() == pytest.approx(expected, rel=0.03)


def test_light_bounces_off_the_rest_of_the_scene():
    """Below a large white plane under a sky, a small sphere receives from the plane what the plane receives."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": {"type": "sphere", "radius": 0.01, "center": [0, 0, 0.05]},
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale(100.0),
                "bsdf": {"type": "diffuse", "reflectance": 0.8},
            },
            "light": {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
        },
        optimize=False,
    )
    samples, light = irradiance_of(scene, paths=256, depth=3)
    lowest = samples.n[:, 2] < -0.95
    _, direct = irradiance_of(scene, paths=16, depth=2)
    assert direct.total[lowest].max() == 0
    # The bottom sees the plane everywhere but in its own shadow, a disk of radius 0.01 at a distance of 0.04.
    assert light.total[lowest].mean() == pytest.approx(0.8 * (1 - 0.01**2 / (0.01**2 + 0.04**2)), rel=0.02)


def test_the_same_seed_gives_the_same_light():
    scene = sphere_scene({"type": "constant"})
    first, second = (irradiance_of(scene, 500, 8)[1].entering for _ in range(2))
    assert np.array_equal(first, second)


def test_an_area_light_gives_the_form_factor_of_a_disk():
    """A disk of radius R at height h over a small level patch: E = pi L R^2 / (R^2 + h^2)."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": {"type": "sphere", "radius": 0.01},
            "lamp": {
                "type": "disk",
                "to_world": mi.ScalarTransform4f().translate([0, 0, 2.01]).rotate([1, 0, 0], 180).scale(1.5),
                "emitter": {"type": "area", "radiance": 2.0},
            },
        },
        optimize=False,
    )
    samples, light = irradiance_of(scene, count=20000, paths=64)
    top = samples.n[:, 2] > 0.999
    assert light.total[top].mean() == pytest.approx(np.pi * 2 * 1.5**2 / (1.5**2 + 2.0**2), rel=0.02)


@pytest.mark.parametrize("kind", ["envmap", "sunsky"])
def test_environments_light_from_above_only(kind):
    up = np.zeros((32, 64, 3), np.float32)
    up[:16] = 1.0  # the upper half of a latitude-longitude picture, whose up is y
    emitter = {
        "envmap": {"type": "envmap", "bitmap": mi.Bitmap(up)},
        "sunsky": {"type": "sunsky", "sun_direction": [0, 0, 1]},
    }[kind]
    samples, light = irradiance_of(sphere_scene(emitter), paths=64)
    height = samples.n[:, 1 if kind == "envmap" else 2]
    top, bottom = light.total[height > 0.9].mean(), light.total[height < -0.9].mean()
    assert top > 20 * bottom
    if kind == "envmap":
        assert top == pytest.approx(np.pi, rel=0.05)


def test_a_coarse_mesh_with_smooth_normals_is_lit_like_the_sphere_it_stands_for():
    """No facets and no terminator: the irradiance of 320 triangles follows the cosine of the smooth normal."""
    import trimesh

    from pellucid.scene.meshes.buffers import mesh_from_arrays

    ball = trimesh.creation.icosphere(subdivisions=2)
    mesh = mesh_from_arrays("ball", ball.vertices, ball.faces, normals=ball.vertices)
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0}
    scene = mi.load_dict({"type": "scene", "body": mesh, "light": light}, optimize=False)
    samples, received = irradiance_of(scene, count=20000, paths=1)
    expected = np.maximum(samples.sh_n[:, 2], 0)
    error = np.abs(received.total[:, 0] - expected)
    assert np.mean(error) < 2e-3
    lit = expected > 0.1
    assert np.mean(error[lit] > 0.01) < 2e-3


def test_indirect_light_is_averaged_over_neighbours_and_direct_light_is_not(monkeypatch):
    """Below a lit plane: with few paths a sample the noise is that of many, and the mean stays."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": {"type": "sphere"},
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -4]).scale(20),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}},
            },
            "lamp": {"type": "point", "position": [3, 0, 8], "intensity": 100.0},
        },
        optimize=False,
    )
    few = irradiance_of(scene, count=5000, paths=8, depth=4)[1].total
    monkeypatch.setattr(irradiance, "MOST_NEIGHBOURS", 1)
    truth, raw = (irradiance_of(scene, count=5000, paths=paths, depth=4)[1].total for paths in (512, 8))
    direct = irradiance_of(scene, count=5000, paths=8, depth=2)[1].total
    assert np.std(few - truth) < 0.4 * np.std(raw - truth)
    assert few.mean() == pytest.approx(truth.mean(), rel=0.01)
    assert np.abs(direct).max() > 1 and (few >= direct * (1 - 1e-5)).all()
