"""The measured materials: names, the two tables, and those that are nearly clear or do not scatter in a channel."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import MediumError, PellucidWarning
from pellucid.model import PRESETS, Medium
from pellucid.model.materials import LIQUIDS, MATERIALS, SOLIDS, clear_warning


def test_every_name_stands_for_one_material():
    assert (len(SOLIDS), len(LIQUIDS)) == (12, 35)
    assert len(MATERIALS) == 47  # no liquid has the name of a solid
    assert all(name.isidentifier() and name == name.lower() for name in MATERIALS)


@pytest.mark.parametrize("name", ["lowfat_milk", "Lowfat Milk", "LOWFAT MILK"])
def test_names_are_taken_in_any_spelling(name):
    assert Medium.from_preset(name).name == "lowfat_milk"


def test_the_reduced_coefficients_are_those_of_every_channel():
    milk = Medium.from_preset("regular_milk")
    assert milk.sigma_s_prime == pytest.approx(np.multiply((18.2052, 20.3826, 22.3698), (0.25, 0.286, 0.319)))
    assert milk.sigma_a == pytest.approx((0.00153, 0.0046, 0.01993))
    assert milk.g == pytest.approx(np.mean((0.75, 0.714, 0.681))) and milk.eta == 1.33


def test_two_copies_agree_on_one_that_is_often_wrong():
    """Reduced coefficients of head_shoulders_shampoo and espresso, from the other copy of the table."""
    assert LIQUIDS["head_shoulders_shampoo"].sigma_s_prime == pytest.approx((0.0238, 0.0288, 0.0343), rel=5e-3)
    assert LIQUIDS["espresso"].sigma_s_prime == pytest.approx((0.72378, 0.84557, 1.0247), rel=5e-3)


def test_a_material_with_a_channel_that_does_not_scatter_is_refused():
    with pytest.raises(MediumError, match=r"'coke' does not scatter in its blue channel"):
        Medium.from_preset("Coke")
    with pytest.raises(MediumError, match="green and blue channel"):
        Medium.from_preset("merlot")


def test_a_material_that_is_nearly_clear_warns_when_it_is_drawn():
    assert clear_warning("wholemilk") is None
    with pytest.warns(PellucidWarning, match=r"'clorox' is nearly clear: light goes 33 mm"):
        mi.load_dict({"type": "pellucid_translucent", "material": "Clorox"})


def test_what_is_offered_can_be_made():
    assert len(PRESETS) == 28
    for name in PRESETS:
        assert clear_warning(name) is None and Medium.from_preset(name).g <= 0.95
