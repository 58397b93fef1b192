"""Bodies that are rigid copies of each other share a prototype, and no others do."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid.methods  # noqa: F401  (registers the material)
from pellucid.errors import EnvironmentProblem
from pellucid.methods.preparation import open_scene
from pellucid.scene.bodies import find_bodies
from pellucid.scene.meshes.buffers import mesh_from_arrays, triangle_corners
from pellucid.scene.prototypes import find_prototypes
from pellucid.scene.samples.draw import Sites, Surface
from pellucid.scene.samples.surface import describe, outside_of, sample_surface
from worlds.balls import T


def ball(x=0.0, **bsdf):
    return {
        "type": "sphere",
        "center": [x, 0, 0],
        "bsdf": {"type": "pellucid_translucent", "material": "cream", **bsdf},
    }


def instances(group, **to_world):
    """Prototypes of the instances of a shape group, and the places of their bodies."""
    content = {"type": "scene", "light": {"type": "constant"}, "group": {"type": "shapegroup", **group}}
    for name, transform in to_world.items():
        content[name] = {"type": "instance", "shapes": {"type": "ref", "id": "group"}, "to_world": transform}
    scene = mi.load_dict(content, optimize=False)
    bodies = find_bodies(scene)
    prototypes, places = find_prototypes(bodies)
    by_name = {body.name.split(".")[0]: tuple(place) for body, place in zip(bodies, places, strict=True)}
    return scene, prototypes, by_name


def distances(prototype, centre):
    """Of points on the surface of a prototype, in its own space."""
    return np.linalg.norm(sample_surface(prototype.surface, 50, "uniform", 0).p - centre, axis=1)


MOVED, TURNED = T.translate([30, 1, 2]), T.translate([0, 20, 0]).rotate([0.6, 0, 0.8], 50)


def test_rigid_copies_share_a_prototype_in_a_space_of_its_own():
    _, (prototype,), places = instances({"ball": ball(3.0)}, a=MOVED, b=TURNED, c=T.scale([1, 1, -1]))
    assert sorted(places.values()) == [(0, 0), (0, 1), (0, 2)]
    assert len(prototype.bodies) == len(prototype.to_world) == 3
    for name, transform in (("a", MOVED), ("b", TURNED)):
        np.testing.assert_allclose(prototype.to_world[places[name][1]], np.array(transform.matrix), atol=1e-6)
    assert distances(prototype, [3, 0, 0]) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("order", [("a", "b", "c"), ("b", "a", "c"), ("a", "c", "b")])
def test_a_scaled_or_sheared_copy_is_a_prototype_of_its_own(order):
    """Wherever it comes in the list of bodies."""
    shear = np.eye(4)
    shear[0, 1] = 0.3
    ways = {"a": MOVED, "b": T.translate([0, 9, 0]).scale(2.0), "c": mi.ScalarTransform4f(shear)}
    _, prototypes, places = instances({"ball": ball()}, rigid=TURNED, **{name: ways[name] for name in order})
    assert places["rigid"][0] == places["a"][0]
    assert len({places[name][0] for name in ("rigid", "b", "c")}) == len(prototypes) == 3
    own = prototypes[places["b"][0]]
    np.testing.assert_array_equal(own.to_world[0], np.eye(4))
    assert distances(own, [0, 9, 0]) == pytest.approx(2, abs=1e-5)
    assert distances(prototypes[places["rigid"][0]], [0, 0, 0]) == pytest.approx(1, abs=1e-5)
    assert own.surface.area == pytest.approx(16 * np.pi, rel=1e-3)


def test_shapes_without_instances_are_prototypes_of_their_own():
    scene = mi.load_dict({"type": "scene", "a": ball(), "b": ball(), "c": ball(50.0)}, optimize=False)
    prototypes, places = find_prototypes(find_bodies(scene))
    assert places.tolist() == [[0, 0], [1, 0], [2, 0]]
    for prototype in prototypes:
        np.testing.assert_array_equal(prototype.to_world, [np.eye(4)])


def test_each_body_of_a_group_is_a_prototype_and_a_body_of_several_shapes_is_one():
    group = {"one": ball(0.0, body="both"), "two": ball(5.0, body="both"), "other": ball(20.0)}
    _, prototypes, _ = instances(group, a=MOVED, b=TURNED)
    assert [len(p.bodies) for p in prototypes] == [2, 2]
    assert sorted(p.surface.area for p in prototypes) == pytest.approx([4 * np.pi, 8 * np.pi], rel=1e-3)


def egg():
    """A closed mesh that no transform but the identity maps to itself."""
    shape = trimesh.creation.icosphere(1)
    vertices = shape.vertices * [1.0, 0.8, 0.6] + 0.1 * shape.vertices**2 + [3, 0, 0]
    bsdf = {"type": "pellucid_translucent", "material": "cream"}
    return mesh_from_arrays("egg", vertices, shape.faces, shape.vertex_normals, vertices[:, :2], bsdf)


def test_samples_are_spread_once_for_all_copies_and_lie_on_each_as_if_spread_there():
    mirrored = T.translate([0, 0, 9]).scale([1, 1, -1])
    scene, _, places = instances({"egg": egg()}, a=MOVED, b=TURNED, c=mirrored, d=T.scale(2))
    opened = open_scene(scene)
    mi.load_dict({"type": "pellucid_two_pass", "sample_count": 300}).method.spread_all(opened)
    by_name = {lit.body.name.split(".")[0]: lit for lit in opened.bodies}
    assert places["a"][0] == places["b"][0] == places["c"][0] != places["d"][0]
    for name, lit in by_name.items():
        samples, (part,) = lit.samples, lit.body.parts
        assert (samples.prim_uv is by_name["a"].samples.prim_uv) == (name != "d")
        surface = Surface([(part.shape, part.to_world)])
        sites = Sites(
            mi.UInt32(samples.shape_index.astype(np.uint32)),
            mi.UInt32(samples.prim_index),
            *(kind(values.T) for kind, values in ((mi.Point2f, samples.prim_uv), (mi.Point3f, samples.p), (mi.Normal3f, samples.n))),
        )  # fmt: skip
        expected = describe(surface, sites, samples.outside)
        for field in ("p_smooth", "sh_n", "dp_du", "dp_dv", "uv"):
            np.testing.assert_allclose(getattr(samples, field), expected[field], atol=2e-5, err_msg=f"{name} {field}")
        assert samples.area.sum(dtype=float) == pytest.approx(surface.area, rel=1e-4)
        p, n = on_triangles(part, samples)
        np.testing.assert_allclose(samples.p, p, atol=2e-5)
        np.testing.assert_allclose(np.abs((samples.n * n).sum(axis=1)), 1, atol=1e-5)
        assert samples.outside == outside_of(samples.p, samples.n, samples.area) == 1


def on_triangles(part, samples):
    """Where samples lie by their triangles and barycentric coordinates, in the scene; and normals, but for their side."""
    corners = triangle_corners(part.shape, part.to_world)[samples.prim_index]
    weights = np.column_stack([1 - samples.prim_uv.sum(axis=1), samples.prim_uv])
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.einsum("nk,nkc->nc", weights, corners), n / np.linalg.norm(n, axis=1, keepdims=True)


def test_memory_is_checked_for_the_samples_of_all_bodies_before_any_is_spread(monkeypatch):
    scene, _, _ = instances({"ball": ball()}, a=MOVED, b=TURNED)
    monkeypatch.setattr("pellucid.methods.preparation.free_memory", lambda: 1_500_000)
    monkeypatch.setattr("pellucid.methods.preparation.sample_surface", None)
    with pytest.raises(EnvironmentProblem, match="600 surface samples need about"):
        mi.load_dict({"type": "pellucid_two_pass", "sample_count": 300}).method.spread_all(open_scene(scene))
