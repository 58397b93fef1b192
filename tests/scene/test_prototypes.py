"""Bodies that are rigid copies of each other share a prototype, and no others do."""

import mitsuba as mi
import numpy as np
import pytest

import pellucid.methods  # noqa: F401  (registers the material)
from pellucid.scene.bodies import find_bodies
from pellucid.scene.prototypes import find_prototypes
from pellucid.scene.samples.surface import sample_surface
from worlds.balls import T


def ball(x=0.0, **bsdf):
    return {
        "type": "sphere",
        "center": [x, 0, 0],
        "bsdf": {"type": "pellucid_translucent", "material": "cream", **bsdf},
    }


def instances(group, **to_world):
    """Prototypes of the instances of a shape group, and the places of their bodies."""
    content = {"type": "scene", "group": {"type": "shapegroup", **group}}
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
