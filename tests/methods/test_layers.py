"""What is kept of every pixel beside its radiance, and what the denoiser makes of it."""

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from worlds.balls import T, looking_at, scene, translucent

FLOOR = {
    "type": "rectangle",
    "to_world": T.translate([0, 0, -5]).scale(200),
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.1]}},
}
TWO_PASS = {"type": "pellucid_two_pass", "sample_count": 600, "irradiance_paths": 16}


def ball_on_floor(rfilter="gaussian", **film):
    """A translucent ball on a coloured floor, seen from above at an angle, under a small lamp."""
    sensor = looking_at([0, 0, 0], [0, -30, 30], fov=25)
    sensor["film"] = {"type": "hdrfilm", "width": 64, "height": 48, "rfilter": {"type": rfilter}, **film}
    ball = {"type": "sphere", "radius": 5.0, "bsdf": translucent(material="marble")}
    lamp = {
        "type": "rectangle",
        "to_world": T.look_at([40, -40, 60], [0, 0, 0], [0, 0, 1]).scale(6),
        "emitter": {"type": "area", "radiance": 90.0},
    }
    return scene(ball, FLOOR, lamp=lamp, sensor=sensor)


@pytest.fixture(scope="module")
def lit():
    world = ball_on_floor()
    return world, mi.load_dict(TWO_PASS)


def test_layers_say_what_every_pixel_shows(lit):
    world, integrator = lit
    layers = pellucid.render_layers(world, seed=1, spp=4, integrator=integrator)
    corner, middle = (slice(2, 6), slice(2, 6)), (slice(22, 26), slice(30, 34))
    assert layers.albedo[corner] == pytest.approx(np.broadcast_to([0.6, 0.3, 0.1], (4, 4, 3)), abs=1e-6)
    assert layers.normal[corner] == pytest.approx(np.broadcast_to([0, 0, 1.0], (4, 4, 3)), abs=1e-6)
    ray, _ = world.sensors()[0].sample_ray(0, 0.5, mi.Point2f(0.5, 0.5), mi.Point2f(0.5))
    assert layers.depth[24, 32, 0] == pytest.approx(float(world.ray_intersect(ray).t[0]), rel=0.01)
    reflectance = mi.load_dict({"type": "pellucid_translucent"}).medium.total_diffuse_reflectance
    assert layers.albedo[middle] == pytest.approx(np.broadcast_to(reflectance, (4, 4, 3)), abs=1e-5)
    assert not layers.exitance[corner].any() and layers.exitance[middle].min() > 0


def test_the_colour_is_that_of_a_box_filter(lit):
    """A wider filter changes the picture, and not the layers."""
    box = ball_on_floor("box")
    one, other = (
        pellucid.render_layers(world, seed=1, spp=4, integrator=mi.load_dict(TWO_PASS)) for world in (lit[0], box)
    )
    np.testing.assert_array_equal(one.colour, other.colour)
    np.testing.assert_allclose(other.colour, np.array(box.sensors()[0].film().develop()), rtol=1e-5)


def test_the_border_of_a_film_is_left_out():
    whole = pellucid.render_layers(ball_on_floor(sample_border=True), spp=2, integrator=mi.load_dict(TWO_PASS))
    assert whole.colour.shape == (48, 64, 3) and whole.depth.shape == (48, 64, 1)
    cropped = {"crop_offset_x": 10, "crop_offset_y": 4, "crop_width": 20, "crop_height": 12}
    part = pellucid.render_layers(ball_on_floor(**cropped), spp=2, integrator=mi.load_dict(TWO_PASS))
    difference = np.abs(part.depth - whole.depth[4:16, 10:30])
    assert np.quantile(difference, 0.9) < 0.5  # but for the outline, where each pixel sees both


def test_the_denoiser_comes_closer_to_the_truth(lit):
    world, integrator = lit
    integrator.prepared = integrator.prepare_scene(world)
    truth = pellucid.render_layers(world, seed=9, spp=512, integrator=integrator).colour
    layers = pellucid.render_layers(world, seed=1, spp=4, integrator=integrator)
    raw, denoised = (np.sqrt(np.mean((picture - truth) ** 2)) for picture in (layers.colour, layers.denoised))
    assert denoised < 0.4 * raw
    assert layers.denoised.mean() == pytest.approx(truth.mean(), rel=0.02)


def test_only_our_integrators_have_layers(lit):
    with pytest.raises(pellucid.PellucidError, match="found PathIntegrator"):
        pellucid.render_layers(lit[0], integrator=mi.load_dict({"type": "path"}))
