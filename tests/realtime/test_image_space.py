"""The image-space baseline: right where all light enters in view of the camera, dark where none does."""

import itertools

import mitsuba as mi
import numpy as np

from pellucid.gather.gather import gather_all
from pellucid.kernels.memory import columns
from pellucid.methods.texture_space.hybrid import filter_maps
from pellucid.model import Medium, ProfileTable
from pellucid.model.fresnel import transmitted
from pellucid.realtime.image_space import pixel_samples, see_from_camera
from pellucid.scene.bodies import build_lookup, find_bodies

RADIUS = 5.0
MARBLE = Medium.from_preset("marble", profile="dipole")
EYE = np.array([0.0, 0.0, 30.0])


def irradiance(n, sun):
    """Entering irradiance of a sphere under light of unit strength along ``sun``."""
    cosine = np.maximum(n @ -np.asarray(sun), 0)
    return cosine * np.array(transmitted(mi.Float(cosine.astype(np.float32)), mi.Float(MARBLE.eta)))


def sphere_points(count):
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * 2.399963229728653
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)


def truth(sun, queries):
    n = sphere_points(200_000)
    area = 4 * np.pi * RADIUS**2 / len(n)
    power = np.repeat((irradiance(n, sun) * area)[:, None], 3, axis=1)
    table = ProfileTable.from_medium(MARBLE, np.sqrt(area / np.pi))
    return np.stack([c.numpy() for c in gather_all(RADIUS * n, power, table, mi.Point3f(*columns(queries)))], 1)


def baseline(sun, queries, count=1600, resolution=512):
    bsdf = {"type": "pellucid_translucent", "material": "marble", "profile": "dipole"}
    light = {"type": "directional", "direction": list(sun), "irradiance": 1.0}
    scene = mi.load_dict(
        {"type": "scene", "light": light, "ball": {"type": "sphere", "radius": RADIUS, "bsdf": bsdf}}, optimize=False
    )
    bodies = find_bodies(scene)
    lookup = build_lookup(scene, bodies)
    seen = see_from_camera(scene, EYE, np.zeros(3), 1.001 * RADIUS, lookup, 0, bodies[0], resolution)
    return seen, filter_maps([seen], pixel_samples(MARBLE, count), mi.Point3f(*columns(queries))).numpy().T


FRONT, BACK = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
n = sphere_points(4001)
FACING = RADIUS * n[n[:, 2] > 0.7]


def test_the_power_seen_is_that_of_the_lit_surface_in_view():
    seen, _ = baseline(FRONT, FACING)
    n = sphere_points(400_000)
    rim = RADIUS / EYE[2]
    flux = irradiance(n, FRONT)[n[:, 2] > rim].sum() * 4 * np.pi * RADIUS**2 / len(n)
    np.testing.assert_allclose(seen.power().sum(axis=(0, 1)), flux, rtol=5e-3)


def test_lit_from_the_camera_it_is_right():
    value, expected = baseline(FRONT, FACING)[1], truth(FRONT, FACING)
    rmse = np.sqrt(np.mean((value - expected) ** 2, axis=0)) / expected.mean(axis=0)
    assert rmse.max() < 0.01, rmse


def test_lit_from_behind_it_is_dark():
    """Its known failure: light that enters out of sight of the camera is lost."""
    value, expected = baseline(BACK, FACING)[1], truth(BACK, FACING)
    assert expected.min() > 0
    assert np.all(value.mean(axis=0) < 0.05 * expected.mean(axis=0))


def test_every_point_has_places_of_its_own():
    """They stand for the plane around it as far as light goes."""
    place = pixel_samples(MARBLE, 400).around(mi.Point3f(*columns(np.repeat(FACING[:2], 400, axis=0))))
    x, y, area = (part.numpy().reshape(2, 400) for part in place(mi.UInt32(np.tile(np.arange(400), 2))))
    assert np.abs(x[0] - x[1]).min() > 0
    light = MARBLE.diffuse_reflectance(np.hypot(x, y).ravel()).sum(axis=1).reshape(2, 400)
    np.testing.assert_allclose((light * area).sum(axis=1), MARBLE.total_diffuse_reflectance.sum(), rtol=0.01)


def test_more_samples_converge():
    expected = truth(FRONT, FACING)
    errors = [np.sqrt(np.mean((baseline(FRONT, FACING, c)[1] - expected) ** 2)) for c in (25, 100, 400, 1600)]
    assert all(fine < coarse for coarse, fine in itertools.pairwise(errors)), errors
