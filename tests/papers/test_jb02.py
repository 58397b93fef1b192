"""JB02, equation by equation: what the code gives against the printed formula, or its corrected form, in NumPy."""

import mitsuba as mi
import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss, legval

import pellucid
from papers.formulas import (
    diffuse_fresnel,
    diffuse_transmittance,
    dipole,
    dipole_constants,
    disk_integral,
    fresnel_transmittance,
    medium_of,
)
from pellucid.gather.gather import count_evaluations, gather_all
from pellucid.gather.octree import build_octree
from pellucid.model.dipole import Dipole
from pellucid.model.fresnel import boundary_mismatch, fdr
from pellucid.model.medium import Medium
from pellucid.model.photon_simulation import simulate, unreduced_albedo
from pellucid.model.profiles import ProfileTable
from pellucid.model.single_scattering import henyey_greenstein
from worlds.slabs import render_slab, slab

MEDIUM = Medium([0.3, 1.0, 5.0], [0.1, 0.01, 2.0], g=0.6, eta=1.4, profile="dipole")
PHOTONS = 1 << 17


def reflectance_by_ordinates(albedo, g, count=32, terms=64):
    """Solve JB02 eq. 1 in a half space under diffuse light, matched boundary, by discrete ordinates.

    ``mu dL/dtau = -L + albedo L_i``, eq. 2 for L_i with the phase function of Henyey and Greenstein as its Legendre series. What
    stays bounded in the depth is spanned by the eigenvectors that decay; at the surface L is 1 in the directions inwards.
    """
    half, weight = leggauss(count)
    mu = np.concatenate([(half + 1) / 2, -(half + 1) / 2])
    weight = np.concatenate([weight, weight]) / 2
    order = np.arange(min(terms, 2 * count))
    legendre = np.array([legval(mu, np.eye(len(order))[k]) for k in order])
    phase = (legendre.T * (2 * order + 1) * g**order) @ legendre / 2
    rate, mode = np.linalg.eig((-np.eye(2 * count) + albedo * phase * weight) / mu[:, None])
    decays = np.argsort(rate.real)[:count]
    inwards = mu > 0
    strength = np.linalg.solve(mode[np.ix_(inwards, decays)], np.ones(count))
    leaving = (mode[np.ix_(~inwards, decays)] @ strength).real
    return np.sum((weight * -mu)[~inwards] * leaving) / np.sum((weight * mu)[inwards])


@pytest.mark.parametrize("albedo", [0.4, 0.9])
def test_eq_1(albedo):
    """JB02 eq. 1: photons against the transport equation, solved by discrete ordinates; isotropic scattering."""
    tally = simulate(albedo, 0.0, 1.0, PHOTONS)
    assert abs(tally.total - reflectance_by_ordinates(albedo, 0.0)) < 4 * tally.error < 0.01


@pytest.mark.parametrize("g", [-0.4, 0.6])
def test_eq_2(g):
    """JB02 eq. 2: the same where L_i is the radiance weighted by a phase function that is not even."""
    tally = simulate(0.9, g, 1.0, PHOTONS)
    assert abs(tally.total - reflectance_by_ordinates(0.9, g)) < 4 * tally.error < 0.01
    assert abs(tally.total - reflectance_by_ordinates(0.9, 0.0)) > 0.05


@pytest.mark.parametrize("g", [-0.5, 0.0, 0.9])
def test_eq_3(g):
    """JB02 eq. 3: g is the mean of the cosine over the sphere, of a phase function whose integral is 1."""
    cosine, weight = leggauss(200)
    p = np.array([float(henyey_greenstein(float(c), g)) for c in cosine])
    assert 2 * np.pi * np.sum(weight * p) == pytest.approx(1, abs=1e-6)
    assert 2 * np.pi * np.sum(weight * p * cosine) == pytest.approx(g, abs=1e-6)


def test_eq_4():
    """JB02 eq. 4: ``sigma_s' = (1 - g) sigma_s``."""
    assert (1 - 0.6) * MEDIUM.sigma_s == pytest.approx(np.array([0.3, 1.0, 5.0]))
    albedo = unreduced_albedo(0.8, 0.6)  # of sigma_s, where sigma_s' is 0.8 and sigma_a 0.2
    assert (1 - 0.6) * albedo / (1 - albedo) == pytest.approx(0.8 / 0.2)


def test_eq_5():
    """JB02 eq. 5: light that has not scattered falls as exp(-tau), and so does that which has scattered once on its way out.

    Without a phase function and a boundary: R_1 is the integral of ``albedo / 4 pi exp(-tau) exp(-tau / mu)`` over all depths and
    all directions out.
    """
    mu, weight = leggauss(64)
    mu, weight = (mu + 1) / 2, weight / 2
    tau, step = np.linspace(0, 40, 40001, retstep=True)
    falls = np.array([np.trapezoid(np.exp(-tau) * np.exp(-tau / m), dx=step) for m in mu])
    expected = 0.7 / (4 * np.pi) * 2 * np.pi * np.sum(weight * falls)
    single = simulate(0.7, 0.0, 1.0, 4 * PHOTONS, "normal").single
    assert single == pytest.approx(expected, abs=4 * np.sqrt(expected / (4 * PHOTONS)))


def test_eq_8():
    """JB02 eq. 8: both sources of the dipole."""
    r = np.geomspace(1e-3, 20, 100)
    for channel, name in enumerate(("red", "green", "blue")):
        expected = dipole(r, *medium_of(MEDIUM, channel))
        assert MEDIUM.diffuse_reflectance(r)[:, channel] == pytest.approx(expected, rel=1e-12), name


def test_eq_9():
    """JB02 eq. 9: C_1 and C_2, each from the profile of the other source taken away; z_r and z_v as the text defines them."""
    r = np.geomspace(1e-3, 20, 100)
    albedo, sigma_tr, z_r, z_v, _ = dipole_constants(*medium_of(MEDIUM, 1))
    assert (MEDIUM.z_r[1], MEDIUM.z_v[1]) == pytest.approx((z_r, z_v))
    d_r, d_v = np.sqrt(r**2 + z_r**2), np.sqrt(r**2 + z_v**2)
    both = MEDIUM.diffuse_reflectance(r)[:, 1] * 4 * np.pi / albedo
    virtual = z_v * (sigma_tr + 1 / d_v) * np.exp(-sigma_tr * d_v) / d_v**2
    c_1 = (both - virtual) * d_r**2 / np.exp(-sigma_tr * d_r)
    assert c_1 == pytest.approx(z_r * (sigma_tr + 1 / d_r), rel=1e-9)


@pytest.mark.parametrize("eta", [1.0, 1.3, 1.5, 2.0])
def test_eq_10(eta):
    """JB02 eq. 10, the internal reflectance (misprint 1), and A that is made of it."""
    assert fdr(eta) == pytest.approx(-1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta)
    assert boundary_mismatch(eta) == pytest.approx((1 + diffuse_fresnel(eta)) / (1 - diffuse_fresnel(eta)))


def test_eq_11():
    """JB02 eq. 11: ``l_d / l_s = 1 / sqrt(3 (1 - albedo) (1 - g albedo))``."""
    sigma_s = MEDIUM.sigma_s_prime / (1 - 0.6)
    albedo = sigma_s / (sigma_s + MEDIUM.sigma_a)
    ratio = MEDIUM.dmfp / (1 / (sigma_s + MEDIUM.sigma_a))
    assert ratio == pytest.approx(1 / np.sqrt(3 * (1 - albedo) * (1 - 0.6 * albedo)))


def test_eq_12():
    """JB02 eq. 12: a voxel stands for its samples where ``A_v / |x - P_v|^2`` is at most the error, P_v weighted by the power."""
    rng = np.random.default_rng(2)
    p, area = rng.uniform(-0.2, 0.2, (8, 3)), rng.uniform(1.0, 2.0, 8)  # one leaf, and larger than it is wide
    power = rng.exponential(size=(8, 3))
    tree, table = build_octree(p, area, power), ProfileTable.from_medium(MEDIUM)
    weight = power.mean(axis=1)
    centre = weight @ p / weight.sum()
    for x in rng.normal(size=(20, 3)) * 6 + 3:
        solid_angle = area.sum() / np.sum((x - centre) ** 2)
        for factor, accepted in ((0.999, 8), (1.001, 1)):
            at = mi.Point3f(*(mi.Float(v) for v in x))
            assert count_evaluations(tree, table, at, factor * solid_angle)[1] == accepted


def test_eq_13():
    """JB02 eq. 13: ``F_t R_d E A`` of each sample, with F_t from outside for F_dt (misprint 1) and a' left in R_d (eq. 15).

    A tilted lamp lights a disk; in the middle the samples, of whatever number and size, add up to the integral over the disk.
    """
    cosine, radius = 0.5, 8.0
    body = slab(radius, cosine, irradiance=3.0, profile="dipole")
    prepared = pellucid.prepare(body, "exact", sample_count=20000, irradiance_paths=4, max_depth=2)
    found = prepared.exitance([[0, 0, 0]])[0]
    medium = Medium.from_preset("marble", profile="dipole")
    entering = 3.0 * cosine * fresnel_transmittance(cosine, medium.eta)
    expected = [entering * disk_integral(radius, *medium_of(medium, c)) for c in range(3)]
    assert found == pytest.approx(expected, rel=0.01)
    # and sample by sample, of unequal areas:
    rng = np.random.default_rng(0)
    p, power = rng.uniform(-3, 3, (50, 3)), rng.exponential(size=(50, 3))
    x = rng.uniform(-3, 3, (20, 3))
    r = np.linalg.norm(x[:, None] - p, axis=-1)
    one = gather_all(p, power, ProfileTable.from_medium(MEDIUM), mi.Point3f(np.ascontiguousarray(x.T)))
    for channel in range(3):
        expected = dipole(r, *medium_of(MEDIUM, channel)) @ power[:, channel]
        assert np.asarray(one[channel]) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("method", ["two_pass", "exact", "sampled", "single_pass"])
def test_eq_14(method):
    """JB02 eq. 14: ``L = F_t(omega_o) / T_d M / pi``, with the external T_d for the divisor F_dr (misprint 1)."""
    for cosine in (0.95, 0.3):
        radiance, exitance = render_slab(method, cosine, profile="dipole")
        eta = Medium.from_preset("marble").eta
        expected = fresnel_transmittance(cosine, eta) / diffuse_transmittance(eta) / np.pi
        assert radiance / exitance == pytest.approx([expected] * 3, rel=2e-3)


def test_eq_15():
    """JB02 eq. 15: the total diffuse reflectance of the reduced albedo."""
    albedo = np.array([1e-3, 0.3, 0.9, 0.999])
    mismatch = dipole_constants(1.0, 1.0, 1.4)[4]
    root = np.sqrt(3 * (1 - albedo))
    expected = albedo / 2 * (1 + np.exp(-4 / 3 * mismatch * root)) * np.exp(-root)
    assert [Dipole().total(s, 0.0, 1.4) for s in root] == pytest.approx(expected, rel=1e-9)
    assert Medium(albedo[1:], 1 - albedo[1:], eta=1.4, profile="dipole").total_diffuse_reflectance == pytest.approx(
        expected[1:]
    )


def test_eq_16():
    """JB02 eq. 16: ``sigma_t' = sigma_tr / sqrt(3 (1 - a'))``, from a reflectance that eq. 15 takes back."""
    reflectance, dmfp = np.array([0.2, 0.6, 0.95]), np.array([0.5, 1.0, 4.0])
    m = Medium.from_reflectance(reflectance, dmfp, eta=1.3, profile="dipole")
    albedo = m.sigma_s_prime / (m.sigma_s_prime + m.sigma_a)
    assert m.sigma_s_prime + m.sigma_a == pytest.approx((1 / dmfp) / np.sqrt(3 * (1 - albedo)))
    mismatch = dipole_constants(1.0, 1.0, 1.3)[4]
    root = np.sqrt(3 * (1 - albedo))
    assert albedo / 2 * (1 + np.exp(-4 / 3 * mismatch * root)) * np.exp(-root) == pytest.approx(reflectance)
