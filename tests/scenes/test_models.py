"""The seven models: closed meshes of the triangle counts of table 2 of CLHHC08, alone in the dark under one lamp."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.scene.meshes.buffers import mesh_buffers
from pellucid.scenes.loading import load_scene
from pellucid.scenes.models.scene import FILLED, MODELS, SHAPES, shape_mesh, sphere_mesh
from pellucid.scenes.shapes.decimate import decimate
from pellucid.scenes.shapes.distance import disc, ellipsoid, tube, weathering
from pellucid.scenes.shapes.level_set import surface_mesh

TRIANGLES = {
    "sphere": 28560,
    "horned_head": 2072,
    "relief_head": 8924,
    "philosopher": 9951,
    "longneck": 7685,
    "antique_head": 10000,
    "wanderer": 10000,
}
"""Table 2 of CLHHC08. A closed mesh has an even number of them: two rows are one less here."""

DIRECT = {"integrator": {"type": "path", "max_depth": 2}}


@pytest.fixture(scope="module")
def meshes():
    return {name: sphere_mesh() if name == "sphere" else shape_mesh(SHAPES[name]) for name in MODELS}


@pytest.mark.parametrize("name", TRIANGLES)
def test_model_is_one_closed_solid_of_the_right_count(meshes, name):
    vertices, normals, faces = meshes[name]
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert len(faces) == TRIANGLES[name] // 2 * 2
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0
    assert solid.body_count == 1
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    # No normal that a smooth surface is shaded with may look into the solid.
    assert np.percentile(np.einsum("ij,ikj->ik", solid.face_normals, normals[faces]), 1) > 0.3
    assert np.einsum("ij,ij->i", solid.vertex_normals, normals).min() > 0


def test_models_lie_on_their_distances(meshes):
    for name, shape in SHAPES.items():
        vertices = meshes[name][0].T.astype(np.float32)
        assert np.quantile(np.abs(shape.distance(vertices)), 0.98) < 0.15, name


@pytest.mark.parametrize(("angle", "lit"), [(0.0, 0.9), (90.0, 0.3), (180.0, 0.0)])
def test_lamp_goes_around_the_sphere(angle, lit):
    scene = load_scene("sphere", resolution=(64, 64), light_angle=angle, bsdf={"type": "diffuse"}, **DIRECT)
    vertices, _ = mesh_buffers(scene.shapes()[0])
    np.testing.assert_allclose(np.ptp(vertices, axis=0), 10, rtol=1e-3)
    picture = np.array(mi.render(scene, spp=16)).mean(2)
    y, x = np.mgrid[:64, :64] - 31.5
    inside = np.hypot(x, y) < 0.8 * FILLED * 32
    assert (picture[inside] > 0.01).mean() == pytest.approx(lit, abs=0.15)
    left, right = picture[inside & (x < 0)].mean(), picture[inside & (x > 0)].mean()
    assert right == pytest.approx(left, rel=0.1) if angle != 90 else right > 3 * left


def test_size_scales_body_and_lamp_and_not_the_picture():
    options = {"resolution": (32, 32), "bsdf": {"type": "diffuse"}, **DIRECT}
    small, large = (load_scene("horned_head", size=size, **options) for size in (10.0, 30.0))
    boxes = [np.ptp(mesh_buffers(scene.shapes()[0])[0], axis=0) for scene in (small, large)]
    assert boxes[0].max() == pytest.approx(10, rel=1e-5)
    np.testing.assert_allclose(boxes[1], 3 * boxes[0], rtol=1e-4)
    pictures = [np.array(mi.render(scene, spp=16)) for scene in (small, large)]
    np.testing.assert_allclose(pictures[1].mean(), pictures[0].mean(), rtol=0.02)


# ------------------------------------------------------------------ decimation


def test_decimation_keeps_a_ball_a_ball():
    vertices, _, faces = surface_mesh(lambda p: np.sqrt((p * p).sum(0)) - 20, np.full(3, -24.0), np.full(3, 24.0), 2.0)
    source, few = decimate(vertices, faces, 500)
    ball = trimesh.Trimesh(vertices[source], few, process=False)
    assert len(few) == 500 and ball.is_watertight and ball.is_winding_consistent and ball.euler_number == 2
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.03)
    # Even triangles: none is a sliver.
    corners = ball.vertices[few]
    longest = ((corners - np.roll(corners, 1, 1)) ** 2).sum(2).max(1)
    assert (ball.area_faces / longest).min() > 0.07


def test_decimation_keeps_edges_and_spends_triangles_on_them():
    vertices, _, faces = surface_mesh(
        lambda p: np.max(np.abs(p) - 10, axis=0), np.full(3, -12.3), np.full(3, 12.1), 1.0
    )
    source, few = decimate(vertices, faces, 400)
    box = trimesh.Trimesh(vertices[source], few, process=False)
    assert box.is_watertight and box.volume == pytest.approx(trimesh.Trimesh(vertices, faces).volume, rel=0.01)


def test_decimation_stops_where_it_would_fold_the_surface():
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    _, few = decimate(tetrahedron, faces, 2)
    assert len(few) == 4


# ------------------------------------------------------------------ what shapes are made of


def test_distances_are_distances():
    p = np.array([[0, 0, 30], [40, 0, 0], [0, 0, 0]], np.float32).T
    np.testing.assert_allclose(disc(p, (0, 0, 0), 20, 20, 1e-3), [20, 20, -10], atol=1e-3)
    np.testing.assert_allclose(ellipsoid(p, (0, 0, 0), (10, 10, 10))[:2], [20, 30], atol=1e-4)
    straight = tube(p, [(0, 0, -10), (0, 0, 0), (0, 0, 10)], (5, 5, 5))
    np.testing.assert_allclose(straight, [15, 35, -5], atol=0.6)


def test_weathering_has_deviation_one():
    p = np.random.default_rng(1).uniform(-500, 500, (3, 20000)).astype(np.float32)
    assert weathering(p, 20, 1).std() == pytest.approx(1, rel=0.1)
