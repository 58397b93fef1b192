"""The two parts of R_d: weights, radii, and tables of either."""

import drjit.llvm
import numpy as np
import pytest

from pellucid.errors import MediumError
from pellucid.model import PRESETS, Medium, ProfileTable
from pellucid.model.decomposition import Decomposition, decompose, equal_radii, importance
from pellucid.model.materials import SOLIDS
from pellucid.model.profiles import mean_over_disc

LOCAL = [name for name in SOLIDS if decompose(Medium.from_preset(name, profile="dipole")).radius > 0]


def table_lookup(table, r):
    return np.stack([c.numpy() for c in table.lookup(drjit.llvm.Float((r * r).astype(np.float32)))], axis=1)


def test_both_parts_together_are_the_whole():
    split = Decomposition(2.4, 1.5)
    r = np.linspace(0, 40, 4001)
    near, far = split.local_weight(r), split.global_weight(r)
    np.testing.assert_allclose(near + far, 1, rtol=1e-15)
    assert near.min() >= 0 and far.min() >= 0
    assert np.all(np.diff(near[:, 0]) <= 0)


def test_weights_are_even_and_smooth_at_the_radius():
    """Misprint of the paper: with the sign as printed W_l jumps at no place but is negative at 0; here it tends to 1."""
    split = Decomposition(2.4, 1.5)
    step = 1e-6
    before, at, after = split.local_weight(np.array([2.4 - step, 2.4, 2.4 + step]))[:, 0]
    assert at == 0.5
    assert (before - at) / step == pytest.approx(0.75, rel=1e-4) == (at - after) / step
    assert split.local_weight(0.0)[0] == pytest.approx(1 - 0.5 * np.exp(-2.4 * 1.5))
    assert split.local_weight(np.array([6.0]))[0, 0] == pytest.approx(0.5 * np.exp(-3.6 * 1.5))


def test_the_papers_radius_for_the_red_channel_of_skimmilk():
    """It prints 2.4141 mm; the root for a bound of 0.1 per millimetre is 2.4163 mm."""
    medium = Medium.from_preset("skimmilk", profile="dipole")
    assert importance(medium, 2.4141)[0] == pytest.approx(0.1, rel=2e-3)
    assert equal_radii(medium, 0.1)[0] == pytest.approx(2.4141, rel=1e-3)
    assert decompose(medium).radius == equal_radii(medium, 0.1).max()


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("bound", [0.01, 0.03, 0.1])
def test_radii_are_the_largest_roots(name, bound):
    medium = Medium.from_preset(name, profile="dipole")
    radii = equal_radii(medium, bound)
    r = np.geomspace(1e-3, 1e3, 20001)
    for k in range(3):
        above = r[importance(medium, r)[:, k] > bound]
        if radii[k] == 0:
            assert len(above) == 0
        else:
            assert importance(medium, radii[k])[k] == pytest.approx(bound, rel=1e-6)
            assert radii[k] == pytest.approx(above.max(), rel=1e-3)


def test_a_medium_that_blurs_widely_has_no_local_part():
    split = decompose(Medium.from_preset("chicken1", profile="dipole"))
    assert split.radius == 0
    r = np.linspace(0, 10, 11)
    assert np.all(split.local_weight(r) == 0) and np.all(split.global_weight(r) == 1)
    assert (
        ProfileTable.from_medium(Medium.from_preset("chicken1", profile="dipole"), weight=split.local_weight).last == 1
    )


def test_the_unit_of_length_does_not_matter():
    in_mm, in_metres = (
        decompose(Medium.from_preset("marble", scale, "dipole"), scale=scale) for scale in (1.0, 1000.0)
    )
    assert in_metres.radius * 1000 == pytest.approx(in_mm.radius)
    assert in_metres.local_weight(0.003)[0] == pytest.approx(in_mm.local_weight(3.0)[0])


@pytest.mark.parametrize("bound", [0.0, -1.0, np.nan, np.inf])
def test_a_bound_that_cannot_be(bound):
    with pytest.raises(MediumError, match="must be positive"):
        decompose(Medium.from_preset("marble", profile="dipole"), bound)


@pytest.mark.parametrize("name", LOCAL)
def test_tables_of_both_parts_add_up_to_that_of_the_whole(name):
    medium = Medium.from_preset(name, profile="dipole")
    split = decompose(medium)
    r = np.concatenate([[0], np.geomspace(1e-3, 60, 5000)])
    near, far = (
        table_lookup(ProfileTable.from_medium(medium, weight=w), r) for w in (split.local_weight, split.global_weight)
    )
    whole = medium.diffuse_reflectance(r)
    seen = whole > 1e-6 * whole[0]
    np.testing.assert_allclose((near + far)[seen], whole[seen], rtol=5e-3)
    closed = whole * split.local_weight(r)
    seen = closed > 1e-6 * whole[0]
    np.testing.assert_allclose(near[seen], closed[seen], rtol=1e-3)


@pytest.mark.parametrize("disc", [0.3, 3.0])
def test_the_mean_of_a_part_over_a_disc_keeps_its_integral(disc):
    medium = Medium.from_preset("marble", profile="dipole")
    split = decompose(medium)
    r2 = np.concatenate([[0], np.geomspace(1e-4, 600.0**2, 6000)])
    r, rings = np.sqrt(0.5 * (r2[1:] + r2[:-1])), np.pi * np.diff(r2)[:, None]
    for weight in (split.local_weight, split.global_weight):
        point, spread = (rings * mean_over_disc(medium, r, d, weight) for d in (0.0, disc))
        np.testing.assert_allclose(spread.sum(axis=0), point.sum(axis=0), rtol=3e-3)
        table = table_lookup(ProfileTable.from_medium(medium, disc, weight), r)
        np.testing.assert_allclose((rings * table).sum(axis=0), point.sum(axis=0), rtol=6e-3)
