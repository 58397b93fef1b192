"""The parts of a frame: cameras, tone mapping, the Fresnel table, direct light."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.light.direct import direct_irradiance, receivers
from pellucid.model.fresnel import external_diffuse_transmittance, fresnel_dielectric
from pellucid.realtime.gbuffer import FIRST_BODY, MIDDLE, DeviceCamera, Eye, Screen
from pellucid.realtime.live_body import LEAVE_STEPS, LiveBody
from pellucid.realtime.source import Camera
from pellucid.realtime.tone import average_radiance, to_bytes, tone_map
from pellucid.scene.bodies import build_lookup, find_bodies
from worlds.live import CAMERA, LAMP, assemble, ball, sensor


def test_tone_mapping_is_not_upside_down():
    assert tone_map(3.0, 3.0) == pytest.approx(0.5)
    assert tone_map(3.0, 3.0, 1.0) == pytest.approx(2 / 3)
    value = tone_map(np.linspace(0, 1000, 50), 2.0)
    assert value[0] == 0 and np.all(np.diff(value) > 0) and value[-1] < 1


def test_a_white_surface_under_average_light_is_average():
    average = average_radiance(mi.Float(12.0), 4.0)
    assert float(average[0]) == pytest.approx(3.0 / np.pi)
    assert float(average_radiance(mi.Float(0.0), 4.0)[0]) == 1


def test_bytes_are_rounded_and_clipped():
    red, green, blue = (channel.numpy().tolist() for channel in to_bytes(mi.Color3f([-1, 0.5], [1, 2], [0.001, 0.999])))
    assert (red, green, blue) == ([0, 128], [255, 255], [0, 255])


@pytest.mark.parametrize("size", [(37, 22), (64, 48)])
def test_rays_are_those_of_the_sensor(size):
    screen, camera = Screen.make(*size), DeviceCamera.make(CAMERA, *size)
    rays = camera.rays(screen.x + 0.5, screen.y + 0.5)
    description = sensor()
    description["film"] |= {"width": size[0], "height": size[1]}
    camera = mi.load_dict(description)
    place = mi.Point2f((screen.x + 0.5) / size[0], (screen.y + 0.5) / size[1])
    truth, _ = camera.sample_ray(0, 0, place, [0, 0])
    inside = screen.inside.numpy()
    np.testing.assert_allclose(rays.d.numpy()[:, inside], truth.d.numpy()[:, inside], atol=2e-6)


def test_a_camera_may_look_straight_up():
    camera = DeviceCamera.make(Camera((0, 0, 0), (0, 5, 0), (0, 1, 0)), 8, 8)
    direction = camera.rays(mi.Float(4.0), mi.Float(4.0)).d.numpy().ravel()
    np.testing.assert_allclose(direction, [0, 1, 0], atol=1e-6)


@pytest.mark.parametrize("size", [(13, 7), (16, 16), (1, 1)])
def test_every_pixel_belongs_to_one_lane_of_its_tile(size):
    screen = Screen.make(*size)
    places = screen.place.numpy()[screen.inside.numpy()]
    assert sorted(places) == list(range(size[0] * size[1]))
    assert screen.lanes % 16 == 0
    x, y = screen.x.numpy().reshape(-1, 16), screen.y.numpy().reshape(-1, 16)
    assert np.all(np.ptp(x, axis=1) == 3) and np.all(np.ptp(y, axis=1) == 3)
    assert np.all(x[:, MIDDLE] % 4 == 2) and np.all(y[:, MIDDLE] % 4 == 2)


def test_the_eye_looks_again_only_when_it_has_moved():
    scene = assemble()
    bodies = find_bodies(scene)
    eye = Eye(scene, build_lookup(scene, bodies), keep_hits=False)
    eye.look(CAMERA, (32, 32), (0.5, 0.5))
    first = eye.gbuffer
    eye.look(Camera(list(CAMERA.origin), CAMERA.target, fov=CAMERA.fov), (32, 32), (0.5, 0.5))
    assert eye.gbuffer is first
    radius = np.linalg.norm(first.p.numpy(), axis=0)[first.kind.numpy() == FIRST_BODY]
    np.testing.assert_allclose(radius, 1.5, rtol=1e-5)
    facing = -dr.dot(first.n, first.ray.d).numpy()[first.kind.numpy() == FIRST_BODY]
    assert facing.min() >= 0
    eye.look(CAMERA, (32, 32), (0.25, 0.5))
    assert eye.gbuffer is not first


@pytest.mark.parametrize("eta", [1.0, 1.3, 1.5, 2.5])
def test_the_table_of_leaving_light_follows_fresnel(eta):
    scene = assemble(body=ball(eta=eta))
    bodies = find_bodies(scene)
    table = LiveBody(bodies[0], 0, build_lookup(scene, bodies), 64).leave_table()
    cosine = np.linspace(0, 1, 1001)
    value = np.interp(cosine, np.linspace(0, 1, LEAVE_STEPS + 1), table)
    exact = 1 - fresnel_dielectric(mi.Float(np.maximum(cosine, 1e-6).astype(np.float32)), eta).numpy()
    np.testing.assert_allclose(value, exact / (np.pi * external_diffuse_transmittance(eta)), atol=5e-4)
    # Radiance integrates back to the exitance.
    total = 2 * np.pi * np.trapezoid(value * cosine, cosine)
    assert total == pytest.approx(1, abs=2e-3)


def test_direct_light_obeys_the_laws_of_distance_and_cosine():
    scene = mi.load_dict({"type": "scene", "lamp": LAMP}, optimize=False)
    p = np.array([[0, 0, 0], [4, 5, 4], [4, 5, 8], [0, 0, 0]], np.float32)
    n = np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, -1]], np.float32)
    si = receivers(mi.Point3f(p.T), mi.Normal3f(n.T))
    falling, entering = direct_irradiance(scene, si, 1.5, mi.Point2f(0.5))
    way = np.array([4, 5, 6]) - p
    distance = np.linalg.norm(way, axis=1)
    cosine = np.maximum(np.sum(way * n, axis=1) / distance, 0)
    expected = np.array([60, 50, 40]) * (cosine / distance**2)[:, None]
    np.testing.assert_allclose(falling.numpy().T, expected, rtol=1e-5, atol=1e-7)
    passed = 1 - fresnel_dielectric(mi.Float(cosine.astype(np.float32)), 1.5).numpy()
    np.testing.assert_allclose(entering.numpy().T, expected * passed[:, None], rtol=1e-4, atol=1e-6)


def test_a_sky_gives_pi_in_the_mean_and_shadows_take_it_away():
    sky = {"type": "constant", "radiance": 1.0}
    shade = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(1e3),
    }
    count = 20000
    n = mi.Normal3f(0, 1, 0) + dr.zeros(mi.Normal3f, count)
    si = receivers(dr.zeros(mi.Point3f, count), n)
    index = dr.arange(mi.UInt32, count)
    sample = mi.Point2f((mi.Float(index) + 0.5) / count, mi.Float(dr.brev(index)) * 2.0**-32)
    for shapes, expected in (({}, np.pi), ({"shade": shade}, 0.0)):
        scene = mi.load_dict({"type": "scene", "sky": sky, **shapes}, optimize=False)
        falling, entering = direct_irradiance(scene, si, 1.5, sample)
        assert float(dr.mean(falling.x)[0]) == pytest.approx(expected, rel=0.01, abs=0.01)
        transmittance = external_diffuse_transmittance(1.5)
        assert float(dr.mean(entering.x)[0]) == pytest.approx(expected * transmittance, rel=0.01, abs=0.01)
