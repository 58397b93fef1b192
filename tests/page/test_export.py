"""What becomes of a scene on its way to the page: what is shown, what is refused, what is said."""

import base64
import json
import re
import zlib

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.errors import SceneError
from pellucid.model.medium import PROFILES, Medium
from pellucid.page.assemble import page
from pellucid.page.lamps import page_lamps
from pellucid.page.medium_table import ABSORPTION, DISTANCE, ETA, G, MediumTable
from pellucid.page.packing import NORMAL_STEPS, Planes, add_mesh, octahedron
from pellucid.page.scene import page_scene
from pellucid.page.surface import PageSurface, harmonics, openness, page_surface, sphere_directions
from pellucid.scene.bodies import find_bodies
from worlds.balls import translucent
from worlds.exported import bumpy, coloured_scene, model_scene


def unpacked(contents):
    """Read the planes of a page as the page does."""
    kinds = {"u8": "u1", "i8": "i1", "u16": "<u2", "u32": "<u4", "f32": "<f4"}
    data, planes, at = zlib.decompress(base64.b64decode(contents.data)), {}, 0
    for plane in contents.head["planes"]:
        kind = np.dtype(kinds[plane["type"]])
        part = np.frombuffer(data, np.uint8, plane["count"] * kind.itemsize, at).reshape(kind.itemsize, -1)
        values = np.ascontiguousarray(part.T).view(kind).ravel()
        if plane["code"] == "delta":
            values = np.cumsum(values, dtype=kind)
        elif plane["code"] == "newest":
            known, result = -1, []
            for value in values.tolist():
                result.append(known + 1 - value)
                known = max(known, result[-1])
            values = np.array(result)
        planes[plane["name"]] = values
        at += part.size
    assert at == len(data)
    return planes


def mesh_of(contents):
    planes, body = unpacked(contents), contents.head["body"]
    place = np.stack([planes[axis] for axis in "xyz"], axis=1) / 65535
    return np.array(body["low"]) + place * body["size"], planes["triangles"].reshape(-1, 3), planes


def volume(p, faces):
    a, b, c = p[faces].transpose(1, 0, 2)
    return float(np.sum(a * np.cross(b, c)) / 6)


def test_a_curved_page_carries_beta_and_says_what_it_lacks():
    contents = page_scene(model_scene(material={"material": "marble", "profile": "curved"}), "bumps")
    (note,) = contents.head["notes"]
    assert "profile = 'curved' has no factor" in note and not contents.notes
    assert unpacked(contents)["table.curve"].nbytes < 3000


def test_the_mesh_survives():
    vertices, normals, faces = bumpy()
    contents = page_scene(model_scene(), "bumps")
    p, found, planes = mesh_of(contents)
    assert len(found) == len(faces)
    assert volume(p, found) == pytest.approx(volume(vertices, faces), rel=1e-4)
    middles = [np.sort(q[f].mean(axis=1) @ [1.0, 10.0, 100.0]) for q, f in ((p, found), (vertices, faces))]
    assert np.allclose(*middles, atol=0.03)  # of 1000
    unfolded = np.stack([planes["nx"], planes["ny"]], axis=1) / NORMAL_STEPS * 2 - 1
    nearest = np.linalg.norm(vertices[:, None] - p[None, :50], axis=2).argmin(axis=0)
    assert np.abs(octahedron(normals[nearest]) - unfolded[:50]).max() < 2e-3


def wound_both_ways(faces):
    return np.where(np.arange(len(faces))[:, None] % 3 == 0, faces[:, ::-1], faces)


@pytest.mark.parametrize("turn", ["inwards", "mirrored", "in part"])
def test_inverted_bodies_are_turned_outwards(turn):
    vertices, normals, faces = bumpy()
    mesh = {
        "inwards": (vertices, -normals, faces[:, ::-1]),
        "mirrored": (vertices * [1, 1, -1], normals * [1, 1, -1], faces),
        "in part": (vertices, normals, wound_both_ways(faces)),
    }[turn]
    (body,) = find_bodies(model_scene(mesh))
    surface, _ = page_surface(body)
    p = surface.corners.reshape(-1, 3)
    assert volume(p, np.arange(len(p)).reshape(-1, 3)) == pytest.approx(volume(vertices, faces), rel=1e-4)
    facing = np.cross(surface.corners[:, 1] - surface.corners[:, 0], surface.corners[:, 2] - surface.corners[:, 0])
    assert np.all(np.sum(facing[:, None] * surface.normals, axis=2) > 0)


def test_open_bodies_are_refused():
    vertices, normals, faces = bumpy()
    half = faces[vertices[faces].mean(axis=1)[:, 2] > 0]
    with pytest.raises(SceneError, match=r"'body' is an open surface: close its holes"):
        page_scene(model_scene((vertices, normals, half)), "half")


def test_bodies_without_an_inside_are_refused():
    """Wound both ways, without normals that tell which is right; and a hollow one, which has an inside."""
    vertices, _, faces = bumpy()
    with pytest.raises(SceneError, match=r"face both ways.*trimesh\.repair\.fix_normals"):
        page_scene(model_scene((vertices, None, wound_both_ways(faces))), "both")
    hollow = np.concatenate([vertices, 0.8 * vertices]), None, np.concatenate([faces, faces[:, ::-1] + len(vertices)])
    surface, _ = page_surface(*find_bodies(model_scene(hollow)))
    p = surface.corners.reshape(-1, 3)
    assert volume(p, np.arange(len(p)).reshape(-1, 3)) == pytest.approx((1 - 0.8**3) * volume(vertices, faces))


def test_several_bodies_and_other_shapes_are_refused():
    ball = {"type": "sphere", "radius": 3.0, "center": [30, 0, 0], "bsdf": translucent(material="skin1")}
    with pytest.raises(SceneError, match=r"has 2.*pellucid view"):
        page_scene(model_scene(shapes=[ball]), "two")
    scene = mi.load_dict({"type": "scene", "ball": ball, "sensor": {"type": "perspective"}}, optimize=False)
    with pytest.raises(SceneError, match=r"Sphere: export it as a mesh"):
        page_scene(scene, "ball")


def test_lamps_keep_their_light_at_the_body():
    """Of each kind the irradiance in the middle of an empty scene, as Mitsuba has it."""
    square = mi.ScalarTransform4f().look_at([0, 0, 40], [0, 0, 0], [0, 1, 0]) @ mi.ScalarTransform4f().scale(0.5)
    colour = {"type": "rgb", "value": [3.0, 2.0, 1.0]}
    lights = {
        "point": {"type": "point", "position": [0, 0, 40], "intensity": colour},
        "directional": {"type": "directional", "direction": [0, 0, -1], "irradiance": colour},
        "area": {"type": "rectangle", "to_world": square, "emitter": {"type": "area", "radiance": colour}},
    }
    for kind, light in lights.items():
        scene = model_scene(light=light)
        (lamp,), sky, notes = page_lamps(scene, np.zeros(3))
        assert sky is None and bool(notes) == (kind == "area")
        assert lamp["kind"] == ("directional" if kind == "directional" else "point")
        irradiance = np.array(lamp["colour"]) * lamp["intensity"]
        irradiance /= 1 if kind == "directional" else 40.0**2
        expected = np.array([3.0, 2.0, 1.0]) / (1 if kind == "directional" else 40.0**2)
        assert np.allclose(irradiance, expected, rtol=1e-4)
        assert np.allclose(np.array(lamp["position"]) / np.linalg.norm(lamp["position"]), [0, 0, 1])


def test_an_even_sky_enters_as_through_a_plane():
    """At a convex place T_d pi of a radiance of 1 enters; the openness says so within its rounding."""
    from pellucid.model.fresnel import external_diffuse_transmittance

    scene = model_scene(light={"type": "constant", "radiance": 2.0})
    contents = page_scene(scene, "sky")
    sky = np.array(contents.head["state"]["sky"])
    assert np.allclose(harmonics(sphere_directions(50)) @ sky, 2.0, atol=0.02)
    planes = unpacked(contents)
    values = planes["openness"].reshape(9, -1) * contents.head["constants"]["opennessScale"]
    entering = sky[:, 0] @ values
    assert entering.max() == pytest.approx(2 * np.pi * external_diffuse_transmittance(1.5), rel=0.03)
    assert entering.min() > 0


def test_bumps_shade_each_other():
    (body,) = find_bodies(model_scene())
    surface, _ = page_surface(body)
    corner = np.arange(0, 3 * len(surface.corners), 7)
    values, _ = openness(surface, corner, 1.5)
    of_a_plane = values[0].max()
    assert values[0].min() < 0.75 * of_a_plane


@pytest.mark.parametrize("name", PROFILES)
def test_the_table_holds_every_medium(name):
    table = MediumTable.make(PROFILES[name])
    m, e, s = 3, 2, 7
    albedo = 1 - ABSORPTION[s] ** 2 / 3
    medium = Medium(albedo, 1 - albedo, g=float(G[m]), eta=float(ETA[e]), profile=name)
    expected = medium.diffuse_reflectance(DISTANCE)[:, 0]
    found = albedo * np.exp(table.profile[m, e, s] - table.decay[m, s] * DISTANCE)
    large = expected > 1e-15 * expected.max()
    assert np.allclose(found[large], expected[large], rtol=1e-3)
    assert albedo * table.reflectance[m, e, s] == pytest.approx(medium.total_diffuse_reflectance[0], rel=1e-4)
    assert np.all(np.isfinite(table.profile)) and np.ptp(table.profile) < 60
    if name == "curved":
        assert np.allclose(table.curve[e, s], medium.curve(2.0 ** np.arange(-3, 6))[:, 0])
    else:
        assert table.curve is None


def test_textures_and_colours_of_vertices_are_baked():
    contents = page_scene(coloured_scene(), "colours")
    picture = base64.b64decode(contents.head["body"]["colours"])
    assert picture[:2] == b"\xff\xd8" and len(picture) < 150_000


def bumpy_ring(cells):
    """A ring with bumps of cells by cells squares, two triangles each, cut open into the unit square: mesh, places."""
    k = np.arange(cells + 1)
    around, across = np.meshgrid(2 * np.pi / cells * (k % cells), 2 * np.pi / cells * (k % cells), indexing="ij")
    thick = 4 + np.sin(7 * around) * np.cos(5 * across + around)
    far = 10 + thick * np.cos(across)
    p = np.stack([far * np.cos(around), far * np.sin(around), thick * np.sin(across)], axis=-1).reshape(-1, 3)
    uv = np.stack(np.meshgrid(k, k, indexing="ij"), axis=-1).reshape(-1, 2) / cells
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return (p, np.array(trimesh.Trimesh(p, faces, process=False).vertex_normals), faces), uv


def test_large_meshes_make_small_files(monkeypatch):
    """Of 10,000 triangles .3 MB, of 100,000 1.5 MB with their openness from few rays, whose noise makes it larger."""
    mesh, uv = bumpy_ring(71)
    small = page(page_scene(model_scene(mesh, uv=uv), "ring"), still=bytes(12_000))
    assert len(small) < 0.3e6
    (vertices, normals, faces), uv = bumpy_ring(224)
    monkeypatch.setattr("pellucid.page.surface.DIRECTIONS", 64)
    surface, planes = PageSurface(vertices[faces], normals[faces], uv[faces]), Planes()
    _, _, corner = add_mesh(planes, surface.corners, surface.normals, surface.uv)
    planes.add("openness", openness(surface, corner, 1.5)[0], "delta")
    assert len(small) + len(planes.packed()) < 1.5e6


def test_names_and_commands_cannot_break_out_of_the_file():
    contents = page_scene(model_scene(), '</script><script>alert("1")</script>')
    text = page(contents, command="pellucid export '</script><b>'")
    assert text.count("<script") == 4 and "<b>" not in text
    head = json.loads(re.search(r'id="head">(.*?)</script>', text, re.S)[1])
    assert head["command"].endswith("'</script><b>'")
