"""Bounds against brute force over the members of clusters, and light cuts against the sum over all lights."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.gather.source import make_source
from pellucid.kernels.heap import push, replace_top
from pellucid.light.points.discretise import irradiance_of_all
from pellucid.light.points.records import DIRECTIONAL, OMNI, ORIENTED, LightSamples, to_device
from pellucid.methods.single_pass.paper.light_cut import LightCluster, light_cuts, unshadowed_factor
from pellucid.methods.single_pass.paper.representatives import representatives
from pellucid.methods.single_pass.trees.binary import boxes, build_binary_tree
from pellucid.methods.single_pass.trees.bounds import Cluster, irradiance_bound, profile_bound
from pellucid.methods.single_pass.trees.light_tree import build_light_tree
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from worlds.points import mixed_lights, receivers

ETA = 1.5
RADIUS = 1.0


@pytest.fixture(scope="module")
def scene():
    """A unit sphere, and a plate that hides some of the lights from it."""
    plate = mi.ScalarTransform4f().translate([0, 0, 1.3]).scale(0.6)
    return mi.load_dict(
        {"type": "scene", "body": {"type": "sphere"}, "plate": {"type": "rectangle", "to_world": plate}}, optimize=False
    )


# ---------------------- Bounds ----------------------


def clusters_of(p, n, groups):
    """Spheres and cones of random groups ``(k, size)`` of points, made by the tree builder."""
    trees = [build_binary_tree(p[g], n[g], np.ones(len(g))) for g in groups]
    return Cluster(
        mi.Point3f(np.stack([t.centre[1] for t in trees]).T),
        mi.Float(np.stack([t.radius[1] for t in trees])),
        mi.Vector3f(np.stack([t.axis[1] for t in trees]).T),
        mi.Float(np.stack([t.cos_cone[1] for t in trees])),
        mi.Vector3f(np.stack([boxes(p[g][t.order], t.depth)[1] for g, t in zip(groups, trees, strict=True)]).T),
    )


def random_groups(rng, groups, size, spread, turn):
    """Groups of points whose place and orientation differ by a little or a lot."""
    place = rng.normal(size=(groups, 1, 3)) + spread * rng.normal(size=(groups, size, 3))
    axis = rng.normal(size=(groups, 1, 3)) + turn * rng.normal(size=(groups, size, 3))
    axis /= np.linalg.norm(axis, axis=2, keepdims=True)
    return place.reshape(-1, 3).astype(np.float32), axis.reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("kind", [OMNI, ORIENTED, DIRECTIONAL])
@pytest.mark.parametrize("size", [1, 4])
def test_no_member_of_two_clusters_exceeds_their_bound(kind, size):
    rng = np.random.default_rng(10 * kind + size)
    groups = 500
    spread, turn = rng.choice([0.05, 0.5], (groups, 1, 1)), rng.choice([0.1, 1.0], (groups, 1, 1))
    rows = np.arange(groups * size).reshape(groups, size)
    p, n = random_groups(rng, groups, size, spread, turn)
    q, m = random_groups(rng, groups, size, spread, turn)
    near2 = np.repeat(rng.uniform(0.01, 0.5, groups), size).astype(np.float32) if kind == ORIENTED else 0.0
    lights = LightSamples.make(kind, q if kind != DIRECTIONAL else 0, m if kind != OMNI else 0, np.ones((1, 3)), near2)
    source = clusters_of(q if kind != DIRECTIONAL else m, m if kind != OMNI else 0 * m, rows)
    smallest = mi.Float(lights.near2.reshape(groups, size).min(axis=1)) if kind != DIRECTIONAL else mi.Float(-1)
    bound = irradiance_bound(clusters_of(p, n, rows), source, smallest, ETA).numpy()

    j, i = (x.reshape(groups, -1) for x in np.broadcast_arrays(rows[:, :, None], rows[:, None, :]))
    tree = build_light_tree(lights)
    si = dr.zeros(mi.SurfaceInteraction3f, j.size)
    si.p = mi.Point3f(p[j.ravel()].T)
    si.sh_frame.n = mi.Normal3f(n[j.ravel()].T)
    tree.lights = to_device(lights)  # in the caller's order; intensities are all 1
    tree.nodes = dr.full(mi.Float, 1, len(tree.nodes))
    factor = unshadowed_factor(si, ETA, tree, mi.UInt32(i.ravel()), True)[0].numpy().reshape(groups, -1)
    assert (factor > 0).mean() > 0.1
    assert (factor.max(axis=1) <= bound * (1 + 1e-4) + 1e-6).all()
    if size == 1:
        assert factor[:, 0] == pytest.approx(bound, rel=1e-4, abs=1e-6)
    else:
        assert np.median(factor.max(axis=1)[bound > 0] / bound[bound > 0]) > 0.02


def test_the_bound_of_the_profile_holds_and_is_tight_for_a_point():
    table = ProfileTable.from_medium(Medium.from_preset("marble"))
    rng = np.random.default_rng(0)
    p, n = random_groups(rng, 1000, 4, 0.7, 1.0)
    eye = rng.normal(size=(1000, 3)).astype(np.float32)
    profile = make_source(dr.empty(mi.Float, 4), 0, table, mi.Float)
    bound = profile_bound(profile, mi.Point3f(eye.T), clusters_of(p, n, np.arange(4000).reshape(1000, 4))).numpy()
    r2 = ((p.reshape(1000, 4, 3) - eye[:, None]) ** 2).sum(axis=2)
    each = np.stack([np.array(c) for c in table.lookup(mi.Float(r2.ravel()))]).reshape(3, 1000, 4)
    assert (each.max(axis=2) <= bound * (1 + 1e-5)).all()
    single = profile_bound(profile, mi.Point3f(eye.T), clusters_of(p, n, np.arange(0, 4000, 4)[:, None])).numpy()
    assert single == pytest.approx(each[:, :, 0], rel=1e-4)


# ---------------------- The heap in local memory ----------------------


@dr.syntax
def _drain(lane, count, capacity, out):
    zero = dr.opaque(mi.UInt32, 0, dr.width(lane))
    heap = dr.alloc_local(LightCluster, capacity)
    size, i, state = zero + 0, mi.UInt32(0), lane * 747796405 + 1
    while i < count:
        state = state * 1664525 + 1013904223
        value = mi.Float(state >> 8) + 1
        heap, size = push(heap, size, LightCluster(value, state, value), zero)
        i += 1
    i = mi.UInt32(0)
    while i < count:
        top = heap[0]
        dr.scatter(out, top.factor, lane * count + i)
        # Half of the entries come back once, smaller: replacing and removing are both exercised.
        again = dr.select((i & 1 == 0) & (i < count // 2), top.bound * 0.25, 0)
        heap, size = replace_top(heap, size, LightCluster(again, top.node, again), zero)
        i += 1
    return size


def test_the_heap_hands_out_the_largest_first():
    count, lanes = 60, 50
    out = dr.zeros(mi.Float, count * lanes)
    size = _drain(dr.arange(mi.UInt32, lanes), dr.opaque(mi.UInt32, count), 64, out)
    dr.eval(size, out)
    assert np.array_equal(size.numpy(), np.full(lanes, 15))  # 60 pushed, 60 taken off, 15 came back
    found = out.numpy().reshape(lanes, count)
    for lane in range(lanes):
        state, values = (lane * 747796405 + 1) % 2**32, []
        for _ in range(count):
            state = (state * 1664525 + 1013904223) % 2**32
            values.append(np.float32(state >> 8) + 1)
        for i in range(count):
            values.sort()
            top = values.pop()
            assert found[lane, i] == np.float32(top), (lane, i)
            if i % 2 == 0 and i < count // 2:
                values.append(top * np.float32(0.25))


# ---------------------- Representatives ----------------------


def test_representatives_are_handed_down_and_drawn_in_proportion():
    strength = np.array([1.0, 0.0, 2.0, 5.0, 0.0, 0.0, 8.0, 0.0])
    chosen = representatives(strength, 3, 4000, 0)
    for node in range(1, 8):
        kept = (chosen[2 * node] == chosen[node]) | (chosen[2 * node + 1] == chosen[node])
        assert kept.all()
    share = np.bincount(chosen[1], minlength=8) / 4000
    assert share == pytest.approx(strength / 16, abs=0.03)
    assert (share[strength == 0] == 0).all()


# ---------------------- Cuts ----------------------


def test_without_error_the_cut_is_the_sum_over_all_lights(scene):
    lights, si = mixed_lights(90), receivers(200)
    _, expected = irradiance_of_all(scene, to_device(lights), len(lights), si, ETA)
    cuts = light_cuts(scene, si, ETA, build_light_tree(lights), max_error=0, max_cut=200)
    assert cuts.entering.numpy() == pytest.approx(expected.numpy(), rel=1e-4, abs=1e-5)


def test_errors_stay_within_the_promise(scene):
    lights, si = mixed_lights(3000), receivers(1500)
    _, expected = irradiance_of_all(scene, to_device(lights), len(lights), si, ETA)
    cuts = light_cuts(scene, si, ETA, build_light_tree(lights), max_cut=3000)
    truth, found = (np.asarray(mi.luminance(x)) for x in (expected, cuts.entering))
    error = np.abs(found - truth) / truth
    assert np.median(error) < 0.015
    assert np.quantile(error, 0.95) < 0.05
    assert abs(found.mean() / truth.mean() - 1) < 0.003
    size, rays = cuts.cut_size.numpy(), cuts.shadow_rays.numpy()
    assert (rays <= size + 1).all() and size.mean() < 1000  # one ray a refinement at most, and few of the lights


def test_a_full_cut_stops(scene):
    cuts = light_cuts(scene, receivers(50), ETA, build_light_tree(mixed_lights(3000)), max_cut=40)
    assert cuts.cut_size.numpy().max() == 40
    assert np.isfinite(cuts.entering.numpy()).all()
    with pytest.raises(SceneError, match="max_cut"):
        light_cuts(scene, receivers(50), ETA, build_light_tree(mixed_lights(90)), max_cut=1 << 15)


def test_the_same_seed_gives_the_same_light_whatever_the_width(scene):
    lights, si = build_light_tree(mixed_lights(600)), receivers(333)
    first = light_cuts(scene, si, ETA, lights, max_error=0.1).entering.numpy()
    assert np.array_equal(first, light_cuts(scene, si, ETA, lights, max_error=0.1).entering.numpy())
    few = dr.gather(mi.SurfaceInteraction3f, si, dr.arange(mi.UInt32, 20))
    assert np.array_equal(first[:, :20], light_cuts(scene, few, ETA, lights, max_error=0.1).entering.numpy())
    assert not np.array_equal(first, light_cuts(scene, si, ETA, lights, max_error=0.1, seed=1).entering.numpy())


def test_kernels_are_compiled_once(scene):
    light_cuts(scene, receivers(50), ETA, build_light_tree(mixed_lights(600)))  # compiles, unless another test has
    lights, si = build_light_tree(mixed_lights(3000)), receivers(99)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        light_cuts(scene, si, 1.3, lights, max_error=0.03, seed=1)
        kernels = dr.kernel_history([dr.KernelType.JIT])
        large = max(kernels, key=lambda kernel: kernel["operation_count"])
        assert large["operation_count"] > 500 and large["cache_hit"] and not large["cache_disk"]


def test_lights_of_one_kind_or_none(scene):
    si = receivers(20)
    every = mixed_lights(90)
    for kept in (every.kind == OMNI, every.kind == DIRECTIONAL, np.zeros(len(every), bool)):
        lights = every.take(kept)
        _, expected = irradiance_of_all(scene, to_device(lights), len(lights), si, ETA)
        cuts = light_cuts(scene, si, ETA, build_light_tree(lights), max_error=0, max_cut=200)
        assert cuts.entering.numpy() == pytest.approx(np.broadcast_to(expected.numpy(), (3, 20)), rel=1e-4, abs=1e-5)
