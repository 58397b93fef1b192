"""The built-in scenes: they load, they answer their parameters, and their solids are solids."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.errors import SceneError
from pellucid.scene.meshes.buffers import mesh_buffers
from pellucid.scenes.builtin import build, builtin_names
from pellucid.scenes.bust.albedo import AXIS_Y, COLUMNS, LIP, ROWS, bust_albedo, cylinder_uv
from pellucid.scenes.bust.scene import LIFE_SIZE
from pellucid.scenes.bust.shape import BASE, HIGH, LOW, MOUTH_Z, bust_distance
from pellucid.scenes.loading import load_scene
from pellucid.scenes.models.scene import MODELS
from pellucid.scenes.shapes.level_set import surface_mesh
from pellucid.scenes.stage import material

SMALL = {"resolution": (48, 36), "spp": 4}
COARSE = {
    "teapot": {"detail": 8},
    "teapot_env": {"detail": 8},
    "bust": {"edge": 5.0},
    "teapot_table": {"detail": 6},
}
PATH = {"integrator": {"type": "path", "max_depth": 4}}
BODIES = {
    "teapot": "teapot",
    "teapot_env": "teapot",
    "cornell_box": "block",
    "bust": "bust",
    "teapot_table": "teapot",
}
"""The scenes of one body that take its size, and the name of that body."""


@pytest.fixture(scope="module")
def head():
    return surface_mesh(bust_distance, LOW, HIGH, 3.0)


def body_of(scene, name):
    return next(shape for shape in scene.shapes() if shape.id() == BODIES[name])


@pytest.mark.parametrize("name", BODIES)
def test_scene_loads_and_gives_a_sensible_picture(name):
    scene = load_scene(name, **SMALL, **COARSE.get(name, {}), **PATH)
    assert type(body_of(scene, name).bsdf()).__name__ == "TranslucentBSDF"
    picture = np.array(mi.render(scene))
    assert picture.shape == (36, 48, 3)
    assert np.isfinite(picture).all()
    # Neither night nor a blown-out picture.
    assert 0.05 < picture.mean() < 0.6


@pytest.mark.parametrize("name", BODIES)
def test_size_scales_the_body_and_not_the_picture(name):
    options = {**SMALL, **COARSE.get(name, {}), **PATH, "bsdf": {"type": "diffuse"}}
    boxes, pictures = [], []
    for size in (50.0, 100.0):
        scene = load_scene(name, size=size, **options)
        vertices, _ = mesh_buffers(body_of(scene, name))
        boxes.append(np.ptp(vertices, axis=0))
        pictures.append(np.array(mi.render(scene, spp=64)).mean((0, 1)))
    np.testing.assert_allclose(boxes[1], 2 * boxes[0], rtol=1e-4)
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=0.05)


@pytest.mark.parametrize("name", ["teapot", "bust"])
def test_camera_goes_around_and_the_light_stays(name):
    before, after = (build(name, camera_angle=a, **COARSE[name]) for a in (0.0, 90.0))
    where = [np.array(spec["sensor"]["to_world"].matrix)[:3, 3] for spec in (before, after)]
    target = np.array([8.0 if name == "teapot" else 0.0, 0, 0])
    a, b = where[0] - target, where[1] - target
    np.testing.assert_allclose(b, (-a[1], a[0], a[2]), atol=1e-3)
    np.testing.assert_array_equal(before["key"]["to_world"].matrix, after["key"]["to_world"].matrix)


def test_scenes_of_many_bodies_have_no_size():
    assert set(builtin_names()) - set(BODIES) - set(MODELS) == {"kitchen", "mezquita"}
    for name in ("kitchen", "mezquita"):
        with pytest.raises(SceneError, match="no parameter 'size'"):
            build(name, size=50.0)


def test_unknown_scene_and_unknown_parameter():
    with pytest.raises(SceneError, match="did you mean 'teapot'"):
        build("teapott")
    with pytest.raises(SceneError, match="no parameter 'environment'"):
        build("cornell_box", environment="sky.exr")


def test_missing_environment(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        build("teapot_env", environment=tmp_path / "sky.exr", detail=4)


def test_environment_picture_stands_upright(tmp_path):
    sky = np.zeros((16, 32, 3), np.float32)
    sky[:8] = (0, 0, 1)
    mi.Bitmap(sky).write(str(tmp_path / "sky.exr"))
    spec = build("teapot_env", environment=tmp_path / "sky.exr", detail=4, bsdf={"type": "diffuse"})
    scene = mi.load_dict({"type": "scene", "sky": spec["sky"]})
    si = mi.SurfaceInteraction3f()
    for z, expected in ((1.0, 1.0), (-1.0, 0.0)):
        si.wi = mi.Vector3f(0, 0, -z)
        assert np.array(scene.environment().eval(si)).ravel()[2] == pytest.approx(expected, abs=1e-3)


def test_material_of_the_caller():
    own = {"type": "pellucid_translucent", "material": "marble", "alpha": 0.03}
    assert material(None, own) == own
    assert material({"type": "pellucid_translucent", "alpha": 0.5}, own)["material"] == "marble"
    changed = material({"type": "pellucid_translucent", "reflectance": 0.5, "dmfp": 2.0}, own)
    assert changed == {"type": "pellucid_translucent", "alpha": 0.03, "reflectance": 0.5, "dmfp": 2.0}
    assert material({"type": "diffuse"}, own) == {"type": "diffuse"}


# ------------------------------------------------------------------ surfaces of distances


@pytest.mark.parametrize("edge", [2.0, 4.0])
def test_level_set_of_a_ball(edge):
    low, high = np.full(3, -61.3), np.full(3, 60.7)
    vertices, normals, faces = surface_mesh(lambda p: np.sqrt((p * p).sum(0)) - 50, low, high, edge)
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_watertight and ball.is_winding_consistent and ball.euler_number == 2
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 50, atol=1e-3)
    np.testing.assert_allclose(normals, vertices / 50, atol=1e-3)
    assert 4 / 3 * np.pi * 50**3 * (1 - (edge / 50) ** 2) < ball.volume < 4 / 3 * np.pi * 50**3


def test_level_set_is_closed_where_cells_are_ambiguous():
    # White noise on the scale of the cells: every one of the 256 cases, the ambiguous ones included, happens.
    rng = np.random.default_rng(3)
    wave, phase = rng.normal(0, 0.9, (40, 3)).astype(np.float32), rng.uniform(0, 6.3, 40).astype(np.float32)

    def sponge(p):
        noise = np.cos(wave @ p + phase[:, None]).sum(0) / 4
        return np.maximum(np.float32(0.3) * noise, np.sqrt((p * p).sum(0)) - 14)

    _, _, faces = surface_mesh(sponge, np.full(3, -16.0), np.full(3, 16.0), 1.0)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert len(faces) > 5000
    np.testing.assert_array_equal(uses % 2, 0)
    assert (uses != 2).mean() < 2e-3


# ------------------------------------------------------------------ the bust


def test_bust_is_one_closed_solid(head):
    vertices, normals, faces = head
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.euler_number == 2 and solid.volume > 0
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    # The normals are those of the distance; grooves narrower than a triangle may turn some away from its face.
    assert np.percentile(np.einsum("ij,ij->i", normals, solid.vertex_normals), 1) > 0.8
    assert vertices[:, 2].min() == pytest.approx(BASE, abs=0.1)
    assert np.ptp(vertices[:, 2]) == pytest.approx(LIFE_SIZE, rel=0.01)
    assert np.quantile(np.abs(bust_distance(vertices.T.astype(np.float32))), 0.99) < 0.02


def test_bust_is_painted_where_its_features_are(head):
    vertices, _, _ = head
    picture = bust_albedo(vertices)
    assert picture.shape == (ROWS, COLUMNS, 3) and picture.min() > 0 and picture.max() < 1
    top = vertices[:, 2].max()
    row = int((top - (MOUTH_Z - 4)) / np.ptp(vertices[:, 2]) * ROWS)
    assert np.abs(picture[row, COLUMNS // 2] / LIP - 1).max() < 0.35
    cheek, nape = picture[row, COLUMNS // 2 + 150], picture[ROWS - 20, 5]
    assert cheek[1] > 2 * picture[row, COLUMNS // 2, 1] and nape[0] > 0.5
    assert picture[60, COLUMNS // 4].mean() < 0.7 * nape.mean()


def test_texture_coordinates_wrap_around_once(head):
    vertices, _, faces = head
    source, uv, wrapped = cylinder_uv(vertices, faces)
    np.testing.assert_array_equal(source[wrapped], faces)
    # Only the faces that the axis goes through, on the crown of the head and in the base, span more than half a turn.
    wide = np.ptp(uv[wrapped][..., 0], axis=1) > 0.5
    assert wide.sum() <= 2 and np.abs(uv[wrapped[wide]][..., 1] - 0.5).min(initial=1) > 0.49
    assert uv[:, 1].min() == 0 and uv[:, 1].max() == 1
    nose = np.argmin(vertices[:, 1])
    assert uv[nose, 0] == pytest.approx(0.5, abs=0.02) and vertices[nose, 1] < AXIS_Y
