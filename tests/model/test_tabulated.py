"""The tabulated profile against two outside answers, and against what is known of it in closed form."""

import drjit.llvm
import iadpython
import numpy as np
import pytest

from pellucid.model import Medium, ProfileTable
from pellucid.model.photon_simulation import simulate, unreduced_albedo
from pellucid.model.tabulated import FLAT, Tabulated, decay

TABLE = Tabulated()


def s_of(albedo_prime):
    return float(np.sqrt(3 * (1 - albedo_prime)))


def adding_doubling(albedo_prime, g, eta):
    """Share of the entering diffuse light that comes back, by a program of others."""

    def reflectance(albedo):
        return iadpython.Sample(a=albedo, b=1e5, g=g, n=eta, n_above=1.0, n_below=eta, quad_pts=32).rt()[2]

    surface = reflectance(0.0)
    return (reflectance(float(unreduced_albedo(albedo_prime, g))) - surface) / (1 - surface)


@pytest.mark.parametrize(("g", "eta"), [(0.0, 1.0), (0.0, 1.33), (-0.3, 1.25), (0.7, 1.33), (0.9, 1.05), (0.2, 1.5)])
@pytest.mark.parametrize("albedo_prime", [0.3, 0.9, 0.99])
def test_totals_are_those_of_adding_doubling(g, eta, albedo_prime):
    """Of dark media the photons of the table leave 0.3 % of noise; the worst of these is off by 0.31 %."""
    error = 3e-3 if albedo_prime > 0.5 else 3.5e-3
    assert TABLE.total(s_of(albedo_prime), g, eta) == pytest.approx(adding_doubling(albedo_prime, g, eta), rel=error)


@pytest.mark.parametrize(("albedo_prime", "g", "eta"), [(0.6, 0.45, 1.25), (0.97, 0.0, 1.45)])
def test_the_profile_is_that_of_photons_of_its_own(albedo_prime, g, eta):
    """Between the nodes of the table, by another program than the one that made it."""
    tally = simulate(float(unreduced_albedo(albedo_prime, g)), g, eta, 1 << 19, seed=5)
    ratio = (1 - g * unreduced_albedo(albedo_prime, g)) / 1  # sigma_t' over sigma_t
    edges = tally.radii[::8] * ratio
    found = np.add.reduceat(
        (tally.profile_single + tally.profile_multiple) * np.pi * np.diff(tally.radii**2), np.arange(0, 145, 8)
    )
    x = np.geomspace(1e-4, edges[-1], 20001)
    middle, area = np.sqrt(x[1:] * x[:-1]), np.pi * np.diff(x**2)
    rings = np.histogram(middle, edges, weights=TABLE.density(middle, s_of(albedo_prime), g, eta) * area)[0]
    assert np.abs(found[: len(rings)] - rings).sum() < 0.015 * tally.total  # of which photons leave 0.005


@pytest.mark.parametrize("k", [0.05, 0.4, 0.9])
def test_the_decay_of_isotropic_media_is_the_root_of_its_equation(k):
    """``1 = a / (2 k) ln((1 + k) / (1 - k))``: Case and Zweifel 1967."""
    albedo = 2 * k / np.log((1 + k) / (1 - k))
    assert decay(s_of(albedo), 0.0) == pytest.approx(k, rel=1e-6)


@pytest.mark.parametrize("g", [-0.4, 0.0, 0.85])
def test_light_decays_as_in_diffusion_where_little_is_absorbed(g):
    for s in (1e-6, 1e-3):
        assert decay(s, g) == pytest.approx(s, rel=1e-5)


def test_a_medium_without_absorption_returns_all_light():
    for g, eta in ((0.0, 1.0), (0.37, 1.42), (0.95, 2.0)):
        assert TABLE.total(0.0, g, eta) == pytest.approx(1, abs=1e-6)


def test_the_table_falls_everywhere():
    x = np.geomspace(0.005, 300, 400)
    for s in np.linspace(0, 1.7, 9):
        for g, eta in ((0.0, 1.3), (0.88, 1.6), (-0.4, 1.02)):
            assert np.all(np.diff(TABLE.density(x, float(s), g, eta)) < 0)


def test_the_file_is_small():
    assert FLAT.stat().st_size < 150_000


def test_colours_come_back():
    for reflectance in (0.02, 0.3, 0.7, 0.95):
        for g, eta in ((0.0, 1.3), (0.5, 1.6), (0.9, 1.33)):
            medium = Medium.from_reflectance(reflectance, 1.0, eta, g)
            r = np.geomspace(1e-5, 1e3, 40001)
            rings = medium.diffuse_reflectance(r)[:, 0] * 2 * np.pi * r * r
            assert np.trapezoid(rings, np.log(r)) == pytest.approx(reflectance, rel=3e-3)


@pytest.mark.parametrize(("sigma_a", "radius", "truth"), [(0.02, 8.0, None), (0.0, 16.0, 1.0)])
def test_the_curved_profile_keeps_the_light_of_a_ball(sigma_a, radius, truth):
    """Without absorption all light comes back, of which a flat profile loses 8 %; mu is the distance over twice the radius."""
    medium = Medium(1.0, sigma_a, profile="curved")
    edges = np.concatenate([[0.0], np.geomspace(1e-4, 1, 4000)]) * 2 * radius
    r, area = 0.5 * (edges[1:] + edges[:-1]), np.pi * np.diff(edges**2)
    flat = medium.diffuse_reflectance(r)[:, 0] * area
    curved = flat @ np.exp(medium.curve(r)[:, 0] * r / (2 * radius))
    assert curved > 1.05 * flat.sum()
    if truth is not None:
        assert curved == pytest.approx(truth, abs=0.01)


def test_thin_bodies_lose_light_and_thick_ones_do_not():
    medium = Medium(1.0, [0.0, 0.01, 0.3], profile="curved")
    total = medium.total_diffuse_reflectance
    white = np.repeat([[1.0], [1.3], [2.0]], 3, axis=1)
    factor = medium.thin(white * total, white)
    assert factor[:, 0] == pytest.approx([1, 1 / 1.3, 1 / 2.0], rel=0.02)  # nothing is absorbed: all light comes out
    assert factor[0] == pytest.approx(1, abs=2e-3)
    assert np.all(np.diff(factor[1:], axis=1) > 0)
    curved = np.full(3, 1.3) * total
    assert medium.thin(curved, np.ones(3)) == pytest.approx(1, abs=1e-6)  # a ball sends out more, and should
    for flat in ("dipole", "tabulated"):
        assert np.all(Medium(1.0, 0.1, profile=flat).thin(curved, 1.3 * np.ones(3)) == 1)


def test_bounds_of_the_profile_hold_whatever_the_normals_are():
    medium = Medium.from_preset("skin2", profile="curved")
    table = ProfileTable.from_medium(medium, 0.3)
    bound = table.bounding()
    r2 = drjit.llvm.Float(np.geomspace(1e-3, 400, 2000).astype(np.float32))
    for mu in (-1.0, 0.0, 0.3, 1.0):
        values, bounds = table.lookup(r2, drjit.llvm.Float(mu)), bound.lookup(r2)
        assert all(np.all(v.numpy() <= b.numpy() * (1 + 1e-5)) for v, b in zip(values, bounds, strict=True))
    assert all(np.all(np.diff(b.numpy()) <= 0) for b in bound.lookup(r2))
