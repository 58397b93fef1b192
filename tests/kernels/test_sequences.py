"""Even sets of numbers and points: strata, gaps, shifts, and what they are compared with."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from pellucid.kernels.even_sampler import EvenSampler
from pellucid.kernels.sequences import (
    GOLDEN,
    R2,
    even_numbers,
    fibonacci_disc,
    fibonacci_lattice,
    fraction,
    hammersley_set,
    independent_points,
    kronecker,
    r2,
    r2_points,
    radical_inverse,
)


def test_even_numbers():
    u = even_numbers(mi.Float, 900, seed=1).numpy()
    assert (np.floor(u.astype(float) * 900) == np.arange(900)).all()
    np.testing.assert_array_equal(u, even_numbers(mi.Float, 900, seed=1).numpy())
    assert (u != even_numbers(mi.Float, 900, seed=2).numpy()).any()
    shifts = [even_numbers(mi.Float, 9, seed=seed).numpy()[0] * 9 for seed in range(200)]
    assert stats.kstest(shifts, "uniform").pvalue > 1e-3
    assert even_numbers(mi.Float, 1 << 22).numpy().max() < 1


def test_the_radical_inverse_mirrors_bits():
    found = radical_inverse(dr.arange(mi.UInt32, 8)).numpy()
    assert found.tolist() == [0, 1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8, 7 / 8]


def lattice(count, stream=0, seed=0, points=fibonacci_lattice):
    index = dr.arange(mi.UInt32, count)
    return points(index, mi.UInt32(count), mi.UInt32(stream), seed).numpy()


SETS = {
    "hammersley": lambda count: np.stack([x.numpy() for x in hammersley_set(mi.Float, count, 3)]),
    "fibonacci": lattice,
    "r2": lambda count: np.stack([fraction(x).numpy() for x in kronecker(dr.arange(mi.UInt32, count), R2, (7, 9))]),
}


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("count", [61, 256])
def test_sets_of_the_square_are_far_more_even_than_chance(name, count):
    points = SETS[name](count)
    assert points.min() >= 0 and points.max() < 1
    chance = np.mean([qmc.discrepancy(lattice(count, seed=s, points=independent_points).T) for s in range(20)])
    assert qmc.discrepancy(points.T) < 0.2 * chance


def test_hammersley_is_the_most_even_where_the_number_is_a_power_of_two():
    cells = np.floor(SETS["hammersley"](256) * 16).astype(int)
    assert (np.bincount(cells[0] * 16 + cells[1], minlength=256) <= 2).all()
    assert len(set(np.floor(SETS["hammersley"](256)[0] * 256))) == 256


def test_every_stream_of_the_lattice_is_shifted_by_itself():
    lane = dr.arange(mi.UInt32, 1500)
    x, y = fibonacci_lattice(lane % 5, mi.UInt32(5), lane // 5, 0).numpy().reshape(2, 300, 5)
    assert (np.floor(x * 5) == np.arange(5)).all()
    assert stats.kstest(y[:, 0], "uniform").pvalue > 1e-3
    assert np.allclose(np.diff(y, axis=1) % 1, GOLDEN, atol=1e-6)


def test_places_of_lanes_go_on_from_turn_to_turn():
    number = dr.arange(mi.UInt32, 50)
    first, later = (r2_points(number, turn).numpy() for turn in (0, 11))
    np.testing.assert_allclose((later - first) % 1, np.broadcast_to(np.array(r2(11))[:, None], (2, 50)), atol=1e-6)
    assert stats.kstest(first.ravel(), "uniform").pvalue > 1e-3


def test_points_of_the_disc_have_equal_areas():
    radius, angle = fibonacci_disc(400)
    np.testing.assert_allclose(radius**2 * 400, np.arange(400) + 0.5)
    assert np.bincount((angle % (2 * np.pi) // (np.pi / 4)).astype(int)).std() < 2


@pytest.mark.parametrize("columns", [1, 4, 16])
def test_every_run_of_scrambled_points_is_even(columns):
    """Each aligned run of 16 indices has one point in each of 16 boxes, of any shape; and all 4096 fill 64 by 64 boxes."""
    sampler = EvenSampler.from_indices(dr.arange(mi.UInt32, 4096), 3)
    first, second = (np.array(sampler.next_2d()).T for _ in range(2))
    for points in (first, second):
        box = (points * [columns, 16 // columns]).astype(int) @ [16 // columns, 1]
        assert (np.sort(box.reshape(-1, 16), axis=1) == np.arange(16)).all()
        assert len(np.unique((points * 64).astype(int) @ [64, 1])) == 4096
    assert abs(np.corrcoef(first[:, 0], second[:, 0])[0, 1]) < 0.05
    other = np.array(EvenSampler.from_indices(dr.arange(mi.UInt32, 4096), 4).next_2d()).T
    assert not np.array_equal(first, other)
