"""The volumetric path tracer that the methods are compared with: it keeps the energy, whatever the index of the medium."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.model.medium import Medium
from support.volume import as_volume, volume_path_tracer
from support.volume_exitance import volume_exitance
from worlds.balls import looking_at

RADIUS = 3.0  # mean free paths


@pytest.mark.parametrize("eta", [1.0, 1.3, 1.5])
def test_a_body_that_absorbs_nothing_cannot_be_seen_in_a_white_furnace(tmp_path, eta):
    """All that enters leaves again, and what is reflected is the same white."""
    medium = Medium(1.0, 0.0, eta=eta)
    spec = {"type": "scene", "ball": {"type": "sphere", "radius": RADIUS}, "sky": {"type": "constant", "radiance": 1.0}}
    spec["sensor"] = looking_at([0, 0, 0], [0, 0, 100], fov=4.0, size=8)
    furnace = mi.load_dict(as_volume(spec, "ball", medium, tmp_path), optimize=False)
    assert np.array(mi.render(furnace, integrator=volume_path_tracer(), spp=32)) == pytest.approx(1, abs=1e-4)


def test_rays_from_below_the_surface_bring_out_all_light_that_entered(tmp_path):
    """In the furnace the exitance is known at every point."""
    medium = Medium(1.0, 0.0, eta=1.4)
    n = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, -0.8]])
    spec = {"type": "scene", "ball": {"type": "sphere", "radius": RADIUS}, "sky": {"type": "constant", "radiance": 1.0}}
    scene = mi.load_dict(as_volume(spec, "ball", medium, tmp_path), optimize=False)
    found = volume_exitance(scene, medium, RADIUS * n, n, 4000, 0).mean(axis=0)
    assert found == pytest.approx(np.full((2, 3), np.pi * external_diffuse_transmittance(1.4)), rel=5e-3)
