"""Bad input of the plug-ins: one clear line each, or a sensible picture."""

import sys
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.scenes.loading import load_scene

sys.path.insert(0, str(Path(__file__).parent))
from worlds.balls import looking_at, scene, translucent


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


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"max_error": -1.0}, "max_error"),
        ({"sampling": "poison"}, "poisson"),
        ({"sample_count": -5}, "sample_count"),
        ({"aovs": "exitanse"}, "exitance"),
        ({"irradiance_paths": -1}, "irradiance_paths"),
        ({"max_erorr": 0.1}, "max_erorr"),
    ],
)
def test_settings_that_cannot_be(parameters, word):
    assert word in message({"integrator": {"type": "pellucid_two_pass", **parameters}})


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


def test_where_diffusion_does_not_hold_there_is_a_warning():
    with pytest.warns(pellucid.PellucidWarning, match="skin1"):
        render(scene({"type": "sphere", "radius": 9.0, "bsdf": translucent(material="skin1")}), sample_count=500)


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
        "to_world": mi.ScalarTransform4f().scale(8.0).rotate([1, 0, 0], 20),
        "bsdf": translucent(material="cream"),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
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
