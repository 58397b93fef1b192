"""The methods against Mitsuba's own Monte Carlo of the medium, where the diffusion approximation holds."""

import mitsuba as mi
import numpy as np
import pytest

from worlds.balls import looking_at, scene, translucent

SIGMA_S_PRIME, SIGMA_A, ETA = 2.0, 0.02, 1.3
RADIUS = 75.0  # 26 diffuse mean free paths: nearly flat


def ball_in_a_medium(light, sensor):
    medium = {
        "type": "homogeneous",
        "sigma_t": SIGMA_S_PRIME + SIGMA_A,
        "albedo": SIGMA_S_PRIME / (SIGMA_S_PRIME + SIGMA_A),
    }
    shape = {
        "type": "sphere",
        "radius": RADIUS,
        "bsdf": {"type": "dielectric", "int_ior": ETA, "ext_ior": 1.0},
        "interior": medium,
    }
    return scene(shape, light=light, sensor=sensor)


def test_a_ball_looks_like_its_medium():
    """Over the whole disk of the ball all exit directions have their share, so the mean radiance is the exitance.

    Photons leave a medium somewhat more along the normal than the Fresnel-weighted cosine that the papers assume, so the
    middle of the disk is darker than the truth and its rim brighter. In the mean the dipole lacks 4 % for this medium on a
    flat half space, and what is left of the curvature another 2 %.
    """
    light = {"type": "constant", "radiance": 1.0}
    sensor = looking_at([0, 0, 0], [0, 0, 3000], fov=2 * np.rad2deg(np.arctan(RADIUS / 3000)), size=16)
    settings = {"type": "volpath", "max_depth": 2000, "rr_depth": 200, "hide_emitters": True}
    truth = mi.render(ball_in_a_medium(light, sensor), integrator=mi.load_dict(settings), spp=256)
    shape = {
        "type": "sphere",
        "radius": RADIUS,
        "bsdf": translucent(sigma_s_prime=SIGMA_S_PRIME, sigma_a=SIGMA_A, eta=ETA, alpha=0.0),
    }
    method = mi.load_dict({"type": "pellucid_two_pass", "hide_emitters": True})
    ours = mi.render(scene(shape, light=light, sensor=sensor), integrator=method, spp=64)
    assert np.mean(np.array(ours)) == pytest.approx(np.mean(np.array(truth)), rel=0.07)
