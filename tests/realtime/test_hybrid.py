"""The local part by rings over shadow maps, against sums over all samples."""

import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid
from pellucid.gather.gather import gather_all
from pellucid.kernels.memory import columns
from pellucid.methods.texture_space.hybrid import NearLight, build_rings, filter_maps
from pellucid.model import Medium, ProfileTable
from pellucid.model.decomposition import decompose
from pellucid.model.fresnel import transmitted
from pellucid.realtime.engine import Engine
from pellucid.realtime.source import Camera
from pellucid.realtime.tone import tone_map
from pellucid.scene.bodies import build_lookup, find_bodies
from pellucid.scene.meshes.buffers import mesh_from_arrays
from worlds.points import relative_rmse, spiral

RADIUS = 5.0
LIGHT = np.array([10.0, 5.0, 12.5])
POINT = {"type": "point", "position": list(LIGHT), "intensity": 100.0}
SUN = {"type": "directional", "direction": [0.2, -1.0, -0.4], "irradiance": 1.0}


QUERIES = RADIUS * spiral(1009)


def sphere_scene(lights, material):
    ball = {
        "type": "sphere",
        "radius": RADIUS,
        "bsdf": {"type": "pellucid_translucent", "material": material, "profile": "dipole"},
    }
    content = {f"light{k}": light for k, light in enumerate(lights)}
    return mi.load_dict({"type": "scene", "ball": ball, **content}, optimize=False)


def maps_of(scene, resolution):
    bodies = find_bodies(scene)
    near = NearLight(bodies[0], 0, build_lookup(scene, bodies), QUERIES, resolution)
    near.update(scene)
    return near.maps


def local_part(lights, medium, rings=20, per_ring=20, resolution=512, weight=None):
    """Filter the maps of the lights on a sphere."""
    maps = maps_of(sphere_scene(lights, medium.name), resolution)
    filter_of = build_rings(medium, weight or decompose(medium).local_weight, rings, per_ring)
    return filter_maps(maps, filter_of, mi.Point3f(*columns(QUERIES))).numpy().T


def lit_samples(medium, count=300_000):
    """The same light on many samples: positions, power, and the radius of the disc that each stands for."""
    n = spiral(count)
    way = LIGHT - RADIUS * n
    distance = np.linalg.norm(way, axis=1)
    cosine = np.sum(way * n, axis=1) / distance
    passed = np.array(transmitted(mi.Float(cosine.astype(np.float32)), mi.Float(medium.eta)))
    area = 4 * np.pi * RADIUS**2 / count
    power = 100.0 / distance**2 * np.maximum(cosine, 0) * passed * area
    lit = power > 0
    return RADIUS * n[lit], np.repeat(power[lit, None], 3, axis=1), np.sqrt(area / np.pi)


def sum_of_all(medium, weight):
    p, power, disc = lit_samples(medium)
    table = ProfileTable.from_medium(medium, disc, weight)
    return np.stack([c.numpy() for c in gather_all(p, power, table, mi.Point3f(*columns(QUERIES)))], 1)


@pytest.mark.parametrize("name", ["marble", "skin1", "cream", "spectralon"])
def test_places_stand_for_the_whole_plane(name):
    medium = Medium.from_preset(name, profile="dipole")
    weight = decompose(medium).local_weight
    places = build_rings(medium, weight).source.records.numpy().reshape(-1, 4)
    assert len(places) == 401
    r = np.hypot(places[:, 0], places[:, 1])
    found = (medium.diffuse_reflectance(r) * weight(r) * places[:, 2:3]).sum(axis=0)
    x = np.geomspace(1e-5, 200, 100_001)
    rings = medium.diffuse_reflectance(x) * weight(x) * (2 * np.pi * x)[:, None]
    total = np.trapezoid(rings, x, axis=0)
    assert found.sum() == pytest.approx(total.sum(), rel=1e-3)
    np.testing.assert_allclose(found, total, rtol=5e-3)


def test_rings_are_round_and_never_in_line():
    places = (
        build_rings(Medium.from_preset("marble", profile="dipole"), None, 8, 12).source.records.numpy().reshape(-1, 4)
    )
    assert np.all(places[0, :2] == 0)
    r = np.hypot(places[1:, 0], places[1:, 1]).reshape(8, 12)
    np.testing.assert_allclose(r, np.repeat(r[:, :1], 12, axis=1), rtol=1e-5)
    assert np.all(np.diff(r[:, 0]) > 0)
    np.testing.assert_allclose(places[1:, :2].reshape(8, 12, 2).mean(axis=1), 0, atol=1e-5 * r.max())
    angle = np.sort(np.arctan2(places[1:, 1], places[1:, 0]) % (2 * np.pi / 12) * 12 / (2 * np.pi))
    gaps = np.diff(np.unique(angle.round(4) % 1))
    assert gaps.max() < 0.3


@pytest.mark.parametrize("name", ["marble", "skin1", "cream"])
def test_the_local_part_is_the_sum_over_all_samples(name):
    """Also where the light does not see the point: the queries are all around the sphere."""
    medium = Medium.from_preset(name, profile="dipole")
    truth = sum_of_all(medium, decompose(medium).local_weight)
    found = local_part([POINT], medium)
    assert relative_rmse(found, truth).max() < 0.01
    assert np.abs(found.mean(axis=0) / truth.mean(axis=0) - 1).max() < 0.004


def test_light_in_the_coarse_pixels_of_a_map_makes_no_sparks():
    """Of a profile that rises as 1 / r: in the middle of a pixel light may be far nearer to a point than the place of the ring is."""
    medium = Medium.from_preset("skin1")
    truth = sum_of_all(medium, decompose(medium).local_weight)
    found = local_part([POINT], medium, resolution=64)
    assert (found - truth).max() < 0.1 * truth.max()
    assert relative_rmse(found, truth).max() < 0.15


@pytest.mark.parametrize("cosine", [0.3, 0.1])
@pytest.mark.parametrize("kind", ["directional", "point"])
def test_light_that_grazes_a_plane_draws_no_stripes(kind, cosine):
    """Pixels of a map are stretched along a plane that light grazes, to 2 mm: as much comes out as an even plane reflects nearby."""
    medium = Medium.from_preset("cream", profile="dipole")
    way = np.array([0.8, 0.6, 0]) * np.sqrt(1 - cosine**2) + [0, 0, cosine]
    lamp = {"type": "directional", "direction": list(-way), "irradiance": 1.0}
    if kind == "point":
        lamp = {"type": "point", "position": list(100 * way), "intensity": 1.0}
    bsdf = {"type": "pellucid_translucent", "material": "cream", "profile": "dipole"}
    plate = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 0, -5]).scale([20, 20, 5]), "bsdf": bsdf}
    scene = mi.load_dict({"type": "scene", "plate": plate, "lamp": lamp}, optimize=False)
    bodies = find_bodies(scene)
    queries = np.column_stack([np.random.default_rng(1).uniform(-5, 5, (1009, 2)), np.zeros(1009)])
    corners = [[20, 20, 0], [-20, -20, -10]]
    near = NearLight(bodies[0], 0, build_lookup(scene, bodies), corners, 256)
    near.update(scene)
    found = near.exitance(mi.Point3f(*columns(queries))).numpy().T
    to_lamp = 100 * way - queries if kind == "point" else np.broadcast_to(way, queries.shape)
    distance = np.linalg.norm(to_lamp, axis=1) if kind == "point" else 1.0
    falling = to_lamp[:, 2] / distance
    passed = np.array(transmitted(mi.Float(falling.astype(np.float32)), mi.Float(medium.eta)))
    r = np.geomspace(1e-5, 200, 100_001)
    rings = medium.diffuse_reflectance(r) * decompose(medium).local_weight(r) * (2 * np.pi * r)[:, None]
    reflected = np.trapezoid(rings, r, axis=0)
    assert found / (falling * passed / distance**2)[:, None] == pytest.approx(reflected + np.zeros((1009, 3)), rel=0.05)


def test_more_rings_converge():
    medium = Medium.from_preset("marble", profile="dipole")
    truth = sum_of_all(medium, decompose(medium).local_weight)
    errors = [relative_rmse(local_part([POINT], medium, n, n, 1024), truth).max() for n in (10, 20, 40, 80)]
    assert all(fine < 0.65 * coarse for coarse, fine in itertools.pairwise(errors)), errors
    assert errors[-1] < 2e-3


def test_with_all_of_the_profile_the_maps_alone_are_the_picture():
    medium = Medium.from_preset("marble", profile="dipole")
    found = local_part([POINT], medium, 40, 40, weight=lambda r: np.ones((*r.shape, 1)))
    assert relative_rmse(found, sum_of_all(medium, None)).max() < 0.01


def test_a_light_far_away_is_a_directional_one():
    medium = Medium.from_preset("skin1", profile="dipole")
    way = np.array(SUN["direction"]) / np.linalg.norm(SUN["direction"])
    far = {"type": "point", "position": list(-3000.0 * way), "intensity": 3000.0**2}
    near, sun = local_part([far], medium), local_part([SUN], medium)
    assert relative_rmse(near, sun).max() < 0.01


def test_the_light_of_several_lamps_adds_up():
    medium = Medium.from_preset("skin1", profile="dipole")
    both = local_part([POINT, SUN], medium)
    np.testing.assert_allclose(both, local_part([POINT], medium) + local_part([SUN], medium), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", ["skin1", "marble", "cream"])
def test_with_few_samples_for_the_far_part_the_sum_is_that_of_all(name):
    """900 samples by importance and 401 places: an RMSE of a hundredth of the mean, a tenth of that of 900 samples alone."""
    medium = Medium.from_preset(name, profile="dipole")
    split = decompose(medium)
    p, power, _ = lit_samples(medium)
    cumulative = np.cumsum(power[:, 0])
    # In the order of the spiral even steps would be stripes: the numbers are random within their strata.
    u = (np.arange(900) + np.random.default_rng(1).random(900)) / 900
    drawn = np.searchsorted(cumulative, u * cumulative[-1])
    share = np.full((900, 3), cumulative[-1] / 900)
    q = mi.Point3f(*columns(QUERIES))

    def few(weight):
        table = ProfileTable.from_medium(medium, 0.0, weight)
        return np.stack([c.numpy() for c in gather_all(p[drawn], share, table, q)], 1)

    truth = sum_of_all(medium, None)
    hybrid = relative_rmse(local_part([POINT], medium) + few(split.global_weight), truth).max()
    plain = relative_rmse(few(None), truth).max()
    assert hybrid < 0.03 and hybrid < 0.25 * plain, (hybrid, plain)


def test_each_light_is_seen_again_only_when_it_has_changed():
    sky = {"type": "constant", "radiance": 1.0}
    scene = sphere_scene([POINT, sky, SUN], "marble")
    bodies = find_bodies(scene)
    near = NearLight(bodies[0], 0, build_lookup(scene, bodies), QUERIES, 64)
    near.update(scene)
    assert near.mapped == [True, False, True]
    before = list(near.maps)
    near.forget(2)
    near.update(scene)
    assert near.maps[0] is before[0] and near.maps[2] is not before[2]
    near.forget()
    near.update(scene)
    assert near.maps[0] is not before[0] and near.mapped == [True, False, True]
    near.update(scene, fine=True)
    assert near.maps[0].camera.resolution == 128
    fine = list(near.maps)
    near.update(scene)
    assert near.maps == fine


def test_a_medium_that_is_all_global_needs_no_maps():
    scene = sphere_scene([POINT], "chicken1")
    bodies = find_bodies(scene)
    near = NearLight(bodies[0], 0, build_lookup(scene, bodies), QUERIES, 64)
    near.update(scene)
    assert near.mapped == [False] and near.split.radius == 0
    assert np.all(near.exitance(mi.Point3f(*columns(QUERIES))).numpy() == 0)
    bodies[0].bsdf.set_medium(Medium.from_preset("marble", profile="dipole"), 1.0)
    near.divide()
    near.update(scene)
    assert near.mapped == [True]
    assert np.all(near.exitance(mi.Point3f(*columns(QUERIES))).numpy().mean(axis=1) > 0)
    bodies[0].bsdf.set_medium(
        Medium.from_preset("marble", profile="dipole"), 1000.0
    )  # a sphere of 10 m: only the unit has changed
    near.divide()
    assert near.split.radius == pytest.approx(decompose(Medium.from_preset("marble", profile="dipole")).radius / 1000)


def test_nothing_is_compiled_when_light_medium_rings_or_points_change():
    scene = sphere_scene([POINT], "marble")
    bodies = find_bodies(scene)
    near = NearLight(bodies[0], 0, build_lookup(scene, bodies), QUERIES, 64)
    parameters, misses = mi.traverse(scene), []
    for k, name in enumerate(["marble", "skin1", "cream", "apple", "skin2"]):
        parameters["light0.position"] = [10.0, 5.0 + k, 12.0]
        parameters.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            bodies[0].bsdf.set_medium(Medium.from_preset(name, profile="dipole"), 1.0)
            near.divide(0.1, 4 + k, 6 + k)
            near.forget(0)
            near.update(scene, fine=k % 2 == 0)
            near.exitance(mi.Point3f(*columns(QUERIES[: 100 + 7 * k])))
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
            misses.append(sum(not entry["cache_hit"] for entry in kernels))
        assert len(kernels) >= 3
    assert misses[3:] == [0, 0], misses


def two_balls(material, size, *lights):
    """A small ball that throws a shadow on a large one; both are one body."""
    bsdf = {
        "type": "pellucid_translucent",
        "material": material,
        "profile": "dipole",
        "scale": size / 4.0,
        "alpha": 0.0,
    }
    bsdf |= {"body": "both"}
    large = {"type": "sphere", "radius": 1.8, "bsdf": bsdf}
    small = {"type": "sphere", "center": [1.4, 1.5, 1.6], "radius": 0.6, "bsdf": bsdf}
    content = {f"light{k}": light for k, light in enumerate(lights)}
    return mi.load_dict({"type": "scene", "large": large, "small": small, **content}, optimize=False)


LAMP = {"type": "point", "position": [6.0, 5.0, 6.0], "intensity": 60.0}
CAMERA = Camera((2.0, 3.0, 14.0), (0.0, 0.0, 0.0), fov=20.0)


def picture(scene, method, count, **settings):
    engine = Engine(scene, 512)
    for name, value in {"gi": False, "method": method, "samples": count, **settings}.items():
        setattr(engine.settings, name, value)
    return engine.linear(CAMERA, (96, 96))


def toned_rmse(value, truth):
    body = truth.max(axis=2) > 0
    average = truth[body].mean()
    return np.sqrt(np.mean((tone_map(value[body], average) - tone_map(truth[body], average)) ** 2))


@pytest.mark.parametrize(("material", "size"), [("skin1", 10.0), ("marble", 20.0), ("cream", 30.0)])
def test_frames_of_the_engine_are_right_with_900_samples(material, size):
    """Against as many samples in texture space as the plain method needs; half of the paper's error."""
    scene = two_balls(material, size, LAMP)
    truth = picture(scene, "texture_space", 100_000)
    assert toned_rmse(picture(scene, "hybrid", 900), truth) < 0.007
    assert toned_rmse(picture(scene, "texture_space", 900), truth) > 0.007 or size == 10.0


def test_light_of_a_sky_goes_by_all_of_the_profile():
    """A lamp, a sky and a lamp too near for a map, in one picture."""
    sky = {"type": "constant", "radiance": 0.3}
    near_by = {"type": "point", "position": [-1.2, 1.5, 1.2], "intensity": 0.1}
    scene = two_balls("skin1", 10.0, LAMP, sky, near_by)
    truth = picture(scene, "texture_space", 40_000)
    assert toned_rmse(picture(scene, "hybrid", 4000), truth) < 0.007


def test_frames_compile_nothing_whatever_changes():
    engine = Engine(two_balls("chicken1", 10.0, LAMP), 256)  # a medium without a local part at first
    misses = []
    for k in range(12):
        engine.settings.method = ("hybrid", "texture_space", "image_space")[k % 3]
        engine.settings.samples = 100 + k
        engine.settings.rings = 3 + k
        engine.settings.importance_bound = 0.1 / (k + 1)
        engine.set_light(0, position=[6.0, 5.0 - k, 6.0])
        engine.set_medium(0, Medium.from_preset(("chicken1", "marble", "skin1", "cream")[k % 4], profile="dipole"))
        engine.set_size(8.0 + k)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
            misses.append(sum(not entry["cache_hit"] for entry in kernels))
    assert misses[3:] == [0] * 9, misses


@pytest.mark.parametrize("shape", ["ball", "box"])
def test_a_coarse_mesh_is_the_smooth_surface_that_it_stands_for(shape):
    """What of its light the map cannot find, as facets turn away or lie behind others, goes by all of the profile: 5 % were lost."""
    mesh = trimesh.creation.icosphere(0, 1.0) if shape == "ball" else trimesh.creation.box([1.5] * 3)
    bsdf = {
        "type": "pellucid_translucent",
        "material": "marble",
        "profile": "dipole",
        "scale": 32.0,
        "specular_reflectance": 0.0,
    }
    body = mesh_from_arrays("coarse", mesh.vertices, mesh.faces, mesh.vertex_normals, bsdf=bsdf)
    scene = mi.load_dict({"type": "scene", "body": body, "light": LAMP}, optimize=False)
    points, _ = trimesh.sample.sample_surface(mesh, 1000, seed=1)
    settings = {"resolution": 256, "irradiance_depth": 2}
    plain, hybrid = (
        pellucid.prepare(scene, "texture_space", hybrid=count < 40_000, sample_count=count, **settings).exitance(points)
        for count in (40_000, 8000)
    )
    assert hybrid.mean() == pytest.approx(plain.mean(), rel=0.005)
    assert np.abs(hybrid - plain).mean() < 0.03 * plain.mean()
    truth = picture(scene, "texture_space", 40_000)
    seen = picture(scene, "hybrid", 8000)
    assert seen.mean() == pytest.approx(truth.mean(), rel=0.005)
    assert toned_rmse(seen, truth) < 0.012
