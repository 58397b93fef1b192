"""Derivatives of the sums: against Dr.Jit's own and finite differences of the direct sum, transposes by dot tests, costs."""

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.gather.derivatives import DirectDerivatives, TreeDerivatives
from pellucid.gather.gather import gather, gather_all
from pellucid.gather.octree import build_octree
from pellucid.model.fresnel import boundary_mismatch
from pellucid.model.medium import PROFILES, Medium
from pellucid.model.profiles import ProfileTable
from pellucid.model.slopes import log_slopes, moved
from worlds.points import spread_on_sphere

NAMES = ("sigma_a", "sigma_s_prime", "eta")
SAMPLES, POINTS, RADIUS = 800, 301, 15.0


def points(p):
    return mi.Point3f(*np.ascontiguousarray(p.T, np.float32))


def as_array(color):
    return np.stack([c.numpy() for c in color], axis=1).astype(np.float64)


class Problem:
    """A lit sphere, points on it, and weights of both signs."""

    def __init__(self, profile, disc=0.0):
        rng = np.random.default_rng(4)
        self.medium = Medium.from_preset("marble", profile=profile)
        self.p = (RADIUS * spread_on_sphere(SAMPLES, 0)).astype(np.float32)
        self.q = (RADIUS * spread_on_sphere(POINTS, 2)).astype(np.float32)
        self.area = np.full(SAMPLES, 4 * np.pi * RADIUS**2 / SAMPLES)
        self.power = (rng.random((SAMPLES, 3)) * 4).astype(np.float32)
        self.weights = (rng.random((POINTS, 3)) - 0.3).astype(np.float32)
        self.power_step = rng.normal(size=(SAMPLES, 3)).astype(np.float32)
        self.theta_steps = [rng.normal(size=3) for _ in NAMES]
        self.table = ProfileTable.from_medium(self.medium, disc)
        self.slopes = [log_slopes(self.medium, self.table, name) for name in NAMES]
        self.at, self.towards = points(self.q), points(self.weights)

    def direct(self):
        return DirectDerivatives(self.p, self.power, self.table, self.slopes, dr.detached_t(mi.Float))

    def tree(self, max_error=0.1):
        octree = build_octree(self.p, self.area, self.power)
        return TreeDerivatives(octree, self.table, self.slopes, max_error, 1.0, dr.detached_t(mi.Float))


@pytest.fixture(scope="module", params=[name for name in PROFILES if not PROFILES[name].is_curved])
def problem(request):
    return Problem(request.param)


@pytest.fixture(params=["direct", "tree"])
def derivatives(request, problem):
    return getattr(problem, request.param)()


def oracle(problem):
    """The gradients of ``sum weights B`` by Dr.Jit from the closed form of the dipole, in double precision: by theta and by power."""
    Float = mi.Float64
    pair = dr.arange(mi.UInt32, SAMPLES * POINTS)
    j, i = pair // POINTS, pair % POINTS
    eta = Float(problem.medium.eta)
    dr.enable_grad(eta)
    total, inputs = Float(0), []

    def take(array, index):
        return dr.gather(Float, Float(np.ascontiguousarray(array, np.float64)), index)

    d2 = sum((take(problem.p[:, k], j) - take(problem.q[:, k], i)) ** 2 for k in range(3))
    for c in range(3):
        a, s = Float(problem.medium.sigma_a[c]), Float(problem.medium.sigma_s_prime[c])
        power = Float(problem.power[:, c].astype(np.float64))
        dr.enable_grad(a, s, power)
        decay = dr.sqrt(3 * a * (a + s))
        profile = Float(0)
        for depth in (1 / (a + s), (1 + 4 / 3 * boundary_mismatch(eta)) / (a + s)):
            d = dr.sqrt(d2 + depth * depth)
            profile += depth * (decay + 1 / d) * dr.exp(-decay * d) / (d * d)
        profile *= s / (a + s) / (4 * dr.pi)
        total += dr.sum(profile * dr.gather(Float, power, j) * take(problem.weights[:, c], i))
        inputs.append((a, s, power))
    dr.backward(total)
    theta = [[(dr.grad(v[k]) * dr.detach(v[k]))[0] for v in inputs] for k in range(2)]
    return theta, dr.grad(eta)[0] * problem.medium.eta, np.stack([dr.grad(v[2]).numpy() for v in inputs], axis=1)


@pytest.mark.parametrize("kind", ["direct", "tree"])
def test_gradients_are_those_of_automatic_differentiation(kind):
    problem = Problem("dipole")
    sums = getattr(problem, kind)(*([0.0] if kind == "tree" else []))
    theta, eta, power = oracle(problem)
    found, found_power = sums.gradient(problem.at, problem.towards)
    np.testing.assert_allclose(found[0], theta[0], rtol=2e-3)
    # The two ways in which scattering acts nearly cancel: what is left is compared with their size, that of the sum.
    size = np.abs(as_array(gather_all(problem.p, problem.power, problem.table, problem.at)) * problem.weights).sum()
    np.testing.assert_allclose(found[1], theta[1], atol=3e-4 * size)  # 1e-3 of R in the table
    np.testing.assert_allclose(found[2].sum(), eta, rtol=5e-3)
    np.testing.assert_allclose(found_power, power, atol=1e-3 * np.abs(power).max())


def test_gradients_are_those_of_finite_differences(problem, derivatives):
    """Of the sum in double precision, for every profile."""
    distance = np.linalg.norm(problem.q[:, None].astype(float) - problem.p[None], axis=-1)
    found, _ = derivatives.gradient(problem.at, problem.towards, of_power=False)
    for name, gradient in zip(NAMES, found, strict=True):
        up, down = (
            np.einsum(
                "qnc,nc,qc->c",
                moved(problem.medium, name, h).diffuse_reflectance(distance),
                problem.power,
                problem.weights,
            )
            for h in (1e-3, -1e-3)
        )
        np.testing.assert_allclose(gradient, (up - down) / 2e-3, rtol=0.01, atol=2e-3 * np.abs(up).max())


def test_the_two_directions_are_transposes(problem, derivatives):
    change = as_array(derivatives.change(problem.at, problem.theta_steps, problem.power_step))
    theta, power = derivatives.gradient(problem.at, problem.towards)
    products = change * problem.weights
    other = (
        sum(g @ step for g, step in zip(theta, problem.theta_steps, strict=True)) + (power * problem.power_step).sum()
    )
    assert products.sum() == pytest.approx(other, abs=1e-5 * np.abs(products).sum())


def test_a_tree_that_accepts_nothing_has_the_derivatives_of_the_direct_sum(problem):
    (theta, power), (direct, direct_power) = (
        d.gradient(problem.at, problem.towards) for d in (problem.tree(0.0), problem.direct())
    )
    np.testing.assert_allclose(theta, direct, rtol=1e-4, atol=1e-5 * np.abs(direct).max())
    np.testing.assert_allclose(power, direct_power, atol=1e-5 * np.abs(direct_power).max())


def test_the_tree_changes_as_its_own_sum_does(problem):
    """The sum over clusters at a medium a little moved, the same clusters: within 1 % of its change."""
    octree = build_octree(problem.p, problem.area, problem.power)
    derivatives = problem.tree()
    for k, name in enumerate(NAMES):
        steps = [np.full(3, float(k == n)) for n in range(len(NAMES))]
        change = as_array(derivatives.change(problem.at, steps, None))
        up, down = (
            as_array(gather(octree, ProfileTable.from_medium(moved(problem.medium, name, h)), problem.at))
            for h in (0.01, -0.01)
        )
        error = (up - down) / 0.02 - change
        assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((change**2).mean())


def test_light_over_discs_has_the_slope_of_its_mean():
    problem = Problem("tabulated", disc=0.5)
    change = as_array(problem.direct().change(problem.at, [np.ones(3), np.zeros(3), np.zeros(3)], None))
    up, down = (
        as_array(
            gather_all(
                problem.p, problem.power, ProfileTable.from_medium(moved(problem.medium, "sigma_a", h), 0.5), problem.at
            )
        )
        for h in (0.01, -0.01)
    )
    error = (up - down) / 0.02 - change
    assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((change**2).mean())


def walks(work):
    """The largest kernel that some work launches: its lanes, and its operations."""
    work()  # tables are uploaded
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        work()
        dr.sync_thread()
        kernels = dr.kernel_history([dr.KernelType.JIT])
    largest = max(kernels, key=lambda kernel: kernel["operation_count"])
    return largest["size"], largest["operation_count"]


def test_gradients_are_one_walk_of_bounded_work():
    """Clusters are those of the sum: what counts is the work at each. By the coefficients at most twice, with all powers four times."""
    problem = Problem("tabulated")
    octree = build_octree(problem.p, problem.area, problem.power)
    two = TreeDerivatives(octree, problem.table, problem.slopes[:2], 0.1, 1.0, dr.detached_t(mi.Float))
    lanes, forward = walks(lambda: dr.eval(gather(octree, problem.table, problem.at)))
    for of_power, most in ((False, 2), (True, 4)):
        width, operations = walks(partial(two.gradient, problem.at, problem.towards, of_power))
        assert width == lanes and operations < most * forward
