"""Surface samples: on the surface, even by area, apart from each other, and their areas add up."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.special import elliprg

from pellucid.errors import SampleCountError, SceneError
from pellucid.methods.preparation import number_of_samples
from pellucid.progress import reporting_to
from pellucid.scene.bodies import find_bodies
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scene.samples.areas import sample_areas
from pellucid.scene.samples.spreading import spread_relaxed
from pellucid.scene.samples.surface import (
    FEWEST_SAMPLES,
    METHODS,
    Surface,
    check_sample_count,
    default_sample_count,
    sample_surface,
)

STRETCH = np.diag([1.0, 2.0, 3.0, 1.0])
SHEAR = np.array([[1, 0.3, 0, 1], [0, 2, 0, 2], [0, 0.1, 3, 3], [0, 0, 0, 1.0]])


def mesh(shape, smooth=True):
    return mesh_from_arrays("mesh", shape.vertices, shape.faces, shape.vertex_normals if smooth else None)


def ellipsoid_area(a, b, c):
    return 4 * np.pi * elliprg((a * b) ** 2, (a * c) ** 2, (b * c) ** 2)


def total(samples):
    return samples.area.sum(dtype=np.float64)


def nearest(p):
    return cKDTree(p).query(p, k=2)[0][:, 1]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("kind", "matrix", "area"),
    [
        ("sphere", None, 4 * np.pi),
        ("sphere", STRETCH, ellipsoid_area(1, 2, 3)),
        ("cylinder", None, 2 * np.pi),
        ("disk", STRETCH, 2 * np.pi),
        ("rectangle", None, 4),
        ("cube", STRETCH, 88),
    ],
)
def test_areas_sum_to_the_surface(kind, matrix, area, method):
    samples = sample_surface([(mi.load_dict({"type": kind}), matrix)], 2000, method, seed=3)
    assert total(samples) == pytest.approx(area, rel=1e-6)
    assert np.all(samples.area > 0)
    assert len(samples) == 2000
    assert all(np.all(np.isfinite(value)) for value in vars(samples).values())


@pytest.mark.parametrize("method", METHODS)
def test_samples_lie_on_a_sheared_sphere_and_its_normals_are_right(method):
    samples = sample_surface([(mi.load_dict({"type": "sphere"}), SHEAR)], 3000, method)
    inverse = np.linalg.inv(SHEAR)
    local = samples.p.astype(float) @ inverse[:3, :3].T + inverse[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1, atol=2e-5)
    normal = local @ inverse[:3, :3]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(samples.n, normal, atol=1e-4)
    np.testing.assert_allclose(samples.sh_n, normal, atol=1e-4)
    np.testing.assert_allclose(np.sum(samples.n * samples.dp_du, axis=1), 0, atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_samples_of_an_instance_lie_on_its_faces(method):
    samples = sample_surface([(mi.load_dict({"type": "cube"}), SHEAR)], 3000, method)
    inverse = np.linalg.inv(SHEAR)
    local = samples.p.astype(float) @ inverse[:3, :3].T + inverse[:3, 3]
    np.testing.assert_allclose(np.abs(local).max(axis=1), 1, atol=1e-5)


def test_uneven_stretch_is_sampled_by_the_area_after_it():
    # On a sphere a fifth of the area lies beyond |z| = 0.8; flattened, these caps are a much larger part.
    flat = np.diag([3.0, 3.0, 1.0, 1.0])
    samples = sample_surface([(mi.load_dict({"type": "sphere"}), flat)], 20000, "uniform")
    z = np.linspace(-1, 1, 200001)
    ring = np.sqrt(9 * (1 - z**2) + 81 * z**2)  # dA/dz / 2 pi of the oblate spheroid (3, 3, 1)
    expected = ring[np.abs(z) > 0.8].sum() / ring.sum()
    assert np.mean(np.abs(samples.p[:, 2]) > 0.8) == pytest.approx(expected, abs=0.005)
    assert abs(expected - 0.2) > 0.05


def test_shapes_of_a_body_share_by_area_and_seed_decides():
    shapes = [(mi.load_dict({"type": "sphere"}), None), (mi.load_dict({"type": "cube"}), np.diag([2.0, 2, 2, 1]))]
    one, same, other = (sample_surface(shapes, 5000, "repulsion", seed) for seed in (1, 1, 2))
    share = np.bincount(one.shape_index, weights=one.area) / total(one)
    np.testing.assert_allclose(share, np.array([4 * np.pi, 96]) / (4 * np.pi + 96), rtol=0.01)
    assert all(np.array_equal(vars(one)[name], vars(same)[name]) for name in vars(one))
    assert not np.array_equal(one.p, other.p)


@pytest.mark.parametrize("body", ["sphere", "torus"])
def test_poisson_samples_are_apart_and_leave_no_hole(body):
    torus = mesh(trimesh.creation.torus(2, 0.7, major_sections=60, minor_sections=30))
    surface = Surface([(mi.load_dict({"type": "sphere"}) if body == "sphere" else torus, None)])
    samples = sample_surface(surface, 5000, "poisson")
    distance = np.sqrt(4 * 0.439 / np.pi * surface.area / 5000)
    assert nearest(samples.p).min() >= distance * (1 - 1e-5)
    dense = sample_surface(surface, 50000, "uniform", seed=9).p
    gap = cKDTree(samples.p).query(dense)[0]
    assert gap.max() < 1.6 * distance
    # A dart more would hardly ever have found a place.
    assert np.mean(gap > distance) < 0.02


def test_pushed_apart_is_the_most_even():
    torus = mesh(trimesh.creation.torus(2, 0.7, major_sections=60, minor_sections=30))
    surface = Surface([(torus, None)])
    found = {method: sample_surface(surface, 5000, method) for method in METHODS}
    spacing = np.sqrt(surface.area / 5000 * 2 / np.sqrt(3))
    mean = {method: nearest(s.p).mean() / spacing for method, s in found.items()}
    assert min(mean["relaxed"], mean["repulsion"]) > 0.81 > 0.79 > mean["poisson"] > mean["uniform"]
    assert max(found[m].area.std() for m in ("relaxed", "repulsion")) < 0.6 * found["poisson"].area.std()


def test_areas_are_as_exact_as_they_are_said_to_be():
    """The area of a sample, from two independent sets of points, and what a sum over ten of them is off by."""
    surface = Surface([(mi.load_dict({"type": "sphere"}), None)])
    sites = spread_relaxed(surface, 4000, 0)
    one, other = (sample_areas(surface, sites, seed) for seed in (1, 2))
    off = np.std(one - other) / np.sqrt(2) / one.mean()
    assert off < 0.03
    assert off / np.sqrt(10) < 0.01


def test_own_areas_take_the_noise_off_a_blur():
    surface = Surface([(mi.load_dict({"type": "sphere"}), None)])
    samples = sample_surface(surface, 10000, "poisson")
    places = sample_surface(surface, 300, "uniform", seed=7).p.astype(float)
    sigma = 3 * np.sqrt(surface.area / len(samples))
    kernel = np.exp(-0.5 * (np.linalg.norm(places[:, None] - samples.p[None], axis=2) / sigma) ** 2)
    truth = 2 * np.pi * sigma**2 * (1 - np.exp(-2 / sigma**2))
    own = np.std(kernel @ samples.area.astype(float) / truth)
    equal = np.std(kernel.sum(axis=1) * surface.area / len(samples) / truth)
    assert own < 0.15 * equal
    assert np.mean(kernel @ samples.area.astype(float)) == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_sides_of_a_thin_sheet_ignore_each_other(method):
    behind = np.diag([1.0, -1.0, -1.0, 1.0])
    behind[2, 3] = -0.002
    sheet = [(mi.load_dict({"type": "rectangle"}), None), (mi.load_dict({"type": "rectangle"}), behind)]
    samples = sample_surface(sheet, 2000, method)
    for side in (0, 1):
        here = samples.shape_index == side
        assert samples.area[here].sum(dtype=float) == pytest.approx(4, rel=2e-3)
        assert here.sum() == pytest.approx(len(samples) / 2, rel=0.05)
    spacing = np.sqrt(8 / 2000)
    assert nearest(samples.p).min() < 0.2 * spacing
    if method != "uniform":
        assert nearest(samples.p[samples.shape_index == 0]).min() > 0.4 * spacing


def test_repulsion_carries_samples_around_an_edge():
    # A needle: faces of one spacing width. Samples that could not pass an edge would stay in unequal rows.
    box = mesh(trimesh.creation.box((0.1, 0.1, 4)), smooth=False)
    samples = sample_surface([(box, None)], 160, "repulsion")
    start = sample_surface([(box, None)], 160, "uniform")
    assert nearest(samples.p).mean() > 1.15 * nearest(start.p).mean()


def test_triangles_without_area_get_no_samples():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [5, 5, 5]]
    shape = mesh_from_arrays("mesh", vertices, [[0, 3, 0], [0, 1, 2], [4, 4, 4], [0, 4, 3]])
    for method in METHODS:
        samples = sample_surface([(shape, None)], 500, method)
        assert total(samples) == pytest.approx(0.5, rel=1e-6)
        assert np.all(samples.p[:, 2] == 0)
        assert np.all(samples.p.sum(axis=1) <= 1 + 1e-6)


def lifted(corners, normals, weights):
    """The same lift in float64, from its definition."""
    p = np.einsum("nk,nkc->nc", weights, corners)
    depth = np.maximum(np.einsum("nkc,nkc->nk", corners - p[:, None], normals), 0)
    return p + np.einsum("nk,nk,nkc->nc", weights, depth, normals)


@pytest.mark.parametrize("matrix", [None, SHEAR])
def test_smooth_positions_match_the_definition(matrix):
    ball = trimesh.creation.icosphere(2)
    samples = sample_surface([(mesh(ball), matrix)], 2000, "uniform")
    to_world = np.eye(4) if matrix is None else matrix
    vertices = ball.vertices @ to_world[:3, :3].T + to_world[:3, 3]
    normals = ball.vertex_normals @ np.linalg.inv(to_world[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    moved = trimesh.Trimesh(vertices, ball.faces, process=False)
    _, _, face = trimesh.proximity.closest_point_naive(moved, samples.p[:200])
    corners = vertices[ball.faces[face]]
    weights = trimesh.triangles.points_to_barycentric(corners, samples.p[:200])
    expected = lifted(corners, normals[ball.faces[face]], weights)
    np.testing.assert_allclose(samples.p_smooth[:200], expected, atol=2e-5)
    if matrix is None:
        # Tangent planes lie outside of a ball, at mid-edge twice as high above the chord as the ball itself.
        below = 1 - np.linalg.norm(samples.p, axis=1)
        above = np.linalg.norm(samples.p_smooth, axis=1) - 1
        assert np.all(above > -1e-6)
        assert np.all(above < 1.1 * below + 1e-6)


@pytest.mark.parametrize("kind", ["cube", "cylinder", "bare"])
def test_flat_and_analytic_surfaces_are_not_lifted(kind):
    shape = mesh(trimesh.creation.icosphere(1), smooth=False) if kind == "bare" else mi.load_dict({"type": kind})
    samples = sample_surface([(shape, None)], 500, "uniform")
    np.testing.assert_allclose(samples.p_smooth, samples.p, atol=1e-6)


def test_default_count_is_one_in_a_disc_of_a_mean_free_path():
    assert default_sample_count(4 * np.pi, 0.02) == 10000
    assert default_sample_count(1e-9, 1.0) == 1


def test_small_bodies_get_a_few_thousand_samples():
    ball = {"type": "sphere", "radius": 1.0, "bsdf": {"type": "pellucid_translucent"}}
    body = find_bodies(mi.load_dict({"type": "scene", "ball": ball}))[0]
    needed = default_sample_count(4 * np.pi, float(np.min(body.medium.mfp)))
    assert needed < 200
    assert number_of_samples(body, body.surface(), 0, 10**6) == FEWEST_SAMPLES
    assert number_of_samples(body, body.surface(), 60, 10**6) == 60


def test_transform_objects_and_matrices_mean_the_same():
    cube = mi.load_dict({"type": "cube"})
    transform = mi.ScalarTransform4f(SHEAR.tolist())
    areas = [Surface([(cube, matrix)]).area for matrix in (SHEAR, transform, transform.matrix)]
    assert areas[1:] == pytest.approx(areas[:1] * 2, rel=1e-6)


def test_too_many_samples_are_refused_with_the_reason():
    check_sample_count(1000, 1000, name="bust", extent=1, mfp=1)
    with pytest.raises(SampleCountError) as caught:
        check_sample_count(3_100_000_000, 20_000_000, name="bust", extent=0.2, mfp=3.8e-6, scale=1000)
    message = str(caught.value)
    for part in ("'bust'", "3.1e+09", "2e+07", "200 mm across", "0.0038 mm", "1000 mm a scene unit", "at most 80 fits"):
        assert part in message
    assert "\n" not in message


def test_a_doubled_factor_of_1000_is_named_whatever_the_excess():
    """A marble of 10 mm in a scene in millimetres with scale 1000: also coefficients per cm would explain it, but not alone."""
    with pytest.raises(SampleCountError, match=r"unit \(1 where a factor of 1000 is too much; at most"):
        check_sample_count(900_000_000, 20_000_000, name="marble", extent=10, mfp=3.33e-4, scale=1000)


def test_bad_requests_are_refused():
    ball = [(mi.load_dict({"type": "sphere"}), None)]
    with pytest.raises(SceneError, match="did you mean 'poisson'"):
        sample_surface(ball, 100, "poison")
    with pytest.raises(SceneError, match="at least 1"):
        sample_surface(ball, 0)
    with pytest.raises(SceneError, match="no shapes"):
        Surface([])
    with pytest.raises(SceneError, match="1 of 1 faces with NaN"):
        Surface([(mesh_from_arrays("mesh", [[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]]), None)])
    with pytest.raises(SceneError, match="zero area"):
        Surface([(mesh_from_arrays("mesh", [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), None)])


@pytest.mark.parametrize("method", METHODS)
def test_few_samples_are_enough(method):
    samples = sample_surface([(mi.load_dict({"type": "cube"}), None)], 1, method)
    assert len(samples) == 1
    assert total(samples) == pytest.approx(24, rel=1e-6)


def test_shapes_keep_their_names():
    ball = mi.load_dict({"type": "sphere", "id": "moon"})
    sample_surface([(ball, None)], 200, "repulsion")
    turned = np.eye(4)
    sample_surface([(ball, turned)], 200, "repulsion")
    assert ball.id() == "moon"


def test_shape_groups_elsewhere_do_not_matter():
    """While one is alive, `Shape.ray_intersect` of Mitsuba 3.9.1 reads out of bounds for every analytic shape."""
    sphere = mi.load_dict({"type": "sphere"})
    alone = sample_surface([(sphere, None)], 100, "uniform")
    group = {"type": "shapegroup", "cube": {"type": "cube"}}
    other = mi.load_dict(
        {"type": "scene", "g": group, "i": {"type": "instance", "g": {"type": "ref", "id": "g"}}}, optimize=False
    )
    beside = sample_surface([(sphere, None)], 100, "uniform")
    assert len(other.shapes()) == 1
    assert np.array_equal(alone.p, beside.p) and np.array_equal(alone.sh_n, beside.sh_n)


def test_what_takes_long_says_where_it_is():
    """Many samples are reported round by round, few not at all."""
    told = []

    class Told:
        def start(self, stage, total, unit):
            told.append([stage, total])

        def advance(self, done):
            told[-1].append(done)

        def finish(self):
            assert sum(told[-1][2:]) == told[-1][1]

    sphere = [(mi.load_dict({"type": "sphere"}), None)]
    with reporting_to(Told()):
        sample_surface(sphere, 2000, "relaxed")
        assert not told
        sample_surface(sphere, 160_000, "relaxed")
    assert [stage for stage, *_ in told] == ["darts", "repulsion", "areas"]
    assert all(len(done) >= 2 and max(done) <= total / 2 for _, total, *done in told)
