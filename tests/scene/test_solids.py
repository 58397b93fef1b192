"""Which triangles of one mesh make up a solid."""

import numpy as np
import pytest
import trimesh

from pellucid.scene.solids import separate_solids


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
