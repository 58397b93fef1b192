"""The order of Morton, in space and in the plane."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.kernels.morton import LEVELS, deinterleave, interleave, morton_codes, morton_order, shared_digits


def test_codes_name_the_octants():
    p = np.array([[0, 0, 0], [7, 7, 7], [0, 0, 4], [0, 4, 0], [4, 0, 0]], np.float32)
    first = morton_codes(p) >> np.uint64(3 * (LEVELS - 1))
    assert first.tolist() == [0, 7, 1, 2, 4]


def test_shared_digits_count_octal_digits():
    codes = np.array([0o1234, 0o1235, 0o1735, 0o1735], np.uint64)
    assert shared_digits(codes).tolist() == [-1, LEVELS - 1, LEVELS - 3, LEVELS, -1]


def test_codes_follow_the_bits_of_every_axis():
    cells = np.random.default_rng(3).integers(0, 2**LEVELS, (50, 3))
    cells[0], cells[1] = 0, 2**LEVELS - 1
    codes = morton_codes((cells * (1.0 / (2**LEVELS - 1))).astype(np.float64))
    for cell, code in zip(cells, codes, strict=True):
        bits = "".join(f"{(x >> b) & 1}" for b in reversed(range(LEVELS)) for x in cell)
        # The cube ends at the last cell, so cells are rounded by up to one.
        assert all(abs(int(format(int(code), "063b")[axis::3], 2) - int(bits[axis::3], 2)) <= 1 for axis in range(3))


def test_the_order_follows_the_codes():
    p = np.random.default_rng(1).random((500, 3)).astype(np.float32)
    digits = morton_codes(p[morton_order(p)]) >> np.uint64(31)
    assert (digits[1:] >= digits[:-1]).all() and len(np.unique(digits)) > 400


@pytest.mark.parametrize("kind", [lambda x: x, mi.UInt32], ids=["host", "device"])
def test_bits_of_the_plane_are_interleaved_and_taken_apart_again(kind):
    x, y = np.random.default_rng(2).integers(0, 1 << 16, (2, 200)).astype(np.uint32)
    code = interleave(kind(x), kind(y))
    expected = [
        sum((a >> b & 1) << 2 * b | (c >> b & 1) << 2 * b + 1 for b in range(16))
        for a, c in zip(x.tolist(), y.tolist(), strict=True)
    ]
    assert np.array(code).tolist() == expected
    for back, was in zip(deinterleave(code), (x, y), strict=True):
        np.testing.assert_array_equal(np.array(back), was)
