"""The grid of neighbours against SciPy's tree and against plain sums."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from pellucid.scene.samples.grid import NONE, PointGrid


def ball(count, seed, flatten=1.0):
    rng = np.random.default_rng(seed)
    v = rng.normal(size=(count, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return (v * [1, 1, flatten]).astype(np.float32)


def device(p):
    up = mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, len(p))
    return mi.Point3f(p.T.copy()), up


@pytest.mark.parametrize(("count", "cell", "flatten"), [(1, 0.1, 1), (300, 0.3, 1), (20000, 0.002, 1), (5000, 0.05, 0)])
def test_nearest_agrees_with_scipy(count, cell, flatten):
    # The third case has a thousand cells a side, few of them occupied: rows share table entries.
    p, q = ball(count, 1, flatten), ball(4000, 2, flatten)
    found = PointGrid(*device(p), cell).nearest(*device(q)).numpy()
    distance, index = cKDTree(p).query(q)
    near = distance < cell * (1 - 1e-5)
    assert np.array_equal(found[near], index[near])
    assert np.all(found[distance > cell * (1 + 1e-5)] == NONE)


def test_repulsion_sees_every_neighbour_once():
    p, cell = ball(800, 3), 0.25
    grid = PointGrid(*device(p), cell)
    away = p[:, None].astype(float) - p[None]
    distance = np.linalg.norm(away, axis=2)
    np.fill_diagonal(distance, 9)
    weight = np.where(distance < cell, 1 / distance - 1 / cell, 0)
    expected = np.einsum("ij,ijc->ic", weight, away)
    np.testing.assert_allclose(grid.repulsion().numpy().T, expected[grid.order.numpy()], atol=2e-5)


def test_opposite_normals_are_no_neighbours():
    p = np.array([[0, 0, 0], [0, 0, 0.01]], np.float32)
    n = mi.Normal3f([0, 0], [0, 0], [1, -1])
    grid = PointGrid(mi.Point3f(p.T.copy()), n, 0.1)
    assert np.all(grid.repulsion().numpy() == 0)
    assert np.array_equal(np.sort(grid.nearest(mi.Point3f(0, 0, 0.005) + dr.zeros(mi.Point3f, 2), n).numpy()), [0, 1])
    assert np.all(grid.first_among_near(mi.UInt32([1, 2])).numpy())


def test_only_normals_more_than_120_degrees_apart_are_opposite():
    rng = np.random.default_rng(6)
    p = np.zeros((4000, 3), np.float32)
    p[:, 0] = np.arange(len(p))
    one, other = (unit / np.linalg.norm(unit, axis=0) for unit in rng.normal(size=(2, 3, len(p))).astype(np.float32))
    points = mi.Point3f(p.T.copy())
    found = PointGrid(points, mi.Normal3f(one), 0.1).nearest(points, mi.Normal3f(other)).numpy()
    cosine = (one * other).sum(axis=0)
    clear = np.abs(cosine + 0.5) > 0.003
    assert np.array_equal((found == np.arange(len(p)))[clear], (cosine > -0.5)[clear])
    assert np.isin(found[cosine < -0.503], NONE).all() and (cosine < -0.503).sum() > 500


def test_first_of_each_neighbourhood_has_the_lowest_priority():
    p, cell = ball(500, 4), 0.2
    grid = PointGrid(*device(p), cell)
    priority = np.random.default_rng(5).integers(0, 50, len(p), dtype=np.uint32)
    first = grid.first_among_near(mi.UInt32(priority)).numpy()
    place = p[grid.order.numpy()]
    near = np.linalg.norm(place[:, None] - place[None], axis=2) < cell
    rank = priority.astype(np.int64) * len(p) + np.arange(len(p))
    expected = np.array([np.min(rank[row]) for row in near]) == rank
    assert np.array_equal(first, expected)


def test_means_keep_what_is_even_and_do_not_mix_sides():
    """A constant stays, noise falls, and the two sides of a thin sheet do not see each other."""
    rng = np.random.default_rng(0)
    p = np.repeat(rng.random((2000, 3)) * [1, 1, 0], 2, axis=0).astype(np.float32)
    n = np.tile([[0, 0, 1.0], [0, 0, -1.0]], (2000, 1)).astype(np.float32)
    side = n[:, 2] > 0
    noisy = np.where(side, 1, 5) + rng.normal(size=4000)
    values = [mi.Color3f(2.0) + dr.zeros(mi.Color3f, 4000), mi.Color3f(*np.tile(noisy.astype(np.float32), (3, 1)))]
    constant, averaged = PointGrid(mi.Point3f(p.T), mi.Normal3f(n.T), 0.1).means(values)
    np.testing.assert_allclose(constant.numpy(), 2, rtol=1e-5)
    averaged = averaged.numpy()[0]
    assert averaged[side].mean() == pytest.approx(1, abs=0.1) and averaged[~side].mean() == pytest.approx(5, abs=0.1)
    assert averaged[side].std() < 0.25
