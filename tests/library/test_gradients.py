"""A gradient that does not flow is refused in one line; it must not be ignored without a word."""

import re

import drjit as dr
import mitsuba as mi
import pytest

from pellucid.errors import MediumError, PellucidError
from pellucid.methods import METHODS

WITHOUT = sorted(METHODS.keys() - {"two_pass", "texture_space", "exact"})
GEOMETRY = ["ball.bsdf.alpha", "floor.vertex_positions", "ball.to_world", "sensor.x_fov"]
TINY = {"sample_count": 50, "irradiance_paths": 2}


@pytest.fixture
def scene():
    return mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": {"type": "pellucid_translucent"}},
            "floor": {"type": "cube", "bsdf": {"type": "diffuse"}},
            "light": {"type": "constant"},
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        },
        optimize=False,
    )


def enable(scene, *names):
    params = mi.traverse(scene)
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    return params


def refused(scene, method, params, **settings):
    integrator = mi.load_dict({"type": f"pellucid_{method}", **settings})
    for given in ({}, {"params": params}):
        with pytest.raises(RuntimeError) as caught:  # Dr.Jit's, in which it wraps what a render raises
            mi.render(scene, integrator=integrator, spp=1, **given)
        assert isinstance(caught.value.__cause__, PellucidError)
    return str(caught.value.__cause__)


@pytest.mark.parametrize("method", WITHOUT)
def test_a_method_without_gradients_refuses_them(scene, method):
    said = refused(scene, method, enable(scene, "ball.bsdf.sigma_a"))
    assert re.fullmatch(
        f"No gradients flow through pellucid_{method},.*'ball.bsdf.sigma_a'.*two_pass.*dr.disable_grad.*", said
    )


@pytest.mark.parametrize("name", GEOMETRY)
@pytest.mark.parametrize("method", ["two_pass", "texture_space", "exact"])
def test_geometry_is_refused(scene, method, name):
    said = refused(scene, method, enable(scene, name))
    assert re.fullmatch(f"No gradients flow through pellucid to '{name}'.*dr.disable_grad.*prbvolpath.*", said)


@pytest.mark.parametrize(
    "method, settings, named",
    [
        ("texture_space", {"hybrid": True}, "hybrid"),  # what shadow maps see
        ("two_pass", {"translucent_passes": 1}, "translucent_passes"),  # bodies that light each other by their exitance
        ("texture_space", {"hybrid": True, "translucent_passes": 1}, "translucent_passes and hybrid"),
    ],
)
def test_settings_without_gradients_are_to_be_left_out(scene, method, settings, named):
    said = refused(scene, method, enable(scene, "ball.bsdf.eta"), **settings)
    assert re.fullmatch(
        f"No gradients flow through pellucid_{method} with {named}, .*: leave {named} out, or call dr.disable_grad .*",
        said,
    )


@pytest.mark.parametrize(
    "bsdf, names, said",
    [
        ({}, ["sigma_a", "dmfp"], "sigma_a and dmfp were asked for at once"),
        ({"sigma_a": 0.0, "sigma_s_prime": 1.0}, ["sigma_s_prime"], "sigma_a = 0 in a channel has no gradient"),
        ({"single_scattering": True, "profile": "dipole"}, ["sigma_a"], "No gradients flow through single_scattering"),
        ({"reflectance": 0.5, "dmfp": {"type": "uniform", "value": 1.0}}, ["eta"], "a body whose dmfp is a texture"),
    ],
)
def test_media_without_gradients_say_so(bsdf, names, said):
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": {"type": "pellucid_translucent", **bsdf}},
            "light": {"type": "constant"},
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        },
        optimize=False,
    )
    params = enable(scene, *(f"ball.bsdf.{name}" for name in names))
    integrator = mi.load_dict({"type": "pellucid_two_pass", **TINY})
    with pytest.raises(MediumError, match=said):
        integrator.render_backward(scene, params, dr.ones(mi.TensorXf, (4, 4, 3)), spp=1)


def test_without_gradients_or_after_disabling_them_nothing_is_refused(scene):
    params = enable(scene, "floor.vertex_positions")
    dr.disable_grad(params["floor.vertex_positions"])
    params.update()
    integrator = mi.load_dict({"type": "pellucid_two_pass", **TINY})
    assert mi.render(scene, params=params, integrator=integrator, spp=1).shape == (4, 4, 3)
