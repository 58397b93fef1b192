"""Colours of mesh files: textures, base colours and vertex colours as reflectance, part by part."""

import json
import os
import warnings

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from PIL import Image

from pellucid.errors import MediumError, PellucidWarning, SceneError
from pellucid.methods.preparation import open_scene
from pellucid.model.medium import Medium
from pellucid.scene.meshes.files import read_mesh
from pellucid.scenes.loading import load_scene
from pellucid.scenes.mesh_scene import mesh_scene

PBR = trimesh.visual.material.PBRMaterial
RED = (200, 40, 40, 255)


def linear(value):
    value = np.asarray(value) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


@pytest.fixture
def ball():
    return trimesh.creation.icosphere(subdivisions=2, radius=20.0)


def plane(material):
    """A square that shows the whole picture once."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float) * 10
    mesh = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=corners[:, :2] / 10, material=material)
    return mesh


def material_of(path, **options):
    """Read the material of the only body of a mesh scene, with what was said about it."""
    with pytest.warns(PellucidWarning) as told:
        spec = mesh_scene(path, **options)
    return spec["body"].bsdf(), " ".join(str(w.message) for w in told)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_vertex_colours_of_scans_are_srgb(ball, tmp_path, suffix):
    ball.visual.vertex_colors = np.where(ball.vertices[:, :1] < 0, (10, 60, 200, 255), RED).astype(np.uint8)
    ball.export(tmp_path / f"scan{suffix}")
    model = read_mesh(tmp_path / f"scan{suffix}")
    assert model.looks[0].by_vertex
    left = model.colors[model.vertices[:, 0] < -5]
    np.testing.assert_allclose(left, np.broadcast_to(linear((10, 60, 200)), left.shape), atol=2e-3)


def test_floats_in_ply_are_linear(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "property float red\nproperty float green\nproperty float blue\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "one.ply").write_text(header + "0 0 0 .2 .4 .8\n1 0 0 .2 .4 .8\n0 1 0 .2 .4 .8\n3 0 1 2\n")
    with pytest.warns(PellucidWarning, match="open"):
        model = read_mesh(tmp_path / "one.ply")
    np.testing.assert_allclose(model.colors[0], (0.2, 0.4, 0.8), atol=3e-3)


def test_face_colours_are_shown(ball, tmp_path):
    ball.visual.face_colors = np.where(ball.triangles_center[:, :1] < 0, (10, 60, 200, 255), RED).astype(np.uint8)
    ball.export(tmp_path / "faces.ply")
    model = read_mesh(tmp_path / "faces.ply")
    assert len(np.unique(model.colors.round(3), axis=0)) == 2
    assert np.einsum("ij,ij->i", model.normals, model.vertices).min() > 0.99 * 20  # smooth all the same


def test_colours_of_gltf_vertices_are_linear_and_exact(ball, tmp_path):
    ball.visual.vertex_colors = np.broadcast_to(np.array((100, 5, 3, 255), np.uint8), (len(ball.vertices), 4))
    ball.export(tmp_path / "scan.glb")
    np.testing.assert_allclose(read_mesh(tmp_path / "scan.glb").colors[0], np.array([100, 5, 3]) / 255, atol=1e-6)


def test_the_base_colour_of_gltf_is_linear(ball, tmp_path):
    ball.visual = trimesh.visual.TextureVisuals(material=PBR(name="gold", baseColorFactor=[204, 127, 13, 255]))
    ball.export(tmp_path / "gold.glb")
    bsdf, said = material_of(tmp_path / "gold.glb", size=40.0)
    assert bsdf.medium.total_diffuse_reflectance == pytest.approx(np.array([204, 127, 13]) / 255, rel=1e-4)
    assert bsdf.medium.dmfp == pytest.approx(1.0)
    assert "gold" in said and "1 mm" in said


def test_the_mean_free_path_is_that_of_the_material_or_as_given(ball, tmp_path):
    ball.visual = trimesh.visual.TextureVisuals(material=PBR(baseColorFactor=[204, 127, 13, 255]))
    ball.export(tmp_path / "gold.glb")
    skin = Medium.from_preset("skin1")
    bsdf, said = material_of(tmp_path / "gold.glb", bsdf={"type": "pellucid_translucent", "material": "skin1"})
    assert bsdf.medium.dmfp == pytest.approx(skin.dmfp) and "skin1" in said
    bsdf, _ = material_of(tmp_path / "gold.glb", bsdf={"type": "pellucid_translucent", "dmfp": 3.0})
    assert bsdf.medium.dmfp == pytest.approx(3.0)
    bsdf, said = material_of(
        tmp_path / "gold.glb", bsdf={"type": "pellucid_translucent", "dmfp": 3.0, "reflectance": 0.5}
    )
    assert bsdf.medium.total_diffuse_reflectance == pytest.approx(0.5) and "not shown" in said
    with pytest.raises(MediumError, match="absorbs nothing"):
        mesh_scene(tmp_path / "gold.glb", bsdf={"type": "pellucid_translucent", "material": "spectralon"})


def test_a_white_or_missing_material_leaves_the_default(ball, tmp_path):
    ball.visual = trimesh.visual.TextureVisuals(material=PBR(baseColorFactor=[255, 255, 255, 255]))
    ball.export(tmp_path / "white.glb")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mesh_scene(tmp_path / "white.glb", size=40.0)["body"].bsdf().medium == Medium.from_preset("marble")


@pytest.mark.parametrize("kind", ["obj", "glb"])
def test_a_texture_lies_the_right_way_up_and_is_decoded(tmp_path, kind):
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:4], picture[4:] = (200, 40, 40), (40, 200, 40)  # red above
    image = Image.fromarray(picture)
    if kind == "obj":
        plane(trimesh.visual.material.SimpleMaterial(image=image)).export(tmp_path / "card.obj")
    else:
        plane(PBR(baseColorTexture=image, baseColorFactor=[255, 255, 255, 255])).export(tmp_path / "card.glb")
    with pytest.warns(PellucidWarning, match="open"):
        model = read_mesh(tmp_path / f"card.{kind}")
    upper = model.uv[model.vertices[:, 1] > 5]
    row = np.clip(upper[:, 1] * 8, 0, 7).astype(int)
    np.testing.assert_allclose(model.looks[0].texture[row, 0], linear([[200, 40, 40]] * len(row)), atol=1e-3)


def test_several_materials_stay_several_bodies(ball, tmp_path):
    other = ball.copy()
    other.apply_translation([60, 0, 0])
    ball.visual = trimesh.visual.TextureVisuals(material=PBR(name="gold", baseColorFactor=[204, 127, 13, 255]))
    other.visual = trimesh.visual.TextureVisuals(material=PBR(name="jade", baseColorFactor=[30, 127, 60, 255]))
    trimesh.Scene([ball, other]).export(tmp_path / "two.glb")
    with pytest.warns(PellucidWarning, match="jade"):
        bodies = open_scene(load_scene(tmp_path / "two.glb", size=100.0)).bodies
    found = sorted(float(lit.body.medium.total_diffuse_reflectance[0]) for lit in bodies)
    assert found == pytest.approx([30 / 255, 204 / 255], rel=1e-3)


def test_a_missing_texture_is_said(tmp_path):
    image = Image.fromarray(np.full((4, 4, 3), 90, np.uint8))
    plane(trimesh.visual.material.SimpleMaterial(image=image)).export(tmp_path / "card.obj")
    next(tmp_path.glob("*.png")).unlink()
    with pytest.warns(PellucidWarning, match=r"names '.*\.png', which cannot be read"):
        read_mesh(tmp_path / "card.obj")


def test_a_picture_as_reflectance_needs_texture_coordinates(ball, tmp_path):
    ball.export(tmp_path / "ball.stl")
    bsdf = {"type": "pellucid_translucent", "reflectance": {"type": "bitmap", "filename": "a.png"}, "dmfp": 1.0}
    with pytest.raises(SceneError, match="no texture coordinates"):
        mesh_scene(tmp_path / "ball.stl", bsdf=bsdf)


# ------------------------------------------------------------------ what trimesh misreads

FACES = [(1, 3, 7), (1, 7, 5), (2, 6, 8), (2, 8, 4), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 2, 4), (1, 4, 3)]
FACES += [(5, 7, 8), (5, 8, 6)]


@pytest.mark.parametrize("corner", ["{0}", "{0}//-1", "{0}/-1", "{0}/-1/-1"])
def test_obj_in_blocks_with_negative_indices(tmp_path, corner):
    blocks = []
    for k in range(3):
        corners = "".join(f"v {3 * k + x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
        faces = "".join("f " + " ".join(corner.format(i - 9) for i in face) + "\n" for face in FACES)
        blocks.append(corners + "vt 0 0\nvn 0 0 1\n" + faces)
    (tmp_path / "cubes.obj").write_text("".join(blocks))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # whichever way FACES are wound
        model = read_mesh(tmp_path / "cubes.obj")
    assert len(model.faces) == 36
    assert np.ptp(model.vertices, axis=0) == pytest.approx([7, 1, 1])


def quantized(ball, path, sparse=False):
    """Write a ball of radius 1 as normalised 16-bit integers, its colours as bytes."""
    points = np.zeros((len(ball.vertices), 4), np.int16)
    points[:, :3] = np.round(ball.vertices / 20 * 32767)
    faces = ball.faces.astype(np.uint32)
    colours = np.tile(np.array([51, 102, 204, 255], np.uint8), (len(points), 1))
    parts = [points.tobytes(), faces.tobytes(), colours.tobytes()]
    views = [{"buffer": 0, "byteOffset": sum(map(len, parts[:k])), "byteLength": len(p)} for k, p in enumerate(parts)]
    views[0]["byteStride"] = 8
    accessors = [
        {"bufferView": 0, "componentType": 5122, "normalized": True, "count": len(points), "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5121, "normalized": True, "count": len(points), "type": "VEC4"},
    ]
    if sparse:  # the first vertex is moved to (1/2, 1/2, 0)
        parts += [np.array([0, 0], np.uint16).tobytes(), np.array([16384, 16384, 0, 0], np.int16).tobytes()]
        views += [{"buffer": 0, "byteOffset": sum(map(len, parts[:3])), "byteLength": 4}]
        views += [{"buffer": 0, "byteOffset": sum(map(len, parts[:4])), "byteLength": 8}]
        indices, values = {"bufferView": 3, "componentType": 5123}, {"bufferView": 4}
        accessors[0]["sparse"] = {"count": 1, "indices": indices, "values": values}
    (path.parent / "ball.bin").write_bytes(b"".join(parts))
    attributes = {"POSITION": 0, "COLOR_0": 2}
    header = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"uri": "ball.bin", "byteLength": sum(map(len, parts))}],
    }
    path.write_text(json.dumps(header))
    return path


def test_gltf_of_normalised_integers(ball, tmp_path):
    model = read_mesh(quantized(ball, tmp_path / "ball.gltf"))
    assert np.ptp(model.vertices, axis=0).max() == pytest.approx(2, abs=1e-3)
    np.testing.assert_allclose(model.colors[0], (0.2, 0.4, 0.8), atol=1e-6)


def test_gltf_with_exceptions_in_sparse_accessors(ball, tmp_path):
    model = read_mesh(quantized(ball, tmp_path / "ball.gltf", sparse=True))
    assert np.abs(model.vertices - (0.5, 0.5, 0)).sum(axis=1).min() < 1e-4


@pytest.mark.parametrize(
    "extension, text",
    [
        ("KHR_draco_mesh_compression", "Draco.*gltf-transform"),
        ("EXT_meshopt_compression", "meshopt.*gltf-transform"),
        ("EXT_mesh_gpu_instancing", "EXT_mesh_gpu_instancing"),
    ],
)
def test_compressed_gltf_is_refused_with_the_reason(ball, tmp_path, extension, text):
    path = quantized(ball, tmp_path / "ball.gltf")
    path.write_text(path.read_text().replace("KHR_mesh_quantization", extension))
    with pytest.raises(SceneError, match=text):
        read_mesh(path)


def test_triangle_strips_in_ply_are_refused_with_the_reason(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (tmp_path / "strips.ply").write_text(header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(SceneError, match=r"tristrips.*MeshLab"):
        read_mesh(tmp_path / "strips.ply")


def test_a_pipe_as_buffer_is_refused_at_once(ball, tmp_path):
    path = quantized(ball, tmp_path / "ball.gltf")
    (tmp_path / "ball.bin").unlink()
    with pytest.raises(SceneError, match=r"'ball.bin', which is not there"):
        read_mesh(path)
    os.mkfifo(tmp_path / "ball.bin")
    with pytest.raises(SceneError, match="no ordinary file"):
        read_mesh(path)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb", ".gltf", ".off"])
@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.95])
def test_a_file_cut_off_is_told_in_one_line_of_ours(ball, tmp_path, suffix, share, capfd):
    path = quantized(ball, tmp_path / "ball.gltf") if suffix == ".gltf" else tmp_path / f"ball{suffix}"
    if suffix != ".gltf":
        ball.export(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PellucidWarning)
        try:
            read_mesh(path)  # a text cut between two lines may still be a mesh
        except SceneError as error:
            assert "\n" not in str(error) and path.name in str(error)
    assert capfd.readouterr() == ("", "")


def test_one_vertex_far_away_is_refused(ball, tmp_path):
    vertices = np.array(ball.vertices)
    vertices[17] = (1e9, 0, 0)
    trimesh.Trimesh(vertices, ball.faces, process=False).export(tmp_path / "lost.ply")
    with pytest.raises(SceneError, match=r"1 of 162 vertices lie far.*number 17"):
        read_mesh(tmp_path / "lost.ply")
    vertices[17] = (1e4, 0, 0)
    trimesh.Trimesh(vertices, ball.faces, process=False).export(tmp_path / "far.ply")
    with pytest.warns(PellucidWarning, match="1 of 162 vertices lie far"):
        read_mesh(tmp_path / "far.ply")


def test_saved_colours_come_back(ball, tmp_path):
    """A scene of a coloured mesh is written as a file, with what it shows."""
    from pellucid.scene.meshes.buffers import mesh_from_arrays

    colors = np.random.default_rng(0).random((len(ball.vertices), 3))
    mesh = mesh_from_arrays("ball", ball.vertices, ball.faces, colors=colors)
    mesh.write_ply(str(tmp_path / "ball.ply"))
    again = mi.load_dict({"type": "ply", "filename": str(tmp_path / "ball.ply")})
    np.testing.assert_allclose(np.array(again.attribute_buffer("vertex_color")), colors.ravel(), atol=1e-6)


def test_vertices_of_two_coordinates_are_told_in_one_line_of_ours(tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(SceneError, match=r"flat\.obj"):
        read_mesh(tmp_path / "flat.obj")


def test_texture_coordinates_without_a_material_have_no_colour(tmp_path):
    """The mesh library makes a grey picture up for them, which replaced the material that was asked for."""
    card = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    (tmp_path / "card.obj").write_text(card)
    with pytest.warns(PellucidWarning, match="is open"):
        model = read_mesh(tmp_path / "card.obj")
    assert model.uv is not None and not any(look.is_coloured for look in model.looks)
