"""The binary cluster tree: what its nodes hold, and that their bounds hold it."""

import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.methods.single_pass.trees.binary import boxes, build_binary_tree, depth_of, sum_up


def cloud(count, seed=0):
    rng = np.random.default_rng(seed)
    n = rng.normal((0, 0, 2), size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return rng.normal(size=(count, 3)).astype(np.float32), n.astype(np.float32), rng.exponential(size=count)


def members(tree, node):
    """Positions in the order of the tree of the items below a node."""
    share = tree.depth - (node.bit_length() - 1)
    first = (node << share) - tree.leaves
    return np.arange(first, min(first + (1 << share), tree.count))


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("count", [1, 2, 3, 64, 77, 1000])
def test_every_node_bounds_and_sums_its_members(count, turn):
    p, n, strength = cloud(count)
    tree = build_binary_tree(p, n, strength, turn)
    assert sorted(tree.order) == list(range(count))
    assert tree.count == count and tree.leaves // 2 < count <= tree.leaves
    p, n, strength = p[tree.order], n[tree.order], strength[tree.order]
    half = boxes(p, tree.depth)
    for node in range(1, 2 * tree.leaves):
        k = members(tree, node)
        assert tree.strength[node] == pytest.approx(strength[k].sum(), rel=1e-6)
        if len(k) == 0:
            continue
        beside = np.abs(p[k] - tree.centre[node]).max(axis=0)
        assert (beside <= half[node]).all() and half[node] == pytest.approx(beside, abs=1e-4)
        away = np.linalg.norm(p[k] - tree.centre[node], axis=1)
        assert away.max() <= tree.radius[node] * (1 + 1e-5) + 1e-6
        assert tree.radius[node] <= away.max() * 1.01 + 1e-6  # and is not larger than it must be
        cosine = n[k].astype(float) @ tree.axis[node]
        assert cosine.min() >= tree.cos_cone[node] - 1e-5
        assert np.linalg.norm(tree.axis[node]) == pytest.approx(1, abs=1e-5) or tree.cos_cone[node] == -1


def test_halves_are_cut_across_the_longest_side_and_the_left_one_is_full():
    p = np.zeros((100, 3), np.float32)
    p[:, 1] = np.random.default_rng(0).permutation(100)
    tree = build_binary_tree(p, np.zeros((100, 3)), np.ones(100))
    assert p[tree.order][:, 1].tolist() == list(range(100))
    assert tree.strength[[1, 2, 3, 6, 7]].tolist() == [100, 64, 36, 32, 4]
    mixed = -p - 5  # negative numbers sort as numbers do
    assert mixed[build_binary_tree(mixed, np.zeros((100, 3)), np.ones(100)).order][:, 1].tolist() == sorted(mixed[:, 1])


def test_deeper_than_needed():
    p, n, strength = cloud(20)
    tree, deep = build_binary_tree(p, n, strength), build_binary_tree(p, n, strength, depth=7)
    assert (tree.depth, deep.depth) == (5, 7) == (depth_of(20), 7)
    np.testing.assert_array_equal(deep.order, tree.order)
    # The same tree below node 4, and empty halves above it.
    for level in range(6):
        at, deep_at = slice(1 << level, 2 << level), slice(4 << level, 5 << level)
        for name in ("strength", "centre", "radius", "axis", "cos_cone"):
            np.testing.assert_array_equal(getattr(deep, name)[deep_at], getattr(tree, name)[at])
    for name in ("strength", "radius", "cos_cone"):
        assert getattr(deep, name)[1] == getattr(deep, name)[2] == getattr(tree, name)[1]
    assert (deep.strength[[3, 5]] == 0).all()


def test_one_item_and_equal_items():
    one = build_binary_tree([[1, 2, 3]], [[0, 0, 1]], [5.0])
    assert (one.depth, one.leaves, one.count) == (0, 1, 1)
    assert one.strength[1] == 5 and one.radius[1] == 0 and one.cos_cone[1] == 1
    np.testing.assert_array_equal(one.centre[1], [1, 2, 3])
    same = build_binary_tree(np.tile([[1.0, 2, 3]], (9, 1)), np.tile([[0.6, 0, 0.8]], (9, 1)), np.ones(9), 0.7)
    assert sorted(same.order) == list(range(9)) and same.strength[1] == 9
    assert same.radius[1] == 0 and same.cos_cone[1] > 1 - 1e-6
    np.testing.assert_allclose(same.axis[1], [0.6, 0, 0.8], atol=1e-6)


def test_cones_without_a_direction_are_all_directions():
    p, _, strength = cloud(4)
    assert build_binary_tree(p, np.zeros((4, 3)), strength).cos_cone[1:].tolist() == [-1] * 7
    opposite = build_binary_tree(p[:2], [[0, 0, 1], [0, 0, -1]], strength[:2])
    assert opposite.cos_cone[1] == -1
    right_angle = build_binary_tree(p[:2], [[0, 0, 1], [1, 0, 0]], strength[:2])
    np.testing.assert_allclose(right_angle.axis[1], np.sqrt([0.5, 0, 0.5]), atol=1e-6)
    assert right_angle.cos_cone[1] == pytest.approx(np.sqrt(0.5), abs=1e-4)


def test_the_sides_of_a_sheet_are_kept_apart_only_if_turning_counts():
    rng = np.random.default_rng(0)
    sheet = np.zeros((256, 3), np.float32)
    sheet[:, :2] = rng.uniform(size=(256, 2))
    p, n = np.tile(sheet, (2, 1)), np.repeat([[0.0, 0, 1], [0, 0, -1]], 256, axis=0)
    apart, mixed = (build_binary_tree(p, n, np.ones(512), turn) for turn in (0.7, 0.0))
    assert (apart.cos_cone[2:4] > 0.999).all() and (mixed.cos_cone[2:4] == -1).all()


def test_preorder_needs_no_stack():
    tree = build_binary_tree(*cloud(13))
    node, visited = 1, []
    while True:
        visited.append(node)
        after = node + 1
        node = 2 * node if node < tree.leaves else after >> ((after & -after).bit_length() - 1)
        if node == 1:
            break
    assert sorted(visited) == list(range(1, 32))
    assert visited[:7] == [1, 2, 4, 8, 16, 17, 9]


def test_sums_of_vectors():
    values = np.random.default_rng(0).normal(size=(5, 3))
    sums = sum_up(values, 3)
    assert sums.shape == (16, 3)
    np.testing.assert_allclose(sums[1], values.sum(axis=0))
    np.testing.assert_allclose(sums[2], values[:4].sum(axis=0))
    np.testing.assert_allclose(sums[12], values[4])
    np.testing.assert_array_equal(sums[13:], 0)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda p, n, s: (p[:0], n[:0], s[:0]), "empty"),
        (lambda p, n, s: (p[:5], n, s), "length"),
        (lambda p, n, s: (p, n[:5], s), "length"),
        (lambda p, n, s: (np.where(p > 1, np.nan, p), n, s), "finite"),
        (lambda p, n, s: (p, np.where(n > 0.9, np.inf, n), s), "finite"),
        (lambda p, n, s: (p, n, np.where(s > 1, np.nan, s)), "finite"),
        (lambda p, n, s: (p, n, np.where(s > 1, np.inf, s)), "finite"),
        (lambda p, n, s: (p, n, -s), "negative"),
    ],
)
def test_items_that_cannot_be(change, word):
    with pytest.raises(SceneError, match=word):
        build_binary_tree(*change(*cloud(50)))
