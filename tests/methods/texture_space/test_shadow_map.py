"""Translucent shadow maps: the flux through what a light sees, whichever light it is."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods.texture_space.shadow_map import bounding_sphere, emitter_camera, look, shadow_map
from pellucid.model.fresnel import fresnel_dielectric
from pellucid.scene.bodies import build_lookup, find_bodies
from worlds.balls import T

ETA = 1.5
RADIUS, CENTRE = 2.0, np.array([1.0, -2.0, 0.5])
EYE = np.array([4.0, 3.0, 7.0])
POINT = {"type": "point", "position": list(EYE), "intensity": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
BALL = {"type": "sphere", "center": list(CENTRE), "radius": RADIUS}


def scene_of(light, shape=BALL, **extra):
    marble = {"type": "pellucid_translucent", "material": "marble"}
    return mi.load_dict({"type": "scene", "light": light, "ball": shape | {"bsdf": marble}, **extra}, optimize=False)


def map_of(scene, resolution=512, centre=CENTRE, radius=RADIUS * 1.001, number=0):
    bodies = find_bodies(scene)
    emitter = scene.emitters()[0]
    camera = emitter_camera(scene, emitter, centre, radius, resolution)
    return shadow_map(scene, emitter, camera, build_lookup(scene, bodies), number, bodies[number])


def cone_flux(distance, cutoff=0.5 * np.pi):
    """Flux of a point of unit intensity into a sphere: the integral of the transmittance over the cone that meets it."""
    widest = min(np.sin(cutoff), RADIUS / distance)
    turn = 0.5 * np.pi * (np.arange(4000) + 0.5) / 4000  # sin(theta) = widest sin(turn): smooth at the rim
    sine = widest * np.sin(turn)
    cosine = np.sqrt(np.maximum(1 - (distance * sine / RADIUS) ** 2, 0))
    transmittance = 1 - np.array([float(fresnel_dielectric(float(c), ETA)) for c in cosine])
    step = widest * np.cos(turn) * (turn[1] - turn[0])
    return 2 * np.pi * np.sum(transmittance * sine / np.sqrt(1 - sine**2) * step)


def test_point_light_on_a_sphere():
    found = map_of(scene_of(POINT)).power().sum(axis=(0, 1))
    distance = np.linalg.norm(EYE - CENTRE)
    np.testing.assert_allclose(found, cone_flux(distance) * np.array([1.0, 2.0, 3.0]), rtol=5e-3)


def test_directional_light_on_a_sphere():
    light = {"type": "directional", "direction": [0.3, -0.5, -1.0], "irradiance": 2.0}
    found = map_of(scene_of(light)).power().sum(axis=(0, 1))
    c = (np.arange(20000) + 0.5) / 20000
    transmittance = 1 - np.array([float(fresnel_dielectric(float(x), ETA)) for x in c])
    expected = 2.0 * 2 * np.pi * RADIUS**2 * np.mean(c * transmittance)
    np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_spot_light_without_falloff_lights_its_cone():
    distance = np.linalg.norm(EYE - CENTRE)
    cutoff = 0.5 * np.arcsin(RADIUS / distance)
    light = {
        "type": "spot",
        "intensity": 1.0,
        "cutoff_angle": float(np.rad2deg(cutoff)),
        "beam_width": float(np.rad2deg(cutoff)) - 1e-3,
        "to_world": T.look_at(list(EYE), list(CENTRE), [0, 1, 0]),
    }
    found = map_of(scene_of(light)).power().sum(axis=(0, 1))
    np.testing.assert_allclose(found, cone_flux(distance, cutoff), rtol=1e-2)


@pytest.mark.parametrize("light", [POINT, {"type": "directional", "direction": list(CENTRE - EYE), "irradiance": 1.0}])
def test_something_before_the_body_takes_its_light(light):
    half = {
        "type": "rectangle",
        "to_world": T.look_at(list(CENTRE + 0.6 * (EYE - CENTRE)), list(EYE), [0, 1, 0])
        .translate([10, 0, 0])
        .scale(10),
    }
    free, shaded = (map_of(scene).power().sum() for scene in (scene_of(light), scene_of(light, half=half)))
    assert shaded == pytest.approx(free / 2, rel=5e-3)


def test_another_body_is_not_lit():
    other = {"type": "sphere", "center": list(CENTRE + 0.5 * (EYE - CENTRE)), "radius": 0.5}
    scene = scene_of(POINT, other=other | {"bsdf": {"type": "pellucid_translucent"}})
    power = np.stack([map_of(scene, number=k).power() for k in (0, 1)])
    assert power[0].sum() > 0 and power[1].sum() > 0
    assert np.all((power > 0).any(axis=3).sum(axis=0) <= 1)


def test_depths_are_those_of_the_surface():
    found = map_of(scene_of(POINT), 64)
    camera, record = found.camera, found.records.numpy().reshape(-1, 4)
    index = dr.arange(mi.UInt32, 64 * 64)
    x, y, z = camera.place(index % camera.size, index // camera.size, mi.Float(record[:, 3]))
    p = camera.centre + x * camera.right + y * camera.up + z * camera.axis
    hit = record[:, 0] > 0
    distance = np.linalg.norm(p.numpy().T - CENTRE, axis=1)[hit]
    np.testing.assert_allclose(distance, RADIUS, rtol=1e-5)
    where = camera.locate(p)
    scale = camera.scale(where.z).numpy()
    np.testing.assert_allclose((where.x.numpy() * scale + 32)[hit], (np.arange(64 * 64) % 64 + 0.5)[hit], atol=1e-3)


@pytest.mark.parametrize("light", [POINT, {"type": "directional", "direction": [0.3, -0.5, -1.0]}])
def test_within_a_pixel_the_surface_is_its_plane(light):
    """A quarter of a pixel beside its middle: on the plane that touches the ball there."""
    found = map_of(scene_of(light), 64)
    camera, record, slope = found.camera, found.records.numpy().reshape(-1, 4), found.slopes.numpy().reshape(-1, 2)
    index = dr.arange(mi.UInt32, 64 * 64)
    column, row = mi.Float(index % camera.size), mi.Float(index // camera.size)
    p = camera.place(column, row, mi.Float(record[:, 3])).numpy().T
    aside = mi.Float(record[:, 3] + slope @ [0.25, -0.25])
    beside = camera.place(column + 0.25, row - 0.25, aside).numpy().T
    met = (record[:, 0] > 0) & (np.abs(slope).max(axis=1) * camera.zoom.numpy() < 8)
    assert met.sum() > 2000
    off = np.sum((beside - p) * p, axis=1) / RADIUS
    np.testing.assert_allclose(off[met], 0, atol=1e-5)


def test_a_coarse_mesh_takes_what_the_smooth_surface_would():
    """A globe of few facets with smooth normals: the flux into the sphere it stands for, but for its smaller area."""
    n, m = 24, 12
    theta, phi = np.meshgrid(np.linspace(0, np.pi, m + 1), np.linspace(0, 2 * np.pi, n + 1), indexing="ij")
    normal = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(m), np.arange(n), indexing="ij")
    a = (i * (n + 1) + j).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a + 1, a + n + 2, a + n + 1], 1)])
    mesh = mi.Mesh("ball", len(normal), len(faces), has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = (CENTRE + RADIUS * normal).astype(np.float32).ravel()
    parameters["vertex_normals"] = normal.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    mesh.set_bsdf(mi.load_dict({"type": "pellucid_translucent", "material": "marble"}))
    scene = mi.load_dict({"type": "scene", "light": POINT, "ball": mesh}, optimize=False)
    found = map_of(scene).power()[..., 0].sum()
    assert found == pytest.approx(cone_flux(np.linalg.norm(EYE - CENTRE)), rel=0.02)


def test_lights_without_a_place_have_no_map():
    scene = scene_of({"type": "constant"})
    assert emitter_camera(scene, scene.emitters()[0], CENTRE, RADIUS, 64) is None
    inside = scene_of(POINT | {"position": [*CENTRE[:2], float(CENTRE[2]) + 1.05 * RADIUS]})
    assert emitter_camera(inside, inside.emitters()[0], CENTRE, RADIUS, 64) is None


def test_a_moving_light_compiles_nothing():
    scene = scene_of(POINT)
    parameters = mi.traverse(scene)
    misses = []
    for k in range(6):
        parameters["light.position"] = [4.0 - k, 3.0, 7.0 + k]
        parameters.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            map_of(scene, 32 + k)
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
            misses.append(sum(not entry["cache_hit"] for entry in kernels))
            assert kernels
    assert misses[3:] == [0, 0, 0], misses


def test_the_bounding_sphere_of_a_box_touches_its_corners():
    corners = np.array([[x, y, z] for x in (0, 2) for y in (1, 5) for z in (-1, 3)], float)
    centre, radius = bounding_sphere(corners)
    np.testing.assert_allclose(centre, [1, 3, 1])
    assert radius == pytest.approx(3.0)
    assert look(centre, radius, 8, eye=[9, 9, 9]).resolution == 8
