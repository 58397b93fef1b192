"""The colour that a material is given is the colour that a flat patch of it has."""

import numpy as np
import pytest

import pellucid

import mitsuba as mi  # isort: skip

from pellucid.model.fresnel import external_diffuse_transmittance
from worlds.balls import rgb

COLOUR = (0.02, 0.4, 0.95)


@pytest.mark.parametrize("g, eta", [(-0.3, 1.1), (0, 1.3), (0.8, 1.5), (0.95, 1.9)])
def test_a_flat_patch_returns_its_reflectance_of_the_light_that_enters(g, eta):
    bsdf = {"type": "pellucid_translucent", "reflectance": rgb(*COLOUR), "dmfp": rgb(0.5, 0.5, 0.5), "g": g, "eta": eta}
    patch = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(20), "bsdf": bsdf}
    scene = pellucid.load_scene({"type": "scene", "sky": {"type": "constant"}, "patch": patch})
    with pytest.warns(pellucid.PellucidWarning, match="open or has no thickness"):
        prepared = pellucid.prepare(scene, sample_count=5000, irradiance_paths=16)
    places = np.random.default_rng(0).uniform(-12, 12, (5000, 2))
    exitance = prepared.exitance(np.pad(places, ((0, 0), (0, 1)))).mean(axis=0)
    entering = np.pi * external_diffuse_transmittance(eta)  # under a sky of radiance 1
    assert exitance / entering == pytest.approx(COLOUR, rel=0.01)
