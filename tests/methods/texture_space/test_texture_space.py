"""Texture-space importance sampling: known answers, twins, convergence, what it refuses."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.gather.gather import gather_all
from pellucid.methods.preparation import entering_power, sample_profile
from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.scenes.loading import load_scene
from worlds.balls import T, looking_at, scene, translucent

SUN = {"type": "directional", "direction": [-1, -0.7, -0.4], "irradiance": 3.0}
POINT = {"type": "point", "position": [-60, 60, 40], "intensity": 20000.0}
SMALL = {"resolution": 256, "irradiance_paths": 4}


def ball(material="marble", diameter=10.0, **bsdf):
    return {"type": "sphere", "radius": diameter / 2, "bsdf": translucent(material=material, **bsdf)}


def torus(tmp_path):
    """A closed mesh without texture coordinates."""
    import trimesh

    path = tmp_path / "torus.ply"
    trimesh.creation.torus(6.0, 3.0).export(path)
    return {"type": "ply", "filename": str(path), "bsdf": translucent(material="marble")}


def lit_body(content, **settings):
    prepared = pellucid.prepare(content, "texture_space", **(SMALL | settings))
    return prepared, prepared.integrator.prepared.bodies[0]


def points_on(lit, count=1500):
    return lit.samples.p[np.linspace(0, len(lit.samples) - 1, count).astype(int)]


def exact(lit, p):
    """The sum over all texels, by the code of `pellucid_exact`."""
    queries = mi.Point3f(np.ascontiguousarray(p.T))
    table = sample_profile(lit, False)
    return np.stack([c.numpy() for c in gather_all(lit.samples.p, entering_power(lit), table, queries)], axis=1)


def relative_rmse(value, truth):
    return float(np.sqrt(np.mean((value - truth) ** 2)) / truth.mean())


def redraw(prepared, lit, **settings):
    integrator = prepared.integrator
    integrator.method = integrator.method.with_parameters(**settings)
    lit.state = integrator.method.build(lit)


@pytest.mark.parametrize("diameter, asked, expected", [(2.0, 0, 256), (20.0, 0, 512), (20.0, 64, 64)])
def test_texels_follow_the_mean_free_path(diameter, asked, expected):
    """Four to the 0.33 mm of marble, 256 along a side at least, unless a number is asked for."""
    _, lit = lit_body(scene(ball(diameter=diameter), light=SUN), resolution=asked, irradiance_paths=1)
    assert lit.state.texels.resolution == expected
    width = np.sqrt(lit.samples.area.mean())
    assert asked or width < lit.body.medium.mfp.min() / 4


@pytest.mark.parametrize("light", [SUN, None], ids=["sun", "sky"])
def test_the_texture_holds_the_flux_through_the_surface(light):
    """Irradiance times area, summed over texels: pi R^2 E under parallel light, 4 pi R^2 pi under a sky of radiance 1."""
    _, lit = lit_body(scene(ball(), light=light))
    flux = (lit.irradiance.total.astype(float) * lit.samples.area[:, None]).sum(axis=0)
    expected = np.pi * 25 * 3.0 if light else 4 * np.pi * 25 * np.pi
    assert flux == pytest.approx([expected] * 3, rel=1e-3)


@pytest.mark.parametrize("order", ["plane", "mipmap", "rows"])
@pytest.mark.parametrize("point_samples", [False, True])
def test_the_samples_carry_all_of_the_power(order, point_samples):
    """In every channel, although they are drawn by luminance: a red light on one side, a blue one on the other."""
    red = {"type": "directional", "direction": [-1, 0, 0], "irradiance": {"type": "rgb", "value": [3.0, 0.3, 0.0]}}
    blue = {"type": "directional", "direction": [1, 0, 0.2], "irradiance": {"type": "rgb", "value": [0.0, 0.1, 2.0]}}
    content = scene(ball(), light=red, other=blue)
    _, lit = lit_body(content, order=order, point_samples=point_samples, sample_count=4000)
    drawn, power = lit.state.drawn, entering_power(lit)
    assert lit.state.power.numpy().sum(axis=1, dtype=float) == pytest.approx(power.sum(axis=0), rel=0.01)
    assert (power[drawn.index.numpy()].sum(axis=1) > 0).all()


@pytest.mark.parametrize("hybrid", [False, True])
@pytest.mark.parametrize("order", ["plane", "mipmap", "rows"])
def test_twin_of_the_sum_over_all_texels(order, hybrid):
    prepared, lit = lit_body(scene(ball(), light=SUN), order=order, hybrid=hybrid, resolution=512, sample_count=6000)
    p = points_on(lit)
    truth, value = exact(lit, p), prepared.exitance(p)
    assert value.mean(axis=0) == pytest.approx(truth.mean(axis=0), rel=0.01)
    assert relative_rmse(value, truth) < {"plane": 0.03, "mipmap": 0.03, "rows": 0.06}[order]


def test_error_falls_at_least_with_the_square_root_of_the_samples():
    """Points fall faster than that, being even. Discs begin with less error, which falls a little more slowly at first."""
    counts = np.array([300, 1200, 4800])
    errors = {}
    for point_samples in (True, False):
        prepared, lit = lit_body(scene(ball(profile="dipole"), light=SUN), resolution=512, point_samples=point_samples)
        p = points_on(lit)
        truth = exact(lit, p)
        for count in counts.tolist():
            redraw(prepared, lit, sample_count=count)
            errors[point_samples, count] = relative_rmse(prepared.exitance(p), truth)
        del prepared, lit  # before the next: kernels are compiled for all scenes that are alive
    points, discs = ([errors[kind, count] for count in counts.tolist()] for kind in (True, False))
    assert np.polyfit(np.log(counts), np.log(points), 1)[0] < -0.6, errors
    assert np.polyfit(np.log(counts), np.log(discs), 1)[0] < -0.45, errors
    assert (np.array(discs) < points).all(), errors


@pytest.mark.parametrize("material", ["marble", "skimmilk"])
def test_discs_leave_less_noise_than_points(material):
    """And less by much where samples are few mean free paths apart."""
    prepared, lit = lit_body(scene(ball(material, 20.0), light=SUN), sample_count=900)
    p = points_on(lit)
    truth, discs = exact(lit, p), prepared.exitance(p)
    redraw(prepared, lit, point_samples=True)
    assert relative_rmse(discs, truth) < 0.75 * relative_rmse(prepared.exitance(p), truth)


def test_the_hybrid_needs_few_samples():
    """A large body with 900 samples: the error of the hybrid is a fraction of that of the samples alone."""
    content = scene(ball(diameter=40.0, profile="dipole"), light=POINT)
    prepared, lit = lit_body(content, resolution=512, sample_count=900)
    p = points_on(lit)
    truth, plain = exact(lit, p), relative_rmse(prepared.exitance(p), exact(lit, p))
    prepared, lit = lit_body(content, resolution=512, sample_count=900, hybrid=True)
    value = prepared.exitance(p)
    assert relative_rmse(value, truth) < 0.3 * plain
    assert value.mean() == pytest.approx(truth.mean(), rel=0.01)


def test_without_a_light_that_can_be_mapped_the_hybrid_changes_nothing():
    prepared, lit = lit_body(scene(ball()), hybrid=True)
    plain, _ = lit_body(scene(ball()))
    assert lit.state.seen.near is None
    assert np.array_equal(prepared.exitance(points_on(lit)), plain.exitance(points_on(lit)))


@pytest.mark.parametrize("shape", ["sphere", "mesh"])
def test_twin_of_two_pass(shape, tmp_path):
    body = ball(diameter=12.0) if shape == "sphere" else torus(tmp_path)
    content = scene(body, light=SUN)
    prepared, lit = lit_body(content, sample_count=10000, resolution=512)
    p = points_on(lit)
    other = pellucid.prepare(content, "two_pass", irradiance_paths=16, sample_count=20000).exitance(p)
    value = prepared.exitance(p)
    assert value.mean(axis=0) == pytest.approx(other.mean(axis=0), rel=0.015)
    assert relative_rmse(value, other) < 0.06


@pytest.mark.parametrize("hybrid", [False, True])
def test_furnace(hybrid):
    """A large ball under an even sky reflects its total diffuse reflectance of what enters."""
    lit = scene(ball("marble", 60.0), sensor=looking_at([0, 0, 0], [0, 0, 200], fov=8, size=16))
    integrator = mi.load_dict(
        {"type": "pellucid_texture_space", "aovs": "exitance,irradiance", "hybrid": hybrid, "max_depth": 2}
    )
    image = np.array(integrator.render(lit, spp=16), dtype=float)[4:12, 4:12]
    medium = pellucid.Medium.from_preset("marble")
    entering = np.pi * external_diffuse_transmittance(1.5)
    assert image[..., 3:6].mean(axis=(0, 1)) == pytest.approx(entering * medium.total_diffuse_reflectance, rel=0.06)
    assert image[..., 6:9].mean(axis=(0, 1)) == pytest.approx([np.pi] * 3, rel=0.03)


@pytest.mark.parametrize("hybrid", [False, True])
def test_light_travels_through_a_body_and_not_through_two(hybrid):
    light = {"type": "directional", "direction": [-1, 0, 0], "irradiance": 3.0}

    def halves(name):
        return scene(
            *(
                {
                    "type": "cube",
                    "to_world": T.translate([x, 0, 0]).scale([1, 4, 4]),
                    "bsdf": translucent(material="wholemilk", body=name, specular_reflectance=0.0),
                }
                for x in (-1.001, 1.001)
            ),
            light=light,
        )

    dark_side = np.array([[-2.001, y, z] for y in (-0.5, 0, 0.5) for z in (-0.5, 0, 0.5)])
    joined, _ = lit_body(halves("both"), hybrid=hybrid)
    apart = pellucid.prepare(halves(""), "texture_space", hybrid=hybrid, **SMALL)
    glow = joined.exitance(dark_side).mean()
    assert glow > 1e-3
    assert apart.exitance(dark_side, body=0).mean() < 1e-3 * glow


def test_few_light_paths_a_texel_are_enough():
    """Paths are even over neighbouring texels: under a sky 2 a texel leave what 64 leave, the noise of the samples drawn from them."""
    lit = scene(ball(profile="dipole"), light={"type": "constant", "radiance": 1.0})
    errors = {}
    reference, body = lit_body(lit, irradiance_paths=64, sample_count=4000)
    p = points_on(body)
    truth = exact(body, p)
    errors[64] = relative_rmse(reference.exitance(p), truth)
    few, _ = lit_body(lit, irradiance_paths=2, sample_count=4000)
    errors[2] = relative_rmse(few.exitance(p), truth)
    assert errors[64] < 0.01 and errors[2] < 0.01, errors


def test_an_open_surface_and_one_without_light():
    disk = {"type": "disk", "to_world": T.scale(8.0), "bsdf": translucent(material="marble")}
    prepared, lit = lit_body(scene(disk), sample_count=4000, hybrid=True)
    assert lit.irradiance.total.mean(axis=0) == pytest.approx([np.pi] * 3, rel=0.02)  # from one side
    p = points_on(lit)
    assert prepared.exitance(p).mean(axis=0) == pytest.approx(exact(lit, p).mean(axis=0), rel=0.01)
    dark, lit = lit_body(scene(ball(), light={"type": "constant", "radiance": 0.0}))
    assert not dark.exitance(points_on(lit)).any()


def test_the_same_seed_gives_the_same_picture_and_another_one_another():
    lit = scene(ball(), light=SUN, sensor=looking_at([0, 0, 0], [0, 0, 100], fov=6))
    pictures = []
    for seed in (0, 0, 1):
        integrator = mi.load_dict({"type": "pellucid_texture_space", "seed": seed, **SMALL})
        pictures.append(np.array(integrator.render(lit, spp=1)))
    assert np.array_equal(pictures[0], pictures[1]) and not np.array_equal(pictures[0], pictures[2])


def test_what_other_surfaces_show_is_summed_over_fewer_samples():
    prepared, lit = lit_body(scene(ball(), light=SUN), sample_count=1000)
    p = mi.Point3f(np.ascontiguousarray(points_on(lit).T))
    coarse, fine = (
        prepared.integrator.method.sum_up(lit, p, None, indirectly).numpy().T for indirectly in (True, False)
    )
    assert dr.width(lit.state.coarse.source.records) == dr.width(lit.state.seen.rest.source.records) // 4
    assert coarse.mean(axis=0) == pytest.approx(fine.mean(axis=0), rel=0.02)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"sample_count": -1}, ["sample_count", "at least 0"]),
        ({"resolution": 1000}, ["power of two", "512", "1024"]),
        ({"resolution": 1}, ["resolution"]),
        ({"order": "mipmaps"}, ["mipmaps", "did you mean 'mipmap'"]),
        ({"sampling": "poisson"}, ["sampling"]),
        ({"irradiance_paths": -1}, ["irradiance_paths"]),
        ({"max_error": 0.1}, ["max_error"]),
    ],
)
def test_settings_that_cannot_be(parameters, words):
    with pytest.raises(pellucid.PellucidError) as caught:
        load_scene({"type": "scene", "integrator": {"type": "pellucid_texture_space", **parameters}})
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_body_far_smaller_than_the_mean_free_path_has_the_coarsest_texture():
    with pytest.warns(pellucid.PellucidWarning, match="too small for light to become diffuse"):
        prepared = pellucid.prepare(scene(ball(diameter=0.02)), "texture_space", sample_count=100)
    assert np.isfinite(prepared.exitance([[0, 0, 0.01]])).all()
