"""Derivatives of the sums: against Dr.Jit's own and finite differences of the direct sum, transposes by dot tests, costs."""

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.gather.derivatives import SampleDerivatives, TreeDerivatives
from pellucid.gather.gather import gather, gather_all
from pellucid.gather.octree import build_octree
from pellucid.gather.source import sample_source
from pellucid.model.fresnel import boundary_mismatch
from pellucid.model.medium import PROFILES, Medium
from pellucid.model.profiles import ProfileTable
from pellucid.model.slopes import BOUND, log_slopes, moved
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
        self.table = ProfileTable.from_medium(self.medium, disc)
        self.slopes = [log_slopes(self.medium, self.table, name) for name in NAMES]
        self.at, self.towards = points(self.q), points(self.weights)
        is_curved = self.medium.flat_profile.is_curved
        self.up = mi.Normal3f(points(self.q / RADIUS)) if is_curved else None
        self.names = (*NAMES, BOUND) if is_curved else NAMES
        self.theta_steps = [rng.normal(size=3) for _ in self.names]

    def direct(self):
        return SampleDerivatives(sample_source(self.p, self.power, self.table, dr.detached_t(mi.Float)), self.slopes)

    def profile(self, medium):
        """The profile between all points and samples in double precision: on a sphere mu is half the distance over the radius."""
        distance = np.linalg.norm(self.q[:, None].astype(float) - self.p[None], axis=-1)
        return medium.diffuse_reflectance(distance) * np.exp(
            medium.curve(distance) * distance[..., None] / (2 * RADIUS)
        )

    def sum(self, medium, octree=None):
        """The sum of a medium over all samples, or over the clusters of a tree."""
        table = ProfileTable.from_medium(medium, self.table.disc)
        if octree is None:
            return as_array(gather_all(self.p, self.power, table, self.at, self.up))
        return as_array(gather(octree, table, self.at, n=self.up))

    def tree(self, max_error=0.1):
        octree = build_octree(self.p, self.area, self.power)
        return TreeDerivatives(octree, self.table, self.slopes, max_error, 1.0, dr.detached_t(mi.Float))


@pytest.fixture(scope="module", params=PROFILES)
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
    found, _ = derivatives.gradient(problem.at, problem.towards, of_power=False, n=problem.up)
    for name, gradient in zip(NAMES, found, strict=False):
        up, down = (
            np.einsum("qnc,nc,qc->c", problem.profile(moved(problem.medium, name, h)), problem.power, problem.weights)
            for h in (1e-3, -1e-3)
        )
        np.testing.assert_allclose(gradient, (up - down) / 2e-3, rtol=0.01, atol=2e-3 * np.abs(up).max())


def test_the_two_directions_are_transposes(problem, derivatives):
    change = as_array(derivatives.change(problem.at, problem.theta_steps, problem.power_step, problem.up))
    theta, power = derivatives.gradient(problem.at, problem.towards, n=problem.up)
    products = change * problem.weights
    other = (
        sum(g @ step for g, step in zip(theta, problem.theta_steps, strict=True)) + (power * problem.power_step).sum()
    )
    assert products.sum() == pytest.approx(other, abs=1e-5 * np.abs(products).sum())


def test_a_tree_that_accepts_nothing_has_the_derivatives_of_the_direct_sum(problem):
    (theta, power), (direct, direct_power) = (
        d.gradient(problem.at, problem.towards, n=problem.up) for d in (problem.tree(0.0), problem.direct())
    )
    np.testing.assert_allclose(theta, direct, rtol=1e-4, atol=1e-5 * np.abs(direct).max())
    np.testing.assert_allclose(power, direct_power, atol=1e-5 * np.abs(direct_power).max())


def test_the_tree_changes_as_its_own_sum_does(problem):
    """The sum over clusters at a medium a little moved, the same clusters: within 1 % of its change."""
    octree = build_octree(problem.p, problem.area, problem.power)
    derivatives = problem.tree()
    for name in NAMES:
        steps = [np.full(3, float(name == k)) for k in problem.names]
        change = as_array(derivatives.change(problem.at, steps, None, problem.up))
        up, down = (problem.sum(moved(problem.medium, name, h), octree) for h in (0.01, -0.01))
        error = (up - down) / 0.02 - change
        assert np.sqrt((error**2).mean()) < 0.01 * np.sqrt((change**2).mean())


@pytest.mark.parametrize("profile", ["tabulated", "curved"])
def test_light_over_discs_has_the_slope_of_its_mean(profile):
    problem = Problem(profile, disc=0.5)
    steps = [np.full(3, float(name == "sigma_a")) for name in problem.names]
    change = as_array(problem.direct().change(problem.at, steps, None, problem.up))
    up, down = (problem.sum(moved(problem.medium, "sigma_a", h)) for h in (0.01, -0.01))
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


@pytest.mark.parametrize("profile", ["tabulated", "curved"])
def test_gradients_are_one_walk_of_bounded_work(profile):
    """Clusters are those of the sum: what counts is the work at each. By the coefficients at most twice, with all powers four times."""
    problem = Problem(profile)
    octree = build_octree(problem.p, problem.area, problem.power)
    two = TreeDerivatives(octree, problem.table, problem.slopes[:2], 0.1, 1.0, dr.detached_t(mi.Float))
    lanes, forward = walks(lambda: dr.eval(gather(octree, problem.table, problem.at, n=problem.up)))
    for of_power, most in ((False, 2), (True, 4)):
        width, operations = walks(partial(two.gradient, problem.at, problem.towards, of_power, problem.up))
        assert width == lanes and operations < most * forward
