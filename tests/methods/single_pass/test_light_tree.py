"""The light tree: what its clusters are said to send, and lights drawn from them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.light.points.records import DIRECTIONAL, OMNI, ORIENTED, LightSamples
from pellucid.methods.single_pass.trees.descent import draw
from pellucid.methods.single_pass.trees.light_tree import (
    DIRECTIONAL_ROOT,
    LOCAL_ROOT,
    ROOT,
    build_light_tree,
    importance,
    luminance,
)
from worlds.points import unit


def lights_of(*kinds, count=40, seed=0, spots=False):
    """Lights in clumps of a few, so that clusters are small beside their distance as well as large."""
    rng = np.random.default_rng(seed)
    parts = []
    for kind in kinds:
        clump = np.repeat(rng.normal(size=(count // 4, 3)), 4, axis=0)
        p = 3 * clump + 0.1 * rng.normal(size=(count, 3))
        n = np.repeat(unit(rng, count // 4), 4, axis=0) + 0.1 * rng.normal(size=(count, 3))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        light = rng.exponential(size=(count, 3))
        near2 = rng.uniform(0.01, 0.2, count) if kind == ORIENTED else 0.0
        cone = {"cutoff": 0.5, "beam": 0.3} if spots and kind == OMNI else {}
        has_normal = kind != OMNI or spots
        parts.append(
            LightSamples.make(kind, 0 if kind == DIRECTIONAL else p, n if has_normal else 0, light, near2, **cone)
        )
    return LightSamples.join(parts)


def points(count, seed=1):
    rng = np.random.default_rng(seed)
    return (2 * rng.normal(size=(count, 3))).astype(np.float32), unit(rng, count).astype(np.float32)


def arriving_and_important(tree, count=300):
    """Luminance that each leaf sends to random points ``(points, leaves)``, and the importance of all nodes there."""
    p, n = points(count)

    def every(numbers, evaluate):
        i, k = (a.ravel() for a in np.meshgrid(np.arange(count), numbers, indexing="ij"))
        at, facing = mi.Point3f(p[i].T), mi.Normal3f(n[i].T)
        return evaluate(mi.UInt32(k.astype(np.uint32)), at, facing).numpy().reshape(count, len(numbers))

    sent = every(np.arange(tree.leaves), lambda k, at, facing: luminance(tree.lights.arriving(k, at, facing, True)[2]))
    return sent, every(np.arange(2 * tree.leaves), lambda k, at, facing: importance(tree, k, at, facing))


KINDS = [(OMNI,), (ORIENTED,), (DIRECTIONAL,), (OMNI, ORIENTED, DIRECTIONAL)]


@pytest.mark.parametrize("kinds", KINDS)
def test_importance_is_exact_for_one_light_and_misses_none_of_many(kinds):
    tree = build_light_tree(lights_of(*kinds))
    sent, important = arriving_and_important(tree)
    assert (sent > 0).any(axis=0).sum() > 0.8 * tree.count
    np.testing.assert_allclose(important[:, tree.leaves :], sent, rtol=2e-3, atol=1e-4)
    some = sent
    for level in range(tree.depth - 1, 0, -1):
        some = np.maximum(some[:, ::2], some[:, 1::2])
        here = important[:, 1 << level : 2 << level]
        assert np.isfinite(here).all() and (here[some > 0] > 0).all()
        # Where no light of a cluster gives anything, the estimate must often know it.
        if level == tree.depth - 1 and ORIENTED in kinds:
            assert (here[some == 0] == 0).mean() > 0.5


def test_importance_of_spots_is_that_of_lights_that_shine_in_all_directions():
    tree = build_light_tree(lights_of(OMNI, spots=True))
    sent, important = arriving_and_important(tree)
    assert (sent > 0).any() and (important[:, tree.leaves :] >= sent * (1 - 1e-4) - 1e-6).all()
    assert (important[:, LOCAL_ROOT][(sent > 0).any(axis=1)] > 0).all()


def test_what_a_small_cluster_sends_is_estimated_well():
    rng = np.random.default_rng(0)
    where = [0, 0, 5] + 0.05 * rng.normal(size=(16, 3))
    light = rng.exponential(size=(16, 3))
    for kind, p, n in ((ORIENTED, where, [[0, 0, -1.0]]), (OMNI, where, 0), (DIRECTIONAL, 0, where / 5)):
        n = n / np.linalg.norm(n, axis=1, keepdims=True) if kind == DIRECTIONAL else n
        tree = build_light_tree(LightSamples.make(kind, p, n, light, 0.01 if kind == ORIENTED else 0.0))
        at, facing = mi.Point3f(0, 0, 0), mi.Normal3f(0, 0.6, 0.8)
        root = mi.UInt32(DIRECTIONAL_ROOT if kind == DIRECTIONAL else LOCAL_ROOT)
        leaf = dr.arange(mi.UInt32, tree.leaves)
        sent = dr.sum(luminance(tree.lights.arriving(leaf, at, facing, True)[2]))[0]
        assert sent * 0.99 < importance(tree, root, at, facing)[0] < sent * 1.15


@pytest.mark.parametrize("kinds", KINDS)
def test_strengths_add_up_and_kinds_are_kept_apart(kinds):
    lights = lights_of(*kinds, count=36)
    tree = build_light_tree(lights)
    strength, nodes = tree.strength.numpy(), tree.nodes.numpy().reshape(-1, 4, 4)
    assert tree.count == len(lights) and len(strength) == 2 * tree.leaves
    total = lights.intensity.astype(float) @ [0.2126, 0.7152, 0.0722]
    assert strength[ROOT] == pytest.approx(total.sum(), rel=1e-5)
    for root, members in (
        (LOCAL_ROOT, lights.kind != DIRECTIONAL),
        (DIRECTIONAL_ROOT, lights.kind == DIRECTIONAL),
    ):
        assert strength[root] == pytest.approx(total[members].sum(), rel=1e-5)
        first = (root - 2) * tree.leaves // 2
        filled = strength[tree.leaves + first : tree.leaves + first + tree.leaves // 2]
        assert sorted(filled[filled > 0]) == pytest.approx(sorted(total[members]), rel=1e-5)
    assert strength[2:-1:2] + strength[3::2] == pytest.approx(strength[1 : tree.leaves], rel=1e-5)
    assert (nodes[:, 2, 3] < 0).any() == (DIRECTIONAL in kinds)


def test_without_lights_nothing_is_sent():
    tree = build_light_tree(LightSamples.none())
    assert tree.count == 0
    sent, important = arriving_and_important(tree, 10)
    assert (sent == 0).all() and (important == 0).all()


def test_nearest_light_of_a_cluster_counts():
    """Lights grow brighter up to a distance each of its own; that of one does not cap the other."""
    lights = LightSamples.make(ORIENTED, [[0, 0, 1], [0, 0, 1.001]], [[0, 0, -1]], np.ones((1, 3)), [4.0, 0.01])
    tree = build_light_tree(lights)
    value = importance(tree, mi.UInt32(LOCAL_ROOT), mi.Point3f(0, 0, 0), mi.Normal3f(0, 0, 1))
    assert value[0] == pytest.approx(2, rel=0.02)


# ------------------------------------------------------------------ drawing


def drawn(strength, node, u):
    """Draw leaves below a node of the heap over given leaf strengths."""
    leaves = len(strength)
    heap = np.zeros(2 * leaves)
    heap[leaves:] = strength
    for i in range(leaves - 1, 0, -1):
        heap[i] = heap[2 * i] + heap[2 * i + 1]
    width = len(u)
    return draw(mi.Float(heap), dr.opaque(mi.UInt32, leaves), dr.full(mi.UInt32, node, width), mi.Float(u)).numpy()


def test_even_numbers_draw_every_item_as_often_as_its_strength_asks():
    strength = np.random.default_rng(0).exponential(size=64) ** 2
    strength[[0, 5, 33, 63]] = 0
    count = 50_000
    for node, below in ((1, slice(0, 64)), (5, slice(16, 32)), (63, slice(62, 64)), (64 + 7, slice(7, 8))):
        found = np.bincount(drawn(strength, node, (np.arange(count) + 0.5) / count), minlength=64)
        expected = np.zeros(64)
        expected[below] = strength[below] / strength[below].sum() * count
        assert np.abs(found - expected).max() <= 3  # evenly spaced numbers: no statistics needed
        assert (found[strength == 0] == 0).all()


def test_random_numbers_at_the_ends_of_their_range_draw_items_that_are_there():
    strength = np.zeros(32)
    strength[[3, 4, 17]] = [1e-6, 1.0, 1e-6]
    assert drawn(strength, 1, np.array([0.0, 1 - 2.0**-24, 0.5])).tolist() in ([3, 17, 4], [3, 4, 4])
    strength[:] = 0
    strength[9] = 2
    assert (drawn(strength, 1, np.linspace(0, 1 - 2.0**-24, 1000)) == 9).all()


def test_few_even_numbers_are_spread_over_the_cluster():
    """Stretched at every branch, eight numbers fall into eight different eighths."""
    found = drawn(np.ones(64), 1, (np.arange(8) + 0.5) / 8)
    assert sorted(found // 8) == list(range(8))


@pytest.mark.parametrize("height", [1.0, 3.0])
def test_no_point_gets_more_than_the_radiosity_of_the_surface_that_lights_stand_for(height):
    """A floor of 32 x 32 lights a unit apart, each a square of the radiosity 2: its irradiance is below 2 at any height.

    Nearer than the lights are to each other the points show.
    """
    side, radiosity = 32, 2.0
    place = np.stack(np.meshgrid(*[np.arange(side) - side / 2.0] * 2, [0.0]), -1).reshape(-1, 3)
    lights = LightSamples.make(ORIENTED, place, [[0, 0, 1]], np.full((1, 3), radiosity / np.pi), 1 / np.pi)
    tree = build_light_tree(lights)
    together = tree.nodes.numpy().reshape(-1, 4, 4)[LOCAL_ROOT, 3, 3]
    most = tree.strength.numpy()[LOCAL_ROOT] / together
    assert most == pytest.approx(radiosity, rel=1e-4)
    at = np.random.default_rng(0).uniform(-2, 2, (50, 2))
    number = dr.arange(mi.UInt32, 50 * len(lights))
    point = mi.UInt32(number // len(lights))
    p = dr.gather(mi.Point3f, mi.Point3f(at[:, 0], at[:, 1], np.full(50, height)), point)
    light = luminance(tree.lights.arriving(number % len(lights), p, mi.Normal3f(0, 0, -1), True)[2])
    irradiance = light.numpy().reshape(50, -1).sum(axis=1)
    assert (irradiance < 1.1 * most).all() and irradiance.max() > 0.7 * most
