"""Single scattering: the BRDF against the exact term, energy and reciprocity."""

import math

import drjit as dr
import numpy as np
import pytest
from drjit.llvm import Array3f, Float

from pellucid.model import Medium
from pellucid.model.single_scattering import brdf, exact_radiance, henyey_greenstein

MEDIUM = Medium([0.5, 1.0, 2.0], [0.5, 0.1, 0.01], g=0.4, eta=1.4)


def direction(theta, phi):
    return Array3f(math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))


@pytest.mark.parametrize("g", [-0.5, 0.0, 0.3, 0.9])
def test_phase_function_is_normalised_with_mean_cosine_g(g):
    nodes, weights = np.polynomial.legendre.leggauss(200)
    p = np.array([henyey_greenstein(float(c), g) for c in nodes]) * 2 * np.pi
    assert np.sum(weights * p) == pytest.approx(1)
    assert np.sum(weights * p * nodes) == pytest.approx(g, abs=1e-9)  # eq. 3


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0, 0.0), (0.5, 1.0, 1.2, 3.0), (1.4, 0.2, 0.3, -2.0)])
def test_exact_term_of_a_uniform_beam_is_the_brdf(angles):
    omega_in, omega_out = direction(*angles[:2]), direction(*angles[2:])
    expected = brdf(MEDIUM, omega_in, omega_out)
    for channel in range(3):
        exact = exact_radiance(MEDIUM, channel, omega_in, omega_out, lambda x, y: Float(2.5) + 0 * x)
        assert exact[0] == pytest.approx(2.5 * expected[channel][0], rel=1e-5)


def test_exact_term_of_a_narrow_beam_integrates_over_the_slab_to_the_brdf():
    """Shifting the beam over the seen point is shifting the seen point under the beam: flux times BRDF."""
    omega_in, omega_out = direction(0.8, 0.4), direction(0.5, 2.5)
    width, extent, count = 0.4, 12.0, 401
    axis = np.linspace(-extent, extent, count)
    x, y = (Float(a.ravel()) for a in np.meshgrid(axis, axis))

    def beam(dx, dy):
        return dr.exp(-(dr.square(dx - x) + dr.square(dy - y)) / (2 * width**2)) / (2 * np.pi * width**2)

    seen = exact_radiance(MEDIUM, 1, omega_in, omega_out, beam, node_count=80)
    total = dr.sum(seen)[0] * (axis[1] - axis[0]) ** 2
    assert total == pytest.approx(brdf(MEDIUM, omega_in, omega_out)[1][0], rel=2e-3)


def test_the_beam_is_displaced_as_snell_says():
    """Light scattered at depth s has entered on the side of the light: mean displacement in closed form."""
    omega_in, omega_out = direction(0.9, 0.0), direction(0.0, 0.0)
    sin_inside = np.sin(0.9) / MEDIUM.eta
    mu_in = np.sqrt(1 - sin_inside**2)
    weighted = exact_radiance(MEDIUM, 2, omega_in, omega_out, lambda x, y: x)
    mean_x = weighted[0] / brdf(MEDIUM, omega_in, omega_out)[2][0]
    decay = MEDIUM.sigma_t[2] * (1 + 1 / mu_in)
    assert mean_x == pytest.approx(sin_inside / mu_in / decay, rel=1e-4)


def test_reciprocity_and_darkness_below():
    a, b = direction(0.3, 1.0), direction(1.3, -1.0)
    assert np.allclose([c[0] for c in brdf(MEDIUM, a, b)], [c[0] for c in brdf(MEDIUM, b, a)], rtol=1e-6)
    below = Array3f(0.0, 0.6, -0.8)
    assert all(c[0] == 0 for c in brdf(MEDIUM, below, a) + brdf(MEDIUM, a, below))
