"""The boundary: Fresnel's equations, their averages, and what energy says about the misprints."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from drjit.llvm import Float64

from pellucid.model.fresnel import boundary_mismatch, external_diffuse_transmittance, fdr, fresnel_dielectric
from pellucid.model.medium import Medium

ETAS = (1.0, 1.0005, 1.1, 1.3, 1.5, 2.0)


def hemisphere_mean(eta, sign=1.0):
    """Cosine-weighted mean of F, the light coming from outside (sign 1) or inside (sign -1)."""
    cosine = (np.arange(1 << 20) + 0.5) / (1 << 20)
    return float(np.mean(2 * cosine * fresnel_dielectric(Float64(sign * cosine), eta).numpy()))


@pytest.mark.parametrize("eta", [1.05, 1.3, 1.5])
def test_reflectance_is_mitsubas_from_both_sides(eta):
    cosine = dr.linspace(mi.Float, -1, 1, 1001)
    ours, theirs = fresnel_dielectric(cosine, eta), mi.fresnel(cosine, eta)[0]
    assert np.allclose(ours.numpy(), theirs.numpy(), atol=1e-4)


def test_reflectance_known_values():
    assert fresnel_dielectric(1.0, 1.5) == pytest.approx(0.04)
    assert fresnel_dielectric(-1.0, 1.5) == pytest.approx(0.04)
    assert fresnel_dielectric(0.0, 1.5) == pytest.approx(1.0)
    assert fresnel_dielectric(-0.5, 1.5) == 1.0  # beyond the critical angle
    brewster = float(np.cos(np.arctan(1.5)))
    assert fresnel_dielectric(brewster, 1.5) == pytest.approx(0.5 * ((1.5**2 - 1) / (1.5**2 + 1)) ** 2)
    assert all(fresnel_dielectric(c, 1.0) == pytest.approx(0.0) for c in (-1.0, -0.3, 0.0, 0.3, 1.0))


@pytest.mark.parametrize("eta", ETAS)
def test_external_transmittance_is_the_mean_over_the_hemisphere(eta):
    assert external_diffuse_transmittance(eta) == pytest.approx(1 - hemisphere_mean(eta), abs=2e-6)


@pytest.mark.parametrize("eta", ETAS)
def test_misprint_1_inside_and_outside_are_linked_by_eta_squared(eta):
    linked = external_diffuse_transmittance(eta) / eta**2
    assert 1 - hemisphere_mean(eta, -1.0) == pytest.approx(linked, abs=1e-4)
    assert 1 - fdr(eta) == pytest.approx(linked, abs=0.002)  # the polynomial is a fit of the internal one


def test_misprint_1_published_values():
    assert fdr(1.5) == pytest.approx(0.597, abs=5e-4)
    assert fdr(1.3) == pytest.approx(0.445, abs=5e-4)
    assert external_diffuse_transmittance(1.5) == pytest.approx(0.908, abs=5e-4)
    assert external_diffuse_transmittance(1.3) == pytest.approx(0.939, abs=5e-4)
    assert boundary_mismatch(1.3) == pytest.approx((1 + 0.4448) / (1 - 0.4448), rel=1e-3)


@pytest.mark.parametrize(("profile", "error"), [("dipole", 1e-5), ("tabulated", 1e-4)])
@pytest.mark.parametrize("eta", [1.3, 1.5])
def test_misprint_1_energy_a_white_slab_under_a_white_sky_is_white(eta, profile, error):
    """Spectralon under a sky of radiance 1 has mean radiance 1; with the printed constants it is far from it."""
    white = Medium(10.0, 0.0, eta=eta, profile=profile)
    r = np.geomspace(1e-7, 1e8, 40001)
    total = np.trapezoid(white.diffuse_reflectance(r)[:, 0] * 2 * np.pi * r * r, np.log(r))
    reflected = hemisphere_mean(eta)

    def mean_radiance(entering, normalisation):  # eqs. 13 and 14: the mean of F + F_t / normalisation * M_o / pi
        return reflected + (1 - reflected) / normalisation * entering * total

    right = external_diffuse_transmittance(eta)
    assert mean_radiance(right, right) == pytest.approx(1.0, abs=error)
    assert abs(mean_radiance(1 - fdr(eta), fdr(eta)) - 1) > 0.1
    assert abs(mean_radiance(1 - fdr(eta), 1.0) - 1) > 0.1
