"""Other formats' colours and radii: what comes back of them, by photons, and the lengths that they stand for."""

import numpy as np
import pytest

from pellucid.errors import MediumError
from pellucid.model import Medium
from pellucid.model.conventions import colour_to_albedo, medium_of_colour, principled_albedo, principled_dmfp
from pellucid.model.photon_simulation import simulate
from pellucid.model.tabulated import decay

PHOTONS = 1 << 17


def returned(albedo, g, eta):
    """The part of the entering light that photons say a half space sends back."""
    return simulate(float(albedo), g, eta, PHOTONS).total


@pytest.mark.parametrize("g", [0.0, 0.6])
@pytest.mark.parametrize("colour", [0.2, 0.5, 0.8])
def test_the_formula_of_openpbr_is_that_of_matched_indices(colour, g):
    """The formula is one of even light from all sides; it is known to be good to some percent."""
    assert returned(colour_to_albedo(colour, g), g, 1.0) == pytest.approx(colour, rel=0.04)


@pytest.mark.parametrize("colour, behind", [(0.5, 0.26), (0.8, 0.60)])
def test_behind_an_index_of_one_and_a_half_less_comes_back(colour, behind):
    medium = medium_of_colour(colour, 1.0, 1.5)
    assert medium.sigma_t == pytest.approx(1) and medium.albedo == pytest.approx(colour_to_albedo(colour))
    assert returned(medium.albedo[0], 0.0, 1.5) == pytest.approx(behind, abs=0.01)


@pytest.mark.parametrize("g", [0.0, 0.6])
@pytest.mark.parametrize("colour", [0.2, 0.5, 0.8])
def test_the_principled_walk_returns_its_colour(colour, g):
    assert returned(principled_albedo(colour, g), g, 1.0) == pytest.approx(colour, rel=0.04)


def test_black_and_white_are_colours():
    assert colour_to_albedo([0.0, 1.0]) == pytest.approx([0, 1], abs=1e-4)
    assert principled_albedo([0.0, 1.0]) == pytest.approx([0, 1], abs=2e-3)
    medium = medium_of_colour([0, 0.5, 1], [1, 2, 3], 1.4, g=0.5)
    assert medium.sigma_t == pytest.approx([1, 1 / 2, 1 / 3])


def test_a_radius_may_be_the_diffuse_one():
    """Marble in the examples of OpenPBR: the colour of JMLH01, and its diffuse mean free path in centimetres."""
    radius = np.array([0.851, 0.557, 0.395])
    diffuse = medium_of_colour([0.830, 0.791, 0.753], 10 * radius, 1.5, is_diffuse=True)
    assert diffuse.dmfp == pytest.approx(Medium.from_preset("marble").dmfp, rel=2e-3)
    literal = medium_of_colour([0.830, 0.791, 0.753], 10 * radius, 1.5)
    assert literal.mfp[0] / Medium.from_preset("marble").mfp[0] == pytest.approx(19, abs=0.5)


def test_the_principled_radius_of_skin_is_the_diffuse_one():
    assert principled_dmfp([0.8, 0.5, 0.3], [1, 0.2, 0.1], method="random_walk_skin") == pytest.approx([1, 0.2, 0.1])


def test_the_principled_radius_is_otherwise_four_pi_free_paths():
    dmfp = principled_dmfp(0.5, [1.0, 2.0, 4.0])
    albedo = principled_albedo(0.5)
    assert dmfp * 4 * np.pi == pytest.approx(
        np.array([1, 2, 4]) / decay(float(np.sqrt(3 * (1 - albedo))), 0.0), rel=1e-6
    )


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: medium_of_colour([0.5, 1.2, 0.5], 1, 1.5), r"colour = 1.2 in the green channel"),
        (lambda: medium_of_colour(0.5, [1, 1, 0], 1.5), "radius = 0 in the blue channel"),
        (lambda: medium_of_colour(1.0, 1, 1.5, is_diffuse=True), "no diffuse mean free path"),
        (lambda: principled_dmfp(0.5, 1, method="walk"), "one of random_walk"),
        (lambda: principled_dmfp(0.5, 1, g=0.95), "between 0 and 0.9"),
    ],
)
def test_what_cannot_be_is_refused(call, message):
    with pytest.raises(MediumError, match=message):
        call()
