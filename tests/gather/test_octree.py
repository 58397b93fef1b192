"""The division into voxels: who is where, sums, skips, openings, odd inputs."""

import time

import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.gather.octree import SAMPLE_PACKETS, VOXEL_PACKETS, build_octree
from pellucid.kernels.morton import morton_codes, shared_digits


def ranges(tree):
    """First sample and end of every voxel, read off the skips."""
    following = np.searchsorted(tree.sample_places(), tree.skip)
    return tree.start.astype(int), following


def test_the_progress_moves_while_a_tree_is_built():
    from pellucid.progress import reporting_to

    class Steps(list):
        def start(self, stage, total, unit):
            self.append((stage, total))

        def advance(self, done):
            self.append(done)

        def finish(self):
            self.append("end")

    told = Steps()
    with reporting_to(told):
        build_octree(np.random.default_rng(0).random((100, 3)), np.ones(100), np.ones((100, 3)))
    assert told == [("tree", 3), 1, 1, 1, "end"]


def test_root_sums_everything(body, octree):
    clusters = octree.clusters()
    assert octree.area[0] == pytest.approx(body.area.sum(dtype=np.float64), rel=1e-6)
    np.testing.assert_allclose(clusters.power[0], body.power.sum(axis=0, dtype=np.float64), rtol=1e-6)


def test_voxels_sum_their_samples(body, octree):
    """Power, area, centroid, bounds and trace of every voxel, against a plain loop."""
    clusters = octree.clusters()
    p, power, area = (a[octree.order].astype(np.float64) for a in (body.p, body.power, body.area))
    for k, (first, end) in enumerate(zip(*ranges(octree), strict=True)):
        own = slice(first, end)
        weight = power[own].mean(axis=1)
        centroid = (weight[:, None] * p[own]).sum(axis=0) / weight.sum()
        np.testing.assert_allclose(clusters.power[k], power[own].sum(axis=0), rtol=1e-5)
        np.testing.assert_allclose(octree.area[k], area[own].sum(), rtol=1e-5)
        np.testing.assert_allclose(clusters.centroid[k], centroid, atol=1e-4)
        d = p[own] - clusters.centroid[k]
        assert (d**2).sum(axis=1).max() <= clusters.cover[k]
        trace = (weight[:, None] * (p[own] - centroid) ** 2).sum() / weight.sum()
        v, c = clusters.spread[k, :3], clusters.spread[k, 3]
        np.testing.assert_allclose(3 * c - v @ v, trace, rtol=1e-3, atol=1e-5)


def test_normals_of_voxels_are_those_of_the_surface(octree):
    clusters = octree.clusters()
    small = np.flatnonzero((octree.area < octree.area[0] / 300) & (np.diff(ranges(octree), axis=0)[0] >= 6))
    v = clusters.spread[small, :3]
    n = clusters.centroid[small]
    cosine = np.abs((v * n).sum(axis=1)) / np.linalg.norm(v, axis=1) / np.linalg.norm(n, axis=1)
    assert len(small) > 100 and np.quantile(cosine, 0.05) > 0.98


@pytest.mark.parametrize("leaf_size", [1, 3, 8])
def test_every_sample_is_in_exactly_one_leaf(body, leaf_size):
    tree = build_octree(body.p, body.area, body.power, leaf_size)
    first, end = ranges(tree)
    assert np.array_equal(np.sort(tree.order), np.arange(len(body.p)))
    number = np.arange(len(body.p))
    holder = tree.sample_parent.astype(int)
    assert np.all(first[holder] <= number) and np.all(number < end[holder])
    for k in range(1, tree.voxel_count):
        own = holder[first[k] : end[k]] == tree.parent[k]
        assert not own.any()  # what a child holds, its parent does not
    # In a voxel that is too large for a leaf only samples hang that are alone in their octant.
    shared = shared_digits(np.sort(morton_codes(body.p)))
    for k in np.flatnonzero(end - first > leaf_size):
        octant = shared[first[k] + 1 : end[k]].min() + 1
        alone = (shared[:-1] < octant) & (shared[1:] < octant)
        assert alone[holder == k].all()


def test_children_lie_within_parents_and_divide_them(octree):
    first, end = ranges(octree)
    inner = np.arange(1, octree.voxel_count)
    parent = octree.parent[1:]
    assert np.all(first[parent] <= first[inner]) and np.all(end[inner] <= end[parent])
    assert np.all(end[inner] - first[inner] < end[parent] - first[parent])
    assert np.all(end - first > 1)


def test_records_are_a_preorder_with_valid_skips(octree):
    packets = octree.records(0.1)
    skips = packets.view(np.uint32)[:, 3]
    at, places = octree.sample_places(), octree.place.astype(int)
    starts = np.sort(np.concatenate([at, places]))
    sizes = np.where(np.isin(starts, places), VOXEL_PACKETS, SAMPLE_PACKETS)
    assert starts[0] == 0 and np.array_equal(starts[1:], (starts + sizes)[:-1])
    assert starts[-1] + sizes[-1] == len(packets)
    # A walk that opens everything meets every record once; one that opens nothing meets the root alone.
    assert np.array_equal(skips[at + 1], at + SAMPLE_PACKETS)
    assert skips[places[0] + 1] == len(packets)
    assert np.all(np.isin(skips[places + 1], np.append(starts, len(packets))))
    assert np.all(skips[places + 1] > places)
    np.testing.assert_array_equal(packets[at, :3], octree.p)


def test_opening_distance_is_equation_12(octree):
    clusters = octree.clusters()
    area = np.maximum(octree.area, clusters.disk_area())
    for max_error in (0.01, 0.1, 10.0):
        opening = octree.records(max_error)[octree.place, 3]
        np.testing.assert_allclose(opening, np.maximum(area / max_error, clusters.cover), rtol=1e-6)
    assert np.all(np.isinf(octree.records(0)[octree.place, 3]))
    assert np.all(octree.records(0.1)[octree.sample_places(), 3] == 0)


def test_area_of_a_disk_and_of_a_few_samples_far_apart():
    """Over an even disk the area is that of the samples; two samples at its ends are as large a thing."""
    i = np.arange(4000) + 0.5
    turn = i * 2.399963229728653
    p = np.sqrt(i / 4000)[:, None] * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    disk = build_octree(p, np.full(4000, np.pi / 4000), np.ones((4000, 3)))
    assert disk.clusters().disk_area()[0] == pytest.approx(np.pi, rel=1e-3)
    pair = build_octree([[-1, 0, 0], [1, 0, 0]], [1e-3, 1e-3], np.ones((2, 3)))
    assert pair.clusters().disk_area()[0] == pytest.approx(2 * np.pi, rel=1e-5)
    assert pair.records(0.1)[0, 3] == pytest.approx(20 * np.pi, rel=1e-5)


def test_dark_voxels_are_never_opened_and_have_a_centroid(body):
    tree = build_octree(body.p, body.area, np.where(body.p[:, :1] > 0, body.power, 0))
    clusters = tree.clusters()
    dark = ~clusters.power.any(axis=1)
    assert 0.3 < dark.mean() < 0.7
    assert np.all(tree.records(0)[tree.place[dark], 3] == 0)
    first, end = ranges(tree)
    k = np.flatnonzero(dark)[0]
    np.testing.assert_allclose(clusters.centroid[k], tree.p[first[k] : end[k]].mean(axis=0), atol=1e-3)
    assert np.isfinite(build_octree(body.p, body.area, 0 * body.power).records(0.1)[:, :3]).all()


def test_other_light_is_the_same_as_a_new_tree(body, octree):
    light = np.random.default_rng(4).random(body.power.shape).astype(np.float32)
    poured, built = octree.with_power(light), build_octree(body.p, body.area, light)
    np.testing.assert_array_equal(poured.records(0.1).view(np.uint32), built.records(0.1).view(np.uint32))
    np.testing.assert_array_equal(octree.power, body.power[octree.order])
    assert poured.parent is octree.parent


def test_one_sample():
    tree = build_octree([[1, 2, 3]], [2], [[3, 4, 5]])
    assert (tree.sample_count, tree.voxel_count) == (1, 1)
    np.testing.assert_array_equal(tree.clusters().power, [[3, 4, 5]])
    assert tree.records(0.1).shape == (VOXEL_PACKETS + SAMPLE_PACKETS, 4)


def test_samples_in_one_place():
    """Points that no voxel can part end up in one leaf, however many."""
    p = np.repeat([[0.0, 0, 0], [1, 1, 1]], [100, 20], axis=0)
    tree = build_octree(p, np.ones(120), np.ones((120, 3)))
    first, end = ranges(tree)
    assert sorted(end - first) == [20, 100, 120]
    alike = build_octree(np.ones((50, 3)), np.ones(50), np.ones((50, 3)))
    assert alike.voxel_count <= 2 and np.isfinite(alike.records(0.1)[:, :3]).all()


@pytest.mark.parametrize(
    ("p", "area", "power"),
    [
        (np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))),
        (np.zeros((2, 3)), np.zeros(3), np.zeros((2, 3))),
        (np.zeros((2, 3)), np.zeros(2), np.zeros((2, 4))),
        ([[0, 0, np.nan]], [1], [[1, 1, 1]]),
        ([[0, 0, 0]], [1], [[1, np.inf, 1]]),
    ],
)
def test_bad_samples_are_refused(p, area, power):
    with pytest.raises(SceneError, match="octree"):
        build_octree(p, area, power)


@pytest.mark.parametrize("max_error", [-1.0, np.nan])
def test_bad_max_error_is_refused(octree, max_error):
    with pytest.raises(SceneError, match="max_error"):
        octree.records(max_error)


def test_memory_and_time_a_sample():
    """At most 100 bytes; a million samples well below the three seconds that ten million in thirty would allow."""
    rng = np.random.default_rng(5)
    n = 300_000
    p = np.concatenate([rng.random((n, 2)), np.zeros((n, 1))], axis=1).astype(np.float32)
    begin = time.process_time()
    tree = build_octree(p, np.ones(n), np.ones((n, 3)))
    assert time.process_time() - begin < 3
    assert tree.nbytes <= 100 * n
