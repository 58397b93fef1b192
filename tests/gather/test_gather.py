"""Sums over the tree against sums over all samples, in double precision and on the device."""

import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.gather.gather import (
    DEFAULT_MAX_ERROR,
    POINTS_PER_LANE,
    count_evaluations,
    gather,
    gather_all,
    gather_samples,
)
from pellucid.gather.octree import build_octree
from pellucid.gather.source import device_source, steepness, with_samples
from pellucid.model.medium import PROFILES, Medium
from pellucid.model.profiles import ProfileTable
from worlds.points import relative_rmse


def points(p):
    return mi.Point3f(np.ascontiguousarray(p.T))


def as_array(color):
    return np.stack([c.numpy() for c in color], axis=1)


@pytest.fixture(scope="module")
def truth(body):
    """The sum over all samples in double precision, from the closed form of the profile."""
    result = np.zeros((len(body.queries), 3))
    for block in np.array_split(np.arange(len(body.queries)), 30):
        d = body.queries[block, None].astype(np.float64) - body.p[None].astype(np.float64)
        profile = body.medium.diffuse_reflectance(np.sqrt((d**2).sum(axis=-1)))
        result[block] = np.einsum("qnc,nc->qc", profile, body.power.astype(np.float64))
    return result


def test_all_samples_against_double_precision(body, truth):
    value = as_array(gather_all(body.p, body.power, body.table, points(body.queries)))
    np.testing.assert_allclose(value, truth, rtol=5e-4)
    assert relative_rmse(value, truth).max() < 1e-4


def test_without_error_the_tree_weighs_every_sample(body, octree, truth):
    value = as_array(gather(octree, body.table, points(body.queries), 0))
    np.testing.assert_allclose(value, truth, rtol=5e-4)
    twin = as_array(gather_all(octree.p, octree.power, body.table, points(body.queries)))
    np.testing.assert_array_equal(value, twin)  # the same sum in the same order
    weighed, accepted, _ = count_evaluations(octree, body.table, points(body.queries), 0)
    assert accepted == len(body.queries) * len(body.p)
    assert weighed == accepted + len(body.queries) * octree.voxel_count


def test_error_falls_with_max_error(body, octree, truth):
    errors = [
        relative_rmse(as_array(gather(octree, body.table, points(body.queries), e)), truth).max()
        for e in (1.6, 0.4, 0.1, 0.025)
    ]
    assert all(b < 0.5 * a for a, b in itertools.pairwise(errors)), errors


@pytest.mark.parametrize("name", ["marble", "skin1", "ketchup", "wholemilk", "spectralon"])
def test_default_error_is_below_one_in_five_hundred(body, name):
    """On a sphere of the same size in mean free paths, lit from one side: RMSE below 0.2 % of the mean."""
    medium = Medium.from_preset(name)
    table, scale = ProfileTable.from_medium(medium), medium.mfp.min() / body.medium.mfp.min()
    tree = build_octree(body.p * scale, body.area * scale**2, body.power)
    q = points(body.queries * scale)
    exact = as_array(gather(tree, table, q, 0)).astype(np.float64)
    assert relative_rmse(as_array(gather(tree, table, q, DEFAULT_MAX_ERROR)), exact).max() < 0.002
    weighed, _, _ = count_evaluations(tree, table, q, DEFAULT_MAX_ERROR)
    assert weighed < 0.25 * len(body.p) * len(body.queries)


def test_thin_slices_of_a_surface(body):
    """Where a plane between voxels nearly touches the surface, a voxel has few samples on a long arc."""
    side = 100
    u, v = (np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) + 0.5).T * 2 * np.pi / side
    jitter = np.random.default_rng(9).normal(size=(2, side**2)) * 0.02
    u, v = u + jitter[0], v + jitter[1]
    weight = 3 + np.cos(v)
    p = np.stack([weight * np.cos(u), weight * np.sin(u), np.sin(v)], axis=1)
    area = weight / weight.sum() * side**2 * np.pi * body.medium.mfp.min() ** 2
    p *= np.sqrt(area.sum() / (12 * np.pi**2))
    power = (np.maximum(np.sin(v), 0) * area)[:, None] * [1.0, 1.0, 1.0]
    tree = build_octree(p, area, power)
    q = points(p[::7])
    exact = as_array(gather(tree, body.table, q, 0)).astype(np.float64)
    assert relative_rmse(as_array(gather(tree, body.table, q, DEFAULT_MAX_ERROR)), exact).max() < 0.001


def test_light_through_a_slab(body):
    """On the dark side of a slab clusters are seen along their normal, where the second moment has the other sign."""
    side, thickness = 60, 10 * body.medium.mfp.min()
    spacing = np.sqrt(np.pi) * body.medium.mfp.min()
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    jitter = np.random.default_rng(6).random((side * side, 2))
    p = np.concatenate([np.stack([x.ravel(), y.ravel()], 1) + jitter, np.zeros((side * side, 1))], axis=1) * spacing
    area = np.full(len(p), spacing**2)
    tree = build_octree(p, area, np.ones((len(p), 3)) * area[:, None])
    rng = np.random.default_rng(7)
    q = np.concatenate([rng.random((2000, 2)) * side * spacing, np.full((2000, 1), thickness)], axis=1)
    exact = as_array(gather(tree, body.table, points(q), 0)).astype(np.float64)
    assert relative_rmse(as_array(gather(tree, body.table, points(q), DEFAULT_MAX_ERROR)), exact).max() < 0.003


def test_the_sum_at_a_point_does_not_depend_on_other_points(body, octree):
    """Bit for bit: in another order, in other company, alone; no flicker rests on less."""
    rng = np.random.default_rng(8)
    whole = as_array(gather(octree, body.table, points(body.queries), 0.1)).view(np.uint32)
    order = rng.permutation(len(body.queries))
    shuffled = as_array(gather(octree, body.table, points(body.queries[order]), 0.1)).view(np.uint32)
    np.testing.assert_array_equal(shuffled, whole[order])
    for first, count in ((0, 1), (5, POINTS_PER_LANE), (17, 3 * POINTS_PER_LANE + 1), (1190, 11)):
        part = as_array(gather(octree, body.table, points(body.queries[first : first + count]), 0.1)).view(np.uint32)
        np.testing.assert_array_equal(part, whole[first : first + count])


def test_every_voxel_that_contains_the_point_is_opened(body, octree):
    """However large the permitted error, samples that share a leaf with the point are weighed one by one."""
    q = points(octree.p[:500])
    coarse = as_array(gather(octree, body.table, q, 1e6))
    exact = as_array(gather(octree, body.table, q, 0))
    assert np.all(np.abs(coarse / exact - 1) < 0.9)
    weighed, _, _ = count_evaluations(octree, body.table, q, 1e6)
    assert weighed > 500 * 10


def test_odd_counts_of_points_and_coinciding_samples(body):
    p = np.repeat(body.p[:3], [20, 1, 5], axis=0)
    tree = build_octree(p, np.ones(26), np.ones((26, 3)))
    for q in (body.queries[:1], body.queries[:9], body.p[:3]):
        value = as_array(gather(tree, body.table, points(q), 0))
        d = np.linalg.norm(q[:, None].astype(np.float64) - p[None], axis=-1)
        np.testing.assert_allclose(value, body.medium.diffuse_reflectance(d).sum(axis=1), rtol=1e-3)


def test_no_points(body, octree):
    none = dr.zeros(mi.Point3f, 0)
    assert dr.width(gather(octree, body.table, none)) == 0
    assert dr.width(gather_all(body.p, body.power, body.table, none)) == 0


def test_one_sample(body):
    tree = build_octree([[0, 0, 0]], [1], [[1, 2, 3]])
    r = np.array([0.0, 0.01, 1, 10])
    value = as_array(gather(tree, body.table, mi.Point3f(mi.Float(r), 0, 0)))
    np.testing.assert_allclose(value, body.medium.diffuse_reflectance(r) * [1, 2, 3], rtol=1e-3)


def test_new_light_reaches_the_device(body, octree):
    q = points(body.queries[:100])
    before = as_array(gather(octree, body.table, q))
    doubled = as_array(gather(octree.with_power(2 * body.power), body.table, q))
    np.testing.assert_allclose(doubled, 2 * before, rtol=1e-6)
    np.testing.assert_array_equal(as_array(gather(octree, body.table, q)), before)


def test_results_are_colors_of_mitsuba(body, octree):
    q = points(body.queries[:100])
    dr.enable_grad(q)
    value = mi.Color3f(gather(octree, body.table, q))
    assert dr.width(value) == 100 and not dr.grad_enabled(value)


def test_steepness_of_power_laws():
    """psi of (s + core)^-k is k + 1, by construction of the fit."""
    table = ProfileTable.from_medium(Medium(1.0, 0.0, profile="dipole"))
    u = (((np.arange(table.last, dtype=np.uint32) + table.base) << table.shift) + (1 << (table.shift - 1))).view("f4")
    for k in (1.0, 1.5, 2.0):
        values = np.zeros_like(table.values)
        values[:-1, :3] = (u.astype(np.float64) ** -k)[:, None]
        law = ProfileTable(values, table.inv_scale2, table.mfp2, last=table.last)
        assert steepness(law)[0] == pytest.approx(k + 1, rel=0.02)


@pytest.mark.parametrize("profile", PROFILES)
def test_steepness_is_near_five_halves(body, profile):
    for name in ("marble", "wholemilk", "spectralon"):
        psi, core = steepness(ProfileTable.from_medium(Medium.from_preset(name, profile=profile)))
        assert 2.2 < psi < 3.0 and core > 0


def test_records_are_fetched_as_packets(body, octree):
    """Dr.Jit fetches them float by float, three times slower, from memory that is not aligned."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        dr.eval(gather(octree, body.table, points(body.queries)))
        code = max((k["ir"].getvalue() for k in dr.kernel_history() if "ir" in k), key=len)
    assert code.count("call fastcc [4 x <") == 3 + POINTS_PER_LANE


def test_unequal_samples_are_refused(body):
    with pytest.raises(SceneError, match="gather_all"):
        gather_all(body.p, body.power[:-1], body.table, points(body.queries[:4]))


def test_scattered_points_get_the_same_sums_in_their_own_order(body, octree):
    shuffled = np.random.default_rng(5).permutation(body.queries)
    plain = gather(octree, body.table, points(shuffled))
    sorted_first = gather(octree, body.table, points(shuffled), scattered=True)
    np.testing.assert_array_equal(as_array(plain), as_array(sorted_first))


def test_samples_that_are_on_the_device_give_the_same_sums(body):
    """Bit for bit those of samples from the host, and no kernel is compiled for another number of them."""
    q, p, power = points(body.queries), points(body.p), mi.Color3f(body.power.T.copy())
    source = device_source(p, power, body.table)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for count in (900, 49, 2500):
            first = [dr.gather(type(x), x, dr.arange(mi.UInt32, count)) for x in (p, power)]
            dr.eval(first)
            dr.kernel_history_clear()
            value = as_array(gather_samples(with_samples(source, *first), q))
            kernels = dr.kernel_history([dr.KernelType.JIT])
            assert kernels and (count == 900 or all(k["cache_hit"] for k in kernels))
            twin = as_array(gather_all(body.p[:count], body.power[:count], body.table, q))
            np.testing.assert_array_equal(value, twin)


def test_no_samples_on_the_device_give_nothing(body):
    none = device_source(dr.zeros(mi.Point3f, 0), dr.zeros(mi.Color3f, 0), body.table)
    assert not as_array(gather_samples(none, points(body.queries[:9]))).any()


@pytest.mark.parametrize("disc", [12.0, 26.0, 40.0])
@pytest.mark.parametrize("profile", ["tabulated", "dipole"])
def test_light_that_enters_over_far_wider_discs_than_the_profile_is_summed(profile, disc):
    """As on a large body with few samples: the fit at the rim of the disc means nothing, and the sum is still that of all samples."""
    table = ProfileTable.from_medium(Medium.from_reflectance([0.7, 1e-3, 1e-3], 1.0, profile=profile), disc)
    p = np.random.default_rng(0).uniform(-20, 20, (300, 3))
    octree, at = build_octree(p, np.ones(300), np.ones((300, 3))), mi.Point3f(*p[:40].T)
    every = np.stack([c.numpy() for c in gather_all(p, np.ones((300, 3)), table, at)])
    found = np.stack([c.numpy() for c in gather(octree, table, at, 1e-3)])
    assert (every > 0).all() and found == pytest.approx(every, rel=0.1)
