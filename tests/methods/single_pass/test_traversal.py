"""The walk by distance: points that share a lane find what each of them finds alone."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import pellucid.methods.single_pass.adaptive.traversal as module
from pellucid.methods.single_pass.adaptive.traversal import walk, walk_source
from pellucid.methods.single_pass.trees.sample_tree import build_sample_tree
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from pellucid.scene.samples.surface import sample_surface

RADIUS, POINTS = 6.0, 203


@pytest.fixture(scope="module")
def source():
    ball = mi.load_dict({"type": "sphere", "radius": RADIUS})
    samples = sample_surface([(ball, None)], 5000, "uniform", 0)
    tree = build_sample_tree(samples, 1)
    return walk_source(tree, ProfileTable.from_medium(Medium.from_preset("marble")), 0.1, 1e-4)


def found(source, points, coarser, number):
    """The sum of weights of each point, its terms, and a number that tells in which order they came."""

    def visit(state, own, node, weight, r2, accepted):
        total, terms, order = state
        mixed = (order ^ node ^ own) * mi.UInt32(2654435769)
        one = dr.select(accepted, mi.UInt32(1), 0)
        return total + weight, terms + one, dr.select(accepted, mixed, order)

    start = mi.Color3f(0), mi.UInt32(0), mi.UInt32(0)
    columns = mi.Point3f(points.T.astype(np.float32)), mi.Float(coarser.astype(np.float32)), mi.UInt32(number)
    total, terms, order = walk(source, columns[0], start, visit, columns[1], columns[2])
    return np.vstack([total.numpy(), terms.numpy(), order.numpy()])


def test_points_of_a_lane_do_not_change_each_other(source, monkeypatch):
    """Neither far neighbours nor lenient ones, nor how many there are; and every point has what is its own."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(POINTS, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1)[:, None]
    points[::7] *= 3
    coarser = rng.choice([1.0, 4.0, 16.0], POINTS)
    number = rng.integers(0, 1 << 32, POINTS, dtype=np.uint32)
    together = found(source, points, coarser, number)
    monkeypatch.setattr(module, "POINTS_PER_LANE", 1)
    alone = found(source, points, coarser, number)
    np.testing.assert_array_equal(together, alone)
    assert np.ptp(together[3]) > 100
