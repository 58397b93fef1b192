"""The teapot: Newell's patches, one closed solid, normals of the patches."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pellucid.scenes.teapots.mesh import DEFAULT_SIZE, patches, teapot_mesh


@pytest.fixture(scope="module")
def mesh():
    return teapot_mesh()


@pytest.fixture(scope="module")
def solid(mesh):
    """The same with one vertex per position, as its topology is meant."""
    welded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    welded.merge_vertices(merge_norm=True, merge_tex=True)
    return welded


def test_control_points_are_the_published_ones():
    control = patches()
    assert control.shape == (32, 4, 4, 3)
    # 306 published, of which the four beside the tip of the knob (0.002 off it) are that tip here, and the ring that
    # body and bottom share, with its 12 points, is listed twice there.
    assert len(np.unique(control.reshape(-1, 3).round(6), axis=0)) == 306 - 4 - 12
    low, high = control.min((0, 1, 2)), control.max((0, 1, 2))
    np.testing.assert_allclose(low, (-3, -2, 0))
    np.testing.assert_allclose(high, (3.525, 2, 3.15))


def test_published_points_lie_on_the_surface(solid):
    unit = DEFAULT_SIZE / 6.4338
    # The corners of the patches: rim, widest ring of the body, tip of the knob, outermost handle, bend of the spout.
    corners = np.array([(0, -1.5, 2.4), (0, 2, 0.9), (0, 0, 3.15), (-3, 0, 1.8), (3.3, 0, 2.4), (2.7, 0, 2.4)]) * unit
    closest = trimesh.proximity.closest_point_naive(solid, corners)[1]
    np.testing.assert_allclose(closest, 0, atol=0.05 * unit)


def test_it_is_one_solid_with_a_handle(solid):
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.euler_number == 0  # a sphere with one handle
    a, b = solid.edges.T
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(len(solid.vertices),) * 2)
    assert connected_components(graph)[0] == 1
    assert solid.volume > 0


def test_size_and_area_are_those_of_figure_3(solid):
    np.testing.assert_allclose(solid.extents[0], DEFAULT_SIZE, rtol=1e-6)
    assert solid.bounds[0][2] == pytest.approx(0, abs=1e-6)
    marble_mfp = 1 / (3.00 + 0.0071)
    assert solid.area / (np.pi * marble_mfp**2) == pytest.approx(150_000, rel=0.01)


def test_area_and_volume_converge():
    areas, volumes = [], []
    for resolution in (6, 12, 24):
        vertices, _, faces = teapot_mesh(100.0, resolution)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        areas.append(mesh.area)
        volumes.append(mesh.volume)
    for values in (areas, volumes):
        ratio = (values[1] - values[0]) / (values[2] - values[1])
        assert 2.5 < ratio < 7  # second order: 4


def test_normals_are_unit_smooth_and_outward(mesh):
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    corners = mesh.vertices[mesh.faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(face, axis=1)
    assert area.min() > 0
    cosine = np.einsum("ij,ikj->ik", face / (2 * area[:, None]), mesh.normals[mesh.faces])
    assert cosine.min() > 0.6
    # Almost everywhere a facet is within a few degrees of the surface it stands for.
    assert np.quantile(cosine, [0.01, 0.2]).tolist() > np.cos(np.deg2rad([18, 6])).tolist()


def test_normals_are_those_of_the_bezier_surface(mesh):
    # On the body, a surface of revolution up to 0.3 %, the normal lies in the plane through the axis.
    x, y, z = mesh.vertices.T
    body = (np.abs(y) > 0.2 * DEFAULT_SIZE) & (z > 5)
    radial = mesh.vertices[body, :2] / np.hypot(x, y)[body, None]
    sideways = radial[:, 0] * mesh.normals[body, 1] - radial[:, 1] * mesh.normals[body, 0]
    assert body.sum() > 500 and np.abs(sideways).max() < 0.02


def test_poles_have_normals_along_the_axis(mesh):
    top, bottom = np.argmax(mesh.vertices[:, 2]), np.argmin(np.abs(mesh.vertices).sum(1))
    np.testing.assert_allclose(mesh.normals[top], (0, 0, 1), atol=1e-5)
    np.testing.assert_allclose(mesh.normals[bottom], (0, 0, -1), atol=1e-5)


def test_it_does_not_cut_itself():
    # The winding number of random points: 2 where parts overlap, -1 where the surface is inside out, else 0 or 1.
    vertices, _, faces = teapot_mesh(200.0, 8)
    solid = trimesh.Trimesh(vertices, faces, process=False)
    points = np.random.default_rng(5).uniform(*solid.bounds, (1500, 3))
    a, b, c = np.moveaxis(vertices[faces][..., :2], 1, 0)
    heights = vertices[faces][..., 2]
    winding = np.zeros(len(points), int)
    for chunk in np.array_split(np.arange(len(points)), 10):
        p = points[chunk][:, None, :2]
        weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)])
        total = weights.sum(0)
        above = (weights * heights.T[:, None]).sum(0) / np.where(total == 0, 1, total) > points[chunk][:, 2:]
        hit = (weights > 0).all(0) | (weights < 0).all(0)
        winding[chunk] = np.where(hit & above, np.sign(total), 0).sum(1)
    assert set(np.unique(winding)) == {0, 1}
    assert winding.mean() * np.prod(solid.extents) == pytest.approx(solid.volume, rel=0.1)


def _cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def test_built_twice_it_is_the_same():
    one, two = teapot_mesh(80.0, 6), teapot_mesh(80.0, 6)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)
