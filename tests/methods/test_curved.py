"""The profile that follows the curve, and the factor of thin parts, against photons traced in the same bodies."""

import numpy as np
import pytest
import trimesh

import pellucid
from pellucid.errors import PellucidWarning
from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.realtime.engine import Engine
from pellucid.scene.meshes.buffers import mesh_from_arrays
from worlds.balls import T, scene, translucent

PATHS = {"irradiance_paths": 32}
METHODS = {
    "two_pass": ("two_pass", PATHS),
    "exact": ("exact", PATHS),
    "texture_space": ("texture_space", PATHS | {"resolution": 256, "sample_count": 3000}),
    "hybrid": ("texture_space", PATHS | {"resolution": 256, "sample_count": 3000, "hybrid": True}),
    "adaptive": ("single_pass", {"sample_count": 3000}),
    "clusters": ("single_pass", {"sample_count": 3000, "mode": "two_pass"}),
}
SPHERE = [0.786, 0.514, 0.393]
"""What comes back of the light that enters a ball of skin2, 20 mm across: 1,000,000 photons of `tools/profile_table/walk.c`."""

TILE = 0.975
"""The same of a wide slab, 4 mean free paths thick, of reduced albedo .9984: 500,000 photons."""


def share_that_leaves(content, method, points, normals, **settings):
    """Divide the mean exitance at points under an even sky by the light that enters: ``(3,) float``."""
    prepared = pellucid.prepare(content, method, **settings)
    assert prepared.integrator.method.name == method
    exitance = prepared.exitance(points.astype(np.float32), normals=normals.astype(np.float32))
    eta = prepared.integrator.prepared.bodies[0].body.medium.eta
    return exitance.mean(axis=0) / (np.pi * external_diffuse_transmittance(eta))


def directions(count):
    n = np.random.default_rng(0).normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def ball(profile):
    bsdf = translucent(material="skin2", profile=profile)
    return scene({"type": "sphere", "radius": 10.0, "bsdf": bsdf})


def slab(profile):
    """Without absorption: all light that enters leaves again."""
    bsdf = translucent(sigma_s_prime=2.0, sigma_a=0.0, eta=1.3, profile=profile)
    return scene({"type": "cube", "to_world": T.scale([8, 8, 0.5]), "bsdf": bsdf})


def middle(count=300):
    p = np.random.default_rng(0).uniform(-2, 2, (count, 3))
    p[:, 2] = 0.5
    return p, np.broadcast_to([0.0, 0.0, 1.0], p.shape)


@pytest.mark.parametrize("name", METHODS)
def test_a_sphere_returns_what_photons_do(name):
    method, settings = METHODS[name]
    n = directions(1000)
    found = share_that_leaves(ball("curved"), method, 10 * n, n, **settings)
    assert found == pytest.approx(SPHERE, rel=0.03)


def test_the_flat_profile_leaves_the_sphere_too_dark():
    n = directions(1000)
    found = share_that_leaves(ball("tabulated"), "two_pass", 10 * n, n)
    assert np.all(found < np.multiply(SPHERE, 0.93))


@pytest.mark.parametrize("name", ["two_pass", "exact", "texture_space", "hybrid"])
def test_a_thin_white_slab_returns_all_light(name):
    method, settings = METHODS[name]
    p, n = middle()
    assert share_that_leaves(slab("curved"), method, p, n, **settings) == pytest.approx(1, abs=0.05)


def test_a_thin_tile_returns_what_photons_do():
    """Little is absorbed, and it is narrow: half of what a half space would send out lies beyond its edges."""
    bsdf = translucent(sigma_s_prime=0.9984, sigma_a=0.0016, eta=1.3, profile="curved")
    tile = scene({"type": "cube", "to_world": T.scale([12, 12, 2]), "bsdf": bsdf})
    p, n = middle()
    p[:, 2] = 2
    assert share_that_leaves(tile, "two_pass", p, n, **PATHS) == pytest.approx(TILE, rel=0.02)


def test_what_leaves_thin_parts_out_says_so():
    n = directions(20_000)
    with pytest.warns(
        PellucidWarning, match="pellucid_sampled follows the curve of the body .* no factor for thin parts"
    ):
        prepared = pellucid.prepare(ball("curved"), "sampled")
    found = prepared.exitance((10 * n).astype(np.float32), normals=n.astype(np.float32)).mean(axis=0)
    assert found / (np.pi * external_diffuse_transmittance(1.3)) == pytest.approx(SPHERE, rel=0.03)


def test_the_engine_says_so_too():
    with pytest.warns(
        PellucidWarning, match="The real-time engine follows the curve of the body .* no factor for thin"
    ):
        Engine(ball("curved"), resolution=64)


def test_normals_that_are_not_given_are_those_of_the_surface():
    prepared = pellucid.prepare(ball("curved"), "two_pass", sample_count=2000, irradiance_paths=4)
    n = directions(50)
    points = (10 * n).astype(np.float32)
    given = prepared.exitance(points, normals=n.astype(np.float32))
    np.testing.assert_allclose(prepared.exitance(points), given, rtol=5e-3)
    flipped = prepared.exitance(points, normals=(-n).astype(np.float32))
    assert np.all(flipped < 0.9 * given)


def test_normals_where_faces_are_wound_inwards():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=10)
    bsdf = translucent(material="skin2", profile="curved")
    usual, prepared = (
        pellucid.prepare(
            scene(mesh_from_arrays("ball", mesh.vertices, faces, mesh.vertex_normals, bsdf=bsdf)),
            "two_pass",
            sample_count=2000,
            irradiance_paths=64,
        )
        for faces in (mesh.faces, mesh.faces[:, ::-1])
    )
    points, n = mesh.triangles_center[::20], mesh.face_normals[::20]
    outwards = prepared.exitance(points, normals=n)
    np.testing.assert_allclose(outwards, usual.exitance(points, normals=n), rtol=0.05)
    assert outwards.mean() == pytest.approx(usual.exitance(points).mean(), rel=0.01)
    np.testing.assert_allclose(outwards, prepared.exitance(points), rtol=5e-3)
    np.testing.assert_allclose(outwards, prepared.exitance(points, normals=-n), rtol=1e-5)
