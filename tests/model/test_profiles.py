"""The table of R_d against its float64 twin."""

import drjit as dr
import drjit.llvm
import drjit.llvm.ad
import numpy as np
import pytest

from pellucid.model import PRESETS, Medium, ProfileTable
from pellucid.model.medium import PROFILES
from pellucid.model.profiles import mean_over_disc


def compare(medium, float_type=drjit.llvm.Float):
    """Relative error where R_d exceeds 1e-9 of its peak, and absolute error over the peak elsewhere.

    The tabulated profile has a peak without end, which is cut off within 1/20 of a mean free path: from there on it counts.
    """
    z = medium.mfp.min()
    r2 = (np.concatenate([[0.0], np.geomspace(1e-5, 3e5, 100001)]) * z).astype(np.float64) ** 2
    r2 = r2.astype(np.float32)
    found = np.stack([c.numpy() for c in ProfileTable.from_medium(medium).lookup(float_type(r2))], axis=-1)
    truth = medium.diffuse_reflectance(np.sqrt(r2.astype(np.float64)))
    peak = truth[0]
    assert (peak > 0).all()
    if medium.profile != "dipole":
        peak = np.diagonal(medium.diffuse_reflectance(0.05 * medium.mfp))
        found = np.where(r2[:, None] > (0.05 * medium.mfp) ** 2, found, truth)
    matters = truth > 1e-9 * peak
    relative = np.abs(found[matters] / truth[matters] - 1)
    return relative.max(), (np.abs(found - truth) / peak)[~matters].max(initial=0)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", PRESETS)
def test_measured_materials(name, profile):
    relative, elsewhere = compare(Medium.from_preset(name, profile=profile))
    assert relative < 5e-4
    assert elsewhere < 1e-12


@pytest.mark.parametrize("profile", PROFILES)
def test_random_media_of_any_size(profile):
    rng = np.random.default_rng(2)
    for _ in range(40):
        size = 10 ** rng.uniform(-4, 4)
        sigma_s_prime, sigma_a = size * 10 ** rng.uniform(-1.5, 1.5, 3), size * 10 ** rng.uniform(-5, 1, 3)
        m = Medium(sigma_s_prime, sigma_a, eta=rng.uniform(1, 2), profile=profile)
        relative, elsewhere = compare(m)
        assert relative < 1e-3
        assert elsewhere < 1e-9


def test_a_strict_medium_of_one_channel_dead_and_one_endless():
    relative, _ = compare(Medium([1.0, 1.0, 1e-3], [0.0, 10.0, 5.0], profile="dipole"))
    assert relative < 1e-3


@pytest.mark.parametrize("name", ["marble", "skin1", "ketchup"])
@pytest.mark.parametrize(("profile", "error"), [("dipole", 1e-4), ("tabulated", 7e-4)])
def test_lookups_over_the_plane_sum_to_the_total_reflectance(name, profile, error):
    m = Medium.from_preset(name, profile=profile)
    edges = np.geomspace(1e-4, 1e4, 200001) * m.mfp.min()
    middle = 0.5 * (edges[1:] + edges[:-1])
    values = ProfileTable.from_medium(m).lookup(drjit.llvm.Float((middle**2).astype(np.float32)))
    for found, total in zip(values, m.total_diffuse_reflectance, strict=True):
        assert np.sum(found.numpy() * np.pi * np.diff(edges**2)) == pytest.approx(total, rel=error)


def test_table_is_small_and_ends_in_nothing():
    table = ProfileTable.from_medium(Medium.from_preset("marble"))
    assert table.values.nbytes < 64 * 1024
    assert np.all(np.isfinite(table.values)) and np.all(table.values[-1] == 0)
    far = table.lookup(drjit.llvm.Float([1e12, 3e38, float("inf")]))
    assert all(np.all(c.numpy() == 0) for c in far)


def test_the_published_index_formula_is_that_of_the_lookup():
    medium = Medium.from_preset("skin2", profile="dipole")
    table = ProfileTable.from_medium(medium)
    r2 = np.geomspace(1e-6, 1e3, 5000).astype(np.float32)
    u = r2.astype(np.float64) * table.inv_scale2 + table.offset
    expected = np.minimum((u.astype(np.float32).view(np.uint32) >> table.shift) - table.base, table.last)
    found = table.index(drjit.llvm.Float(r2))[0].numpy()
    assert np.mean(found == expected) > 0.999 and np.abs(found.astype(int) - expected.astype(int)).max() <= 1
    bare = table.values[found, :3]
    assert np.allclose(bare, medium.diffuse_reflectance(np.sqrt(r2)), rtol=0.05)


def test_gradient_types_work_too():
    assert compare(Medium.from_preset("cream"), drjit.llvm.ad.Float)[0] < 1e-3
    r2 = drjit.llvm.ad.Float(0.5)
    dr.enable_grad(r2)
    red, _, _ = ProfileTable.from_medium(Medium.from_preset("cream")).lookup(r2)
    assert not dr.grad_enabled(red)


def test_lookup_inside_a_symbolic_loop():
    medium = Medium.from_preset("marble", profile="dipole")
    table = ProfileTable.from_medium(medium)
    table.to_device(drjit.llvm.Float)
    Float, UInt32 = drjit.llvm.Float, drjit.llvm.UInt32

    def body(i, total):
        return i + 1, total + table.lookup(dr.square(Float(i)))[1]

    _, total = dr.while_loop((UInt32(0), Float(0)), lambda i, total: i < 20, body)
    assert total[0] == pytest.approx(medium.diffuse_reflectance(np.arange(20.0))[:, 1].sum(), rel=1e-3)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("disc", [0.02, 0.5, 5.0, 50.0])
def test_the_mean_over_a_disc_keeps_the_integral_over_the_plane(disc, profile):
    medium = Medium.from_preset("marble", profile=profile)
    r2 = np.concatenate([[0], np.geomspace(1e-8, 600.0**2, 6000)])
    r = np.sqrt(0.5 * (r2[1:] + r2[:-1]))
    rings = np.pi * np.diff(r2)[:, None]
    point, spread = (rings * mean_over_disc(medium, r, d) for d in (0.0, disc))
    np.testing.assert_allclose(spread.sum(axis=0), point.sum(axis=0), rtol=2e-3)
    if disc > 0.1:
        assert (mean_over_disc(medium, np.zeros(1), disc) < 0.8 * medium.diffuse_reflectance(np.zeros(1))).all()


@pytest.mark.parametrize("profile", PROFILES)
def test_the_mean_over_a_disc_against_many_random_points(profile):
    medium = Medium.from_preset("skin1", profile=profile)
    rng = np.random.default_rng(0)
    t = 1 - rng.random(2_000_000) ** (1 / 3)  # of a density 3 (1 - t)^2
    rho, phi = 0.7 * np.sqrt(t), 2 * np.pi * rng.random(2_000_000)
    for r in (0.0, 0.4, 1.5, 6.0):
        d = np.sqrt((r + rho * np.cos(phi)) ** 2 + (rho * np.sin(phi)) ** 2)
        expected = medium.diffuse_reflectance(d).mean(axis=0)
        np.testing.assert_allclose(
            mean_over_disc(medium, np.array([r]), 0.7)[0], expected, rtol=6e-3 if profile == "dipole" else 1e-2
        )


@pytest.mark.parametrize("profile", PROFILES)
def test_a_table_of_discs_is_as_exact_as_one_of_points(profile):
    medium = Medium.from_preset("marble", profile=profile)
    table = ProfileTable.from_medium(medium, 0.4)
    r = np.geomspace(1e-3, 40, 500)
    value = np.stack([c.numpy() for c in table.lookup(drjit.llvm.Float(r * r))], axis=1)
    np.testing.assert_allclose(value, mean_over_disc(medium, r, 0.4), rtol=1e-3 if profile == "dipole" else 2e-3)


@pytest.mark.parametrize("profile", PROFILES)
def test_only_the_curved_profile_has_a_curve_to_look_up(profile):
    table = ProfileTable.from_medium(Medium.from_preset("marble", profile=profile), 0.4)
    assert (table.curve is not None) == (profile == "curved")


def test_a_weight_that_leaves_nearly_nothing_leaves_nothing():
    """Splines through what is 0 near by and hardly more far away must not rise between."""

    def far(r):
        return np.where(r > 5, 1e-45, 0.0)[:, None] * np.ones(3)

    for weight in (far, lambda r: 0 * far(r)):
        table = ProfileTable.from_medium(Medium.from_preset("marble"), 0.5, weight)
        r2 = drjit.llvm.Float(np.geomspace(1e-4, 1e4, 10_000).astype(np.float32))
        assert max(abs(channel.numpy()).max() for channel in table.lookup(r2)) < 1e-30


def test_a_table_holds_channels_that_differ_by_ten_thousand():
    table = ProfileTable.from_medium(Medium([31400.0, 3.0, 3.0], [0.002, 0.004, 0.007]))
    r2 = np.geomspace(1e-9, 1.0, 50)
    assert np.isfinite([c.numpy() for c in table.lookup(drjit.llvm.Float(r2.astype(np.float32)))]).all()
