"""The single pass: its four modes against each other and against paths, copies, what it costs, and what it refuses."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.effort import observing
from pellucid.methods.single_pass.modes import enough_eyes
from pellucid.methods.single_pass.samples import EyePoints, sample_prototype
from pellucid.methods.surface_samples import SpreadParameters
from pellucid.model.fresnel import external_diffuse_transmittance, fdr
from pellucid.scene.prototypes import find_prototypes
from pellucid.scene.samples.surface import FEWEST_SAMPLES
from pellucid.scenes.loading import load_scene
from worlds.balls import T, looking_at, rgb, scene, translucent

RADIUS = 10.0
FEW = {"sample_count": 2000, "sampling": "uniform", "direct": 512, "indirect": 1000, "max_depth": 4}


def render(lit, spp=4, **settings):
    """The picture, what was prepared, and what was spent."""
    integrator = mi.load_dict({"type": "pellucid_single_pass", **settings})
    with observing() as effort:
        integrator.prepared = integrator.prepare_scene(lit)
        picture = np.array(mi.render(lit, integrator=integrator, spp=spp), dtype=float)
    return picture, integrator.prepared, effort.counts


def without_view(lit, **settings):
    """A scene that is prepared for no view, as one that has no camera."""
    prepared = pellucid.prepare(lit, "single_pass", **settings)
    method = prepared.integrator.method
    prepared.integrator.prepared = method.prepare_view(lit, prepared.integrator.prepared, None)
    return prepared


def ball(**parameters):
    where = {key: parameters.pop(key) for key in ("center", "to_world") if key in parameters}
    return {"type": "sphere", "radius": RADIUS, "bsdf": translucent(**({"material": "marble"} | parameters)), **where}


def lamp():
    to_world = T.translate([15, 25, 5]).rotate([1, 0, 0], 90).scale(6)
    return {"type": "rectangle", "to_world": to_world, "emitter": {"type": "area", "radiance": 20.0}}


def floor(height=-14.0):
    return {
        "type": "rectangle",
        "to_world": T.translate([0, height, 0]).rotate([1, 0, 0], -90).scale(40),
        "bsdf": {"type": "diffuse", "reflectance": 0.7},
    }


def room(*shapes):
    """A ball, or other shapes, over a floor under a lamp and a dim sky."""
    return scene(*(shapes or [ball()]), floor(), lamp(), light={"type": "constant", "radiance": 0.2})


def points_around(centre=(0, 0, 0), count=500, seed=0):
    n = np.random.default_rng(seed).normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return RADIUS * n + centre


def bright(exitance):
    return np.asarray(exitance, float) @ [0.2126, 0.7152, 0.0722]


# ------------------------------------------------------------------ the same light as by other methods


def test_points_of_light_give_what_paths_give():
    """Lamp, sky and the light of both from the floor, against path tracing, from the same samples."""
    lit, points = room(), points_around()
    settings = {"sample_count": 2000, "sampling": "uniform", "max_depth": 4}
    paths = pellucid.prepare(lit, "exact", irradiance_paths=2048, **settings).exitance(points)
    exact = without_view(lit, mode="exact", direct=1024, indirect=4000, **settings).exitance(points)
    error = bright(exact) / bright(paths) - 1
    assert np.median(np.abs(error)) < 0.02 and np.quantile(np.abs(error), 0.98) < 0.08
    assert exact.sum(axis=0) == pytest.approx(paths.sum(axis=0), rel=0.01)
    direct = without_view(lit, mode="exact", **{**FEW, "irradiance_depth": 2}).exitance(points)
    assert direct.sum() < 0.9 * exact.sum()  # there is something to be had from the floor


def test_adaptive_and_lightcuts_are_near_the_sum_over_all():
    lit, points = room(), points_around()
    truth = bright(without_view(lit, mode="exact", **FEW).exitance(points))
    for mode, bias in (("adaptive", 0.006), ("two_pass", 0.003)):
        found = bright(without_view(lit, mode=mode, **FEW).exitance(points))
        error = found / truth - 1
        assert np.median(np.abs(error)) < 0.01 and np.quantile(np.abs(error), 0.95) < 0.03, mode
        assert np.abs(error).max() < 0.1, mode
        assert found.sum() / truth.sum() == pytest.approx(1, abs=bias), mode


def test_the_mean_over_seeds_is_not_biased():
    """Samples and lights change with the seed, so each is compared with the sum over its own."""
    lit, points, found = room(), points_around(count=300), []
    for seed in range(3):
        mean = {}
        for mode in ("exact", "adaptive"):
            settings = {**FEW, "direct": 256, "indirect": 300, "seed": seed}
            mean[mode] = bright(without_view(lit, mode=mode, **settings).exitance(points)).mean()
        found.append(mean["adaptive"] / mean["exact"] - 1)
    assert np.mean(found) == pytest.approx(0, abs=0.005)


def test_the_cut_of_the_paper_is_roughly_right():
    """Its bounds are on triples, and what it leaves out adds up: some per cent at a point, little in the mean."""
    lit, points = room(), points_around(count=300)
    settings = {**FEW, "sample_count": 1000, "direct": 128, "indirect": 100}
    exact = bright(without_view(lit, mode="exact", **settings).exitance(points))
    for more, error in (({}, 0.04), ({"max_error": 0.005}, 0.02)):
        with observing() as effort:
            prepared = without_view(lit, mode="cut", **settings, **more)
            cut = bright(prepared.exitance(points))
        assert np.median(np.abs(cut / exact - 1)) < error
        assert cut.sum() == pytest.approx(exact.sum(), rel=0.01)
        assert effort.counts["cache hits"] > 5 * effort.counts["shadow rays"] > 0
    # No kernel may look for a sample behind the last one: 1000 are no power of two.
    state = prepared.integrator.prepared
    tables, count = state.prepared[0], state.sampled[0].samples.count
    assert tables.sample_choices.numpy().max() < count
    assert tables.last_opaque[0] == count - 1


@pytest.mark.parametrize("mode", ["exact", "adaptive", "two_pass"])
def test_a_white_ball_under_a_white_sky(mode):
    """The furnace: the same exitance as with paths, and hardly less than what enters."""
    lit = scene(ball(material="spectralon", scale=0.1))
    points, settings = points_around(), {"sample_count": 4000, "sampling": "uniform", "max_depth": 2}
    paths = pellucid.prepare(lit, "two_pass", irradiance_paths=64, **settings).exitance(points)
    found = without_view(lit, mode=mode, direct=4096, **settings).exitance(points)
    assert found.mean(axis=0) == pytest.approx(paths.mean(axis=0), rel=0.005)
    assert np.median(np.abs(bright(found) / bright(paths) - 1)) < 0.01
    entering = np.pi * external_diffuse_transmittance(1.3)
    assert 0.9 * entering < found.mean() < 1.02 * entering


@pytest.mark.parametrize("mode", ["exact", "adaptive", "two_pass", "cut"])
def test_misprint_2_light_enters_by_the_transmittance_of_its_direction(mode):
    """AWB08 figure 3 prints the internal diffuse reflectance F_dr for T_d; neither is the factor of light from above.

    A flat square under parallel light, large beside its mean free path: in the middle the exitance is F_t times R_d.
    """
    medium = pellucid.Medium(2.0, 0.1, eta=1.5)
    slab = {
        "type": "rectangle",
        "to_world": T.scale(8.0),
        "bsdf": translucent(sigma_s_prime=2.0, sigma_a=0.1, eta=1.5),
    }
    for angle in (0.0, 75.0):
        towards = [-np.sin(np.radians(angle)), 0.0, -np.cos(np.radians(angle))]
        lit = scene(slab, light={"type": "directional", "direction": towards, "irradiance": 1.0})
        settings = {"sample_count": 3000, "sampling": "uniform", "indirect": 0, "mode": mode}
        middle = np.random.default_rng(0).uniform(-1.5, 1.5, (200, 3)) * [1, 1, 0]
        found = without_view(lit, **settings).exitance(middle).mean(axis=0)
        del lit  # before the next: kernels are compiled for all scenes that are alive
        cosine = np.cos(np.radians(angle))
        transmittance = 1 - mi.fresnel(float(cosine), medium.eta)[0]
        expected = transmittance * cosine * medium.total_diffuse_reflectance
        assert found == pytest.approx(expected, rel=0.03 if mode != "cut" else 0.08)
        assert abs(transmittance / fdr(medium.eta) - 1) > 0.2  # what the misprint would give, and T_d at this angle:
        if angle:
            assert abs(transmittance / external_diffuse_transmittance(medium.eta) - 1) > 0.15


# ------------------------------------------------------------------ shapes


WAYS = {
    "a": T.translate([-25, 0, 0]),
    "b": T.rotate([0.6, 0, 0.8], 70),
    "c": T.translate([25, 2, 3]).rotate([0, 1, 0], 200),
}


def copies(**ways):
    group = {"type": "shapegroup", "ball": ball()}
    content = {"type": "scene", "group": group, "floor": floor(), "lamp": lamp()}
    content["sky"] = {"type": "constant", "radiance": 0.2}
    content["sensor"] = looking_at([0, 0, 0], [0, 0, 200], fov=22, size=48)
    for name, to_world in ways.items():
        content[name] = {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": to_world}
    return mi.load_dict(content, optimize=False)


def test_copies_share_samples_and_look_like_bodies_of_their_own():
    settings = {
        "sample_count": 2000,
        "sampling": "uniform",
        "direct": 1024,
        "max_depth": 2,
    }  # no virtual lights: their noise
    picture, state, spent = render(copies(**WAYS), **settings)
    assert len(state.sampled) == 1 and len(state.prototypes) == 1
    assert spent["samples"] == 3 * 2000
    balls = [ball(to_world=to_world) for to_world in WAYS.values()]
    sensor = looking_at([0, 0, 0], [0, 0, 200], fov=22, size=48)
    separate = scene(*balls, floor(), lamp(), light={"type": "constant", "radiance": 0.2}, sensor=sensor)
    expected, apart, spent = render(separate, **settings)
    assert len(apart.sampled) == 3 and spent["samples"] == 6000
    middle = np.s_[20:28]
    for columns in (np.s_[5:12], np.s_[20:28], np.s_[36:43]):
        one, other = picture[middle, columns], expected[middle, columns]
        assert one.mean(axis=(0, 1)) == pytest.approx(other.mean(axis=(0, 1)), rel=0.03)
        assert np.median(np.abs(one / other - 1)) < 0.05


def test_a_scaled_copy_has_samples_of_its_own():
    lit = copies(a=WAYS["a"], wide=T.translate([25, 0, 0]).scale([1, 0.5, 1]), c=WAYS["b"])
    _, state, _ = render(lit, spp=1, **{**FEW, "max_depth": 2})
    assert len(state.prototypes) == len(state.sampled) == 2
    assert sorted(len(prototype.bodies) for prototype in state.prototypes) == [1, 2]
    flat = next(each for each in state.sampled.values() if each.copies == 1)
    assert np.abs(flat.samples.p[:, 1]).max() == pytest.approx(RADIUS / 2, rel=0.02)
    assert flat.samples.p[:, 0].mean() == pytest.approx(25, abs=0.5)


@pytest.mark.parametrize("mode", ["adaptive", "two_pass", "cut", "exact"])
def test_each_side_of_an_open_surface_has_light_of_its_own(mode):
    """A sheet under one light above and another below: as with paths, on both sides."""
    sheet = {"type": "rectangle", "to_world": T.scale(6.0), "bsdf": translucent(material="marble")}
    lights = {
        "above": {"type": "directional", "direction": [0.3, 0, -1], "irradiance": rgb(2.0, 0.5, 1.0)},
        "below": {"type": "directional", "direction": [0, 0.6, 1], "irradiance": rgb(0.5, 2.0, 1.0)},
    }
    lit = scene(sheet, light=lights["above"], below=lights["below"])
    settings = {"sample_count": 1000, "sampling": "uniform", "max_depth": 2}
    points = np.random.default_rng(0).uniform(-5, 5, (200, 3)) * [1, 1, 0]
    paths = pellucid.prepare(lit, "two_pass", irradiance_paths=4, **settings)
    prepared = without_view(lit, mode=mode, indirect=0, **settings)
    for normal, brightest in ((1, 0), (-1, 1)):
        normals = np.full_like(points, [0, 0, normal])
        found, expected = prepared.exitance(points, normals=normals), paths.exitance(points, normals=normals)
        assert np.argmax(found.mean(axis=0)) == brightest
        assert found.mean(axis=0) == pytest.approx(expected.mean(axis=0), rel=0.02 if mode != "cut" else 0.06)
        assert np.median(np.abs(found / expected - 1)) < (0.03 if mode != "cut" else 0.1)


def test_a_texture_colours_the_light_that_enters():
    board = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [0.2, 0.3, 0.4]},
        "color1": {"type": "rgb", "value": [0.8, 0.7, 0.6]},
        "to_uv": mi.ScalarTransform3f().scale([2, 2]),
    }
    lit = room({"type": "sphere", "radius": RADIUS, "bsdf": translucent(reflectance=board, dmfp=1.0)})
    points, settings = points_around(), {"sample_count": 3000, "sampling": "uniform", "max_depth": 2}
    paths = pellucid.prepare(lit, "two_pass", irradiance_paths=256, **settings).exitance(points)
    for mode, typical in (("exact", 0.02), ("adaptive", 0.02), ("two_pass", 0.02)):
        found = without_view(lit, mode=mode, direct=1024, **settings).exitance(points)
        assert np.median(np.abs(found / paths - 1)) < typical
        assert found.mean(axis=0) == pytest.approx(paths.mean(axis=0), rel=0.015)
    assert np.ptp(paths[:, 0] / paths[:, 2]) > 0.5


# ------------------------------------------------------------------ what it costs


def test_a_body_that_is_not_in_view_costs_nothing():
    behind = ball(center=[40, 0, 400])  # behind the camera, and not in the way of the light
    sun = {"type": "directional", "direction": [0, -1, -1]}
    settings = {**FEW, "max_depth": 2}
    both, state, spent = render(scene(ball(), behind, light=sun), **settings)
    assert len(state.prototypes) == 2 and list(state.sampled) == [0]
    assert spent["samples"] == FEW["sample_count"]
    alone, _, other = render(scene(ball(), light=sun), **settings)
    assert spent["shadow rays"] == other["shadow rays"] > 0
    assert spent["receivers"] == other["receivers"] and np.array_equal(both, alone)
    nothing, empty, spent = render(
        scene(behind, sensor=looking_at([0, 0, 0], [0, 0, 100]), light={"type": "point", "position": [0, 0, 50]}), **FEW
    )
    assert not empty.sampled and spent["shadow rays"] == spent["light samples"] == 0
    assert nothing.max() == 0


def test_many_lights_need_few_rays():
    lit, points = room(), points_around(count=200)
    settings = {**FEW, "indirect": 6000}
    rays = {}
    for mode in ("adaptive", "two_pass"):
        with observing() as effort:
            pellucid.prepare(lit, "single_pass", mode=mode, **settings).exitance(points)
        spent = effort.counts
        assert spent["eye points"] == 200 and spent["samples"] == 2000 and spent["light samples"] > 4000
        assert set(effort.seconds) == {"samples", "lights", "exitance", "surfaces"}
        rays[mode] = spent["shadow rays"]
    # Where light is even it takes few; `exact` would take a ray for each pair.
    assert rays["two_pass"] < 0.1 * 2000 * spent["light samples"]
    assert rays["adaptive"] < 0.06 * 2000 * spent["light samples"]


def test_one_eye_point_a_pixel_and_body():
    sensor = looking_at([0, 0, 0], [0, 0, 200], fov=2, size=16)
    lit = scene(
        ball(specular_reflectance=0.0, alpha=0.0), light={"type": "point", "position": [0, 60, 60]}, sensor=sensor
    )
    one, _, few = render(lit, spp=1, max_depth=2, **{k: v for k, v in FEW.items() if k != "max_depth"})
    many, _, most = render(lit, spp=64, max_depth=2, **{k: v for k, v in FEW.items() if k != "max_depth"})
    assert few["eye points"] <= most["eye points"] <= 256
    assert most["eye points"] < 1.3 * few["eye points"]
    inside = np.s_[6:10, 6:10]
    assert many[inside].mean() == pytest.approx(one[inside].mean(), rel=0.06)


@pytest.mark.parametrize(("material", "least", "most"), [("none", 2.0, 3.0), ("plastic", 12.0, 40.0)])
def test_what_is_seen_by_way_of_another_surface_is_as_exact_as_it_counts(material, least, most):
    """In a mirror, twice the error of what is seen at once; in varnish, which reflects little, more."""
    mirror = {"type": "conductor", "material": "none"}
    varnish = {"type": "plastic", "diffuse_reflectance": 0.0, "nonlinear": False}
    surface = floor() | {"bsdf": mirror if material == "none" else varnish}
    sensor = looking_at([0, -5, 0], [0, 90, 90], fov=25, size=32)
    lit = scene(ball(specular_reflectance=0.0, alpha=0.0), surface, light={"type": "constant"}, sensor=sensor)
    _, state, _ = render(lit, spp=4, **FEW)
    tolerance = state.view_points.tolerance.numpy()
    indirect = tolerance[tolerance > 1]
    assert (tolerance >= 1).all() and len(indirect) > 20 and (tolerance == 1).sum() > 100
    assert indirect.max() <= 256 and least <= np.median(indirect) <= most


def test_two_bodies_in_one_pixel_are_two_eye_points():
    """A film of one pixel, half of which shows the flat face of a bright block and half that of a dark one."""
    bodies = [
        {"type": "cube", "to_world": T.translate([x, 0, 0]).scale(10), "bsdf": translucent(material=m)}
        for m, x in (("spectralon", -10.0), ("ketchup", 10.0))
    ]
    sensor = looking_at([0, 0, 0], [0, 0, 400], fov=1.0, size=1)
    picture, _, spent = render(scene(*bodies, sensor=sensor), spp=256, max_depth=2, sample_count=1000)
    assert spent["eye points"] == 2 and spent["samples"] == 2000
    assert 0.3 < picture.mean() < 1


def test_the_same_picture_bit_for_bit():
    lit = room()
    for mode in ("adaptive", "two_pass", "cut"):
        settings = {**FEW, "mode": mode, "direct": 64, "indirect": 64, "sample_count": 500}
        (one, *_), (two, *_) = (render(lit, spp=1, **settings) for _ in range(2))
        assert np.array_equal(one, two), mode


# ------------------------------------------------------------------ views


def two_bodies(**options):
    """A ball in view, and one behind the camera."""
    behind = ball(material="cream", center=[0, 0, 250])
    return scene(ball(), behind, floor(), lamp(), light={"type": "constant", "radiance": 0.2}, **options)


@pytest.mark.parametrize("mode", ["adaptive", "two_pass", "cut", "exact"])
def test_what_was_asked_before_does_not_matter(mode):
    """Both bodies in both orders, in shuffled chunks, before and after others, one of them out of view: equal bits."""
    points = np.concatenate([points_around(), points_around((0, 0, 250), seed=1)]).astype(np.float32)
    settings = {**FEW, "mode": mode, "direct": 64, "indirect": 64, "sample_count": 500}
    whole, backwards = (
        pellucid.prepare(two_bodies(), "single_pass", **settings).exitance(p) for p in (points, points[::-1])
    )
    assert np.array_equal(backwards[::-1], whole)
    other, order = (
        pellucid.prepare(two_bodies(), "single_pass", **settings),
        np.random.default_rng(1).permutation(len(points)),
    )
    for part in (order[:3], np.arange(700, 701), *np.array_split(order, 7)):
        assert np.array_equal(other.exitance(points[part]), whole[part])


def test_points_outside_the_view_have_the_error_that_is_said():
    """The back of a body in view, and one that is not: below 3 % for half of the points, below 12 % for 95 of 100.

    In view 80 of 100 errors are below `max_error`.
    """
    points = [points_around(), points_around((0, 0, 250), seed=1)]
    lit, settings = two_bodies(), {**FEW, "sample_count": 8000}
    exact, found = (
        [bright(pellucid.prepare(lit, "single_pass", mode=mode, **settings).exitance(p)) for p in points]
        for mode in ("exact", "adaptive")
    )
    for truth, value in zip(exact, found, strict=True):
        error = np.abs(value / truth - 1)
        assert np.median(error) < 0.03 and np.quantile(error, 0.95) < 0.12
    front = points[0][:, 2] > 3
    assert np.quantile(np.abs(found[0] / exact[0] - 1)[front], 0.8) < 0.02


def test_without_a_camera_all_is_known_as_well_as_is_asked():
    error = np.abs(
        bright(without_view(room(), **FEW).exitance(points_around()))
        / bright(without_view(room(), mode="exact", **FEW).exitance(points_around()))
        - 1
    )
    assert np.median(error) < 0.01 and np.quantile(error, 0.95) < 0.02


# ------------------------------------------------------------------ bad input


def message(**parameters):
    """Load an integrator that must fail, and return the line the user sees."""
    with pytest.raises(pellucid.PellucidError) as caught:
        load_scene({"type": "scene", "integrator": {"type": "pellucid_single_pass", **parameters}})
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"mode": "adaptve"}, ["adaptve", "did you mean 'adaptive'", "two_pass"]),
        ({"max_error": -0.1}, ["max_error", "-0.1"]),
        ({"max_error": 0.0}, ["max_error"]),
        ({"alternation": 0}, ["alternation"]),
        ({"alternation": 100}, ["alternation", "15"]),
        ({"max_cut": 100000}, ["max_cut", "16384"]),
        ({"alpha": -1.0}, ["alpha"]),
        ({"white": 0.0}, ["white"]),
        ({"direct": 0}, ["direct"]),
        ({"indirect": -1}, ["indirect"]),
        ({"first_rays": 0}, ["first_rays"]),
        ({"irradiance_paths": 16}, ["irradiance_paths"]),
        ({"translucent_passes": 1}, ["translucent_passes"]),
    ],
)
def test_settings_that_cannot_be(parameters, words):
    text = message(**parameters)
    for word in words:
        assert word in text


def test_a_scene_without_light_is_black_with_a_warning():
    dark = mi.load_dict({"type": "scene", "ball": ball(), "sensor": looking_at([0, 0, 0], [0, 0, 100])}, optimize=False)
    for mode in ("adaptive", "two_pass", "cut", "exact"):
        with pytest.warns(pellucid.PellucidWarning, match="no light"):
            picture, *_ = render(dark, mode=mode, **FEW)
        assert picture.max() == 0, mode


def test_an_emitter_that_no_points_can_stand_for_is_left_out_with_a_warning():
    projector = {
        "type": "projector",
        "irradiance": {"type": "rgb", "value": 1.0},
        "to_world": T.look_at([0, 50, 0], [0, 0, 0], [1, 0, 0]),
    }
    with pytest.warns(pellucid.PellucidWarning, match="left out"):
        picture, *_ = render(scene(ball(specular_reflectance=0.0), light=projector), max_depth=2, sample_count=500)
    assert picture.max() == 0


def test_small_bodies_have_even_samples():
    """There is no room for 5,000 samples a mean free path apart on a ball of 10 mm: darts that are thrown all the same lie anyhow."""
    bodies = pellucid.prepare(scene(ball()), "two_pass", sample_count=50, irradiance_paths=1).integrator.prepared.bodies
    prototypes, _ = find_prototypes([bodies[0].body])
    with observing() as effort:
        samples = sample_prototype(prototypes[0], SpreadParameters(), 0).samples
    assert samples.count == FEWEST_SAMPLES and effort.counts["violations"] == 0


@pytest.mark.parametrize("samples, left", [(5, 20), (8, 34), (13, 100), (1000, 100)])
def test_few_eye_points_a_sample_decide_how_well_light_is_measured(samples, left):
    number = dr.arange(mi.Float, 100)
    eyes = enough_eyes(EyePoints(mi.Point3f(number), mi.Normal3f(0, 0, number), mi.UInt32(number), number), samples)
    step = 100 // left + (100 % left > 0)
    np.testing.assert_array_equal(eyes.tolerance.numpy(), np.arange(0, 100, step))


def test_full_cuts_are_told_once():
    settings = FEW | {"mode": "cut", "max_cut": 4}
    with pytest.warns(pellucid.PellucidWarning, match="Many cuts are full") as told:
        mi.render(scene(ball()), integrator=mi.load_dict({"type": "pellucid_single_pass", **settings}), spp=1)
    assert len([w for w in told if "Many cuts" in str(w.message)]) == 1
