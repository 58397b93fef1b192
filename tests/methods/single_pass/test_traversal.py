"""The walk by distance: what a point finds depends on no other."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods.single_pass.adaptive.traversal import footprint, walk, walk_source
from pellucid.methods.single_pass.trees.sample_tree import build_sample_tree
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from pellucid.scene.samples.surface import sample_surface

RADIUS, POINTS = 6.0, 203


@pytest.fixture(scope="module")
def source():
    ball = mi.load_dict({"type": "sphere", "radius": RADIUS})
    samples = sample_surface([(ball, None)], 5000, "uniform", 0)
    tree = build_sample_tree(samples)
    return walk_source(tree, ProfileTable.from_medium(Medium.from_preset("marble")), 0.1, 1e-4)


def found(source, points, coarser):
    """The sum of weights of each point, its terms, and a number that tells in which order they came."""

    def visit(state, node, weight, r2, accepted):
        total, terms, order = state
        mixed = (order ^ node) * mi.UInt32(2654435769)
        one = dr.select(accepted, mi.UInt32(1), 0)
        return total + weight, terms + one, dr.select(accepted, mixed, order)

    start = mi.Color3f(0), mi.UInt32(0), mi.UInt32(0)
    p = mi.Point3f(np.ascontiguousarray(points.T, np.float32))
    total, terms, order = walk(source, p, start, visit, mi.Float(coarser.astype(np.float32)))
    return np.vstack([total.numpy(), terms.numpy(), order.numpy()])


def test_points_do_not_change_each_other(source):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(POINTS, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1)[:, None]
    points[::7] *= 3
    coarser = rng.choice([1.0, 4.0, 16.0], POINTS)
    together = found(source, points, coarser)
    order = rng.permutation(POINTS)
    np.testing.assert_array_equal(found(source, points[order], coarser[order]), together[:, order])
    np.testing.assert_array_equal(found(source, points[:50], coarser[:50]), together[:, :50])
    assert np.ptp(together[3]) > 100


def test_the_footprint_is_that_of_the_profile():
    """Of a profile that is even over a disc it would be the area of the disc: here it is between those of one and ten mean free paths."""
    medium = Medium.from_preset("marble", profile="dipole")  # of a profile that grows as 1 / r it has no bound
    area = footprint(ProfileTable.from_medium(medium))
    r = np.geomspace(1e-4, 1e3, 20_000) * medium.mfp.mean()
    profile = medium.diffuse_reflectance(r).mean(axis=1)
    expected = 2 * np.pi * np.trapezoid(profile * r, r) ** 2 / np.trapezoid(profile**2 * r, r)
    assert area == pytest.approx(expected, rel=0.05)
