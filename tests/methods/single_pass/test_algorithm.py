"""The exitance from clusters that are lit as well as they are seen, against the sum over all samples and lights."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import pellucid.methods.single_pass.adaptive.algorithm as module
from pellucid.kernels.morton import morton_order
from pellucid.light.points.records import LightSamples
from pellucid.methods.single_pass.adaptive.algorithm import AdaptiveSettings, adaptive_exitance
from pellucid.methods.single_pass.adaptive.copies import VisibleCopies
from pellucid.methods.single_pass.adaptive.traversal import walk, walk_source
from pellucid.methods.single_pass.trees.light_tree import LUMINANCE, build_light_tree, luminance
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from worlds.copies import ETA, all_triples, lamps, sorted_directions, two_copies

RADIUS = 8.0
MFP = float(np.max(Medium.from_preset("marble").mfp))
REFLECTANCE = float(Medium.from_preset("marble").total_diffuse_reflectance @ LUMINANCE)
CUT_ERROR, STRICT = 0.3, 0.02


@pytest.fixture(scope="module")
def world():
    """Two balls of 3000 samples and 720 lights, and what all triples give to 1200 points."""
    w = two_copies(RADIUS, [18, 1, 0], ([3, 0, 11], 5), 3000, (0.5, 1.5))
    n = sorted_directions(1200)
    n = np.concatenate([half[morton_order(half)] for half in (n[:600], n[600:])])
    w.eye = (RADIUS * n).astype(np.float32)
    w.copy = np.repeat([0, 1], 600)
    w.lights = lamps(side=20, width=4, height=18, sky=300, far=14, strength=8)
    w.light_tree = build_light_tree(w.lights)
    w.truth = all_triples(w)
    return w


def owned(array):
    """Copy an array to memory of Dr.Jit's own: that of NumPy has any alignment, and each has kernels of its own."""
    copy = array + dr.opaque(mi.UInt32, 0)
    dr.eval(copy)
    return copy


def adaptive(w, cut_error=CUT_ERROR, take=slice(None), tolerance=1.0, lights=None, mfp=MFP, **settings):
    """Exitance ``(3, points)`` and effort."""
    copies = w.copy[take]
    seen = np.unique(copies)
    cut = VisibleCopies(w.tree, w.placement, walk_source(w.tree, w.table, cut_error), ETA, seen, mfp, REFLECTANCE)
    exitance, effort = adaptive_exitance(
        w.scene,
        cut,
        lights or w.light_tree,
        owned(mi.Point3f(w.eye[take].T)),
        owned(mi.UInt32(np.searchsorted(seen, copies).astype(np.uint32))),
        dr.full(mi.Float, tolerance, len(copies)),
        AdaptiveSettings(**settings),
    )
    return exitance.numpy().astype(float), effort


def touch(w, monkeypatch, **settings):
    """The cut, the eye points, the frontier, and what the first walk found."""
    original, calls = module._brightness, []

    def brightness(cut, eyes, touched, frontier, rough):
        calls.append((cut, eyes, frontier, touched))
        return original(cut, eyes, touched, frontier, rough)

    with monkeypatch.context() as patch:
        patch.setattr(module, "_brightness", brightness)
        adaptive(w, **settings)
    return calls[0]


def bright(exitance):
    return np.asarray(luminance(mi.Color3f(exitance.astype(np.float32)))).astype(float)


def errors(w, exitance, take=slice(None)):
    return bright(exitance) / bright(w.truth)[take] - 1


def test_errors_are_those_that_are_asked_for(world):
    exitance, effort = adaptive(world)
    error = errors(world, exitance)
    assert np.median(np.abs(error)) < 0.012 and np.quantile(np.abs(error), 0.95) < 0.035
    assert np.abs(error).max() < 0.12
    # Clusters are a little too bright in the mean, by about half a per cent here; see the next test for what is not.
    assert exitance.sum(axis=1) == pytest.approx(world.truth.sum(axis=1), rel=0.012)
    assert effort.shadow_rays < 0.2 * 2 * world.tree.count * len(world.lights)
    assert effort.links < 0.25 * len(world.eye) * world.tree.count


def test_what_counts_for_nothing_is_not_divided(world):
    """In a medium a tenth as clear light does not come far: sums do not change, though many of their terms are saved."""
    eye, table = owned(mi.Point3f(world.eye.T)), ProfileTable.from_medium(Medium.from_preset("marble", 10.0))

    def visit(state, own, node, weight, r2, accepted):
        return state[0] + weight, state[1] + dr.select(accepted, mi.UInt32(1), 0)

    def sums(negligible):
        start = mi.Color3f(0), mi.UInt32(0)
        weight, terms = walk(walk_source(world.tree, table, 0.05, negligible), eye, start, visit)
        return weight.numpy(), int(terms.numpy().sum())

    (all_of_it, many), (most, few) = sums(0.0), sums(1e-4)
    assert few < 0.6 * many
    assert np.abs(most / all_of_it - 1).max() < 0.01


def test_with_many_rays_and_single_samples_it_is_the_sum_over_all(world):
    """Nothing but chance is left where no cluster stands for several samples; and that is not biased."""
    exitance, _ = adaptive(world, STRICT, max_error=1e-4, mfp=1e-3)
    error = errors(world, exitance)
    assert np.sqrt((error**2).mean()) < 0.008
    assert exitance.sum(axis=1) == pytest.approx(world.truth.sum(axis=1), rel=0.003)


def test_a_smaller_error_takes_more_rays_and_is_met(world):
    spent, found = [], []
    asked = (0.03, 0.01, 0.004)
    for max_error in asked:
        exitance, effort = adaptive(world, STRICT, max_error=max_error)
        spent.append(effort.shadow_rays)
        found.append(np.sqrt((errors(world, exitance) ** 2).mean()))
    assert spent[2] > 1.5 * spent[1] > 1.5 * 1.5 * spent[0]
    assert found[2] < 0.8 * found[0]
    assert (np.array(found) < asked).all()


def test_concern_is_the_squares_of_weights_over_the_tolerance(world, monkeypatch):
    """Light in one cluster alone tells the weight that it has for every eye point."""
    monkeypatch.setattr(module, "LITTLE", 0.0)
    cut, eyes, frontier, touched = touch(world, monkeypatch, tolerance=3.0)
    shared = frontier.share_concern(frontier.by_slot(touched.concern) / module.UNIT)
    assert eyes.tolerance.numpy() == pytest.approx(3.0)
    for leaf in np.random.default_rng(4).choice(len(frontier.node), 6, replace=False):
        light = np.zeros((len(frontier.node), 3), np.float32)
        light[leaf] = 1
        weight = luminance(module._gather(cut, eyes, frontier, light)).numpy().astype(float) / REFLECTANCE
        assert shared[leaf] == pytest.approx(np.square(weight / eyes.tolerance.numpy()).sum(), rel=1e-3)
        assert shared[leaf] > 0


def test_clusters_are_as_bright_as_the_eye_points_on_them(world, monkeypatch):
    """Half of the ball is lit: where its eye points lie errors may be larger, up to where they are no longer relative."""
    cut, eyes, frontier, touched = touch(world, monkeypatch)
    lit = cut.samples.p[cut.samples.members(frontier.node)[0]][:, 0] > 0
    light = np.repeat(np.where(lit, 1.0, 0.01)[:, None], 3, axis=1).astype(np.float32)
    monkeypatch.setattr(module, "ALIKE", 1)
    monkeypatch.setattr(module, "DIM", 0.0)
    monkeypatch.setattr(module, "GLARE", np.inf)
    found = module._brightness(cut, eyes, touched, frontier, light)
    assert found.shape == frontier.node.shape
    exitance = luminance(module._gather(cut, eyes, frontier, light)).numpy().astype(float)
    leaf = frontier.find(eyes.copy.numpy(), touched.nearest.numpy(), cut.samples)
    for here in np.unique(leaf):
        assert found[here] == pytest.approx(exitance[leaf == here].mean())
    alone = np.setdiff1d(np.arange(len(found)), leaf)
    assert np.isin(found[alone], found[np.unique(leaf)]).all()
    assert np.median(found[lit]) > 5 * np.median(found[~lit])
    monkeypatch.setattr(module, "DIM", 0.5)
    monkeypatch.setattr(module, "GLARE", 0.6)
    found = module._brightness(cut, eyes, touched, frontier, light)
    assert found.min() == pytest.approx(0.5 * exitance.mean()) and found.max() == pytest.approx(0.6 * exitance.mean())


def test_what_is_seen_by_way_of_another_surface_costs_less(world):
    _, direct = adaptive(world)
    _, indirect = adaptive(world, tolerance=4.0)
    assert indirect.shadow_rays < 0.6 * direct.shadow_rays


def test_what_other_surfaces_show_has_wide_clusters_but_not_where_light_is_measured(world, monkeypatch):
    """Solid angles and the width of the smallest clusters grow with the tolerance, up to a point."""
    levels = {}
    for tolerance, coarser in ((1.0, 1.0), (8.0, 8.0 * module.LARGER), (100.0, module.LARGEST)):
        _, eyes, _, _ = touch(world, monkeypatch, tolerance=tolerance)
        assert eyes.coarser.numpy() == pytest.approx(coarser)
        levels[tolerance] = eyes.finest.numpy().astype(int)
    assert levels[8.0].min() > 0
    coarser = levels[1.0] - levels[8.0]
    assert (np.abs(coarser - 2 * np.log2(8 * module.WIDER)) < 1).all() and coarser.min() >= 1


def test_however_lenient_no_point_is_inside_a_cluster_that_stands_for_its_members(world):
    """Their mean distance says nothing there: points would have next to no light."""
    exitance, _ = adaptive(world, tolerance=16.0)
    error = errors(world, exitance)
    assert np.sqrt((error**2).mean()) < 0.5
    assert abs(bright(exitance).mean() / bright(world.truth).mean() - 1) < 0.3


def test_rays_end_where_they_must(world):
    _, effort = adaptive(world, max_error=1e-6, most_rays=16)
    _, more = adaptive(world, max_error=1e-6, most_rays=64)
    assert effort.shadow_rays < more.shadow_rays < 5 * effort.shadow_rays


def test_the_same_picture_bit_for_bit(world):
    (one, spent), (two, again) = adaptive(world), adaptive(world)
    assert np.array_equal(one, two)
    assert vars(spent) == vars(again)


def test_what_is_not_seen_is_not_lit(world):
    """Eye points on a few square millimetres of one copy: the rest is lit as a few large clusters, the other copy not at all."""
    near = np.flatnonzero((np.linalg.norm(world.eye - world.eye[700], axis=1) < 2.5) & (world.copy == 1))
    _, whole = adaptive(world)
    exitance, few = adaptive(world, take=near)
    assert 5 < len(near) < 60
    assert few.clusters < 0.2 * whole.clusters and few.shadow_rays < 0.5 * whole.shadow_rays
    assert np.abs(errors(world, exitance, near)).max() < 0.05
    _, one_copy = adaptive(world, take=slice(0, 600))
    assert 0.35 * whole.clusters < one_copy.clusters < 0.65 * whole.clusters


def test_copies_do_not_depend_on_each_other(world):
    both, _ = adaptive(world, STRICT, max_error=0.01)
    second, _ = adaptive(world, STRICT, max_error=0.01, take=slice(600, 1200))
    assert np.sqrt(((bright(second) / bright(both[:, 600:]) - 1) ** 2).mean()) < 0.015


def test_one_eye_point(world):
    exitance, effort = adaptive(world, take=slice(3, 4), max_error=0.005)
    assert errors(world, exitance, slice(3, 4)) == pytest.approx(0, abs=0.05)
    assert effort.links < 500


def test_without_light_it_is_black(world):
    exitance, effort = adaptive(world, lights=build_light_tree(LightSamples.none()))
    assert (exitance == 0).all() and effort.shadow_rays == 0


def test_kernels_are_compiled_once(world):
    """Other sizes, numbers and lights, the same kernels."""
    adaptive(world)
    few = build_light_tree(world.lights.take(np.arange(0, len(world.lights), 3)))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        adaptive(world, take=slice(10, 777), max_error=0.013, first_rays=100, lights=few)
        kernels = [k for k in dr.kernel_history([dr.KernelType.JIT]) if k["operation_count"] > 150]
    assert len(kernels) > 5
    assert all(kernel["cache_hit"] for kernel in kernels)


def test_what_is_next_to_black_takes_fewer_rays_and_what_is_bright_more(world, monkeypatch):
    """All eye points judged by a share of the mean, as if too dim or too bright: errors are as large as asked for there."""
    _, usual = adaptive(world, STRICT, max_error=0.01)
    for share, fewest, most in ((3.0, 0, 0.8), (0.5, 1.5, np.inf)):
        monkeypatch.setattr(module, "DIM", share)
        monkeypatch.setattr(module, "GLARE", share)
        exitance, effort = adaptive(world, STRICT, max_error=0.01)
        assert fewest < effort.shadow_rays / usual.shadow_rays < most
        off = np.sqrt(np.mean((bright(exitance) - bright(world.truth)) ** 2))
        assert off < 0.01 * share * bright(world.truth).mean()
