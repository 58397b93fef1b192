"""Warnings where diffusion is off, justified by the measured table."""

import json
from pathlib import Path

import numpy as np
import pytest

from pellucid.model import Medium, validity
from pellucid.model.validity import reflectance_error

MEASURED = Path(__file__).parents[2] / "docs" / "figures" / "dipole_accuracy.json"


def test_estimate_is_what_was_measured():
    rows = json.loads(MEASURED.read_text())["rows"]
    assert len(rows) == 55
    for row in rows:
        worst = max(abs(row["dipole"] / row[total] - 1) for total in ("total", "total_forward"))
        assert reflectance_error(row["albedo_prime"], row["eta"]) == pytest.approx(worst, abs=0.0051)


def test_dipole_column_is_this_codes():
    for row in json.loads(MEASURED.read_text())["rows"]:
        medium = Medium(row["albedo_prime"], 1 - row["albedo_prime"], eta=row["eta"], profile="dipole")
        assert row["dipole"] == pytest.approx(medium.total_diffuse_reflectance[0], rel=1e-4)


@pytest.mark.parametrize("name", ["marble", "cream", "wholemilk", "spectralon", "apple", "skin2"])
def test_white_materials_are_fine(name):
    assert validity(Medium.from_preset(name, profile="dipole")) == []


def test_dark_channels_are_named():
    (warning,) = validity(Medium.from_preset("skin1", profile="dipole"))
    assert "blue channel of 'skin1'" in warning and "26%" in warning
    assert len(validity(Medium(0.5, 0.5, eta=1.5, profile="dipole"))) == 3


def test_darkness_that_nobody_sees_is_not_mentioned():
    assert validity(Medium([1.0, 1.0, 0.01], [0.001, 0.001, 1.0], profile="dipole")) == []


def test_brighter_media_are_never_worse_above_the_threshold():
    errors = np.array([reflectance_error(a, 1.5) for a in np.linspace(0.5, 0.95, 30)])
    assert np.all(np.diff(errors) < 0)


def test_tables_have_no_error_of_diffusion_but_an_end():
    assert validity(Medium.from_preset("skin1")) == []
    steep, dense = validity(Medium(1.0, 0.1, g=0.98, eta=2.4))
    assert steep.startswith("g = 0.98 of the medium: profiles are tabulated from -0.5 to 0.95") and dense.startswith(
        "eta = 2.4"
    )
    far, end = Medium(1.0, 0.1, g=0.98, eta=2.4), Medium(1.0, 0.1, g=0.95, eta=2.0)
    np.testing.assert_array_equal(far.total_diffuse_reflectance, end.total_diffuse_reflectance)
