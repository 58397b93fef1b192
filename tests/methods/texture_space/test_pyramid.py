"""Texels drawn in proportion to their values: exact, chi-square, twins, precision, kernels."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from pellucid.errors import SceneError
from pellucid.kernels.morton import deinterleave
from pellucid.kernels.sequences import even_numbers, hammersley_set
from pellucid.methods.texture_space.pyramid import (
    build_pyramid,
    build_rows,
    sample_pyramid,
    sample_rows,
    warp_points,
)


def warp(pyramid, u):
    return warp_points(pyramid, u, randoms(dr.width(u), 99))


ORDERS = {"mipmap": (build_pyramid, sample_pyramid), "rows": (build_rows, sample_rows), "plane": (build_pyramid, warp)}
every_order = pytest.mark.parametrize("order", ORDERS)
both_orders = pytest.mark.parametrize("order", ["mipmap", "rows"])


def texture(resolution, seed=0):
    """Values over many orders of magnitude, and nothing at all in two fifths of the texels."""
    rng = np.random.default_rng(seed)
    values = np.exp(2 * rng.normal(size=resolution**2)).astype(np.float32)
    values[rng.random(resolution**2) < 0.4] = 0
    return values


def draw(order, values, u):
    build, sample = ORDERS[order]
    texel, value = sample(build(mi.Float(values), int(np.sqrt(len(values)))), u)
    np.testing.assert_array_equal(value.numpy(), values[texel.numpy()])
    return texel.numpy()


def randoms(count, seed=0):
    return mi.Float(np.random.default_rng(seed).random(count, np.float32))


def test_levels_are_sums_over_quarters():
    values = texture(16)
    pyramid = build_pyramid(mi.Float(values), 16)
    assert [dr.width(level) for level in pyramid.levels] == [1, 4, 16, 64]
    for level, array in enumerate(pyramid.levels):
        side = 1 << level
        block = 16 // side
        expected = values.reshape(side, block, side, block).sum(axis=(1, 3), dtype=float)
        x, y = deinterleave(dr.arange(mi.UInt32, side**2))
        np.testing.assert_allclose(array.numpy(), expected[y.numpy(), x.numpy()], rtol=1e-6)


def test_the_order_of_the_paper():
    """Figure 2b: a quarter of the texture after the other, and in each of them a quarter of it."""
    order = draw("mipmap", np.ones(16, np.float32), (dr.arange(mi.Float, 16) + 0.5) / 16)
    assert order.tolist() == [0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 12, 13, 10, 11, 14, 15]
    assert draw("rows", np.ones(16, np.float32), (dr.arange(mi.Float, 16) + 0.5) / 16).tolist() == list(range(16))


@every_order
@pytest.mark.parametrize("resolution", [2, 8, 32])
def test_chi_square(order, resolution):
    values = texture(resolution, seed=1)
    texel = draw(order, values, randoms(400_000))
    expected = values.astype(float) / values.sum(dtype=float) * 400_000
    count = np.bincount(texel, minlength=len(values))
    assert not count[values == 0].any()
    rare = expected < 10  # taken together, as the test asks for
    seen = np.append(count[~rare], count[rare].sum())
    wanted = np.append(expected[~rare], expected[rare].sum())
    assert stats.chisquare(seen[wanted > 0], wanted[wanted > 0]).pvalue > 1e-3


def test_all_orders_draw_from_one_distribution():
    values = texture(64, seed=2)
    counts = [
        np.bincount(draw(order, values, randoms(300_000, seed)), minlength=len(values))
        for order, seed in (("mipmap", 3), ("rows", 4), ("plane", 5))
    ]
    enough = sum(counts) > 30
    assert stats.chi2_contingency([c[enough] for c in counts]).pvalue > 1e-3


@both_orders
def test_single_precision_does_not_bias_a_million_texels(order):
    """A fine comb of numbers through the whole sum: every texel, and every block of texels, gets its share to a tooth."""
    values, count = texture(1024), 1 << 22
    texel = draw(order, values, (dr.arange(mi.Float, count) + 0.5) / count)
    excess = np.bincount(texel, minlength=1 << 20) - values / values.sum(dtype=float) * count
    assert np.abs(excess).max() < 1.5
    assert not (texel[values[texel] == 0]).any()
    # A block is one piece of the sum in the order of the pyramid, and `block` of them in the order of rows.
    for block in (4, 32, 256):
        whole = np.abs(excess.reshape(1024 // block, block, 1024 // block, block).sum(axis=(1, 3))).max()
        assert whole < (1.5 if order == "mipmap" else 4 * np.sqrt(block))


@every_order
def test_ends_of_the_numbers_and_of_the_texture(order):
    ends = mi.Float([0.0, 1e-30, 0.5, 1 - 2.0**-24, 1.0])
    for place in (0, 5, 63):
        values = np.zeros(64, np.float32)
        values[place] = 1e-20
        assert draw(order, values, ends).tolist() == [place] * 5
    values = np.zeros(64, np.float32)
    values[[7, 40]] = 1e-12, 1e12  # a texel that is rounded away next to the other
    assert set(draw(order, values, randoms(1000))) == {40}
    assert ((texel := draw(order, np.zeros(64, np.float32), ends)) < 64).all() and texel.shape == (5,)


def test_even_numbers_give_places_that_are_even_in_both_directions():
    """In the order of the pyramid each of 1024 equal cells of an even texture gets one sample, in that of rows not."""
    u = even_numbers(mi.Float, 1024, seed=5)
    cells = {}
    for order in ("mipmap", "rows"):
        texel = draw(order, np.ones(256**2, np.float32), u)
        y, x = np.divmod(texel, 256)
        cells[order] = np.bincount(y // 8 * 32 + x // 8, minlength=1024)
    assert (cells["mipmap"] == 1).all()
    assert (cells["rows"] != 1).any()


def test_even_points_stay_even_and_move_little_when_values_change_little():
    x = np.linspace(0.1, 1, 256, dtype=np.float32)
    before = (x[:, None] * x).ravel()
    after = (x[:, None] * x * (1 + 0.02 * np.sin(9 * x))).astype(np.float32).ravel()
    strayed = {}
    for order in ("mipmap", "plane"):
        places = []
        for values in (before, after):
            pyramid = build_pyramid(mi.Float(values), 256)
            if order == "plane":
                texel, _ = warp_points(pyramid, *hammersley_set(mi.Float, 1024, seed=5))
            else:
                texel, _ = sample_pyramid(pyramid, even_numbers(mi.Float, 1024, seed=5))
            places.append(np.stack(np.divmod(texel.numpy().astype(float), 256)))
        strayed[order] = np.mean(np.linalg.norm(places[1] - places[0], axis=0) > 16)
    assert strayed["plane"] < 0.5 * strayed["mipmap"]

    texel, _ = warp_points(
        build_pyramid(mi.Float(np.ones(256**2, np.float32)), 256), *hammersley_set(mi.Float, 1024, 3)
    )
    y, x = np.divmod(texel.numpy(), 256)
    assert np.bincount(y // 8 * 32 + x // 8, minlength=1024).var() < 0.5  # 1 at random


@both_orders
def test_another_number_of_samples_needs_no_other_kernel(order):
    build, sample = ORDERS[order]
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for count in (100, 49, 2501):
            values = mi.Float(texture(32, count)) + dr.opaque(mi.Float, 0)
            dr.eval(values)
            dr.kernel_history_clear()
            texel, value = sample(build(values, 32), even_numbers(mi.Float, count, count))
            dr.eval(texel, value)
            kernels = dr.kernel_history([dr.KernelType.JIT])
            assert kernels and (count == 100 or all(k["cache_hit"] for k in kernels))


@both_orders
@pytest.mark.parametrize(
    ("resolution", "count", "words"), [(100, 10_000, "64 or 128"), (0, 0, "2"), (8, 63, "found 63")]
)
def test_textures_that_cannot_be_halved(order, resolution, count, words):
    with pytest.raises(SceneError, match=words):
        ORDERS[order][0](dr.zeros(mi.Float, count), resolution)
