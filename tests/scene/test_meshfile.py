"""Bare meshes: every format, every repair, every refusal."""

import warnings

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.errors import PellucidWarning, SceneError
from pellucid.methods.preparation import open_scene, warn_of_units
from pellucid.model.units import unit_mistake
from pellucid.scene.meshes.buffers import mesh_buffers
from pellucid.scene.meshes.files import MESH_FORMATS, read_mesh
from pellucid.scenes.loading import load_scene, scene_dict
from pellucid.scenes.mesh_scene import mesh_scene

DIFFUSE = {"type": "diffuse"}


@pytest.fixture
def ball():
    return trimesh.creation.icosphere(subdivisions=2, radius=1.0)


def write(mesh, path):
    """Export a mesh; glTF becomes several files."""
    if path.suffix == ".gltf":
        for name, content in mesh.scene().export(file_type="gltf").items():
            (path.parent / (path.name if name.endswith(".gltf") else name)).write_bytes(content)
    else:
        mesh.export(path)
    return path


def soup(path, vertices, faces):
    """Write an OFF file by hand, so that no library repairs it on the way."""
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(str, v)) for v in vertices] + [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def volume(model):
    p = model.vertices[model.faces]
    return np.einsum("ij,ij->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6


def outward(model):
    p = model.vertices[model.faces]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    return np.einsum("ij,ikj->ik", normal, model.normals[model.faces])


@pytest.mark.parametrize("suffix", sorted(MESH_FORMATS))
def test_every_format_gives_the_same_ball(ball, tmp_path, suffix):
    path = write(ball, tmp_path / f"ball{suffix}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = read_mesh(path)
    assert len(model.faces) == len(ball.faces)
    np.testing.assert_allclose(volume(model), ball.volume, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(model.normals, axis=1), 1, atol=1e-6)
    # Smooth normals hide the facets: on a ball they are radial. Flat ones would be off by 1 - cos(9 degrees) = 0.012.
    assert np.einsum("ij,ij->i", model.normals, model.vertices).min() > 0.9995


@pytest.mark.parametrize("suffix", sorted(MESH_FORMATS))
def test_scene_loads_with_the_mesh_on_the_table(ball, tmp_path, suffix):
    ball.apply_scale([1, 1, 2])
    scene = load_scene(write(ball, tmp_path / f"ball{suffix}"), bsdf=DIFFUSE, size=80.0, resolution=(32, 24))
    vertices, _ = mesh_buffers(next(shape for shape in scene.shapes() if shape.id() == "body"))
    low, high = vertices.min(0), vertices.max(0)
    assert (high - low).max() == pytest.approx(80, rel=1e-5)
    assert low[2] == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose((low + high)[:2], 0, atol=1e-4)
    # In formats with y up the long axis (z) lies on the table, pointing to the viewer.
    assert np.argmax(high - low) == (1 if suffix in (".obj", ".gltf", ".glb") else 2)
    assert next(iter(scene.sensors())).film().size()[0] == 32


def test_up_can_be_chosen(ball, tmp_path):
    ball.apply_scale([1, 1, 2])
    path = write(ball, tmp_path / "ball.ply")
    body = mesh_scene(path, bsdf=DIFFUSE, size=80.0, up="y")["body"]
    assert np.argmax(np.ptp(mesh_buffers(body)[0], axis=0)) == 1


def test_the_mesh_fills_the_picture(ball, tmp_path):
    path = write(ball, tmp_path / "ball.ply")
    spec = mesh_scene(path, bsdf=DIFFUSE, size=80.0, resolution=(120, 90))
    scene = mi.load_dict({k: v for k, v in spec.items() if k in ("type", "sensor", "body")}, optimize=False)
    seen = np.array(mi.render(scene, integrator=mi.load_dict({"type": "depth"}), spp=16))[..., 0] > 0
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    assert not seen[[0, -1]].any() and not seen[:, [0, -1]].any()
    assert np.ptp(rows) > 0.75 * 90 or np.ptp(columns) > 0.75 * 120
    assert abs(rows.mean() - 44.5) < 6 and abs(columns.mean() - 59.5) < 6


def test_cube_keeps_its_edges(tmp_path):
    model = read_mesh(write(trimesh.creation.box(), tmp_path / "box.stl"))
    assert len(model.vertices) == 24
    np.testing.assert_allclose(np.sort(np.abs(model.normals), axis=1), np.tile([0, 0, 1], (24, 1)), atol=1e-12)


def test_normals_and_uv_of_the_file_are_kept(ball, tmp_path):
    tilted = ball.vertices + np.array([0.1, 0, 0])
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    uv = ball.vertices[:, :2] * 0.4 + 0.5
    mesh = trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=tilted, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv)
    model = read_mesh(write(mesh, tmp_path / "ball.glb"))
    order = np.lexsort(model.vertices.round(4).T), np.lexsort(ball.vertices.round(4).T)
    np.testing.assert_allclose(model.normals[order[0]], tilted[order[1]], atol=1e-5)
    np.testing.assert_allclose(model.uv[order[0]][:, 0], uv[order[1]][:, 0], atol=1e-5)


def test_parts_of_a_scene_graph_become_one_body(tmp_path):
    graph = trimesh.Scene()
    for k in range(3):
        graph.add_geometry(trimesh.creation.box(), transform=trimesh.transformations.translation_matrix([3 * k, 0, 0]))
    graph.export(tmp_path / "boxes.glb")
    model = read_mesh(tmp_path / "boxes.glb")
    assert len(model.faces) == 36
    np.testing.assert_allclose(np.ptp(model.vertices, axis=0), (7, 1, 1), rtol=1e-6)
    assert volume(model) == pytest.approx(3)


def test_mirrored_node_is_not_inside_out(ball, tmp_path):
    graph = trimesh.Scene()
    graph.add_geometry(ball, transform=np.diag([-1.0, 1, 1, 1]))
    graph.export(tmp_path / "mirror.glb")
    model = read_mesh(tmp_path / "mirror.glb")
    assert volume(model) > 0 and outward(model).min() > 0


# ------------------------------------------------------------------ repairs


def test_inside_out_solid_is_turned(ball, tmp_path):
    path = soup(tmp_path / "ball.off", ball.vertices, ball.faces[:, ::-1])
    with pytest.warns(PellucidWarning, match="inside out"):
        model = read_mesh(path)
    assert volume(model) == pytest.approx(ball.volume) and outward(model).min() > 0


def test_single_turned_faces_are_turned_back(ball, tmp_path):
    faces = ball.faces.copy()
    faces[::7] = faces[::7, ::-1]
    path = soup(tmp_path / "ball.off", ball.vertices, faces)
    with pytest.warns(PellucidWarning, match=rf"{len(faces[::7])} of {len(faces)} faces pointed inwards"):
        model = read_mesh(path)
    assert volume(model) == pytest.approx(ball.volume) and outward(model).min() > 0


def test_a_cavity_keeps_its_winding(ball, tmp_path):
    n = len(ball.vertices)
    vertices = np.concatenate([ball.vertices, 0.5 * ball.vertices])
    path = soup(tmp_path / "shell.off", vertices, np.concatenate([ball.faces, n + ball.faces[:, ::-1]]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = read_mesh(path)
    assert volume(model) == pytest.approx(ball.volume * (1 - 0.125))


def test_one_of_two_solids_is_turned(ball, tmp_path):
    n = len(ball.vertices)
    vertices = np.concatenate([ball.vertices, 0.5 * ball.vertices + (5, 0, 0)])
    path = soup(tmp_path / "two.off", vertices, np.concatenate([ball.faces, n + ball.faces[:, ::-1]]))
    with pytest.warns(PellucidWarning, match="pointed inwards"):
        model = read_mesh(path)
    assert volume(model) == pytest.approx(ball.volume * 1.125)


def test_repeated_and_flat_faces_are_dropped(ball, tmp_path):
    flat = np.array([[0, 0, 1], [2, 2, 2]])
    path = soup(tmp_path / "ball.off", ball.vertices, np.concatenate([ball.faces, ball.faces[:5], flat]))
    with pytest.warns(PellucidWarning) as told:
        model = read_mesh(path)
    text = " ".join(str(w.message) for w in told)
    assert "5 of" in text and "twice" in text and "2 of" in text and "no area" in text
    assert len(model.faces) == len(ball.faces) and volume(model) == pytest.approx(ball.volume)


def test_open_mesh_works_with_a_warning(ball, tmp_path):
    below = ball.vertices[ball.faces][..., 2].max(1) < 0.3
    path = soup(tmp_path / "bowl.off", ball.vertices, ball.faces[below])
    with pytest.warns(PellucidWarning, match="open"):
        model = read_mesh(path)
    assert len(model.faces) == below.sum() and outward(model).min() > 0


# ------------------------------------------------------------------ units


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_is_in_metres_by_its_specification(ball, tmp_path, suffix):
    ball.apply_scale(0.05)
    body = mesh_scene(write(ball, tmp_path / f"ball{suffix}"), bsdf=DIFFUSE)["body"]
    assert np.ptp(mesh_buffers(body)[0], axis=0).max() == pytest.approx(100, rel=1e-5)


@pytest.mark.parametrize("size", [0.1, 1e5, None])
def test_a_mesh_of_any_size_is_seen(ball, tmp_path, size):
    ball.apply_scale(0.05)
    scene = load_scene(write(ball, tmp_path / "ball.ply"), bsdf=DIFFUSE, size=size, resolution=(32, 24))
    assert np.array(mi.render(scene, integrator=mi.load_dict({"type": "direct"}), spp=4))[8:16, 12:20].min() > 0.01


@pytest.mark.parametrize("size, text", [(0.1, "0.1 mm"), (1e5, r"1e\+05 mm")])
def test_a_factor_of_1000_is_pointed_out(ball, tmp_path, size, text):
    scene = load_scene(write(ball, tmp_path / "ball.ply"), size=size, resolution=(32, 24))
    with pytest.warns(PellucidWarning, match=f"{text}.*0.333 mm.*1000.*--size 100") as told:
        warn_of_units(open_scene(scene))
    assert len(told) == 1


def test_a_plausible_size_is_not_remarked_on(ball, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_units(open_scene(load_scene(write(ball, tmp_path / "ball.ply"), size=50.0, resolution=(32, 24))))
    assert unit_mistake("skin", 5.0, 0.67) is None and unit_mistake("statue", 2000.0, 0.33) is None


# ------------------------------------------------------------------ refusals


def refused(path, **options):
    with warnings.catch_warnings(), pytest.raises(SceneError) as caught:
        warnings.simplefilter("ignore")
        scene_dict(path, bsdf=DIFFUSE, **options)
    text = str(caught.value)
    assert "\n" not in text and len(text) < 300
    return text


def test_missing_file(tmp_path):
    assert "no mesh file" in refused(tmp_path / "nothing.ply")


def test_unknown_format_suggests_one(tmp_path):
    (tmp_path / "mesh.plyy").write_text("ply")
    with pytest.raises(SceneError, match=r"did you mean '\.ply'"):
        read_mesh(tmp_path / "mesh.plyy")


@pytest.mark.parametrize("suffix", sorted(MESH_FORMATS))
def test_damaged_file(tmp_path, suffix):
    (tmp_path / f"bad{suffix}").write_bytes(b"this is no mesh\x00\xff")
    assert f"bad{suffix}" in refused(tmp_path / f"bad{suffix}")


def test_not_a_number(ball, tmp_path):
    vertices = ball.vertices.copy()
    vertices[3] = np.nan
    assert "NaN" in refused(soup(tmp_path / "nan.off", vertices, ball.faces))


def test_no_faces(ball, tmp_path):
    trimesh.PointCloud(ball.vertices).export(tmp_path / "points.ply")
    assert "no faces" in refused(tmp_path / "points.ply")


def test_no_area(tmp_path):
    line = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    assert "no area" in refused(soup(tmp_path / "line.off", line, [(0, 1, 2)]))


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_size(ball, tmp_path, size):
    assert "size" in refused(write(ball, tmp_path / "ball.ply"), size=size)


def test_impossible_axis(ball, tmp_path):
    assert "'x'" in refused(write(ball, tmp_path / "ball.ply"), up="x")
