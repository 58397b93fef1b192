"""Derivatives of the sum over drawn samples: by the light of the texels that they are drawn from, and by the medium through discs."""

from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods.texture_space import discs
from pellucid.methods.texture_space.drawing import Drawn, DrawnDerivatives, SampleSum
from pellucid.model.medium import Medium
from pellucid.model.slopes import BOUND, moved
from worlds.points import spread_on_sphere

NAMES = ("sigma_a", "sigma_s_prime")
NO_THETA = [np.zeros(3)] * 3
TEXELS, SAMPLES, POINTS, RADIUS = 200, 300, 101, 15.0


@pytest.fixture(scope="module")
def problem():
    """A lit sphere; some texels are drawn several times, others never; discs of all sizes."""
    rng = np.random.default_rng(4)
    medium = Medium.from_preset("marble", profile="curved")
    p = (RADIUS * spread_on_sphere(TEXELS, 0)).astype(np.float32)
    q = (RADIUS * spread_on_sphere(POINTS, 2)).astype(np.float32)
    index = rng.integers(0, TEXELS // 2, SAMPLES).astype(np.uint32)
    share = rng.uniform(0.5, 2, SAMPLES).astype(np.float32)
    radius = np.append(0, np.geomspace(0.05, 10, SAMPLES - 1)).astype(np.float32)
    drawn = Drawn(mi.UInt32(index), mi.Float(share), mi.Point3f(p[index].T), mi.Float(radius))
    light = rng.random((TEXELS, 3)).astype(np.float32)
    at, n = mi.Point3f(q.T), mi.Normal3f(q.T / np.float32(RADIUS))
    tables = SampleSum.of(medium, 2 * RADIUS)

    def exitance(light, tables=tables):
        power = mi.Color3f((light[index] * share[:, None]).astype(np.float32).T)
        return tables.hold(drawn, power).exitance(at, n).numpy().T.astype(float)

    slopes = [tables.discs.log_slopes(medium, name) for name in NAMES]
    total = tables.hold(drawn, mi.Color3f((light[index] * share[:, None]).T))
    return SimpleNamespace(
        medium=medium,
        light=light,
        exitance=exitance,
        derivatives=DrawnDerivatives(total, drawn, TEXELS, slopes),
        at=at,
        n=n,
        weights=(rng.random((POINTS, 3)) - 0.3).astype(np.float32),
        step=rng.normal(size=(TEXELS, 3)).astype(np.float32),
        theta=[rng.normal(size=3) for _ in (*NAMES, BOUND)],
    )


def as_array(color):
    return np.stack([c.numpy() for c in color], axis=1).astype(np.float64)


def test_the_exitance_is_linear_in_the_light_of_texels(problem):
    """What is drawn kept, the change by any step is the exitance under that step."""
    change = as_array(problem.derivatives.change(problem.at, NO_THETA, problem.step, problem.n))
    np.testing.assert_allclose(change, problem.exitance(problem.step), atol=2e-6 * np.abs(change).max())


def test_the_two_directions_are_transposes(problem):
    change = as_array(problem.derivatives.change(problem.at, problem.theta, problem.step, problem.n))
    theta, power = problem.derivatives.gradient(problem.at, mi.Point3f(problem.weights.T), n=problem.n)
    products = change * problem.weights
    other = sum(g @ step for g, step in zip(theta, problem.theta, strict=True)) + (power * problem.step).sum()
    assert products.sum() == pytest.approx(other, abs=1e-5 * np.abs(products).sum())
    assert not power[TEXELS // 2 :].any() and power[: TEXELS // 2].any(axis=1).mean() > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_the_sum_changes_with_the_medium_as_tables_of_other_media_do(problem, name, monkeypatch):
    """The discs kept: their sizes are multiples of the mean free path."""
    change = as_array(
        problem.derivatives.change(problem.at, [np.full(3, float(name == k)) for k in (*NAMES, BOUND)], None, problem.n)
    )
    sums = []
    for h in (0.02, -0.02):
        other = moved(problem.medium, name, h)
        monkeypatch.setattr(discs, "SMALLEST_DISC", 0.05 * problem.medium.mfp.min() / other.mfp.min())
        sums.append(problem.exitance(problem.light, SampleSum.of(other, 2 * RADIUS)))
    error = (sums[0] - sums[1]) / 0.04 - change
    assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((change**2).mean())
