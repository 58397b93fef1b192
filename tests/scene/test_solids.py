"""Which triangles of one mesh make up a solid."""

import time

import numpy as np
import pytest
import trimesh

from pellucid.scene.solids import faces_without_normals, hole_share, repeated_faces, separate_solids


def box(*at, edge=1.0, faces=12):
    mesh = trimesh.creation.box([edge] * 3).apply_translation(at)
    mesh.update_faces(np.arange(faces))
    return mesh


def ball(*at, radius=1.0, inwards=False):
    mesh = trimesh.creation.icosphere(2, radius).apply_translation(at)
    if inwards:
        mesh.invert()
    return mesh


def ring(*at, turned=False):
    mesh = trimesh.creation.torus(3.0, 0.5)
    if turned:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return mesh.apply_translation(at)


def split_vertices(mesh):
    """As a renderer has them for flat shading: every triangle its own."""
    return trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)


CASES = {
    "one": ([box(0, 0, 0)], [0]),
    "flat shaded": ([split_vertices(box(0, 0, 0))], [0]),
    "a gap of a fiftieth": ([box(0, 0, 0), box(1.02, 0, 0)], [0, 1]),
    "the same far from the origin": ([box(20000, 0, 0), box(20001.02, 0, 0)], [0, 1]),
    "touching": ([box(0, 0, 0), box(1, 0, 0)], [0, 0]),
    "touching, shifted": ([box(0, 0, 0), box(1, 0.3, 0.2)], [0, 0]),
    "overlapping": ([box(0, 0, 0), box(0.7, 0.3, 0.2)], [0, 0]),
    "hollow": ([ball(0, 0, 0), ball(0, 0, 0, radius=0.5, inwards=True)], [0, 0]),
    "hollow, and one beside it": ([ball(0, 0, 0), ball(0, 0, 0, radius=0.5, inwards=True), ball(2.5, 0, 0)], [0, 0, 1]),
    "inwards on purpose": ([ball(0, 0, 0, inwards=True), ball(1.5, 1.5, 0, inwards=True)], [0, 1]),
    "boxes overlap, solids do not": ([ball(0, 0, 0), ball(1.5, 1.5, 0)], [0, 1]),
    "links of a chain": ([ring(0, 0, 0), ring(3, 0, 0, turned=True)], [0, 1]),
    "an open part beside a closed one": ([box(0, 0, 0), box(5, 0, 0, faces=10)], [0, 1]),
    "open parts": ([box(0, 0, 0, faces=10), box(5, 0, 0, faces=10)], [0, 0]),
}


@pytest.mark.parametrize(("parts", "solids"), CASES.values(), ids=CASES)
def test_parts_become_solids(parts, solids):
    mesh = trimesh.util.concatenate(parts)
    found = separate_solids(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert found.tolist() == np.repeat(solids, [len(part.faces) for part in parts]).tolist()


def test_the_order_of_triangles_does_not_matter():
    mesh = trimesh.util.concatenate([ball(0, 0, 0), ball(2.5, 0, 0), ball(0, 2.5, 0)])
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    straight = separate_solids(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    shuffled = separate_solids(np.asarray(mesh.vertices), np.asarray(mesh.faces)[order])
    assert all(len(np.unique(shuffled[straight[order] == k])) == 1 for k in range(3))
    assert shuffled.max() == 2 and shuffled[0] == 0


def half_ball(inwards=False):
    mesh = ball(0, 0, 0, inwards=inwards)
    mesh.update_faces(mesh.triangles_center[:, 2] > 0)
    return mesh


def tube(length=4.0, sections=64):
    mesh = trimesh.creation.cylinder(1.0, length, sections=sections)
    mesh.update_faces(np.abs(mesh.face_normals[:, 2]) < 0.5)
    return mesh


def half_turned():
    mesh = ball(0, 0, 0)
    upper = mesh.triangles_center[:, 2] > 0
    return trimesh.Trimesh(mesh.vertices, np.where(upper[:, None], mesh.faces, mesh.faces[:, ::-1]), process=False)


def sheet(*at):
    return trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]).apply_translation(at)


HOLES = {
    "ball": ([ball(0, 0, 0)], 0),
    "flat shaded": ([split_vertices(box(0, 0, 0))], 0),
    "a shell inside": ([ball(0, 0, 0), ball(0, 0, 0, radius=0.5, inwards=True)], 0),
    "wound differently": ([half_turned()], 0),
    "sheet": ([sheet(0, 0, 0)], 1),
    "sheet far away": ([sheet(1e4, 0, 0)], 1),
    "two sheets, one turned": (
        [sheet(0, 0, 0), trimesh.Trimesh(**{**sheet(0, 0, 1).to_dict(), "faces": [[2, 1, 0], [3, 2, 0]]})],
        1,
    ),
    "bowl": ([half_ball()], 0.5),
    "bowl of single triangles": ([split_vertices(half_ball(inwards=True))], 0.5),
    "tube": ([tube()], 0.25),
    "box without a lid": ([box(0, 0, 0, faces=10)], 0.2),
    "a sheet and a ball": ([ball(0, 0, 0), sheet(3, 0, 0)], 1 / (1 + 4 * np.pi)),
}


def test_sides_that_touch_but_for_rounding_close_a_box():
    turn = trimesh.transformations.rotation_matrix
    lid = sheet(-0.5, -0.5, 0.5)
    ways = [turn(k * np.pi / 2, [0, 1, 0]) for k in range(4)] + [turn(k * np.pi / 2, [1, 0, 0]) for k in (1, 3)]
    box = trimesh.util.concatenate([lid.copy().apply_transform(way) for way in ways])
    vertices = box.vertices * 17.3 + np.random.default_rng(0).uniform(-2e-6, 2e-6, box.vertices.shape)
    assert hole_share(vertices, box.faces) == 0
    assert hole_share(vertices, box.faces[:-2]) == pytest.approx(1 / 5, rel=1e-3)


@pytest.mark.parametrize("case", HOLES)
def test_holes_are_measured_by_what_would_close_them(case):
    meshes, expected = HOLES[case]
    whole = trimesh.util.concatenate(meshes)
    assert hole_share(whole.vertices, whole.faces) == pytest.approx(expected, rel=0.06, abs=1e-9)


def test_a_mesh_is_divided_once():
    mesh = trimesh.creation.icosphere(6)
    began = time.perf_counter()
    first = separate_solids(mesh.vertices, mesh.faces), hole_share(mesh.vertices, mesh.faces)
    took = time.perf_counter() - began
    began = time.perf_counter()
    again = separate_solids(mesh.vertices.copy(), mesh.faces.copy()), hole_share(mesh.vertices, mesh.faces)
    assert again[0] is first[0] and again[1] == first[1]
    assert time.perf_counter() - began < max(0.5 * took, 0.02)


def test_faces_that_are_there_twice_are_counted():
    mesh = ball(0, 0, 0)
    assert repeated_faces(mesh.vertices, mesh.faces) == 0
    apart = mesh.vertices[mesh.faces[:7, [1, 2, 0]]].reshape(
        -1, 3
    )  # copies with vertices of their own, begun elsewhere
    faces = np.concatenate([mesh.faces, len(mesh.vertices) + np.arange(21).reshape(7, 3), mesh.faces[:2, ::-1]])
    assert repeated_faces(np.concatenate([mesh.vertices, apart]), faces) == 9


def test_vertex_normals_that_lie_in_their_face_are_found():
    mesh = ball(0, 0, 0)
    normals = np.array(mesh.vertex_normals, np.float32)
    assert faces_without_normals(mesh.vertices, mesh.faces, normals) == 0
    corners = mesh.faces[5]
    edge = mesh.vertices[corners[1]] - mesh.vertices[corners[0]]
    normals[corners[0]] = normals[corners[1]] = normals[corners[2]] = edge / np.linalg.norm(edge)
    assert faces_without_normals(mesh.vertices, mesh.faces, normals) == 1
