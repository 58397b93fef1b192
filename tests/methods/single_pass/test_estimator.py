"""Light from a few shadow rays against the sum over all lights, whatever is believed of visibility; and what is learnt."""

import types

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.kernels.memory import upload
from pellucid.light.points.discretise import irradiance_of_all
from pellucid.light.points.records import DIRECTIONAL, OMNI, to_device
from pellucid.methods.single_pass.adaptive.candidates import DRAWS, MOST_LIGHTS, NOBODY, bound_groups, choose_lights
from pellucid.methods.single_pass.adaptive.estimator import BUNDLE, Receiver, _bundle, estimate_light
from pellucid.methods.single_pass.adaptive.visibility import (
    CLUSTERS,
    PRIOR_RAYS,
    REGION,
    Expectation,
    RayCounts,
    build_guide,
)
from pellucid.methods.single_pass.trees.light_tree import build_light_tree
from worlds.points import mixed_lights, receivers

ETA = 1.5
POINTS = 60


def world_of(lights, **shapes):
    """Some points of a unit sphere below a plate, lights, and what they give to the points."""
    scene = mi.load_dict({"type": "scene", "body": {"type": "sphere"}, **shapes}, optimize=False)
    si = receivers(POINTS)
    truth = irradiance_of_all(scene, to_device(lights), len(lights), si, ETA)[1].numpy().T.astype(float)
    truth = np.broadcast_to(truth, (POINTS, 3)).sum(axis=1)
    return types.SimpleNamespace(scene=scene, lights=lights, tree=build_light_tree(lights), si=si, truth=truth)


def plate():
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 1.3]).scale(0.8)}


@pytest.fixture(scope="module")
def world():
    """Many more lights than clusters of a cut."""
    return world_of(mixed_lights(3000), plate=plate())


@pytest.fixture(scope="module")
def small():
    """Fewer lights than clusters: all that is left to chance is what is seen."""
    return world_of(mixed_lights(240), plate=plate())


def columns(*values):
    """Whole numbers on the device."""
    return [upload(np.ravel(value).astype(np.uint32), mi.UInt32) for value in values]


def rays_at(place, tried, seen):
    """Rays towards some clusters, as a guide takes them."""
    place, tried, seen = columns(place, tried, seen)
    return place, RayCounts(tried, seen)


def guided(tree, visibility=None):
    """One group that believes in some visibility of everything, or that knows nothing."""
    guide = build_guide(1)
    if visibility is not None:
        many = 1 << 24
        guide.add(*rays_at(np.arange(CLUSTERS), np.full(CLUSTERS, many), np.full(CLUSTERS, visibility * many)))
        guide.learn()
    return guide


def estimate(world, guide, rays, repeats, seed=0, region=None, clusters=256, demand=None, group=None, deviations=None):
    """Estimate the sum of red, green and blue at all points, over and over: ``(repeats, points)``, and the rays by group.

    With a ``demand``, a number a point, ``rays`` is the largest number of rays. Lights are chosen for every estimate anew, or for
    all points of a ``group``. ``deviations`` is given the mean standard deviation of a ray at each point.
    """
    rng, found = np.random.default_rng(seed), []
    group = np.arange(POINTS) if group is None else group
    p, n = (v.numpy().T for v in (world.si.p, world.si.sh_frame.n))
    at_once = max(1024 // POINTS, 1)
    asked = np.zeros(POINTS, np.float32) if demand is None else demand.astype(np.float32)
    least, most = (dr.opaque(mi.Float, number) for number in (rays if demand is None else 1, rays))
    for first in range(0, repeats, at_once):
        many = min(at_once, repeats - first)
        point = np.tile(np.arange(POINTS), many)
        place = np.repeat(np.arange(many), POINTS) * (group.max() + 1) + group[point]
        names, number = (
            upload(rng.integers(0, 1 << 32, k, dtype=np.uint32), mi.UInt32) for k in (place[-1] + 1, len(place))
        )
        wanted = dr.opaque(mi.UInt32, clusters, len(names))
        first_of = np.searchsorted(place, np.arange(place[-1] + 1))
        where = upload((point[first_of] if region else 0 * first_of).astype(np.uint32), mi.UInt32)
        chosen = choose_lights(
            world.tree, guide.visibility, bound_groups(p[point], n[point], place), where, names, wanted
        )
        expected = guide.expect(chosen, RayCounts.none(chosen))
        light = trace(world, chosen, expected, point, place, number, asked, least, most)
        guide.add(chosen.place, light.rays)
        owner = np.repeat(np.arange(len(names)), wanted.numpy())
        traced = np.bincount(owner, light.rays.tried.numpy(), len(names))
        found.append((light.light.numpy().sum(axis=0, dtype=float), traced, light.deviation.numpy()))
    light, traced, deviation = (np.concatenate(values) for values in zip(*found, strict=True))
    if deviations is not None:
        deviations[:] = deviation.reshape(repeats, POINTS).mean(axis=0)
    return light.reshape(repeats, POINTS), traced


def trace(world, chosen, expected, point, place, number, asked, least, most):
    """Estimate the light at some points, of some groups each."""
    si = dr.gather(mi.SurfaceInteraction3f, world.si, upload(point.astype(np.uint32), mi.UInt32))
    dr.eval(si)
    receiver = Receiver(si, dr.opaque(mi.Float, ETA), upload(place.astype(np.uint32), mi.UInt32), number)
    return estimate_light(
        world.scene, world.tree, chosen, expected, receiver, upload(asked[point], mi.Float), least, most
    )


def error_of(world, light):
    """Root mean square of the relative errors of the estimates."""
    return np.sqrt(np.mean((light / world.truth - 1) ** 2))


@pytest.mark.parametrize("rays, visibility", [(0.5, None), (0.5, 0.0), (2, 0.9), (2, 1.0), (16, None), (16, 0.9)])
def test_the_mean_is_the_sum_over_all_lights_whatever_is_believed(world, visibility, rays):
    repeats = 600
    light, traced = estimate(world, guided(world.tree, visibility), rays, repeats)
    assert (traced <= np.ceil(rays)).all() and traced.mean() > 0.7 * rays
    error, spread = light.mean(axis=0) - world.truth, light.std(axis=0) / np.sqrt(repeats)
    assert (np.abs(error) < 4.5 * spread).all()
    assert 0.7 < np.std(error / spread) < 1.4
    assert np.abs(error.sum()) < 3.5 * np.sqrt((spread**2).sum())
    assert np.sqrt((spread**2).sum()) < 0.01 * max(1, rays**-0.5) * world.truth.sum()


def test_errors_fall_with_the_rays(small):
    errors = [error_of(small, estimate(small, guided(small.tree), rays, 40)[0]) for rays in (2, 8, 32, 128)]
    for more, fewer in zip(errors[1:], errors, strict=False):
        assert more < 0.6 * fewer
    assert errors[-1] < 0.06


def test_rays_follow_the_variance_that_is_demanded(small):
    """Every point a group of its own that knows what it sees: half the error takes more rays, up to four times, and is met."""
    guide = build_guide(POINTS)
    for seed in range(3):
        estimate(small, guide, 64, 40, seed, region=True)
        guide.learn()
    rays, met, deviation = [], [], np.zeros(POINTS)
    estimate(small, guide, 64, 40, 3, region=True, deviations=deviation)
    for allowed in (0.02, 0.01, 0.005):
        # Luminance is a third of the sum of red, green and blue in the mean; the square of the deviation over that of the error.
        demand = deviation / (allowed * small.truth / 3) ** 2
        light, traced = estimate(small, guide, 4096, 100, 9, region=True, demand=demand)
        rays.append(traced.mean())
        met.append(error_of(small, light) / allowed)
    assert 1.8 < rays[1] / rays[0] < 5 and 1.8 < rays[2] / rays[1] < 5
    assert max(met) < 1


def test_more_clusters_leave_less_to_chance(world):
    open_air = world_of(mixed_lights(3000))
    errors = [
        error_of(open_air, estimate(open_air, guided(open_air.tree, 1.0), 1, 20, clusters=count)[0])
        for count in (64, 256, 1024)
    ]
    assert errors[1] < 0.6 * errors[0] and errors[2] < 0.4 * errors[1]


def test_with_every_light_in_a_cluster_of_its_own_only_visibility_is_left_to_chance():
    open_air = world_of(mixed_lights(240))
    light, _ = estimate(open_air, guided(open_air.tree, 1.0), 2, 1)
    assert light[0] == pytest.approx(open_air.truth, rel=1e-3)


def test_points_of_a_group_share_their_lights_without_bias(world):
    """Groups of five points, from a tenth of the sphere each: lights behind one of them may be in front of another."""
    order = np.argsort(world.si.p.numpy()[2])
    turned = types.SimpleNamespace(**vars(world) | {"truth": world.truth[order]})
    turned.si = dr.gather(mi.SurfaceInteraction3f, world.si, mi.UInt32(order.astype(np.uint32)))
    repeats = 600
    light, _ = estimate(turned, guided(world.tree), 16, repeats, group=np.arange(POINTS) // 5)
    error, spread = light.mean(axis=0) - turned.truth, light.std(axis=0) / np.sqrt(repeats)
    assert (np.abs(error) < 4.5 * spread).all()
    assert np.sqrt((spread**2).sum()) < 0.01 * world.truth.sum()


def test_a_group_is_bounded(world):
    """No light that reaches one of its points is left out: with as many clusters as there are lights, all are chosen."""
    p, n = (v.numpy().T for v in (world.si.p, world.si.sh_frame.n))
    near = np.argsort(((p - p[0]) ** 2).sum(axis=1))[:6]
    few = world_of(world.lights.take(np.arange(0, 3000, 3)), plate=plate())
    bounds = bound_groups(p[near], n[near], np.zeros(6, np.int64))
    region, names, wanted = (dr.opaque(mi.UInt32, number, 1) for number in (0, 0, MOST_LIGHTS))
    chosen = choose_lights(few.tree, guided(few.tree).visibility, bounds, region, names, wanted)
    lights = chosen.lights.numpy().reshape(MOST_LIGHTS, DRAWS, 2)[: int(chosen.count[0]), :, 0]
    assert (lights == lights[:, :1]).all()
    lights = lights[:, 0]
    assert len(np.unique(lights)) == len(lights)
    lane = dr.arange(mi.UInt32, few.tree.leaves)
    reaching = np.zeros(few.tree.leaves, bool)
    for i in near:
        point, normal = (mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in v[i])) for v in (p, n))
        light = few.tree.lights.arriving(lane, mi.Point3f(point), normal, mi.Bool(True))[2]
        reaching |= (light.numpy() > 0).any(axis=0)
    assert set(np.flatnonzero(reaching)) <= set(lights.tolist()) and reaching.sum() < len(few.lights)


@pytest.mark.parametrize("kept", ["bulbs", "sky", "one", "none"])
def test_lights_of_one_kind_one_light_or_none(world, kept):
    every = world.lights
    chosen = {
        "bulbs": every.kind == OMNI,
        "sky": every.kind == DIRECTIONAL,
        "one": np.arange(len(every)) == 5,
        "none": np.zeros(len(every), bool),
    }[kept]
    few = world_of(every.take(chosen), plate=plate())
    light, traced = estimate(few, guided(few.tree), 16, 100)
    mean = light.mean(axis=0)
    assert np.isfinite(light).all()
    assert mean.sum() == pytest.approx(few.truth.sum(), rel=0.02, abs=1e-7)
    if kept == "one":
        assert mean == pytest.approx(few.truth, rel=1e-3, abs=1e-5)
        assert traced.max() == 1  # for all of the rays that it stands for
    if kept == "none":
        assert traced.max() == 0


def test_the_same_numbers_give_the_same_light_and_others_another(world):
    one, two, other = (estimate(world, guided(world.tree), 16, 3, seed)[0] for seed in (0, 0, 1))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)


def test_kernels_are_compiled_once(world, small):
    estimate(world, guided(world.tree, 0.3), 16, 2)
    other = types.SimpleNamespace(**vars(world) | {"tree": small.tree})  # a kernel belongs to its scene
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        estimate(other, guided(small.tree, 0.4), 4, 3, 1)
        large = max(dr.kernel_history([dr.KernelType.JIT]), key=lambda kernel: kernel["operation_count"])
        assert large["operation_count"] > 300 and large["cache_hit"] and not large["cache_disk"]


# ------------------------------------------------------------------ what groups learn


def test_every_light_has_a_cluster_and_clusters_hold_neighbours(world):
    nodes = world.tree.owner.numpy()
    assert (nodes[1:4] == NOBODY).all() and len(nodes) == 2 * world.tree.leaves
    owner = nodes[world.tree.leaves :]
    assert owner.max() == CLUSTERS - 1
    assert len(np.unique(owner)) == CLUSTERS
    # Clusters are nodes of the tree: leaves that follow each other.
    assert (np.diff(np.flatnonzero(np.diff(owner) != 0)) > 0).all()
    assert (np.diff(owner) != 0).sum() == CLUSTERS - 1
    few = build_light_tree(world.lights.take([1, 2, 3]))
    assert len(np.unique(few.owner.numpy()[few.leaves :])) <= few.leaves


def test_groups_learn_what_they_see_and_ask_their_surroundings_for_the_rest(world):
    """Groups 0 and 1 lie in one region, the last one in another."""
    count = REGION + 1
    guide = build_guide(count)
    assert (guide.visibility.numpy() == 0.5).all()
    tried, seen = np.zeros((2, count, CLUSTERS), np.uint32)
    tried[0, 7], seen[0, 7] = 100, 90
    tried[0, 8], seen[0, 8] = 100, 0
    guide.add(*rays_at(np.arange(tried.size), tried, seen))
    guide.learn()
    known = guide.visibility.numpy().reshape(count, CLUSTERS)
    assert known.min() >= 0 and known.max() <= 1
    assert known[0, 7] == pytest.approx(0.9, abs=0.01) and known[0, 8] < 0.01
    assert known[1, 7] > 0.85 and known[1, 8] < 0.02  # a neighbour
    assert known[REGION, 7] > 0.85  # all else that is known of that light
    assert (known[:, 100] == 0.5).all()
    # A group that sees for itself believes itself.
    tried[REGION, 7], seen[REGION, 7] = 50, 0
    guide = build_guide(count)
    guide.add(*rays_at(np.arange(tried.size), tried, seen))
    guide.learn()
    assert guide.visibility.numpy().reshape(count, CLUSTERS)[REGION, 7] < 0.03


def test_a_group_learns_about_each_of_its_lights(small):
    """Two groups of one row and half of the lights of the first one seen: it believes that, its neighbour less of it."""
    p, n = (v.numpy().T for v in (small.si.p, small.si.sh_frame.n))
    guide, region = guided(small.tree), dr.opaque(mi.UInt32, 0, 2)
    names, wanted = dr.arange(mi.UInt32, 2), dr.opaque(mi.UInt32, 240, 2)
    bounds = bound_groups(p[[0, 0]], n[[0, 0]], np.arange(2))
    chosen = choose_lights(small.tree, guide.visibility, bounds, region, names, wanted)
    count = int(chosen.count[0])

    def visibility(expected, group):
        return expected.visibility.numpy()[int(chosen.first[group]) :][:count]

    assert (visibility(guide.expect(chosen, RayCounts.none(chosen)), 0) == 0.5).all()
    tried, seen = np.zeros((2, 2 * 240), np.uint32)
    tried[:count], seen[:count:2] = 8, 8
    found = RayCounts(*columns(tried, seen))
    guide.add(chosen.place, found)
    assert guide.tried.numpy().sum() == 8 * count and guide.seen.numpy().sum() == 8 * ((count + 1) // 2)
    guide.learn()
    expected = guide.expect(chosen, found)
    own, other = visibility(expected, 0), visibility(expected, 1)
    assert own[::2].min() > 0.9 and own[1::2].max() < 0.1
    assert (own[::2] >= other[::2]).all() and (own[1::2] <= other[1::2]).all() and not np.allclose(own, other)


def test_a_ray_is_left_out_of_what_is_expected_for_itself():
    """A cluster of which three quarters are expected to be seen, as of 9.5 rays, and half was by 4 rays since."""
    expected = Expectation(*(dr.opaque(mi.Float, value, 2) for value in (0.75, PRIOR_RAYS + 8, 0.4)))
    found, entry = RayCounts(*columns([4, 0], [2, 0])), dr.opaque(mi.UInt32, 0)
    prior = PRIOR_RAYS + 8
    assert expected.after(found, entry).numpy() == pytest.approx((0.75 * prior + 2) / (prior + 4))
    assert expected.after(found, entry, 1.0).numpy() == pytest.approx((0.75 * prior + 1) / (prior + 3))
    assert expected.after(found, entry, 0.0).numpy() == pytest.approx((0.75 * prior + 2) / (prior + 3))
    assert expected.after(found, entry + 1).numpy() == pytest.approx(0.75)


def test_leaving_one_out_lowers_the_error_and_has_no_bias(world, monkeypatch):
    """One group of all points, which does not know yet what it sees: under a plate, and where nothing stands between."""
    one, repeats = np.zeros(POINTS, np.int64), 400
    open_air = world_of(mixed_lights(240))
    found = [estimate(each, guided(each.tree), 8, repeats, group=one)[0] for each in (world, open_air)]
    for each, light in zip((world, open_air), found, strict=True):
        error, spread = light.mean(axis=0) - each.truth, light.std(axis=0) / np.sqrt(repeats)
        assert (np.abs(error) < 4.5 * spread).all()
    monkeypatch.setattr(
        Expectation, "after", lambda self, found, entry, without=None: dr.gather(mi.Float, self.visibility, entry)
    )
    before, _ = estimate(open_air, guided(open_air.tree), 8, repeats, group=one)
    assert error_of(open_air, found[1]) < 0.9 * error_of(open_air, before)


def test_lights_stand_in_the_order_of_the_tree(world):
    """Group by group, the clusters of lights follow each other, none is left out and none is there twice."""
    p, n = (v.numpy().T for v in (world.si.p, world.si.sh_frame.n))
    wanted = np.array([40, 300, 7])
    bounds, asked = bound_groups(p[:3], n[:3], np.arange(3)), columns(np.zeros(3), np.arange(3), wanted)
    chosen = choose_lights(world.tree, guided(world.tree).visibility, bounds, *asked)
    lights = chosen.lights.numpy().reshape(-1, DRAWS, 2)[:, :, 0].astype(int)
    for first, count, most in zip(chosen.first.numpy(), chosen.count.numpy(), wanted, strict=True):
        here = lights[first : first + count]
        assert most / 2 < count <= most
        assert (here[1:].min(axis=1) > here[:-1].max(axis=1)).all()


def test_rays_are_counted_and_what_is_learnt_from_them_lowers_the_error(small):
    """Every point a group of its own: after some rounds it knows what it sees."""
    guide = build_guide(POINTS)
    light, traced = estimate(small, guide, 16, 40, region=True)
    assert guide.tried.numpy().sum() == traced.sum()
    assert (guide.seen.numpy() <= guide.tried.numpy()).all() and guide.seen.numpy().sum() > 0
    guide.learn()
    learnt, _ = estimate(small, guide, 16, 40, 1, region=True)
    assert error_of(small, learnt) < 0.5 * error_of(small, light)
    # and no bias comes with it
    spread = learnt.std(axis=0) / np.sqrt(40)
    error = learnt.mean(axis=0) - small.truth
    assert np.abs(error.sum()) < 4 * np.sqrt((spread**2).sum()) + 1e-4 * small.truth.sum()


def test_what_is_drawn_evens_out(world):
    """What 16 groups in one place find, and what the draws of one find: errors cancel, and do not add up as if by chance."""
    groups, repeats, clusters, rng = 16, 40, 1024, np.random.default_rng(6)
    count = groups * repeats
    guide, point = build_guide(1), np.tile([0.0, 0.0, 1.0], (count, 1))
    bounds = bound_groups(point, point, np.arange(count))
    row, wanted = dr.opaque(mi.UInt32, 0, count), dr.opaque(mi.UInt32, clusters, count)
    first = rng.integers(0, 1 << 28, (repeats, 1))
    errors = []
    for number in (first + np.arange(groups), rng.integers(0, 1 << 28, (repeats, groups))):
        name = upload(number.astype(np.uint32).ravel(), mi.UInt32)
        chosen = choose_lights(world.tree, guide.visibility, bounds, row, name, wanted)
        found = []
        for drawn in range(DRAWS):
            light, scale = chosen.fetch(dr.arange(mi.UInt32, dr.width(chosen.place)), drawn)
            falling = world.tree.lights.arriving(light, mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, 1), True)[2]
            each = np.add.reduceat((scale * dr.sum(falling)).numpy().astype(float), chosen.first.numpy())
            found.append(each.reshape(repeats, groups))
        errors.append((np.std(found[0].mean(axis=1)), np.std(np.mean(found, axis=0)), np.std(found)))
    (following, _, _), (strewn, of_draws, of_one) = errors
    assert following < 0.6 * strewn
    assert of_draws < 0.6 * of_one / np.sqrt(DRAWS)


def test_neighbours_try_different_lights():
    """Every receiver has a place of its own, in a bundle of its group, and neighbours do not try the same lights."""
    sizes = np.array([256, 1, 5, 33, 128, 3])
    group = np.repeat(np.arange(len(sizes)), sizes)
    receiver = Receiver(dr.zeros(mi.SurfaceInteraction3f, len(group)), None, mi.UInt32(group.astype(np.uint32)), None)
    bundles = _bundle(receiver)
    size, drawn, drawn_of = (getattr(bundles, name).numpy() for name in ("size", "drawn", "drawn_of"))
    members = np.stack([member.numpy() for member in bundles.members()])
    seats = members[np.arange(BUNDLE)[:, None] < size]
    assert np.array_equal(np.sort(seats), np.arange(len(group))) and (size >= 1).all() and (size <= BUNDLE).all()
    assert (group[members] == bundles.group.numpy()).all()
    assert (drawn_of[members] == drawn).all() and drawn.max() == DRAWS - 1
    same = (np.diff(drawn_of) == 0) & (np.diff(group) == 0)
    assert not same[group[1:] == 0].any() and same.sum() <= sizes[1:].sum() // BUNDLE


def test_receivers_that_keep_their_lights_share_bundles_with_their_like():
    """Where each has its own lights, whoever else is there changes nothing."""
    rng = np.random.default_rng(0)
    group, fixed = np.repeat([0, 1], [100, 7]), rng.integers(0, DRAWS, 107)
    order = np.lexsort((fixed, group))
    fixed = fixed[order].astype(np.uint32)
    receiver = Receiver(dr.zeros(mi.SurfaceInteraction3f, len(group)), None, mi.UInt32(group.astype(np.uint32)), None)
    bundles = _bundle(receiver, mi.UInt32(fixed))
    members = np.stack([member.numpy() for member in bundles.members()])
    assert np.array_equal(np.unique(members), np.arange(len(group)))
    assert (fixed[members] == bundles.drawn.numpy()).all() and np.array_equal(bundles.drawn_of.numpy(), fixed)
    assert (group[members] == bundles.group.numpy()).all()
