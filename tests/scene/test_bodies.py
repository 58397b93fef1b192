"""Which solids of a scene are bodies, whoever has loaded it, and which of them a ray has met."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid
from pellucid.scene.bodies import build_lookup, find_bodies
from pellucid.scene.meshes.buffers import mesh_buffers, mesh_from_arrays
from worlds.balls import looking_at, translucent

T = mi.ScalarTransform4f
EDGE, GAP = 10.0, 0.2
MILK = {"type": "pellucid_translucent", "material": "wholemilk"}
FEW = {
    "two_pass": {"sample_count": 3000},
    "sampled": {},
    "single_pass": {"sample_count": 2000, "indirect": 200, "direct": 64},
    "texture_space": {"sample_count": 800, "resolution": 128},
}


def two_cubes(optimize, gap=GAP, **bsdf):
    """Two cubes that share a material, under a spot that lights only the first; Mitsuba merges them if it may."""
    shared = {"type": "ref", "id": "w"}
    spot = T().look_at([-20, 0, 25], [-2, 0, 5], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "w": MILK | bsdf,
            "a": {"type": "cube", "to_world": T().scale(EDGE / 2), "b": shared},
            "b": {"type": "cube", "to_world": T().translate([EDGE + gap, 0, 0]).scale(EDGE / 2), "b": shared},
            "spot": {"type": "spot", "to_world": spot, "intensity": 900.0, "cutoff_angle": 4.0},
            "sensor": looking_at([5, 0, 0], [5, -20, 60], fov=25, size=24),
        },
        optimize=optimize,
    )


@pytest.mark.parametrize("method", FEW)
def test_merged_meshes_are_the_bodies_they_were(method):
    """Across a gap there is no light, and the picture is that of the scene whose meshes were kept apart."""
    found = {}
    for optimize in (True, False):
        prepared = pellucid.prepare(two_cubes(optimize), method, **FEW[method])
        assert len(prepared.bodies) == 2
        other = prepared.exitance([[EDGE + GAP, 0, 5], [EDGE + GAP - 4.9, 1, 5]], normals=[[0, 0, 1.0]] * 2)
        assert other.max() < 1e-4
        found[optimize] = np.array(prepared.integrator.render(prepared.scene, spp=4))
    assert len(two_cubes(True).shapes()) == 1
    assert found[True] == pytest.approx(found[False], rel=1e-4, abs=1e-6)


def test_a_body_name_joins_them():
    for optimize in (True, False):
        prepared = pellucid.prepare(two_cubes(optimize, body="both"), sample_count=3000)
        assert prepared.bodies == ["both"]
        assert prepared.exitance([[EDGE + GAP - 4.9, 1, 5]]).min() > 1e-4


def test_cubes_that_touch_are_one_solid_if_they_are_one_mesh():
    assert len(find_bodies(two_cubes(True, gap=0.0))) == 1


def merged(*meshes, **options):
    mesh = trimesh.util.concatenate(meshes)
    colour = np.random.default_rng(0).uniform(size=(len(mesh.vertices), 2))
    options = {"normals": mesh.vertex_normals, "uv": colour} | options
    return mesh_from_arrays("mesh", mesh.vertices, mesh.faces, bsdf=translucent(material="cream"), **options)


def in_scene(*shapes):
    content = {f"shape{k}": shape for k, shape in enumerate(shapes)}
    return mi.load_dict({"type": "scene", "light": {"type": "constant"}} | content, optimize=False)


def ball(*at, radius=1.0, inwards=False):
    mesh = trimesh.creation.icosphere(3, radius).apply_translation(at)
    if inwards:
        mesh.invert()
    return mesh


def test_a_hollow_ball_is_one_body_and_its_cavity_is_dark():
    hollow = in_scene(merged(ball(0, 0, 0, radius=10.0), ball(0, 0, 0, radius=8.0, inwards=True)))
    prepared = pellucid.prepare(hollow, sample_count=6000, irradiance_paths=16)
    assert prepared.bodies == ["shape0"]
    (lit,) = prepared.integrator.prepared.bodies
    outside = np.linalg.norm(lit.samples.p, axis=1) > 9
    assert 0.3 < np.mean(~outside) < 0.5
    # No light enters the cavity but that of its own walls, which is counted as that of a diffuse surface: none here.
    assert lit.irradiance.total[~outside].mean() < 1e-4 * lit.irradiance.total[outside].mean()


def test_rays_meet_the_body_of_their_triangle():
    """Also where a mesh stands in several instances."""
    pair = merged(ball(-3, 0, 0), ball(3, 0, 0))
    group = {"type": "shapegroup", "pair": pair}
    ref = {"type": "ref", "id": "group"}
    at = [{"type": "instance", "g": ref, "to_world": T().translate([0, y, 0])} for y in (-5, 5)]
    whole = mi.load_dict(
        {"type": "scene", "group": group, "low": at[0], "high": at[1], "single": merged(ball(0, 0, 0))}, optimize=False
    )
    bodies = find_bodies(whole)
    assert sorted(body.name for body in bodies) == sorted(
        ["low.pair.0", "low.pair.1", "high.pair.0", "high.pair.1", "single"]
    )
    centres = [(x, y, 0) for y in (-5, 5) for x in (-3, 3)] + [(0, 0, 0)]
    names = [f"{row}.pair.{k}" for row in ("low", "high") for k in (0, 1)] + ["single"]
    p = mi.Point3f(*np.array(centres, np.float32).T)
    si = whole.ray_intersect(mi.Ray3f(p + mi.Vector3f(0.1, 0.1, 10), mi.Vector3f(0, 0, -1)))
    for chosen in (bodies, bodies[::-1][1:4], bodies[1:2]):
        index = build_lookup(whole, chosen).body_index(si).numpy() if chosen is bodies else None
        if index is not None:
            assert [bodies[k - 1].name for k in index] == names
    alone = next(body for body in bodies if body.name == "high.pair.1")
    assert build_lookup(whole, [alone]).body_index(si).numpy().tolist() == [0, 0, 0, 1, 0]


def test_a_solid_of_a_mesh_keeps_what_the_mesh_knows():
    mesh = merged(ball(-3, 0, 0), ball(3, 0, 0))
    mesh.add_attribute("vertex_color", 3, np.random.default_rng(1).uniform(size=3 * mesh.vertex_count()))
    mesh.add_attribute("face_grade", 1, np.arange(mesh.face_count(), dtype=float))
    part = find_bodies(in_scene(mesh))[1].parts[0]
    vertices, faces = mesh_buffers(part.shape)
    whole, all_faces = mesh_buffers(mesh)
    assert np.array_equal(vertices[faces], whole[all_faces][part.faces])
    own, source = mi.traverse(part.shape), mi.traverse(mesh)
    for name, width in (("vertex_normals", 3), ("vertex_texcoords", 2), ("vertex_color", 3)):
        values, expected = (np.array(p[name]).reshape(-1, width) for p in (own, source))
        assert np.array_equal(values[faces], expected[all_faces][part.faces])
    assert np.array_equal(np.array(own["face_grade"]), np.flatnonzero(part.faces))
    assert part.shape.bsdf() is mesh.bsdf()


@pytest.mark.parametrize("wrappers", [["twosided"], ["bumpmap", "twosided"], ["twosided", "mask"], ["mask", "bumpmap"]])
def test_materials_are_found_inside_others(wrappers):
    """Any depth, any order."""
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(np.zeros((4, 4, 1), np.float32)), "raw": True}
    inner = translucent(material="marble")
    for name in wrappers:
        inner = {"type": name, "nested": inner}
        if name == "bumpmap":
            inner["arbitrary"] = texture
        if name == "mask":
            inner["opacity"] = 1.0
    bodies = find_bodies(in_scene({"type": "sphere", "bsdf": inner}))
    assert bodies[0].medium.name == "marble"
