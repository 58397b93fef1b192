"""Bad input of the plug-ins: one clear line each, or a sensible picture."""

import math
import re
import warnings
from dataclasses import fields

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.methods import METHODS, method_class
from pellucid.scenes.loading import load_scene
from worlds.balls import T, looking_at, scene, translucent


def message(content) -> str:
    """Load a scene dictionary that must fail, and return the line the user sees."""
    with pytest.raises(pellucid.PellucidError) as caught:
        load_scene({"type": "scene", **content})
    assert "\n" not in str(caught.value)
    return str(caught.value)


def ball(**parameters):
    return {"ball": {"type": "sphere", "bsdf": {"type": "pellucid_translucent", **parameters}}}


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"material": "marbel"}, ["marbel", "marble"]),
        ({"sigma_a": -1.0, "sigma_s_prime": 2.0}, ["sigma_a", "negative"]),
        ({"sigma_a": 0.1, "sigma_s_prime": {"type": "rgb", "value": [1.0, 0.0, 1.0]}}, ["sigma_s_prime", "green"]),
        ({"sigma_a": 0.1}, ["sigma_s_prime", "both"]),
        ({"material": "skin1", "sigma_a": 0.1, "sigma_s_prime": 1.0}, ["keep one"]),
        ({"reflectance": 0.5}, ["dmfp"]),
        ({"reflectance": 1.5, "dmfp": 1.0}, ["reflectance"]),
        ({"reflectance": 0.5, "dmfp": 0.0}, ["dmfp"]),
        ({"material": "marble", "scale": 0.0}, ["scale", "millimetres"]),
        ({"material": "marble", "alpha": 3.0}, ["alpha"]),
        ({"material": "marble", "eta": 0.5}, ["eta"]),
        ({"material": "marble", "g": 1.0}, ["g = 1"]),
        ({"material": "marble", "rougness": 0.1}, ["rougness"]),
        ({"sigma_a": "1, 2", "sigma_s_prime": 1.0}, ["2 values"]),
        ({"reflectance": {"type": "bitmap", "filename": "nowhere.png"}, "dmfp": 1.0}, ["nowhere.png"]),
    ],
)
def test_materials_that_cannot_be(parameters, words):
    text = message(ball(**parameters))
    for word in words:
        assert word in text


# ------------------------------------------------------------------ the parameters of every method


def parameters_of(method):
    """The parameters of a method: name and default."""
    return {field.name: field.default for field in fields(method_class(method)) if field.init}


def wrong_values(default):
    """What a parameter with such a default can never be."""
    if isinstance(default, bool):
        return ["yes", 2, 1.0]
    if isinstance(default, str):
        return ["no such thing", 3, True]
    wrong = [float("nan"), float("inf"), -float("inf"), -3, "many", True, mi.ScalarColor3f(1, 2, 3)]
    return wrong if isinstance(default, float) else [*wrong, 2.5]


WRONG = [
    (method, name, value)
    for method in METHODS
    for name, default in parameters_of(method).items()
    for value in wrong_values(default)
]


@pytest.mark.parametrize(("method", "name", "value"), WRONG, ids=lambda v: str(v))
def test_a_parameter_that_cannot_be_is_refused_in_one_line(method, name, value):
    """The line names the parameter, says what it may be, and shows what was found."""
    text = message({"integrator": {"type": f"pellucid_{method}", name: value}})
    assert re.search(rf"\b{name}\b", text)
    assert str(value) in text or ((value in (-math.inf, math.inf) or value != value) and "NaN or infinite" in text)
    assert re.search(r"\b(is|must be|knows)\b", text)


@pytest.mark.parametrize("method", METHODS)
def test_an_unknown_parameter_is_refused_with_the_nearest_known_one(method):
    for misspelt, meant in (("max_detph", "max_depth"), ("irradiance_detph", "irradiance_depth")):
        text = message({"integrator": {"type": f"pellucid_{method}", misspelt: 4}})
        assert misspelt in text and f"did you mean '{meant}'" in text
    assert "quality" in message({"integrator": {"type": f"pellucid_{method}", "quality": "high"}})


@pytest.mark.parametrize("method", METHODS)
def test_every_parameter_may_be_given_its_default(method):
    defaults = {name: value for name, value in parameters_of(method).items() if value is not None}
    integrator = mi.load_dict({"type": f"pellucid_{method}", **defaults})
    again = mi.load_dict({"type": f"pellucid_{method}", **integrator.method.parameters()})
    assert again.method.parameters() == integrator.method.parameters() == defaults


@pytest.mark.parametrize("method", METHODS)
def test_whole_numbers_may_be_written_as_floats_and_numbers_as_whole_ones(method):
    """XML files tell ``<float>`` from ``<integer>``; 3 and 3.0 are one number."""
    for name, default in parameters_of(method).items():
        if isinstance(default, (int, float)) and not isinstance(default, bool):
            value = 2048 if isinstance(default, int) else 2
            other = float(value) if isinstance(default, int) else int(value)
            if name in ("alternation", "pairs"):
                value, other = 4, 4.0
            found = [
                mi.load_dict({"type": f"pellucid_{method}", name: v}).method.parameters()[name] for v in (value, other)
            ]
            assert found[0] == found[1] == value and type(found[0]) is type(found[1]) is type(default)


@pytest.mark.parametrize("method", METHODS)
def test_the_depths_know_no_limit(method):
    integrator = mi.load_dict({"type": f"pellucid_{method}", "max_depth": -1, "irradiance_depth": -1})
    assert integrator.method.parameters()["max_depth"] == -1


@pytest.mark.parametrize(
    ("method", "parameters", "word"),
    [
        ("two_pass", {"sampling": "poison"}, "did you mean 'poisson'"),
        ("two_pass", {"aovs": "exitanse"}, "did you mean 'exitance'"),
        ("single_pass", {"mode": "adaptiv"}, "did you mean 'adaptive'"),
        ("single_pass", {"aovs": "irradiance"}, "two_pass"),
        ("single_pass", {"max_error": 0.0}, "max_error"),
        ("single_pass", {"cache_entries": 5000}, "power of two"),
        ("single_pass", {"cache_entries": 1 << 40}, "1024 to 2^30"),
        ("single_pass", {"max_cut": 1 << 20}, "max_cut"),
        ("single_pass", {"alternation": 100}, "alternation"),
        ("texture_space", {"resolution": 1000}, "power of two"),
        ("texture_space", {"order": "mipmaps"}, "did you mean 'mipmap'"),
        ("texture_space", {"sampling": "poisson"}, "sampling"),
        ("sampled", {"sample_count": 100}, "sample_count"),
    ],
)
def test_settings_that_cannot_be(method, parameters, word):
    assert word in message({"integrator": {"type": f"pellucid_{method}", **parameters}})


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "settings", [{"seed": -1}, {"max_depth": "deep"}, {"max_detph": 3}, {"rr_depth": float("nan")}]
)
def test_prepare_refuses_settings_in_one_line(method, settings):
    with pytest.raises(pellucid.PellucidError) as caught:
        pellucid.prepare(scene({"type": "sphere", "bsdf": translucent()}), method, **settings)
    (name,) = settings
    assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("method", ["two-pass", "single_passs"])
def test_an_unknown_method_is_refused_with_the_nearest_known_one(method):
    with pytest.raises(pellucid.PellucidError, match=r"did you mean '(two|single)_pass'"):
        pellucid.prepare(scene({"type": "sphere", "bsdf": translucent()}), method)


# ------------------------------------------------------------------ what is asked of a prepared scene


@pytest.fixture(scope="module", params=METHODS)
def prepared(request):
    content = scene(
        {"type": "sphere", "id": "one", "radius": 5.0, "bsdf": translucent(material="cream")},
        {"type": "sphere", "id": "two", "radius": 5.0, "center": [20, 0, 0], "bsdf": translucent(material="cream")},
    )
    return pellucid.prepare(content, request.param, **SMALL[request.param])


SMALL = {
    "two_pass": {"sample_count": 200, "irradiance_paths": 4},
    "exact": {"sample_count": 200, "irradiance_paths": 4},
    "sampled": {},
    "texture_space": {"sample_count": 200, "resolution": 32, "irradiance_paths": 4},
    "single_pass": {"sample_count": 200, "direct": 32, "indirect": 0},
}
"""Of each method, as little as can be."""


@pytest.mark.parametrize(
    ("points", "more", "word"),
    [
        ([[1.0, 2.0]], {}, "points"),
        ([[float("nan"), 0, 0]], {}, "points"),
        ([[5.0, 0, 0]], {"normals": [[1, 0]]}, "normals"),
        ([[5.0, 0, 0]], {"normals": [[1, 0, 0], [0, 1, 0]]}, "normals"),
        ([[5.0, 0, 0]], {"body": "onn"}, "did you mean 'one'"),
        ([[5.0, 0, 0]], {"body": 7}, "7"),
        ([[5.0, 0, 0]], {"body": -1}, "-1"),
        ([[5.0, 0, 0]], {"body": True}, "True"),
    ],
)
def test_questions_that_cannot_be_answered(prepared, points, more, word):
    with pytest.raises(pellucid.PellucidError) as caught:
        prepared.exitance(points, **more)
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_no_points_have_no_exitance(prepared):
    assert prepared.exitance(np.zeros((0, 3))).shape == (0, 3)


# ------------------------------------------------------------------ scenes


def render(content, **settings):
    integrator = mi.load_dict({"type": "pellucid_two_pass", "irradiance_paths": 4, **settings})
    return np.array(integrator.render(content, spp=4), dtype=float)


def test_a_scene_without_translucent_objects():
    with pytest.raises(pellucid.PellucidError, match="pellucid_translucent"):
        render(scene({"type": "sphere"}))


def test_a_scene_without_light_is_black_with_a_warning():
    dark = mi.load_dict(
        {"type": "scene", **ball(material="cream"), "sensor": looking_at([0, 0, 0], [0, 0, 9])}, optimize=False
    )
    with pytest.warns(pellucid.PellucidWarning, match="no light"):
        assert render(dark, sample_count=500).max() == 0


def test_a_scene_a_million_times_too_large():
    with pytest.raises(pellucid.PellucidError, match=r"samples.*mm"):
        render(scene({"type": "sphere", "radius": 1e6, "bsdf": translucent(material="marble")}))


def test_without_absorption():
    image = render(scene({"type": "sphere", "radius": 9.0, "bsdf": translucent(sigma_a=0.0, sigma_s_prime=2.0)}))
    assert np.isfinite(image).all() and 0.7 < image[12, 12].mean() < 1.02


@pytest.mark.parametrize("value", [-0.5, 3.0])
def test_a_texture_that_no_surface_reflects_is_refused(value):
    """It gave a negative picture, or was said to be of a wrong size."""
    texels = np.full((4, 4, 3), 0.5, np.float32)
    texels[0] = value
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True}
    with pytest.raises(RuntimeError, match=r"texture of the reflectance has values from"):
        mi.load_dict({"type": "pellucid_translucent", "reflectance": texture, "dmfp": 1.0})


def test_where_diffusion_does_not_hold_there_is_a_warning():
    with pytest.warns(pellucid.PellucidWarning, match="skin1"):
        bsdf = translucent(material="skin1", profile="dipole")
        render(scene({"type": "sphere", "radius": 9.0, "bsdf": bsdf}), sample_count=500)


def test_shapes_of_one_body_with_different_media():
    shapes = [
        {"type": "sphere", "center": [x, 0, 0], "bsdf": translucent(material=m, body="one")}
        for x, m in ((0, "cream"), (3, "skin1"))
    ]
    with pytest.raises(pellucid.PellucidError, match="one"):
        render(scene(*shapes))


def test_a_blend_with_another_material_is_refused_and_wrappers_are_not():
    inner = translucent(material="cream")
    blend = {"type": "blendbsdf", "weight": 0.5, "a": {"type": "diffuse"}, "b": inner}
    with pytest.raises(pellucid.PellucidError, match="blends"):
        render(scene({"type": "sphere", "bsdf": blend}))
    plain = render(scene({"type": "sphere", "radius": 8.0, "bsdf": inner}), sample_count=500)
    wrapped = render(
        scene({"type": "sphere", "radius": 8.0, "bsdf": {"type": "twosided", "a": inner}}), sample_count=500
    )
    assert wrapped == pytest.approx(plain, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "rectangle", "disk", "cube"])
def test_every_shape_of_mitsuba_can_be_translucent(shape):
    content = {
        "type": shape,
        "to_world": T.scale(8.0).rotate([1, 0, 0], 20),
        "bsdf": translucent(material="cream"),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if shape in ("rectangle", "disk", "cylinder"):
            warnings.filterwarnings("ignore", "The body '.*' is open or has no thickness")
        image = render(scene(content), sample_count=500)
    assert np.isfinite(image).all() and image[12, 12].min() > 0.5


@pytest.mark.parametrize("depths", [{"max_depth": 1}, {"max_depth": -1}, {"max_depth": 2, "irradiance_depth": -1}])
def test_depths_at_the_ends_of_their_range(depths):
    lit = scene(
        {"type": "sphere", "radius": 8.0, "bsdf": translucent(material="cream", alpha=0.0)},
        sensor=looking_at([0, 0, 0], [0, 0, 99], fov=3),
    )
    image = render(lit, sample_count=500, **depths)
    assert (image.max() == 0) if depths["max_depth"] == 1 else (image.min() > 0.5)


def test_single_scattering_is_not_added_to_a_profile_that_has_it():
    with pytest.warns(UserWarning, match="single_scattering is left out"):
        material = mi.load_dict(translucent(material="marble", single_scattering=True))
    assert not material.single_scattering
    assert mi.load_dict(translucent(material="marble", profile="dipole", single_scattering=True)).single_scattering


def test_an_unknown_profile():
    with pytest.raises(RuntimeError, match="no profile 'tripole'; choose one of: tabulated, curved, dipole"):
        mi.load_dict(translucent(profile="tripole"))


@pytest.mark.parametrize("method", ["two_pass", "single_pass"])
def test_very_few_samples_are_told(method):
    ball = {"type": "sphere", "radius": 10.0, "bsdf": {"type": "pellucid_translucent"}}
    lit = mi.load_dict({"type": "scene", "ball": ball, "sky": {"type": "constant"}})
    with pytest.warns(pellucid.PellucidWarning, match="gets 3 surface samples: with fewer than 20"):
        pellucid.prepare(lit, method, sample_count=3).exitance([[0, 0, 10]])
