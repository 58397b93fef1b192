"""Photons in a half space against theory, published tables, the BRDF of single scattering, and the dipole."""

import numpy as np
import pytest
from drjit.llvm import Array3f

from pellucid.errors import MediumError
from pellucid.model import Medium
from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.model.photon_simulation import simulate, unreduced_albedo
from pellucid.model.single_scattering import brdf

PHOTONS = 1 << 17


def chandrasekhar_h(albedo, at):
    """Solve the H function of isotropic scattering by iteration (Chandrasekhar 1960)."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    mu, w = 0.5 * (nodes + 1), 0.5 * weights
    h = np.ones_like(mu)
    for _ in range(2000):
        h = 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * (1 / (mu[:, None] + mu)) @ (w * mu * h))
    return 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * np.sum(w * mu * h / (at + mu)))


@pytest.mark.parametrize("albedo", [0.5, 0.95])
def test_matched_isotropic_half_space_is_chandrasekhars(albedo):
    tally = simulate(albedo, 0.0, 1.0, PHOTONS, "normal")
    exact = 1 - chandrasekhar_h(albedo, 1.0) * np.sqrt(1 - albedo)
    assert abs(tally.total - exact) < 4 * tally.error < 0.01


def test_mismatched_half_space_is_giovanellis():
    """Giovanelli 1955: 0.2600 for index 1.5 and albedo 0.9, the mirror reflection included."""
    tally = simulate(0.9, 0.0, 1.5, PHOTONS, "normal")
    assert 0.04 + 0.96 * tally.total == pytest.approx(0.2600, abs=4 * tally.error)


@pytest.mark.parametrize(("albedo", "g", "eta"), [(0.6, 0.0, 1.0), (0.9, 0.0, 1.3), (0.9, 0.7, 1.5)])
def test_single_scattering_is_the_integral_of_the_brdf(albedo, g, eta):
    medium = Medium(albedo * (1 - g), 1 - albedo, g=g, eta=eta)
    rng = np.random.default_rng(3)
    u = rng.random((4, 1 << 20))
    theta, phi = np.arcsin(np.sqrt(u[:2])), 2 * np.pi * u[2:]
    light, eye = (
        Array3f(np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)) for t, p in zip(theta, phi, strict=True)
    )
    leaving = np.pi * brdf(medium, light, eye)[0].numpy() / external_diffuse_transmittance(eta)
    tally = simulate(albedo, g, eta, 4 * PHOTONS)
    noise = np.hypot(leaving.std() / 1024, np.sqrt(tally.single / (4 * PHOTONS)))
    assert abs(leaving.mean() - tally.single) < 4 * noise < 0.08 * tally.single


def test_almost_nothing_is_lost_without_absorption():
    tally = simulate(0.9999, 0.0, 1.3, 1 << 14)
    assert 0.93 < tally.total < 1
    assert tally.total == pytest.approx(Medium(0.9999, 0.0001, eta=1.3).total_diffuse_reflectance[0], abs=0.02)


def test_profiles_hold_all_the_light():
    tally = simulate(0.95, 0.0, 1.3, PHOTONS)
    areas = np.pi * np.diff(tally.radii**2)
    assert np.sum(tally.profile_single * areas) == pytest.approx(tally.single, rel=1e-3)
    assert np.sum(tally.profile_multiple * areas) == pytest.approx(tally.multiple, rel=1e-3)
    middle = np.sqrt(0.5 * (tally.radii[1:] ** 2 + tally.radii[:-1] ** 2))
    energy = (tally.profile_single + tally.profile_multiple) * areas
    assert np.sum(energy * middle) / energy.sum() == pytest.approx(tally.distance, rel=0.01)


def test_similarity_of_forward_and_isotropic_scattering():
    """Equation 4: media of one reduced albedo reflect the same where the light scatters often."""
    isotropic = simulate(0.99, 0.0, 1.3, PHOTONS)
    forward = simulate(unreduced_albedo(0.99, 0.9), 0.9, 1.3, PHOTONS // 8)
    assert isotropic.total == pytest.approx(forward.total, abs=0.01)


@pytest.mark.parametrize(("eta", "tolerance"), [(1.3, 0.05), (1.5, 0.03)])
def test_dipole_holds_all_orders_of_scattering(eta, tolerance):
    """Equation 15 meets the whole reflectance of photons: to add single scattering would count it twice."""
    tally = simulate(0.99, 0.0, eta, PHOTONS)
    dipole = Medium(0.99, 0.01, eta=eta).total_diffuse_reflectance[0]
    assert abs(dipole / tally.total - 1) < tolerance
    assert abs(dipole - tally.total) < 0.6 * abs(dipole - tally.multiple)


def test_figure_1_shares_of_multiple_scattering():
    isotropic, forward = simulate(0.999, 0.0, 1.3, 1 << 15), simulate(0.999, 0.9, 1.3, 1 << 14)
    assert isotropic.multiple / isotropic.total == pytest.approx(0.9, abs=0.02)
    assert forward.multiple / forward.total > 0.985


def test_figure_1_mean_distance_is_that_of_the_dipole():
    medium = Medium(0.99, 0.01, eta=1.3)
    r = np.geomspace(1e-3, 1e4, 5000)
    ring = medium.diffuse_reflectance(r)[:, 0] * r * r
    assert simulate(0.99, 0.0, 1.3, PHOTONS).distance == pytest.approx(np.sum(ring * r) / np.sum(ring), rel=0.1)


def test_same_seed_same_photons():
    first, again, other = (simulate(0.8, 0.5, 1.3, 1 << 14, seed=s) for s in (1, 1, 2))
    assert first.total == again.total and first.total != other.total
    assert np.array_equal(first.profile_multiple, again.profile_multiple)


@pytest.mark.parametrize("albedo", [0.0, 1.0, 1.5, float("nan")])
def test_endless_walks_are_refused(albedo):
    with pytest.raises(MediumError, match="albedos between 0 and 1"):
        simulate(albedo)
