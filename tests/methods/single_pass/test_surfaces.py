"""Opaque surfaces lit by the light samples: the light that paths find, whatever lies between; tiles, and points by themselves."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods.preparation import open_scene
from pellucid.methods.single_pass.surfaces import make_cells
from pellucid.methods.tiles import make_tile, sums_of
from worlds.balls import T, diffuse, looking_at, scene, translucent

FEW = {"sample_count": 300, "sampling": "uniform", "direct": 256, "indirect": 2000, "max_depth": 4}
COATED = {"type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": [0.6, 0.5, 0.4]}, "alpha": 0.3}
SEEDS = 3


def wall(to_world, bsdf):
    return {"type": "rectangle", "to_world": to_world.scale(30), "bsdf": {"type": "twosided", "bsdf": bsdf}}


def corner(bsdf, *more, lamp_size=5):
    """A ball of marble over a floor in front of a wall, under a lamp and a dim sky."""
    ball = {"type": "sphere", "radius": 6.0, "bsdf": translucent(material="marble", alpha=0.3)}
    floor = wall(T.translate([0, -12, 0]).rotate([1, 0, 0], -90), bsdf)
    back = wall(T.translate([0, 0, -20]), diffuse(0.7, 0.3, 0.2))
    lamp_at = T.translate([12, 24, 6]).rotate([1, 0, 0], 90).scale(lamp_size)
    lamp = {"type": "rectangle", "to_world": lamp_at, "emitter": {"type": "area", "radiance": 500.0 / lamp_size**2}}
    sensor = looking_at([0, -2, 0], [0, 10, 90], fov=26, size=20)
    return scene(ball, floor, back, lamp, *more, sensor=sensor, light={"type": "constant", "radiance": 0.05})


def picture(lit, spp=16, seed=0, **settings):
    integrator = mi.load_dict({"type": "pellucid_single_pass", **FEW, "seed": seed, **settings})
    return np.array(mi.render(lit, integrator=integrator, spp=spp, seed=seed), float)[..., :3]


PANE = {"type": "rectangle", "to_world": T.translate([12, 18, 6]).rotate([1, 0, 0], 90).scale(25)}


@pytest.mark.parametrize("more", [[], [PANE | {"bsdf": {"type": "thindielectric"}}]], ids=["open", "behind glass"])
def test_opaque_surfaces_have_the_light_that_paths_find(more):
    """On a coated floor and a diffuse wall; what comes through glass is left to paths, and as noisy as theirs."""
    lit = corner(COATED, *more, lamp_size=15 if more else 5)
    paths = picture(lit, spp=512, light_opaque=False)
    found = np.array([picture(lit, spp=32, seed=seed) for seed in range(SEEDS)])
    error = found.mean(axis=(1, 2, 3)) / paths.mean() - 1
    assert error.mean() == pytest.approx(0, abs=(0.02 if more else 0.005) + 3 * error.std(ddof=1) / np.sqrt(SEEDS))
    blocks = (found.mean(axis=0) - paths).reshape(5, 4, 5, 4, 3).mean(axis=(1, 3))
    assert np.abs(blocks).max() < (0.4 if more else 0.12) * paths.mean()


def test_a_lamp_close_to_a_body_lights_opaque_surfaces_near_and_far():
    """The body gets its light by rays; a card beside the lamp, nearer than these reach, and a floor far below it do not."""
    ball = {"type": "sphere", "radius": 6.0, "bsdf": translucent(material="marble")}
    card = {"type": "rectangle", "to_world": T.translate([3, 6.3, 1]).rotate([0, 1, 0], -90).scale(4)}
    card["bsdf"] = {"type": "twosided", "bsdf": diffuse(0.5, 0.5, 0.5)}
    floor = wall(T.translate([0, -12, 0]).rotate([1, 0, 0], -90), diffuse(0.5, 0.6, 0.7))
    lamp = {"type": "point", "position": [0.0, 6.3, 1.0], "intensity": 100.0}
    lit = scene(ball, card, floor, sensor=looking_at([3, 4, 1], [-40, 20, 1], fov=20, size=16), light=lamp)
    settings = {"irradiance_depth": 2, "max_depth": 2}
    paths, found = (picture(lit, spp=64, light_opaque=way, **settings) for way in (False, True))
    assert np.abs(found - paths).max() > 1e-6  # by another way
    np.testing.assert_allclose(found.mean(axis=(0, 1)), paths.mean(axis=(0, 1)), rtol=0.02)
    np.testing.assert_allclose(np.median(found, axis=(0, 1)), np.median(paths, axis=(0, 1)), rtol=0.03)


def test_what_a_highlight_shows_falls_on_the_coated_surface_once():
    """Where a path goes on by the highlight, the light of the diffuse base is in the light samples already: else 2 to 3 % too much."""
    white = {"type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": [0.9, 0.9, 0.9]}, "alpha": 0.5}
    ball = {"type": "sphere", "radius": 3.0, "bsdf": translucent(material="marble", alpha=0.3)}
    floor = wall(T.translate([0, -12, 0]).rotate([1, 0, 0], -90), white)
    back = wall(T.translate([0, 0, -20]), white)
    lamp_at = T.translate([0, 8, 10]).rotate([1, 0, 0], 150).scale(5)
    lamp = {"type": "rectangle", "to_world": lamp_at, "emitter": {"type": "area", "radiance": 20.0}}
    sensor = looking_at([0, -6, -5], [0, 10, 60], fov=22, size=20)
    lit = scene(ball, floor, back, lamp, sensor=sensor, light={"type": "constant", "radiance": 0.02})
    on_floor = slice(12, 20)
    paths = picture(lit, spp=512, light_opaque=False)[on_floor].mean()
    found = np.array([picture(lit, spp=32, seed=seed)[on_floor].mean() for seed in range(SEEDS)])
    assert found.mean() / paths == pytest.approx(1, abs=0.012)


def test_there_is_less_noise_than_with_paths():
    lit = corner(diffuse(0.5, 0.6, 0.7))
    noise = []
    for lights in (True, False):
        one, other = (picture(lit, 4, seed, light_opaque=lights)[14:] for seed in (0, 1))  # the floor before the ball
        noise.append(np.std(one - other))
    assert noise[0] < 0.5 * noise[1]


def test_more_samples_a_pixel_have_less_of_that_noise():
    lit = corner(diffuse(0.6, 0.5, 0.4))
    few, many = (
        np.subtract(*(np.array(mi.render(lit, integrator=the_same, spp=spp, seed=seed)) for seed in (1, 2)))[
            15:, :6
        ].std()
        for the_same in [mi.load_dict({"type": "pellucid_single_pass", **FEW})]
        for spp in (16, 144)
    )
    assert many < 0.5 * few


def test_a_plane_under_an_even_sky_reflects_its_albedo():
    ball = {"type": "sphere", "radius": 0.5, "bsdf": translucent(material="marble")}
    sensor = looking_at([0, -12, 0], [0, 10, 90], size=8)
    lit = scene(ball, wall(T.translate([0, -12, 0]).rotate([1, 0, 0], -90), diffuse(0.2, 0.5, 0.8)), sensor=sensor)
    assert picture(lit)[5].mean(axis=0) == pytest.approx([0.2, 0.5, 0.8], rel=0.03)


def test_tiles_are_those_of_the_picture():
    """With more samples a pixel than share a light."""
    lit, sensor = (view := corner(COATED)), view.sensors()[0]
    integrator = mi.load_dict({"type": "pellucid_single_pass", **FEW})
    integrator.prepared = integrator.prepare_scene(lit, sensor)
    integrator.render(lit, sensor, seed=1, spp=18, develop=False)
    once = sums_of(sensor.film())
    assert once.std() > 0
    for number in range(1, 5):
        tile = make_tile(sensor.film(), number, 4)
        integrator.render_tile(lit, sensor, tile, seed=1, spp=18)
        (x, y), (width, height) = tile.crop_offset(), tile.crop_size()
        np.testing.assert_array_equal(sums_of(tile), once[y : y + height, x : x + width])


def test_the_light_at_a_point_depends_on_no_other():
    lit = corner(diffuse(0.5, 0.6, 0.7))
    integrator = mi.load_dict({"type": "pellucid_single_pass", **FEW})
    state = integrator.prepare_scene(lit)
    every = state.view_points.take(state._opaque(state.view_points))
    dr.eval(every)
    at_once = state.exitance(lit, every).numpy().T
    some = np.random.default_rng(0).permutation(len(at_once))[:37].astype(np.uint32)
    np.testing.assert_array_equal(state.exitance(lit, every.take(mi.UInt32(some))).numpy().T, at_once[some])
    behind = replace(every, n=-every.n)  # nothing is known of those: every light is asked
    assert np.isfinite(state.exitance(lit, behind).numpy()).all()


def test_cells_hold_neighbours_that_face_alike():
    rng = np.random.default_rng(0)
    p = rng.random((4000, 3)).astype(np.float32)
    n = np.eye(3, dtype=np.float32)[rng.integers(0, 3, len(p))]
    lit = corner(diffuse(0.5, 0.5, 0.5))
    cells, order, cell = make_cells(lit, p, n)
    sizes = np.bincount(cell)[1:]
    assert sizes.max() <= 256 and len(sizes) == len(cells) - 1 and sizes.sum() == len(p)
    assert all(len(np.unique(n[order[cell == k]], axis=0)) == 1 for k in range(1, len(cells)))
    found = cells.find(mi.Point3f(p[order].T), mi.Normal3f(n[order].T))
    np.testing.assert_array_equal(found, cell)
    assert (cells.find(mi.Point3f(p.T + 50), mi.Normal3f(n.T)) == 0).all()


def test_emitters_that_no_points_stand_for_leave_surfaces_to_paths():
    lit = corner(COATED)
    method = mi.load_dict({"type": "pellucid_single_pass", **FEW}).method
    assert method.prepare(lit, open_scene(lit)).lights_opaque
    looking = T.look_at([0, 0, 50], [0, 0, 0], [0, 1, 0])
    lit = corner(COATED, {"type": "projector", "irradiance": 1.0, "to_world": looking})
    assert not method.prepare(lit, open_scene(lit)).lights_opaque
