"""The triple cut against the sum over all triples, its heuristic, its representatives and its cache."""

import types
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.kernels.memory import columns, upload
from pellucid.light.points.records import DIRECTIONAL
from pellucid.methods.single_pass.paper.cache import LinkCache
from pellucid.methods.single_pass.paper.representatives import representatives, spread_place, spread_representatives
from pellucid.methods.single_pass.paper.tables import CutTables
from pellucid.methods.single_pass.paper.triple_cut import CutParameters, history, splits_lights, triple_cut
from pellucid.methods.single_pass.paper.triples import Settings
from pellucid.methods.single_pass.trees.light_tree import build_light_tree
from worlds.copies import ETA, all_triples, lamps, sorted_directions, two_copies

RADIUS = 5.0
LIGHTS = 200


@pytest.fixture(scope="module")
def world():
    """Two balls of 1000 samples and 200 lights, and what all triples give to 300 points."""
    w = two_copies(RADIUS, [11, 1, 0], ([2, 0, 7], 3), 1000, (0, 1))
    w.eye = (RADIUS * sorted_directions(300)).astype(np.float32)
    w.copy = np.arange(300) % 2
    w.lights = lamps(side=10, width=3, height=12, sky=80, far=9, strength=3)
    w.tables = CutTables.build(w.tree, build_light_tree(w.lights), w.table)
    w.truth = all_triples(w)
    return w


def cut(w, cache=None, tables=None, take=slice(None), **parameters):
    return triple_cut(
        w.scene,
        tables or w.tables,
        w.placement,
        ETA,
        mi.Point3f(*columns(w.eye[take])),
        upload(np.asarray(w.copy[take], np.uint32), mi.UInt32),
        CutParameters(**parameters),
        cache,
    )


def relative_errors(w, cuts):
    truth = np.asarray(mi.luminance(mi.Color3f(w.truth.astype(np.float32))))
    return np.abs(np.asarray(mi.luminance(cuts.exitance)) - truth) / truth


def test_without_error_the_cut_is_the_sum_over_all_triples(world):
    """Every triple of single samples: 1024 x 256 leaves are too many for a heap, so of an eighth of the lights."""
    few = replace_lights(world, world.lights.take(np.arange(0, LIGHTS, 25)))
    cuts = cut(few, take=slice(0, 16), max_error=0.0, max_cut=8192)
    assert not cuts.full.numpy().any()
    assert cuts.exitance.numpy() == pytest.approx(all_triples(few)[:, :16], rel=2e-4)


def replace_lights(w, lights):
    values = vars(w) | {"lights": lights, "tables": CutTables.build(w.tree, build_light_tree(lights), w.table)}
    return types.SimpleNamespace(**values)


def test_errors_are_small_and_shrink_with_the_bound(world):
    cuts = cut(world, alternation=8)
    error = relative_errors(world, cuts)
    assert np.median(error) < 0.04 and np.quantile(error, 0.95) < 0.12 and error.max() < 0.3
    assert cuts.cut_size.numpy().mean() < 0.015 * 1000 * LIGHTS
    assert (cuts.shadow_rays.numpy() < 2 * cuts.cut_size.numpy()).all()  # at most one for each half of a triple
    finer = cut(world, max_error=0.002, max_cut=16384, alternation=8)
    assert not finer.full.numpy().any()
    assert np.median(relative_errors(world, finer)) < 0.02


def test_errors_of_different_representatives_cancel(world):
    """Neither what is split nor which representatives are drawn favours large or small estimates: then sums over the picture are biased.

    Strengths differ in colour from member to member: with representatives drawn by luminance, and sums by colour, red was 1 % too small.
    The mean of one picture has a standard deviation of 3 %.
    """
    take = slice(0, 300, 4)
    tables = (CutTables.build(world.tree, world.tables.lights, world.table, seed=seed) for seed in range(40))
    mean = np.mean(
        [cut(world, tables=t, take=take, max_error=0.005).exitance.numpy().mean(axis=1) for t in tables], axis=0
    )
    assert mean == pytest.approx(world.truth[:, take].mean(axis=1), rel=0.02)


@pytest.mark.parametrize("alternation", [1, 8])
def test_cuts_do_not_depend_on_the_scale_of_a_scene(world, alternation):
    """R_j and F_ji are compared as numbers without units (AWB08 eq. 11): with lengths a thousand times larger, cuts are the same."""
    large = two_copies(1000 * RADIUS, [11000, 1000, 0], ([2000, 0, 7000], 3000), 1000, (0, 1), 1e-3)
    lights = replace(world.lights, p=1000 * world.lights.p, near2=1e6 * world.lights.near2)
    local = lights.kind != DIRECTIONAL
    lights = replace(lights, intensity=np.where(local[:, None], 1e6, 1) * lights.intensity.astype(np.float32))
    large.eye, large.copy, large.lights = 1000 * world.eye, world.copy, lights
    large.tables = CutTables.build(large.tree, build_light_tree(lights), large.table)
    small, scaled = (cut(w, alternation=alternation) for w in (world, large))
    assert scaled.exitance.numpy().mean() == pytest.approx(small.exitance.numpy().mean(), rel=0.01)
    assert scaled.cut_size.numpy().mean() == pytest.approx(small.cut_size.numpy().mean(), rel=0.01)
    # Which cluster is split shows in the links that are asked for.
    assert scaled.links.numpy().mean() == pytest.approx(small.links.numpy().mean(), rel=0.01)


def test_a_full_cut_stops_and_says_so(world):
    cuts = cut(world, max_cut=100)
    assert (cuts.cut_size.numpy() == 100).all() and cuts.full.numpy().all()
    for wrong in (
        {"max_cut": 1 << 15},
        {"max_cut": 0},
        {"alternation": 0},
        {"alternation": 16},
        {"pairs": 3},
        {"pairs": 32},
    ):
        with pytest.raises(SceneError, match=next(iter(wrong))):
            CutParameters(**wrong)


def test_the_picture_depends_neither_on_the_cache_nor_on_chunks(world):
    expected = cut(world).exitance.numpy()
    caches = [LinkCache(), LinkCache(1024)]
    for cache in (None, *caches, *caches):
        assert np.array_equal(cut(world, cache).exitance.numpy(), expected)
    assert np.array_equal(cut(world, caches[0], take=slice(100, 117)).exitance.numpy(), expected[:, 100:117])


def test_kernels_are_compiled_once(world):
    cache = LinkCache()
    cut(world, cache)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        cut(world, cache, take=slice(0, 77), max_error=0.03, alternation=3, white=2.0)
        kernels = dr.kernel_history([dr.KernelType.JIT])
        large = max(kernels, key=lambda kernel: kernel["operation_count"])
        assert large["operation_count"] > 500 and large["cache_hit"] and not large["cache_disk"]


# ---------------------- The cache ----------------------


def test_lanes_share_what_they_find_within_a_launch_and_between_launches(world):
    alone, cache = cut(world), LinkCache()
    first, second = cut(world, cache), cut(world, cache)
    assert alone.cache_hits.numpy().sum() == 0
    assert np.array_equal(alone.links.numpy(), second.links.numpy())
    assert 0.5 < first.hit_rate < second.hit_rate <= 1
    assert first.shadow_rays.numpy().sum() < 0.3 * alone.shadow_rays.numpy().sum()
    assert second.shadow_rays.numpy().sum() < 0.05 * alone.shadow_rays.numpy().sum()
    assert second.cache_hits.numpy().sum() > first.cache_hits.numpy().sum()
    small = LinkCache(1024)
    cut(world, small)
    assert cut(world, small).shadow_rays.numpy().sum() > second.shadow_rays.numpy().sum()


def test_a_cache_returns_what_was_kept_and_tells_all_keys_apart():
    cache = LinkCache(1 << 16)
    key = mi.UInt64(np.arange(5000, dtype=np.uint64) * 7 + (1 << 47))
    link = mi.UInt32(np.arange(5000, dtype=np.uint32) * 429_496)
    assert not cache.find(key, True)[1].numpy().any()
    cache.keep(key, link, True)
    dr.eval(cache.written)
    found, hit = (x.numpy() for x in cache.find(key, True))
    assert hit.mean() > 0.9  # but for those that share a place
    assert np.array_equal(found[hit], link.numpy()[hit])
    assert hit[0] and found[0] == 0
    assert not cache.find(key + 1, True)[1].numpy().any()
    key = np.random.default_rng(0).integers(0, 1 << 48, 1 << 18, dtype=np.uint64)
    for keys in (np.arange(1 << 18, dtype=np.uint64), np.arange(1 << 18, dtype=np.uint64) << 30, np.unique(key)):
        place, tag = (x.numpy().astype(np.uint64) for x in cache._mix(mi.UInt64(keys)))
        assert (place < 1 << 16).all() and (tag < 1 << 32).all()
        assert len(np.unique(tag << np.uint64(16) | place)) == len(keys)
        assert np.bincount(place.astype(int), minlength=1 << 16).max() < 25  # evenly filled: 4 on average


def test_a_cache_that_cannot_tell_all_links_apart_is_refused(world):
    with pytest.raises(SceneError, match="power of two"):
        LinkCache(1000)
    far = CutTables.build(world.tree, world.tables.lights, world.table, first_key=1 << 42)
    with pytest.raises(SceneError, match="too few"):
        cut(world, LinkCache(1024), tables=far)


# ---------------------- Choices ----------------------


def decide(contains_eye=False, run=0, last_was_lights=False, irradiance=0.0, profile=1.0, factor=0.5):
    """The heuristic with m = 8, alpha = 10, W = 2, beta = 1: which cluster is split?"""
    settings = Settings(
        mi.Float(0.02), mi.Float(10 * 2.0), mi.Float(1), mi.UInt32(8), mi.UInt32(1), mi.Float(ETA), mi.UInt64(0)
    )
    numbers = (mi.Float(x) for x in (irradiance, profile, factor))
    lights = splits_lights(mi.Bool(contains_eye), mi.UInt32(run), mi.Bool(last_was_lights), *numbers, settings)
    return "lights" if lights[0] else "samples"


def test_the_four_tests_of_the_heuristic_apply_in_order():
    # Fourth: the link that contributes more is split.
    assert decide(profile=1.0, factor=0.5) == "samples"
    assert decide(profile=0.4, factor=0.5) == "lights"
    # Third: bright lights are split early, whatever the fourth says; alpha W is 20.
    assert decide(irradiance=21, profile=1.0, factor=0.5) == "lights"
    assert decide(irradiance=19, profile=1.0, factor=0.5) == "samples"
    # Second: after eight of a kind the other one, whatever the third and fourth say; not after seven.
    assert decide(run=8, last_was_lights=True, irradiance=21, profile=0.4) == "samples"
    assert decide(run=8, last_was_lights=False, profile=1.0) == "lights"
    assert decide(run=7, last_was_lights=True, irradiance=21) == "lights"
    # First: around the eye the samples are split, whatever the others say.
    assert decide(contains_eye=True, run=8, last_was_lights=False, irradiance=21, profile=0.4) == "samples"


def test_runs_of_one_kind_are_counted():
    word = mi.UInt32(0)
    for by_lights, run in ((True, 1), (True, 2), (True, 3), (False, 1), (False, 2), (True, 1)):
        word = history(word | 12345, mi.Bool(by_lights))
        assert (word[0] >> 27 & 15, word[0] >> 31) == (run, int(by_lights))
    for _ in range(20):
        word = history(word, mi.Bool(True))
    assert word[0] >> 27 & 15 == 15


@pytest.mark.parametrize("seed", [0, 1])
def test_representatives_of_lights_are_spread_over_their_cluster(seed):
    """32 of 32 lights, each once; of 256 lights one in each eighth; and each is that of a child in the same slot."""
    chosen = representatives(np.ones(32), 5, 32, seed)
    assert sorted(chosen[1]) == list(range(32))
    chosen = representatives(np.ones(256), 8, 32, seed)
    assert sorted(chosen[1] // 8) == list(range(32))
    parents = np.arange(1, 256)
    kept = (chosen[parents] == chosen[2 * parents]) | (chosen[parents] == chosen[2 * parents + 1])
    assert kept.all()
    strength = np.array([0.0, 1, 0, 3])
    drawn = np.concatenate([representatives(strength, 2, 32, seed)[1] for seed in range(40)])
    assert np.bincount(drawn, minlength=4) / len(drawn) == pytest.approx([0, 0.25, 0, 0.75], abs=0.03)


@pytest.mark.parametrize("depth", [0, 1, 5, 8, 10])
def test_256_representatives_of_every_cluster_by_strength(depth):
    leaves, slots = 1 << depth, 256
    strength = np.random.default_rng(depth).uniform(0, 1, leaves)
    strength[leaves // 2 + 1 :] = 0
    node = np.repeat(np.arange(1, 2 * leaves), slots)
    slot = np.tile(np.arange(slots), 2 * leaves - 1)
    place = spread_place(mi.UInt32(depth), mi.UInt32(node), mi.UInt32(slot)).numpy()
    chosen = spread_representatives(strength, depth, 0)[place]
    share = depth - np.floor(np.log2(node)).astype(int)
    assert np.array_equal(chosen + leaves >> share, node)
    drawn = chosen[(node == 1)]
    assert (strength[drawn] > 0).all()
    assert len(np.unique(drawn)) >= min(leaves // 4, slots // 2) or depth == 0
    if depth == 10:  # evenly spread: each stratum once
        upto = np.concatenate([[0], np.cumsum(strength) / strength.sum()])
        middle = (upto[drawn] + upto[drawn + 1]) / 2
        assert np.abs(middle - (np.arange(slots) + 0.5) / slots).max() < 1.5 / slots
