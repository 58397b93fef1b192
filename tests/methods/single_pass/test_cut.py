"""The clusters whose light is measured: that they cover the surface once, and that means and importance reach them."""

import types

import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods.single_pass.adaptive.cut import find_cut
from pellucid.methods.single_pass.trees.binary import level_of
from pellucid.methods.single_pass.trees.sample_tree import build_sample_tree
from pellucid.scene.samples.surface import sample_surface

COPIES = 3


@pytest.fixture(scope="module")
def world():
    """Some nodes of two of three copies of a ball with 700 samples, which fill no power of two."""
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    tree = build_sample_tree(sample_surface([(scene.shapes()[0], None)], 700, "uniform", 0))
    rng = np.random.default_rng(4)
    exists = np.flatnonzero(tree.tree.strength > 0)
    asked = np.zeros((COPIES, 2 * tree.leaves), np.uint64)
    for copy, count in ((0, 60), (2, 5)):
        asked[copy, rng.choice(exists[exists > 8], count, replace=False)] = 1
    cut = find_cut(tree, mi.UInt64(asked.ravel()), COPIES)
    return types.SimpleNamespace(tree=tree, asked=asked, cut=cut, slots=cut.slots.numpy().reshape(asked.shape))


def covered(world):
    """For each sample of each copy the cluster of the cut that holds it, -1 for none; how often it is held."""
    tree, cut = world.tree, world.cut
    leaf, times = np.full((COPIES, tree.count), -1), np.zeros((COPIES, tree.count), int)
    for k, (node, copy) in enumerate(zip(cut.node, cut.copy, strict=True)):
        here = slice(*tree.members(node))
        leaf[copy, here] = k
        times[copy, here] += 1
    return leaf, times


def test_every_sample_of_every_copy_is_covered_once(world):
    _, times = covered(world)
    assert (times == 1).all()


def test_nodes_below_the_cut_have_the_slot_of_the_cluster_that_holds_them(world):
    leaf, _ = covered(world)
    place = world.cut.place.numpy()
    rng = np.random.default_rng(3)
    for copy in range(COPIES):
        for sample in rng.choice(world.tree.count, 50):
            for level in range(world.tree.depth + 1):
                node = (sample + world.tree.leaves) >> (world.tree.depth - level)
                if level >= level_of(world.cut.node[leaf[copy, sample]]):
                    assert world.slots[copy, node] == place[leaf[copy, sample]]


def test_no_node_that_is_asked_for_is_coarser_than_what_is_measured(world):
    leaf, _ = covered(world)
    level = level_of(world.cut.node)
    for copy, node in np.argwhere(world.asked):
        here = slice(*world.tree.members(node))
        assert (level[leaf[copy, here]] >= level_of(node)).all()


def test_nothing_is_split_for_nothing(world):
    """Every node that is split has a node below that is asked for: a small tree has a leaf and a sibling for each level."""
    assert len(world.cut.node) <= (world.tree.depth + 1) * world.asked.sum() + 1


def test_light_of_nodes_is_the_mean_of_what_is_below(world):
    leaf, _ = covered(world)
    light = np.random.default_rng(0).uniform(size=(len(world.cut.node), 3))
    mean = world.cut.mean_light(light).numpy().reshape(-1, 4)[:, :3]
    area = world.tree.area.astype(float)
    for copy, node in np.argwhere(world.asked):
        here = slice(*world.tree.members(node))
        # Clusters of the cut that are smaller than the node lie in it as a whole.
        expected = np.average(light[leaf[copy, here]], axis=0, weights=area[here])
        assert mean[world.slots[copy, node]] == pytest.approx(expected, rel=1e-4)


def test_clusters_take_their_share_of_the_importance_above(world):
    cut, tree = world.cut, world.tree
    importance = np.zeros(world.asked.shape, np.uint64)
    copy, node = np.argwhere(world.asked)[0]
    parent = max(node >> 2, 1)
    importance[copy, parent] = 5000
    found = cut.share_importance(mi.UInt64(importance.ravel()))
    below = (cut.copy == copy) & ((cut.node >> np.maximum(level_of(cut.node) - level_of(parent), 0)) == parent)
    assert (found[~below] == 0).all()
    # The light of the parent is the mean by area, and errors count by their squares.
    area = tree.tree.strength[cut.node[below]]
    assert found[below] == pytest.approx(5000 * (area / area.sum()) ** 2)
    before = found[below][0]
    importance[copy, cut.node[below][0]] = 100
    assert cut.share_importance(mi.UInt64(importance.ravel()))[below][0] == pytest.approx(100 + before)


@pytest.mark.parametrize("most", [1, 4, 16, 1000])
def test_leaves_are_grouped_by_nodes_of_one_copy(world, most):
    cut, tree = world.cut, world.tree
    group = cut.groups(tree, most)
    assert (np.diff(group) >= 0).all() and (np.unique(group) == np.arange(group[-1] + 1)).all()
    first, end = (tree.members(cut.node)[k] for k in (0, 1))
    spans = []
    for k in range(group[-1] + 1):
        here = group == k
        assert here.sum() <= most and len(np.unique(cut.copy[here])) == 1
        low, high = first[here].min(), end[here].max() - 1
        level = int(low ^ high).bit_length()  # of the smallest node around them
        spans.append((cut.copy[here][0], low >> level, level, here.sum()))
        assert ((first >> level == low >> level) & (cut.copy == cut.copy[here][0])).sum() == here.sum()
    # No node is cut where its parent would do.
    for copy, node, level, size in spans:
        above = (first >> (level + 1) == node >> 1) & (cut.copy == copy)
        assert above.sum() > most or above.sum() == size


def test_the_leaf_that_holds_a_sample_is_found(world):
    leaf, _ = covered(world)
    rng = np.random.default_rng(1)
    sample = rng.integers(0, world.tree.count, 200)
    copy = rng.choice(COPIES, 200)
    assert np.array_equal(world.cut.find(copy, sample + world.tree.leaves, world.tree), leaf[copy, sample])


def test_levels_and_first_samples(world):
    node = np.array([1, 2, 3, 4, 7, 8, world.tree.leaves, 2 * world.tree.leaves - 1])
    assert level_of(node).tolist() == [0, 1, 1, 2, 2, 3, world.tree.depth, world.tree.depth]
    first, end = world.tree.members(node)
    assert first[:3].tolist() == [0, 0, world.tree.leaves // 2]
    assert end[:3].tolist() == [world.tree.count, world.tree.leaves // 2, world.tree.count]
