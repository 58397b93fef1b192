"""A scene parameter with gradients enabled is refused in one line; it must not be ignored without a word."""

import re

import drjit as dr
import mitsuba as mi
import pytest

from pellucid.errors import PellucidError
from pellucid.methods import METHODS

PARAMETERS = ["ball.bsdf.sigma_a", "ball.bsdf.alpha", "light.radiance.value", "floor.vertex_positions", "sensor.x_fov"]


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


@pytest.fixture(params=METHODS)
def integrator(request):
    return mi.load_dict({"type": f"pellucid_{request.param}"})


def enable(scene, name):
    params = mi.traverse(scene)
    dr.enable_grad(params[name])
    params.update()
    return params


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_render_is_refused_in_one_line(scene, integrator, name):
    params = enable(scene, name)
    for given in ({}, {"params": params}):
        with pytest.raises(RuntimeError) as caught:  # Dr.Jit's, in which it wraps what a render raises
            mi.render(scene, integrator=integrator, spp=1, **given)
        refused = caught.value.__cause__
        assert isinstance(refused, PellucidError)
        assert re.fullmatch(f"No gradients flow.*'{name}'.*dr.disable_grad.*prbvolpath.*", str(refused))


def test_without_gradients_or_after_disabling_them_nothing_is_refused(scene, integrator):
    params = enable(scene, "light.radiance.value")
    dr.disable_grad(params["light.radiance.value"])
    params.update()
    assert mi.render(scene, params=params, integrator=integrator, spp=1).shape == (4, 4, 3)
