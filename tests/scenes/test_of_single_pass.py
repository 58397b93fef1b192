"""The three scenes of AWB08: closed solids, as many samples, lights and bodies as promised, a sensible picture."""

import gc
from functools import cache

import manifold3d
import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid.methods  # noqa: F401  (registers the material)
from pellucid.errors import SceneError
from pellucid.model.validity import validity
from pellucid.scene.bodies import find_bodies
from pellucid.scene.meshes.buffers import mesh_buffers, triangle_areas, triangle_corners
from pellucid.scenes.builtin import build
from pellucid.scenes.kitchen.objects import OBJECTS, make, slab
from pellucid.scenes.kitchen.scene import BLACK_OBJECTS, WHITE_OBJECTS
from pellucid.scenes.loading import load_scene
from pellucid.scenes.mezquita.arches import LOWER, UPPER, voussoirs
from pellucid.scenes.mezquita.capital import capital
from pellucid.scenes.shapes.boxes import perforated
from pellucid.scenes.shapes.lathe import joined, revolve, rounded, rounded_block
from pellucid.scenes.teapots.table import cathedral

PATH = {"integrator": {"type": "path", "max_depth": 3}}
COARSE = {"teapot_table": {"detail": 6}, "kitchen": {"detail": 48}, "mezquita": {"detail": 56, "bays": (3, 8)}}
SCENES = list(COARSE)


@pytest.fixture(scope="module", autouse=True)
def _leave_no_scene():
    """Every kernel of the process is prepared for the instances of all scenes that are alive: these go with their tests."""
    yield
    coarse.cache_clear()
    gc.collect()


@cache
def coarse(name):
    return load_scene(name, **COARSE[name], **PATH)


def samples_of(scene):
    """Irradiance samples of each body: A / (pi mfp^2)."""
    counts = {}
    for body in find_bodies(scene):
        area = sum(triangle_areas(triangle_corners(part.shape, part.to_world)).sum() for part in body.parts)
        counts[body.name] = area / (np.pi * body.medium.mfp.min() ** 2)
    return counts


def assert_solid(solid, pieces=1):
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent
    parts = mesh.split(only_watertight=False)
    assert len(parts) == pieces and all(part.volume > 0 for part in parts)
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1, atol=1e-6)
    facing = np.einsum("ij,ikj->ik", mesh.face_normals, solid.normals[solid.faces])
    # Where leaves and flutes are sharper than a triangle, a few normals turn away from their faces.
    assert np.mean(facing > 0.3) > 0.97


# ------------------------------------------------------------------ solids


@pytest.mark.parametrize("name", OBJECTS)
def test_kitchen_objects_are_closed(name):
    assert_solid(make(name, 96))


def test_slab_is_closed():
    assert_solid(slab(32))


def test_capital_is_closed_and_stays_so_at_any_detail():
    for segments in (56, 224):
        assert_solid(capital(segments), pieces=2)
    assert len(capital(224).faces) > 20_000


@pytest.mark.parametrize(("arch", "first", "count"), [(LOWER, 1, 9), (LOWER, 0, 10), (UPPER, 1, 8), (UPPER, 0, 9)])
def test_voussoirs_are_closed_wedges(arch, first, count):
    stones = voussoirs(arch, first, 2)
    assert_solid(stones, pieces=count)
    radius = np.hypot(stones.vertices[:, 1] - 1.5, stones.vertices[:, 2] - arch.z)
    assert radius.min() == pytest.approx(arch.inner, abs=0.01) and radius.max() == pytest.approx(arch.outer, abs=0.01)


def test_voussoirs_do_not_touch():
    white, brick = (trimesh.Trimesh(*voussoirs(LOWER, first, 1)[:2], process=False) for first in (1, 0))
    distance = trimesh.proximity.closest_point_naive(brick, white.vertices[:200])[1]
    assert distance.min() > 0.005


def test_a_turned_cylinder_has_the_volume_of_one():
    solid = revolve(rounded([(0, 0), (1, 0), (1, 0), (1, 2), (1, 2), (0, 2)], 400), 400)
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    assert mesh.volume == pytest.approx(2 * np.pi, rel=1e-3) and solid.area == pytest.approx(6 * np.pi, rel=3e-3)


def test_a_seam_changes_only_the_coordinates():
    profile = rounded([(0, 0), (1, 0), (2, 1), (0, 2)], 30)
    plain, seamed = revolve(profile, 24), revolve(profile, 24, with_uv=True)
    assert seamed.area == pytest.approx(plain.area)
    assert len(seamed.faces) == len(plain.faces) and seamed.uv.min() == 0 and seamed.uv.max() == 1
    # No face reaches back over the seam.
    assert np.ptp(seamed.uv[seamed.faces][..., 0], axis=1).max() == pytest.approx(1 / 24)


def test_a_rounded_block_has_the_volume_of_one():
    h, b = np.array((1.0, 2.0, 0.5)), 0.3
    mesh = trimesh.Trimesh(*rounded_block(h, b, (2, 3, 1), 16)[:2])
    inner = 2 * (h - b)
    expected = inner.prod() + 2 * b * (inner[[0, 1, 2]] * inner[[1, 2, 0]]).sum()
    expected += np.pi * b**2 * inner.sum() + 4 / 3 * np.pi * b**3
    assert mesh.is_watertight and mesh.volume == pytest.approx(expected, rel=2e-3)


def test_joined_solids_keep_their_faces():
    one = rounded_block((1, 1, 1), 0.1, (1, 1, 1))
    assert_solid(joined([one, one.moved((3, 0, 0))]), pieces=2)


def test_a_perforated_slab_lacks_its_holes_and_nothing_else():
    boxes = perforated((0, 0, 0), (10, 6, 1), 2, [((1, 1), (3, 2)), ((6, 3), (9, 5))])
    low, high = np.array(boxes).transpose(1, 0, 2)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(60 - 2 - 6)
    for x, y, solid in ((2, 1.5, False), (7, 4, False), (2, 4, True), (9.5, 4, True)):
        assert ((low[:, :2] < (x, y)) & (high[:, :2] > (x, y))).all(1).any() == solid


# ------------------------------------------------------------------ scenes


@pytest.mark.parametrize("name", SCENES)
def test_picture_is_well_exposed(name):
    picture = np.array(mi.render(coarse(name), sensor=coarse(name).sensors()[0], spp=1))
    assert picture.shape == (480, 640, 3) and np.isfinite(picture).all()
    assert 0.05 < picture.mean() < 0.6
    assert np.mean(picture.max(-1) > 2) < 0.05 and np.mean(picture.mean(-1) < 0.003) < 0.35


@pytest.mark.parametrize("name", SCENES)
def test_default_resolution_and_method(name):
    spec = build(name, **COARSE[name])
    assert (spec["sensor"]["film"]["width"], spec["sensor"]["film"]["height"]) == (640, 480)
    assert spec["integrator"] == {"type": "pellucid_single_pass"}


@pytest.mark.parametrize("name", SCENES)
def test_unknown_parameter(name):
    with pytest.raises(SceneError, match="no parameter 'sample'"):
        build(name, sample=3)


@pytest.mark.parametrize(
    ("name", "count"), [("kitchen", 3.5e6), ("kitchen", 2e4), ("mezquita", 64e6), ("mezquita", 1e4)]
)
def test_samples_add_up_to_what_is_asked_for(name, count):
    scene = load_scene(name, samples=count, **COARSE[name], **PATH)
    assert sum(samples_of(scene).values()) == pytest.approx(count, rel=1e-3)


def test_samples_of_the_teapot_are_those_of_the_paper():
    (count,) = samples_of(load_scene("teapot_table", **PATH)).values()
    assert count == pytest.approx(173_671, rel=0.001)


@pytest.mark.parametrize("name", ["kitchen", "mezquita"])
def test_no_samples_at_all(name):
    with pytest.raises(SceneError, match="at least one"):
        build(name, samples=0)


def test_every_kitchen_object_is_a_body():
    bodies = find_bodies(coarse("kitchen"))
    assert len(bodies) == sum(len(places) for places in [*WHITE_OBJECTS.values(), *BLACK_OBJECTS.values()])
    media = {body.medium for body in bodies}
    assert sorted(float(m.total_diffuse_reflectance.mean() > 0.5) for m in media) == [0, 1]
    assert not any(validity(medium) for medium in media)


def test_blocks_of_bays_are_instances_with_three_bodies_each():
    scene = coarse("mezquita")
    instances = [shape for shape in scene.shapes() if shape.class_name() == "Instance"]
    bodies = find_bodies(scene)
    assert len(instances) == 3 * 8 / 2 and len(bodies) == 3 * len(instances)
    assert len({part.shape.id() for body in bodies for part in body.parts}) == 3


def test_the_whole_hall_has_336_bays_and_90_lamps():
    spec = build("mezquita", detail=56)
    types = [value["type"] for value in spec.values() if isinstance(value, dict)]
    assert types.count("instance") == 336 / 4 and types.count("point") == 90 and types.count("sunsky") == 1


def test_samples_of_a_prototype_lie_below_a_power_of_two():
    spec = build("mezquita")
    scene = load_scene({**{key: spec[key] for key in ("type", "block", "block_0_0")}})
    for count in samples_of(scene).values():
        power = 2 ** np.ceil(np.log2(count))
        assert 0.9 < count / power < 1


def test_the_smallest_hall():
    scene = load_scene("mezquita", bays=(1, 1), samples=100, detail=56, **PATH)
    assert len(find_bodies(scene)) == 3 and len(scene.emitters()) == 2 + 1


def test_a_hall_needs_a_bay():
    with pytest.raises(SceneError, match="at least"):
        build("mezquita", bays=(0, 4))


def test_lamps_hang_free():
    """No lamp is inside of masonry: each sees the floor below it."""
    scene = coarse("mezquita")
    for emitter in scene.emitters():
        if emitter.class_name() == "PointLight":
            p = mi.traverse(emitter)["position"]
            si = scene.ray_intersect(mi.Ray3f(mi.Point3f(p), mi.Vector3f(0, 0, -1)))
            assert si.shape[0].id() == "floor"


@pytest.mark.parametrize("name", ["kitchen", "mezquita"])
def test_no_light_leaks_in(name):
    """Rays from inside reach the sky only where there is a window: never through a corner or between two walls."""
    scene = coarse(name)
    low, high = np.array(scene.bbox().min).ravel(), np.array(scene.bbox().max).ravel()
    rng = np.random.default_rng(1)
    # Towards the edges of the room, where walls meet.
    where = rng.uniform(low, high, (20_000, 3))
    axis = rng.integers(0, 3, len(where))
    for k in (1, 2):
        other = (axis + k) % 3
        where[np.arange(len(where)), other] = np.where(rng.random(len(where)) < 0.5, low[other], high[other])
    eye = np.array(scene.sensors()[0].world_transform().translation()).ravel()
    direction = where - eye
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(*eye.tolist()), mi.Vector3f(direction.T.astype(np.float32)))
    escaped = ~np.array(scene.ray_test(ray))
    assert escaped.mean() == 0


def test_nothing_in_the_kitchen_cuts_into_anything_else():
    placed = []
    for body in find_bodies(coarse("kitchen")):
        (part,) = body.parts
        vertices, faces = mesh_buffers(part.shape)
        if part.to_world is not None:
            vertices = vertices @ part.to_world[:3, :3].T + part.to_world[:3, 3]
        assert vertices[:, 2].min() > -0.1
        solid = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))
        assert solid.volume() > 0
        placed.append((body.name, solid))
    for k, (name, solid) in enumerate(placed):
        for other_name, other in placed[:k]:
            assert (solid ^ other).volume() < 1.0, f"{name} and {other_name}"


@pytest.mark.parametrize("name", SCENES)
def test_built_twice_it_is_the_same(name):
    pictures = [np.array(mi.render(load_scene(name, resolution=(32, 24), **COARSE[name], **PATH), spp=1)) for _ in "ab"]
    np.testing.assert_array_equal(*pictures)


def test_cathedral_is_lit_by_its_windows():
    light = cathedral(64)
    assert light.shape == (64, 128, 3) and light.min() >= 0 and np.isfinite(light).all()
    assert light[:32].mean() > 3 * light[32:].mean()
    # Warm, as stone and sunlight are; yet there is blue glass.
    assert light[..., 0].sum() > 1.2 * light[..., 2].sum()
    assert (light[..., 2] > 1.5 * light[..., 0]).mean() > 0.002
