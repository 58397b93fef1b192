"""Texels as surface samples: no light is lost, and each is where it says it is."""

import numpy as np
import pytest

import pellucid  # noqa: F401 isort: skip

import mitsuba as mi

from pellucid.kernels.morton import interleave
from pellucid.scene.atlas.layout import build_atlas
from pellucid.scene.atlas.texels import rasterise
from pellucid.scene.bodies import Body, Part
from pellucid.scene.meshes.buffers import mesh_from_arrays

trimesh = pytest.importorskip("trimesh")

LIGHT = np.array([0.48, -0.6, 0.64])


def texels_of(*parts, resolution=128, stretch=4.0):
    """Lay out and rasterise shapes, or pairs of a shape and a matrix: texels, and the area of the surface."""
    pairs = [part if isinstance(part, tuple) else (part, None) for part in parts]
    atlas = build_atlas(Body("body", None, [Part(shape, None, matrix) for shape, matrix in pairs]), resolution, stretch)
    texels = rasterise(atlas)
    assert texels.samples.area.sum(dtype=float) == pytest.approx(atlas.surface.area, rel=1e-5)
    row, column = np.divmod(texels.texel, np.uint32(resolution))
    assert np.all(np.diff(interleave(column, row).astype(int)) > 0) and texels.texel.max() < resolution**2
    assert texels.samples.area.min() > 0 and texels.resolution == resolution
    for name in ("p", "n", "sh_n", "p_smooth", "uv", "dp_du", "dp_dv"):
        values = getattr(texels.samples, name)
        assert values.dtype == np.float32 and len(values) == len(texels.texel) and np.isfinite(values).all()
    np.testing.assert_allclose(np.linalg.norm(texels.samples.n, axis=1), 1, atol=1e-5)
    return texels


def integral(texels, values) -> float:
    return float(np.sum(values * texels.samples.area.astype(float)))


def ball(subdivisions=4, **more):
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return sphere, mesh_from_arrays("ball", sphere.vertices, sphere.faces, **more)


def square(size, shape):
    """Two triangles a cell of a unit square in the xy plane, with texture coordinates shape(u, v)."""
    u, v = (x.ravel() for x in np.meshgrid(*[np.linspace(0, 1, size + 1)] * 2))
    corner = (np.arange(size)[:, None] * (size + 1) + np.arange(size)).ravel()
    lower, upper = (corner, corner + 1, corner + size + 2), (corner, corner + size + 2, corner + size + 1)
    faces = np.concatenate([np.stack(lower, -1), np.stack(upper, -1)])
    return mesh_from_arrays("square", np.stack([u, v, 0 * u], -1), faces, uv=np.stack(shape(u, v), -1))


# --- flux: CLHHC08 eq. 7, the integral of E' over the square is the flux through the surface -----------------------


@pytest.mark.parametrize("resolution", [64, 256])
def test_parallel_light_on_a_mesh(resolution):
    sphere, shape = ball()
    texels = texels_of(shape, resolution=resolution)
    exact = np.sum(sphere.area_faces * np.maximum(sphere.face_normals @ LIGHT, 0))
    assert integral(texels, np.maximum(texels.samples.n @ LIGHT, 0)) == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize("resolution", [32, 256])
def test_parallel_light_on_a_sphere(resolution):
    texels = texels_of(mi.load_dict({"type": "sphere", "radius": 2, "center": [1, 2, 3]}), resolution=resolution)
    assert integral(texels, np.maximum(texels.samples.n @ LIGHT, 0)) == pytest.approx(4 * np.pi, rel=1e-3)


def test_polynomials_on_a_cube():
    texels = texels_of(mi.load_dict({"type": "cube"}), resolution=256)
    x, y, z = texels.samples.p.astype(float).T
    assert integral(texels, x**2) == pytest.approx(40 / 3, rel=1e-3)
    assert integral(texels, x**2 * y**4) == pytest.approx(8 / 5 + 8 / 3 + 8 / 15, rel=1e-3)
    assert integral(texels, 1 + x * y + z) == pytest.approx(24, rel=1e-3)


def test_the_error_falls_with_the_square_of_the_texel():
    sphere, shape = ball(2)
    a, b, c = np.moveaxis(sphere.triangles[..., 0], 1, 0)
    # The mean of x^4 over a triangle with corners a, b, c is that of all products of four of them.
    powers = [a**i * b**j * c ** (4 - i - j) for i in range(5) for j in range(5 - i)]
    mean = np.mean(powers, axis=0)
    exact = np.sum(sphere.area_faces * mean)
    errors = []
    for resolution in (32, 256):
        texels = texels_of(shape, resolution=resolution)
        errors.append(abs(integral(texels, texels.samples.p[:, 0].astype(float) ** 4) / exact - 1))
    assert errors[0] < 0.02 and errors[1] < errors[0] / 8


def test_a_strong_distortion_changes_no_flux():
    for shape in (
        lambda u, v: (u, v),
        lambda u, v: (u**2, v**1.5),
        lambda u, v: (0.5 * u * v + 0.01 * u, 0.5 * v + 0.1),
    ):
        texels = texels_of(square(16, shape), resolution=256, stretch=np.inf)
        x, y, _ = texels.samples.p.astype(float).T
        assert integral(texels, x * y**2) == pytest.approx(1 / 6, rel=2e-3)


def test_triangles_much_smaller_than_texels_lose_nothing():
    sphere, shape = ball(5)
    texels = texels_of(shape, resolution=32)
    assert len(texels.texel) < len(sphere.faces) / 20
    assert integral(texels, np.maximum(texels.samples.n @ LIGHT, 0)) == pytest.approx(np.pi, rel=2e-2)


# --- shapes and instances --------------------------------------------------------------------------------------------


def turned(*scales):
    """A rotation after a scaling, and a shift."""
    matrix = mi.ScalarTransform4f().translate([1, 2, 3]).rotate([0.6, 0.8, 0], 50).scale(list(scales))
    return np.array(matrix.matrix, float).reshape(4, 4)


@pytest.mark.parametrize("scales", [(2, 2, 2), (1, 2, 3), (4, 0.5, 1)])
def test_an_instance_of_a_sphere(scales):
    matrix = turned(*scales)
    texels = texels_of((mi.load_dict({"type": "sphere"}), matrix))
    p, n = texels.samples.p.astype(float), texels.samples.n.astype(float)
    local = (p - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1, atol=1e-5)
    assert integral(texels, np.sum((p - p.mean(0)) * n, 1)) == pytest.approx(4 * np.pi * np.prod(scales), rel=1e-3)
    assert np.linalg.norm(n.T @ texels.samples.area) < 1e-3 * texels.samples.area.sum()


@pytest.mark.parametrize("kind", ["mesh", "cube"])
def test_an_instance_of_a_mesh(kind):
    matrix = turned(1, 2, 3)
    shape = mi.load_dict({"type": "cube"}) if kind == "cube" else ball(3)[1]
    texels = texels_of((shape, matrix))
    p, n = texels.samples.p.astype(float), texels.samples.n.astype(float)
    volume = 8 if kind == "cube" else ball(3)[0].volume
    assert integral(texels, np.sum((p - matrix[:3, 3]) * n, 1)) == pytest.approx(3 * 6 * volume, rel=1e-3)


def test_texels_of_a_sphere_are_about_as_long_as_wide():
    texels = texels_of(mi.load_dict({"type": "sphere"}), resolution=64)
    p = texels.samples.p[np.argsort(texels.texel)].reshape(64, 64, 3)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(p, axis=axis), axis=-1) * 64 / np.sqrt(4 * np.pi)
        assert step.min() > 0.4 and step.max() < 1.7


@pytest.mark.parametrize("kind", ["disk", "rectangle", "cylinder"])
def test_other_shapes(kind):
    texels = texels_of(mi.load_dict({"type": kind}))
    x, y, z = texels.samples.p.astype(float).T
    exact = {"disk": np.pi / 4, "rectangle": 4 / 3, "cylinder": np.pi}[kind]
    assert integral(texels, x**2) == pytest.approx(exact, rel=1e-3)
    if kind == "cylinder":
        np.testing.assert_allclose(x**2 + y**2, 1, atol=1e-5)
    else:
        np.testing.assert_allclose(z, 0, atol=1e-6)


def test_sides():
    assert texels_of(mi.load_dict({"type": "sphere"}), resolution=32).samples.outside == 1
    assert texels_of(mi.load_dict({"type": "sphere", "flip_normals": True}), resolution=32).samples.outside == -1
    assert texels_of(mi.load_dict({"type": "cube", "flip_normals": True}), resolution=32).samples.outside == -1
    assert texels_of(mi.load_dict({"type": "disk"}), resolution=32).samples.outside == 1


def test_shapes_keep_their_places_when_laid_out_together():
    shapes = [
        mi.load_dict({"type": kind, "to_world": mi.ScalarTransform4f().translate([10 * k, 0, 0])})
        for k, kind in enumerate(("sphere", "cube", "disk", "cylinder"))
    ]
    samples = texels_of(*shapes).samples
    np.testing.assert_array_equal(np.round(samples.p[:, 0] / 10), samples.shape_index)
    areas = np.bincount(samples.shape_index, samples.area)
    np.testing.assert_allclose(areas, [4 * np.pi, 24, np.pi, 2 * np.pi], rtol=1e-4)


# --- what a sample knows ---------------------------------------------------------------------------------------------


def test_a_sample_lies_in_its_texel():
    texels = texels_of(square(5, lambda u, v: (u, v)), resolution=32)
    column, row = texels.texel % 32, texels.texel // 32
    np.testing.assert_array_equal(np.floor(texels.samples.p[:, 0] * 32), column)
    np.testing.assert_array_equal(np.floor(texels.samples.p[:, 1] * 32), row)
    assert len(texels.texel) == 32**2
    np.testing.assert_allclose(texels.samples.area, 32.0**-2, rtol=1e-5)


def test_a_whole_texel_is_sampled_at_its_centre():
    texels = texels_of(square(1, lambda u, v: (u, v)), resolution=16)
    off = texels.texel % 16 != texels.texel // 16
    centre = (np.stack([texels.texel % 16, texels.texel // 16], -1) + 0.5) / 16
    np.testing.assert_allclose(texels.samples.p[off, :2], centre[off], atol=1e-6)


def test_texture_coordinates_are_those_of_the_mesh_even_if_they_overlap():
    texels = texels_of(square(6, lambda u, v: (2 * np.abs(u - 0.5), v)), resolution=64)
    p, uv = texels.samples.p, texels.samples.uv
    np.testing.assert_allclose(uv, np.stack([2 * np.abs(p[:, 0] - 0.5), p[:, 1]], -1), atol=1e-5)
    np.testing.assert_allclose(np.abs(texels.samples.dp_du[:, 0]), 0.5, atol=1e-5)


def test_normals_and_lifted_positions():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    samples = texels_of(ball(2, normals=sphere.vertices)[1]).samples
    direction = samples.p / np.linalg.norm(samples.p, axis=1, keepdims=True)
    assert np.sum(samples.sh_n * direction, 1).min() > 0.999
    assert np.sum(samples.n * direction, 1).min() < 0.99
    # The facets lie inside the ball, and the positions for shadow rays outside.
    assert np.linalg.norm(samples.p, axis=1).max() < 1 + 1e-6
    assert np.linalg.norm(samples.p_smooth, axis=1).min() > 1 - 1e-6


def test_the_same_body_gives_the_same_texels():
    one, two = (texels_of(ball(3)[1], resolution=64).samples for _ in range(2))
    np.testing.assert_array_equal(one.p, two.p)
    np.testing.assert_array_equal(one.area, two.area)
