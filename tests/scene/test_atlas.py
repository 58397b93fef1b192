"""The atlas: a bijection onto part of the unit square, whatever a body is made of."""

import numpy as np
import pytest

import pellucid  # noqa: F401 isort: skip

import mitsuba as mi

from pellucid.errors import SceneError
from pellucid.scene.atlas import layout as atlas_module
from pellucid.scene.atlas import unwrapping
from pellucid.scene.atlas.clipping import cut_triangles
from pellucid.scene.atlas.layout import build_atlas, fragment_areas, largest_in_texel
from pellucid.scene.atlas.unwrapping import UnwrapError, by_triangles, by_uvunwrap, by_xatlas, charts_of, components
from pellucid.scene.bodies import Body, Part
from pellucid.scene.meshes.buffers import mesh_from_arrays

trimesh = pytest.importorskip("trimesh")


def body(*parts) -> Body:
    """A body of shapes, or of pairs of a shape and a matrix."""
    pairs = [part if isinstance(part, tuple) else (part, None) for part in parts]
    return Body("body", None, [Part(shape, None, matrix) for shape, matrix in pairs])


def mesh(vertices, faces, **more):
    return mesh_from_arrays("mesh", vertices, faces, **more)


def blob(subdivisions=3):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    v = ball.vertices
    return v * (1 + 0.2 * np.sin(5 * v[:, :1]) * np.cos(4 * v[:, 1:2])), ball.faces


def grid(size=8, shape=lambda u, v: (u, v)):
    """A flat square of 2 size^2 triangles in space, with texture coordinates shape(u, v)."""
    u, v = (x.ravel() for x in np.meshgrid(*[np.linspace(0, 1, size + 1)] * 2))
    corner = (np.arange(size)[:, None] * (size + 1) + np.arange(size)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + size + 2], -1),
            np.stack([corner, corner + size + 2, corner + size + 1], -1),
        ]
    )
    return mesh(np.stack([u, v, 0 * u], -1), faces, uv=np.stack(shape(u, v), -1))


def misplaced(atlas) -> float:
    """The part of the surface in texels that belong to more than one chart."""
    fragments = atlas.fragments
    low, high = np.full(atlas.resolution**2, 1 << 40), np.full(atlas.resolution**2, -1)
    chart = atlas.chart[fragments.triangle]
    np.minimum.at(low, fragments.texel, chart)
    np.maximum.at(high, fragments.texel, chart)
    return fragment_areas(atlas.area_surface, fragments)[low[fragments.texel] != high[fragments.texel]].sum()


def check(atlas, most_shared=0.0):
    """What every atlas promises: all area, inside the square, nothing twice, no texel of two charts."""
    assert np.isfinite(atlas.uv).all() and atlas.uv.min() >= -1e-6 and atlas.uv.max() <= 1 + 1e-6
    assert atlas.area_surface.sum() == pytest.approx(atlas.surface.area, rel=1e-6)
    assert fragment_areas(atlas.area_surface, atlas.fragments).sum() == pytest.approx(atlas.surface.area, rel=1e-6)
    covered = np.bincount(atlas.fragments.texel, atlas.fragments.area)
    assert np.maximum(covered - 1, 0).sum() < 1e-3 * covered.sum()
    assert atlas.fragments.texel.max() < atlas.resolution**2
    assert misplaced(atlas) <= most_shared * atlas.surface.area


# --- cutting ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1.0, 0.1, 0.01, 1e-4])
def test_pieces_of_triangles_add_up(size):
    rng = np.random.default_rng(0)
    corners = np.clip(rng.random((500, 1, 2)) + size * (rng.random((500, 3, 2)) - 0.5), 0, 1)
    pieces = cut_triangles(corners, 40)
    a, b = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * 40**2
    np.testing.assert_allclose(np.bincount(pieces.triangle, pieces.area), area, rtol=1e-7, atol=1e-12)
    for k in (0, 1):
        moment = np.bincount(pieces.triangle, pieces.area * pieces.centre[:, k])
        np.testing.assert_allclose(moment, area * corners[:, :, k].mean(axis=1) * 40, rtol=1e-6, atol=1e-11)
    assert np.all(np.diff(pieces.triangle) >= 0)
    assert len(np.unique(pieces.triangle * 1600 + pieces.texel)) == len(pieces.texel)
    assert pieces.area.max() <= 1 + 1e-9
    assert np.all(np.floor(np.nextafter(pieces.centre, 20)).astype(int) @ [1, 40] == pieces.texel)


def test_pieces_are_where_a_fine_grid_says():
    corners = np.array([[[0.11, 0.07], [0.93, 0.31], [0.42, 0.88]]])
    pieces = cut_triangles(corners, 8)
    g = (np.arange(8 * 100) + 0.5) / 800
    p = np.stack(np.meshgrid(g, g), -1)
    side = [
        np.cross(np.append(b - a, 0), np.append(p - a, 0 * p[..., :1], -1))[..., 2]
        for a, b in zip(corners[0], np.roll(corners[0], -1, 0), strict=True)
    ]
    inside = np.min(side, axis=0) > 0
    covered = np.bincount(pieces.texel, pieces.area, minlength=64)
    np.testing.assert_allclose(covered, inside.reshape(8, 100, 8, 100).mean(axis=(1, 3)).ravel(), atol=2e-3)


def test_triangles_on_the_lines_of_the_grid():
    corners = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]], [[0.25, 0.5], [0.5, 0.5], [0.5, 0.75]]])
    pieces = cut_triangles(corners, 4)
    np.testing.assert_allclose(np.bincount(pieces.triangle, pieces.area), [8, 8, 0.5])
    np.testing.assert_allclose(np.bincount(pieces.texel[:-1], pieces.area[:-1], minlength=16), 1)
    assert pieces.texel[-1] == 9


def test_flat_triangles_are_points():
    corners = np.array([[[0.1, 0.1]] * 3, [[0, 0.5], [1, 0.5], [0.3, 0.5]], [[1, 1]] * 3, [[0, 0], [0.5, 0], [0, 0.5]]])
    pieces = cut_triangles(corners, 4)
    np.testing.assert_array_equal(pieces.triangle[:3], [0, 1, 2])
    np.testing.assert_array_equal(pieces.texel[:3], [0, 9, 15])
    np.testing.assert_array_equal(pieces.area[:3], 0)
    assert pieces.area[3:].sum() == pytest.approx(2)


def test_the_largest_piece_of_a_texel_is_the_first_of_equals():
    np.testing.assert_array_equal(largest_in_texel(np.array([0, 2, 2, 2]), np.array([1.0, 2, 3, 3])), [0, 0, 2])


# --- layouts ---------------------------------------------------------------------------------------------------------


def test_a_mesh_keeps_its_area_nearly():
    atlas = build_atlas(body(mesh(*blob())), 256)
    check(atlas)
    assert atlas.notes == ["laid out by uvunwrap"]
    ratio = atlas.area_surface / atlas.area_texture
    low, high = np.quantile(ratio / np.average(ratio, weights=atlas.area_texture), (0.01, 0.99))
    assert low > 0.7 and high < 1.5
    assert atlas.area_texture.sum() > 0.45


def test_the_same_body_gives_the_same_atlas():
    one, two = (build_atlas(body(mesh(*blob())), 128) for _ in range(2))
    np.testing.assert_array_equal(one.uv, two.uv)


@pytest.mark.parametrize("resolution", [32, 100, 512])
def test_charts_never_share_a_texel(resolution):
    check(build_atlas(body(mesh(*blob())), resolution))


def test_both_libraries_lay_out_the_same_triangles():
    corners = np.asarray(blob()[0])[blob()[1]]
    for method in (by_uvunwrap, by_xatlas):
        uv, chart = method(corners, 200)
        assert uv.shape == (len(corners), 3, 2) and uv.min() >= 0 and uv.max() <= 1
        pieces = cut_triangles(uv, 200)
        assert np.bincount(pieces.texel, pieces.area).max() < 1 + 1e-6
        np.testing.assert_array_equal(
            components(np.unique(chart)[:, None].repeat(3, 1)), np.arange(len(np.unique(chart)))
        )
        np.testing.assert_array_equal(
            charts_of(corners, uv)[:, None] == charts_of(corners, uv), chart[:, None] == chart
        )


def test_charts_are_as_small_as_is_asked():
    """A chart of at most a fiftieth of the surface: there are fifty at least, and they are a bijection as before."""
    large, small = (build_atlas(body(mesh(*blob())), 256, largest_chart=share) for share in (0, 0.02))
    check(small)
    assert large.chart.max() + 1 < 50
    shares = np.bincount(small.chart, small.area_surface) / small.area_surface.sum()
    assert (
        shares.max() < 0.03
        and shares.max() < 0.5 * np.bincount(large.chart, large.area_surface).max() / large.area_surface.sum()
    )


def test_xatlas_steps_in(monkeypatch):
    def fail(corners, resolution, largest_chart):
        raise UnwrapError("no luck today")

    monkeypatch.setattr(atlas_module, "by_uvunwrap", fail)
    atlas = build_atlas(body(mesh(*blob())), 128)
    check(atlas)
    assert atlas.notes == ["uvunwrap: no luck today", "laid out by xatlas"]


def test_a_broken_layout_is_not_taken(monkeypatch):
    def collapse(corners, resolution, largest_chart):
        return np.full((len(corners), 3, 2), 0.5), np.zeros(len(corners), int)

    def pile(corners, resolution):
        return np.tile([[0, 0], [0.9, 0], [0, 0.9]], (len(corners), 1, 1)), np.zeros(len(corners), int)

    monkeypatch.setattr(atlas_module, "by_uvunwrap", collapse)
    monkeypatch.setattr(atlas_module, "by_xatlas", pile)
    atlas = build_atlas(body(mesh(*blob())), 128)
    assert "no area" in atlas.notes[0] and "overlap" in atlas.notes[1]
    assert atlas.notes[2] == "laid out by triangles, which share texels"
    check(atlas, most_shared=1)


def test_xatlas_is_not_asked_for_what_takes_minutes(monkeypatch):
    monkeypatch.setattr(unwrapping, "XATLAS_LIMIT", 10)
    with pytest.raises(UnwrapError, match="would take it minutes"):
        by_xatlas(np.asarray(blob()[0])[blob()[1]], 64)


# --- own coordinates -------------------------------------------------------------------------------------------------


def test_good_texture_coordinates_are_kept():
    atlas = build_atlas(body(grid()), 64)
    check(atlas)
    assert atlas.notes == ["laid out by its own coordinates"]
    np.testing.assert_allclose(atlas.area_texture, atlas.area_surface, rtol=1e-5)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        (lambda u, v: (2 * u, v), "leave the unit square"),
        (lambda u, v: (u, v + np.nan), "leave the unit square"),
        (lambda u, v: (2 * np.abs(u - 0.5), v), "50.0% of them overlap"),
        (lambda u, v: (0 * u, 0 * v), "100.0% of the surface has no area"),
        (lambda u, v: (0.25 * u, 0.25 * v), "16 times"),
    ],
)
def test_other_texture_coordinates_are_replaced(shape, reason):
    atlas = build_atlas(body(grid(shape=shape)), 64)
    check(atlas)
    assert reason in atlas.notes[0]
    assert atlas.notes[1] == "laid out by uvunwrap"


def test_a_strong_distortion_is_kept_where_it_is_asked_for():
    shape = grid(shape=lambda u, v: (u**4, v**4))
    assert "times area" in build_atlas(body(shape), 64).notes[0]
    atlas = build_atlas(body(shape), 64, stretch=np.inf)
    check(atlas)
    assert atlas.notes == ["laid out by its own coordinates"]
    assert np.ptp(np.log10(atlas.area_surface / atlas.area_texture)) > 3


def test_own_coordinates_can_be_refused():
    assert build_atlas(body(grid()), 64, stretch=0).notes[-1] == "laid out by uvunwrap"


def test_charts_that_touch_in_the_square_but_not_in_space_are_replaced():
    """Two sheets far apart, side by side without a gap, on a border that is not one of texels."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    uv = np.array([[0, 0], [0.51, 0], [0.51, 1], [0, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.concatenate([uv, [[0.51, 0], [1, 0], [1, 1], [0.51, 1]]])
    shape = mesh(np.concatenate([vertices, vertices + np.array([5, 0, 0])]), np.concatenate([faces, faces + 4]), uv=uv)
    assert "in texels of other charts" in build_atlas(body(shape), 64).notes[0]
    # At twice the resolution, fewer do; where the border is one of texels, none.
    assert build_atlas(body(shape), 100).notes == ["laid out by its own coordinates"]


def test_the_cube_of_mitsuba_overlaps_itself():
    atlas = build_atlas(body(mi.load_dict({"type": "cube"})), 64)
    check(atlas)
    assert atlas.notes == ["its own coordinates: 83.3% of them overlap", "laid out by uvunwrap"]


# --- shapes that are no meshes, and several of them -----------------------------------------------------------------


@pytest.mark.parametrize("kind", ["sphere", "disk", "rectangle", "cylinder"])
def test_an_analytic_shape_fills_the_square(kind):
    atlas = build_atlas(body(mi.load_dict({"type": kind})), 64)
    check(atlas)
    assert atlas.notes == ["laid out by its own coordinates"]
    assert atlas.area_texture.sum() == pytest.approx(1)


def test_shapes_of_all_kinds_are_laid_out_together():
    move = np.eye(4)
    move[0, 3] = 9
    shapes = [mi.load_dict({"type": kind}) for kind in ("sphere", "cylinder", "cube", "disk")]
    atlas = build_atlas(body(*shapes, (mesh(*blob()), move)), 256)
    check(atlas)
    assert len(np.unique(atlas.chart[atlas.piece == 2])) == 6
    ratio = atlas.area_surface / atlas.area_texture
    assert ratio[atlas.piece < 4].max() < 1.05 * ratio[atlas.piece < 4].min()


def test_an_instance_is_as_large_as_it_is_in_the_scene():
    atlas = build_atlas(
        body((mi.load_dict({"type": "sphere"}), np.diag([3.0, 3, 3, 1])), mi.load_dict({"type": "sphere"})), 256
    )
    check(atlas)
    areas = np.bincount(atlas.piece, atlas.area_texture)
    assert areas[0] == pytest.approx(9 * areas[1], rel=1e-3)


# --- bad meshes ------------------------------------------------------------------------------------------------------


def soup(count, seed=1):
    rng = np.random.default_rng(seed)
    return rng.random((count, 1, 3)) + 0.05 * rng.normal(size=(count, 3, 3))


def triangles(subdivisions=2):
    vertices, faces = blob(subdivisions)
    return np.asarray(vertices)[faces]


def needles():
    """Triangles, lines, points, and triangles that are nearly lines."""
    good = soup(50)
    line, point = good[:, [0, 1, 1]], good[:, [0, 0, 0]]
    return np.concatenate([good, line, point, line + np.array([[[0.0] * 3, [0.0] * 3, [1e-5] * 3]])])


BAD = {
    "soup that belongs together": triangles,
    "soup": lambda: soup(300),
    "open": lambda: triangles()[:200],
    "two of everything": lambda: np.repeat(triangles(), 2, axis=0),
    "turned": lambda: np.where(np.arange(320)[:, None, None] % 3 == 0, triangles()[:, ::-1], triangles()),
    "needles": needles,
    "scales": lambda: np.concatenate([soup(200) * 1e-3, soup(3) * 100]),
    "one": lambda: soup(1),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_meshes_are_laid_out(name):
    corners = BAD[name]()
    atlas = build_atlas(body(mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))), 256)
    check(atlas, most_shared=1e-3)
    assert atlas.notes[-1].endswith(("uvunwrap", "xatlas"))


def test_more_pieces_than_texels_share_them():
    corners = soup(5000)
    atlas = build_atlas(body(mesh(corners.reshape(-1, 3), np.arange(15000).reshape(-1, 3))), 64)
    check(atlas)
    assert "separate pieces are too many for 64 x 64 texels" in atlas.notes[0]
    assert atlas.notes[-1] == "laid out by triangles, which share texels"


@pytest.mark.parametrize("count", [1, 2, 3, 1000])
def test_squares_of_triangles_fill_the_square_without_overlap(count):
    corners = soup(count) * np.random.default_rng(2).lognormal(size=(count, 1, 1))
    uv, _ = by_triangles(corners)
    assert uv.min() >= 0 and uv.max() <= 1
    pieces = cut_triangles(uv, 256)
    assert np.bincount(pieces.texel, pieces.area).max() < 1 + 1e-9
    assert pieces.area.sum() > 0.2 * 256**2
    # Triangles near in the square are near in space.
    if count == 1000:
        near = np.argsort(np.linalg.norm(uv[:, 0] - uv[0, 0], axis=1))[1:9]
        assert np.linalg.norm(corners[near].mean(1) - corners[0].mean(0), axis=1).mean() < 10


@pytest.mark.parametrize("resolution", [1, 2, 5])
def test_few_texels_are_enough(resolution):
    for shape in (mi.load_dict({"type": "cube"}), mesh(*blob()), mi.load_dict({"type": "sphere"})):
        check(build_atlas(body(shape), resolution), most_shared=1)


def test_what_cannot_be_laid_out_is_refused():
    with pytest.raises(SceneError, match="at least 1; found 0"):
        build_atlas(body(mi.load_dict({"type": "sphere"})), 0)
    with pytest.raises(SceneError, match="no surface"):
        build_atlas(body(mesh(np.zeros((3, 3)), [[0, 1, 2]])), 64)
    with pytest.raises(SceneError, match="NaN or infinite"):
        build_atlas(body(mesh(np.full((3, 3), np.nan), [[0, 1, 2]])), 64)
    with pytest.raises(SceneError, match="no shapes"):
        build_atlas(body(), 64)
