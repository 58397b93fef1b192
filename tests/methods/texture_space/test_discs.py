"""Discs over which the light of samples enters: their profiles and their sizes."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.gather.gather import gather_samples
from pellucid.gather.source import device_source
from pellucid.kernels.sequences import even_numbers
from pellucid.methods.texture_space import discs
from pellucid.methods.texture_space.discs import DiscTables, disc_radius
from pellucid.methods.texture_space.pyramid import build_pyramid, sample_pyramid
from pellucid.model.medium import Medium
from pellucid.model.profiles import DISC_STEP, ProfileTable, mean_over_disc


@pytest.mark.parametrize("radius", [0.0, 0.3, 1.0, 4.0])
def test_a_sample_is_looked_up_in_the_table_of_its_disc(radius):
    """Against the mean of R_d over the disc of the nearest tabulated size."""
    medium = Medium.from_preset("marble")
    tables = DiscTables.from_medium(medium, 5.0)
    r = np.array([0.0, 0.2, 0.9, 1.7, 3.0, 6.0])
    first = tables.first(mi.Float([radius]))
    size = int(first[0]) // tables.entries
    nearest = tables.smallest * DISC_STEP ** (size - 1) if size else 0.0
    assert abs(np.log(nearest / radius)) <= 0.51 * np.log(DISC_STEP) if radius else nearest == 0
    source = device_source(mi.Point3f(0), mi.Color3f(1, 2, 3), tables.table, first)
    value = np.stack([c.numpy() for c in gather_samples(source, mi.Point3f(mi.Float(r), 0, 0))], axis=1)
    np.testing.assert_allclose(value, mean_over_disc(medium, r, nearest) * [1, 2, 3], rtol=3e-3)


def test_without_discs_there_is_the_table_of_points_alone():
    medium = Medium.from_preset("skin1")
    tables = DiscTables.from_medium(medium, 0.0)
    np.testing.assert_array_equal(tables.table.values, ProfileTable.from_medium(medium).values)
    assert tables.count == 1


def test_samples_stand_for_the_area_that_has_their_share_of_the_light():
    """Half of the texture four times as bright as the other: the areas are 1 to 4, and add up to all of it."""
    values = np.repeat([4.0, 1.0], 64 * 128).astype(np.float32)
    light, area = build_pyramid(mi.Float(values), 128), build_pyramid(dr.full(mi.Float, 0.5, 128**2), 128)
    texel, value = sample_pyramid(light, even_numbers(mi.Float, 320))
    radius = disc_radius(light, area, texel, 320).numpy() / discs.OVERLAP
    stands_for, bright = np.pi * radius.astype(float) ** 2, value.numpy() > 2
    np.testing.assert_allclose(stands_for[bright], 0.5 * values.sum() / 320 / 4, rtol=1e-4)
    np.testing.assert_allclose(stands_for[~bright], 0.5 * values.sum() / 320, rtol=1e-4)
    assert stands_for.sum() == pytest.approx(0.5 * 128**2, rel=1e-3)


def test_discs_without_light():
    dark = build_pyramid(dr.zeros(mi.Float, 64), 8)
    area = build_pyramid(dr.full(mi.Float, 1.0, 64), 8)
    assert not disc_radius(dark, area, mi.UInt32([0, 63]), 2).numpy().any()
