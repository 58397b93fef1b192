"""Media that are found from pictures of them."""

import functools
import json
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from scipy.optimize import least_squares

import pellucid
from pellucid.errors import PellucidError, PellucidWarning
from pellucid.fitting.fit import EXPOSURES
from pellucid.fitting.medium_fit import Problem, warn_of_untold
from pellucid.fitting.photos import deviation, read_photo
from pellucid.fitting.views import HUBER, Views
from pellucid.methods.material import COEFFICIENTS
from pellucid.model.medium import Medium

TRUE = {"sigma_a": [0.05, 0.1, 0.2], "sigma_s_prime": [3.0, 4.0, 5.0]}
START = {"sigma_a": [0.1, 0.1, 0.1], "sigma_s_prime": [4.0, 4.0, 4.0]}
NEAR = {"sigma_a": [0.06, 0.08, 0.24], "sigma_s_prime": [3.3, 3.6, 5.5]}
NEARER = {"sigma_a": [0.055, 0.09, 0.22], "sigma_s_prime": [3.15, 3.8, 5.25]}
SIZE = (60, 45)
QUICK = {"sample_count": 1000, "irradiance_paths": 64, "sampling": "uniform"}


def build(profile="tabulated", **medium):
    bsdf = {"type": "pellucid_translucent", "eta": 1.4, "alpha": 0.3, "profile": profile}
    bsdf |= {name: {"type": "rgb", "value": value} for name, value in medium.items()}

    def camera(x, y):
        return {
            "type": "perspective",
            "fov": 35,
            "to_world": mi.ScalarTransform4f().look_at([x, y, 3], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}},
        }

    return mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": bsdf},
            "lamp": {"type": "point", "position": [3, 0, 3], "intensity": {"type": "rgb", "value": [30.0, 30.0, 30.0]}},
            "front": camera(3, 0),
            "side": camera(0, 3),
        },
        optimize=False,
    )


@functools.cache
def photos(profile, sample_count=6000):
    """Pictures from other samples, with other random numbers."""
    scene = build(profile, **TRUE)
    integrator = mi.load_dict(
        {"type": "pellucid_two_pass", "seed": 9, "sample_count": sample_count, "irradiance_paths": 128}
    )
    integrator.prepared = integrator.prepare_scene(scene)
    return [mi.render(scene, sensor=k, integrator=integrator, spp=16, seed=50 + k).numpy() for k in range(2)]


@pytest.mark.parametrize(
    "profile, start, work",
    [
        ("tabulated", START, {"sample_count": 4000, "irradiance_paths": 128, "spp": 16}),
        ("curved", NEARER, {"sample_count": 2500, "irradiance_paths": 64, "spp": 4}),
    ],
)
def test_coefficients_are_found_within_two_percent(tmp_path, profile, start, work):
    found = pellucid.fit(build(profile, **start), photos(profile), **work)
    for name, true in TRUE.items():
        np.testing.assert_allclose(getattr(found.medium, name), true, rtol=0.02)
    found.write(tmp_path / "ball.json")
    bsdf = mi.load_dict({"type": "pellucid_translucent", "material": str(tmp_path / "ball.json")})
    assert bsdf.medium == found.medium
    assert json.loads((tmp_path / "ball.json").read_text())["fit"]["condition_number"] == found.condition_number


@pytest.fixture(scope="module")
def too_bright():
    """Photos whose exposure is 1.3 times that of the scene."""
    return [1.3 * photo for photo in photos("tabulated")]


def test_reflectance_and_exposure_are_found_with_a_warning(too_bright):
    """A brighter photo and a body that absorbs less look alike."""
    with pytest.warns(
        PellucidWarning, match="condition number.*; with the exposure unknown, a dark photo and an absorb"
    ):
        found = pellucid.fit(build(**NEAR), too_bright, parameters="reflectance", exposure="shared", spp=4, **QUICK)
    np.testing.assert_allclose(found.exposure, 1.3, rtol=0.02)
    true = Medium(TRUE["sigma_s_prime"], TRUE["sigma_a"], eta=1.4)
    np.testing.assert_allclose(found.medium.total_diffuse_reflectance, true.total_diffuse_reflectance, rtol=0.04)
    np.testing.assert_allclose(found.medium.dmfp, true.dmfp, rtol=0.04)
    np.testing.assert_allclose(found.values[3:6], found.medium.dmfp, rtol=1e-5)


@pytest.mark.parametrize("exposure", EXPOSURES)
def test_the_residuals_change_as_their_jacobian_says(exposure):
    """With every exposure: known, one for each photo, or one for all."""
    problem = Problem(Views(build(**NEAR), photos("tabulated", 100), None, False, 1, QUICK), COEFFICIENTS, exposure)
    theta = problem.start()
    assert len(theta) == 6 + {"known": 0, "free": 2, "shared": 1}[exposure]
    step = 0.02 * np.cos(np.arange(len(theta)))
    change = problem.jacobian(theta) @ step
    found = (problem.residuals(theta + step) - problem.residuals(theta - step)) / 2
    assert np.linalg.norm(found - change) < 0.05 * np.linalg.norm(found)


@pytest.mark.parametrize(
    "reflectance, pixel, extent, said",
    [
        (0.5, 2.0, 9.0, "1 mm, is less than a pixel, 2 mm"),
        (0.5, 0.1, 0.5, "1 mm, is longer than the body"),
        (0.01, 0.1, 9.0, "0.01, is less than the 0.017 of the surface"),
    ],
)
def test_what_photos_cannot_tell_is_warned_of(reflectance, pixel, extent, said):
    body = SimpleNamespace(bsdf=SimpleNamespace(specular=1.0))
    with pytest.warns(PellucidWarning, match=said):
        warn_of_untold(
            Medium.from_reflectance(reflectance, 1.0), SimpleNamespace(pixel=pixel, extent=extent, body=body)
        )


def test_noise_of_a_photo_is_measured():
    """By how pixels differ from their neighbours, whatever a few highlights do; not below a hundredth."""
    rng = np.random.default_rng(0)
    slope = np.linspace(1, 2, 60)[:, None, None] * np.ones((60, 60, 3))
    photo = slope * (1 + rng.normal(size=slope.shape) * [0.2, 0.05, 0.0])
    photo[::20, ::20] = 30
    found = np.median(deviation(photo, np.ones((60, 60), bool)) / slope, axis=(0, 1))
    np.testing.assert_allclose(found, [0.2, 0.05, 0.01], rtol=0.15)


def test_few_photons_do_not_make_a_photo_darker():
    """Where hardly any arrive, most pixels and all their neighbours may be black: they are no surer than others."""
    expected = np.geomspace(0.2, 10, 60)[:, None, None] * np.ones((60, 60, 3))
    photo = np.random.default_rng(0).poisson(expected).astype(float)
    weight = 1 / deviation(photo, np.ones((60, 60), bool))
    found = least_squares(lambda k: ((k * expected - photo) * weight).ravel(), 1.0, loss="huber", f_scale=HUBER)
    assert found.x[0] == pytest.approx(1, rel=0.02)


def textured(data, size=(32, 24)):
    """A ball whose reflectance is a bitmap, seen from two sides."""
    reflectance = {"type": "bitmap", "data": mi.TensorXf(data), "raw": True}
    views = {
        f"view_{k}": {
            "type": "perspective",
            "fov": 35,
            "to_world": mi.ScalarTransform4f().look_at(origin, [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}},
        }
        for k, origin in enumerate([[3, 0, 2], [-2, 3, 2]])
    }
    bsdf = {"type": "pellucid_translucent", "eta": 1.4, "alpha": 0.3, "reflectance": reflectance, "dmfp": 0.15}
    return mi.load_dict(
        {"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}, "sky": {"type": "constant"}, **views},
        optimize=False,
    )


def test_a_texture_is_found_where_photos_tell_of_it(tmp_path):
    true = np.random.default_rng(0).uniform(0.3, 0.8, (2, 4, 3)).astype(np.float32)
    scene = textured(true)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "seed": 9, "sample_count": 3000, "irradiance_paths": 64})
    taken = [mi.render(scene, sensor=k, integrator=integrator, spp=16, seed=50 + k).numpy() for k in range(2)]
    begin = textured(np.full_like(true, 0.5))
    found = pellucid.fit(
        begin, taken, parameters="texture", sample_count=1500, irradiance_paths=32, spp=4, max_evaluations=20
    )
    error = (found.texture - true)[found.told]
    assert 0.4 < found.told.mean() < 1
    assert np.sqrt((error**2).mean()) < 0.03, np.sqrt((error**2).mean())
    found.write(tmp_path / "ball.json")
    bsdf = mi.load_dict({"type": "pellucid_translucent", "material": str(tmp_path / "ball.json")})
    np.testing.assert_allclose(mi.traverse(bsdf)["reflectance.data"].numpy(), found.texture, rtol=1e-3)
    np.testing.assert_allclose(bsdf.medium.dmfp, 0.15)
    assert bsdf.medium.eta == pytest.approx(1.4)


@pytest.mark.parametrize(
    "given, said",
    [
        ({"parameters": "texture"}, "give the BSDF a reflectance of type bitmap"),
        ({"parameters": "texture", "exposure": "shared"}, "A texture is fitted with a known exposure"),
        ({"parameters": "colour"}, "parameters is one of coefficients, reflectance, texture; found 'colour'"),
    ],
)
def test_a_texture_that_cannot_be_fitted_is_refused(given, said):
    with pytest.raises(PellucidError, match=said):
        pellucid.fit(build(**START), [np.ones((45, 60, 3))], **given)


def test_parameters_of_a_medium_with_a_texture_are_refused():
    with pytest.raises(PellucidError, match="The reflectance is a texture: fit the texture"):
        pellucid.fit(textured(np.full((2, 2, 3), 0.5, np.float32)), [np.ones((24, 32, 3))])


def test_a_curved_photo_is_refused_unless_it_is_to_be_linearised(tmp_path):
    grey = mi.Bitmap(np.full((SIZE[1], SIZE[0], 3), 188, np.uint8))
    grey.write(str(tmp_path / "grey.png"))
    with pytest.raises(PellucidError, match=r"8 bits.*linearise"):
        pellucid.fit(build(**START), [tmp_path / "grey.png"])
    np.testing.assert_allclose(read_photo(tmp_path / "grey.png", True), 0.5, atol=0.01)


@pytest.mark.parametrize(
    "given, said",
    [
        ({"photos": [np.ones((3, 4, 3))]}, "Photo 0 has 4x3 pixels and its camera 60x45"),
        ({"photos": [np.ones((45, 60, 3))] * 3}, "There are 3 photos and 2 cameras"),
        ({"photos": [np.ones((45, 60, 3))], "masks": [np.zeros((45, 60))]}, "No pixel of the photos is left"),
        (
            {"photos": [np.ones((45, 60, 3))], "masks": [np.ones((22, 30))]},
            "Mask 0 has 30x22 pixels and its photo 60x45",
        ),
        ({"photos": [np.zeros((45, 60, 3))]}, "Photo 0 is black"),
        ({"photos": [np.full((45, 60, 3), [1.0, 1.0, -0.5])]}, "Photo 0 is black, or below zero, in a channel"),
        (
            {"photos": [np.ones((45, 60, 3))], "exposure": "auto"},
            "exposure is one of known, free, shared; found 'auto'",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(given, said):
    with pytest.raises(PellucidError, match=said):
        pellucid.fit(build(**START), **given)


def test_a_file_that_is_no_material_is_refused(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(RuntimeError, match="no material file of pellucid fit"):
        mi.load_dict({"type": "pellucid_translucent", "material": str(tmp_path / "x.json")})


def test_a_photo_may_have_layers(tmp_path):
    """As pictures of the command line do: the picture itself comes first."""
    channels = np.random.default_rng(0).random((4, 5, 6), np.float32)
    names = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B"]
    mi.Bitmap(channels, channel_names=names).write(str(tmp_path / "photo.exr"))
    assert np.array_equal(read_photo(tmp_path / "photo.exr", False), channels[:, :, :3])
