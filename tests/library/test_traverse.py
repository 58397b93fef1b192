"""Every parameter of a translucent material can be changed after ``mi.traverse``: the scene is then like a fresh one.

Values are such that 32 bits hold them: Mitsuba's parameters have no more.
"""

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.errors import MediumError
from pellucid.model.medium import Medium

pytestmark = pytest.mark.filterwarnings("ignore::pellucid.errors.PellucidWarning")

POINTS = np.array([[0, 0, 1], [0, 1, 0], [0.6, 0, 0.8]], np.float32)
COEFFICIENTS = {"sigma_a": [0.0625, 0.125, 0.25], "sigma_s_prime": [1.0, 1.5, 2.0]}
REFLECTANCE = {"reflectance": [0.75, 0.5, 0.25], "dmfp": [0.5, 0.25, 0.125]}
SURFACE = {"alpha": 0.25, "specular_reflectance": 0.5}
CHANGES = [
    (way, {name: value})
    for way in (COEFFICIENTS, REFLECTANCE)
    for name, value in {
        "sigma_a": [0.5, 0.25, 0.125],
        "sigma_s_prime": [3.0, 2.0, 1.0],
        "reflectance": [0.125, 0.25, 0.875],
        "dmfp": [0.25, 0.5, 0.75],
        "eta": 1.5,
        "scale": 2.0,
        "alpha": 0.5,
        "specular_reflectance": 0.25,
    }.items()
    if name in way or name not in COEFFICIENTS | REFLECTANCE
]


def build(sided=False, **bsdf):
    bsdf = {"type": "pellucid_translucent"} | {k: color(v) for k, v in bsdf.items()}
    return mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": {"type": "twosided", "nested": bsdf} if sided else bsdf},
            "light": {"type": "envmap", "bitmap": mi.Bitmap(np.array([[[1, 2, 3.0], [3, 2, 1]]] * 3, np.float32))},
            "integrator": {"type": "pellucid_two_pass", "sample_count": 200, "irradiance_paths": 4},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
        },
        optimize=False,
    )


def color(value):
    return {"type": "rgb", "value": value} if isinstance(value, list) else value


def exitance(scene):
    return pellucid.prepare(scene, sample_count=200, irradiance_paths=4).exitance(POINTS, normals=POINTS)


def picture(scene):
    return mi.render(scene, spp=2).numpy()


def assert_same_picture(one, other):
    """Up to the last bits, which depend on the order in which threads add to the film."""
    np.testing.assert_allclose(one, other, rtol=1e-5)


def change(scene, sided=False, **values):
    params = mi.traverse(scene)
    for name, value in values.items():
        key = f"ball.bsdf.{'brdf_0.' if sided else ''}{name}"
        kind = mi.Color3f if isinstance(value, list) else mi.Float
        assert type(params[key]) is kind
        params[key] = kind(value)
    params.update()


@pytest.mark.parametrize("way, new", CHANGES, ids=[f"{next(iter(new))} of {next(iter(way))}" for way, new in CHANGES])
def test_a_changed_scene_is_like_a_fresh_one(way, new):
    sided = way is REFLECTANCE
    scene, fresh = build(sided, **way, **SURFACE), build(sided, **(way | SURFACE | new))
    before, before_picture = exitance(scene), picture(scene)
    change(scene, sided, **new)
    after, after_picture = exitance(scene), picture(scene)
    np.testing.assert_array_equal(after, exitance(fresh))
    assert_same_picture(after_picture, picture(fresh))
    assert not np.allclose(after_picture, before_picture, rtol=1e-3)
    assert np.array_equal(after, before) == (new.keys() <= SURFACE.keys())


@pytest.mark.parametrize("way, other", [(COEFFICIENTS, REFLECTANCE), (REFLECTANCE, COEFFICIENTS)])
def test_what_was_changed_last_describes_the_medium(way, other):
    scene = build(**way)
    change(scene, **other)
    change(scene, eta=1.5)
    np.testing.assert_array_equal(exitance(scene), exitance(build(**other, eta=1.5)))


def test_all_parameters_show_what_the_medium_is():
    params = mi.traverse(build(material="marble", scale=10.0))
    marble = Medium.from_preset("marble")
    expected = {
        "sigma_a": marble.sigma_a,
        "sigma_s_prime": marble.sigma_s_prime,
        "reflectance": marble.total_diffuse_reflectance,
        "dmfp": marble.dmfp,
        "eta": 1.5,
        "scale": 10,
        "alpha": 0.1,
        "specular_reflectance": 1,
    }
    shown = {key.removeprefix("ball.bsdf."): params[key] for key in params.keys() if key.startswith("ball.bsdf.")}  # noqa: SIM118
    assert shown.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(np.squeeze(shown[name].numpy()), np.float32(value))
    change(scene := build(**COEFFICIENTS), **REFLECTANCE)
    medium = Medium.from_reflectance(**REFLECTANCE)
    shown = mi.traverse(scene)["ball.bsdf.sigma_a"].numpy().ravel()
    np.testing.assert_array_equal(shown, np.float32(medium.sigma_a))


def test_what_was_given_is_shown_as_it_was_given():
    scene = build(reflectance=[0.0, 0.5, 1 - 2**-20], dmfp=0.5)
    for eta in (1.25, 1.5):
        change(scene, eta=eta)
        shown = mi.traverse(scene)["ball.bsdf.reflectance"].numpy().ravel()
        np.testing.assert_array_equal(shown, np.float32([0, 0.5, 1 - 2**-20]))


def texture(value):
    data = np.full((2, 2, 3), 0.25, np.float32)
    data[0] = value
    return {"type": "bitmap", "data": mi.TensorXf(data), "raw": True, "filter_type": "nearest"}


@pytest.mark.parametrize("sided", [False, True], ids=["one side", "twosided"])
def test_a_texture_of_the_reflectance_is_changed_too(sided):
    scene = build(sided, reflectance=texture(0.75), dmfp=0.5)
    params = mi.traverse(scene)
    keys = {key.rpartition("bsdf.")[2].removeprefix("brdf_0.") for key in params.keys() if "bsdf" in key}  # noqa: SIM118
    assert "reflectance.data" in keys and not keys & {"sigma_a", "sigma_s_prime", "reflectance"}
    key = next(key for key in params.keys() if key.endswith("reflectance.data"))  # noqa: SIM118
    params[key][:] = 0.625
    params.update()
    change(scene, sided, dmfp=[0.25, 0.5, 0.75])
    data = mi.TensorXf(np.full((2, 2, 3), 0.625, np.float32))
    fresh = build(sided, reflectance=texture(0.75) | {"data": data}, dmfp=[0.25, 0.5, 0.75])
    np.testing.assert_array_equal(exitance(scene), exitance(fresh))
    assert_same_picture(picture(scene), picture(fresh))


def test_a_roughness_of_zero_and_back_changes_the_lobes():
    scene = build(**COEFFICIENTS, alpha=0.0)
    change(scene, alpha=0.5)
    assert_same_picture(picture(scene), picture(build(**COEFFICIENTS, alpha=0.5)))
    change(scene, alpha=0.0)
    assert_same_picture(picture(scene), picture(build(**COEFFICIENTS, alpha=0.0)))


@pytest.mark.parametrize(
    "new, said",
    [
        ({"sigma_a": [-1.0, 0.0, 0.0]}, "sigma_a = -1 in the red channel"),
        ({"alpha": 2.0}, "alpha.*between 0 and 1; found 2"),
        ({"sigma_a": [0.5] * 3, "dmfp": [0.5] * 3}, "dmfp, sigma_a were changed at once"),
        ({"scale": 0.0}, "scale = 0"),
        ({"eta": 9.0}, "eta = 9"),
    ],
)
def test_what_cannot_be_is_refused_until_it_is_changed_back(new, said):
    scene = build(**COEFFICIENTS)
    with pytest.raises(MediumError, match=said):
        change(scene, **new)
    with pytest.raises(MediumError, match=said):
        change(scene, specular_reflectance=0.125)


def test_one_value_is_asked_for():
    params = mi.traverse(build(**COEFFICIENTS))
    params["ball.bsdf.alpha"] = mi.Float(0.1, 0.2)
    with pytest.raises(MediumError, match="alpha was given an array of shape"):
        params.update()
