import numpy as np
import pytest

from pellucid.errors import PellucidError
from pellucid.metrics import relative_rmse, rmse


def test_rmse_of_a_constant_offset_is_the_offset():
    reference = np.random.default_rng(0).random((5, 7, 3))
    assert rmse(reference + 0.25, reference) == pytest.approx(0.25)


def test_rmse_weighs_large_errors_more_than_their_share():
    picture = np.zeros((2, 2, 3))
    picture[0, 0, 0] = 6.0  # one of twelve numbers: 6 / sqrt(12)
    assert rmse(picture, np.zeros_like(picture)) == pytest.approx(np.sqrt(3))


def test_single_precision_pictures_are_compared_in_double():
    reference = np.full((64, 64, 3), 1e4, np.float32)
    assert rmse(reference, reference) == 0
    picture = reference.copy()
    picture[0, 0, 0] += 1
    assert rmse(picture, reference) == pytest.approx(1 / np.sqrt(reference.size), rel=1e-9)


def test_relative_rmse_does_not_depend_on_exposure():
    rng = np.random.default_rng(1)
    reference = rng.random((4, 4, 3))
    picture = reference + 0.1 * rng.random((4, 4, 3))
    assert relative_rmse(50 * picture, 50 * reference) == pytest.approx(relative_rmse(picture, reference))
    assert relative_rmse(1.01 * np.ones((3, 3, 3)), np.ones((3, 3, 3))) == pytest.approx(0.01)


def test_a_black_reference_leaves_no_relative_error():
    black = np.zeros((2, 2, 3))
    assert relative_rmse(black, black) == 0
    assert relative_rmse(black + 1, black) == np.inf


@pytest.mark.parametrize("shape", [(2, 3, 3), (3, 2, 4), (0,)])
def test_pictures_of_different_shapes_are_refused(shape):
    with pytest.raises(PellucidError, match="one shape"):
        rmse(np.zeros(shape), np.zeros((3, 2, 3)) if shape != (0,) else np.zeros(0))
