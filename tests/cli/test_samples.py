import mitsuba as mi
import numpy as np
import pytest

from pellucid.cli import sample_picture as draw
from pellucid.errors import SceneError
from pellucid.jobs.job import Request

RADIUS, CAMERA = 3.0, np.array([0, -20.0, 6.0])


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    from worlds.terminal import write_scene

    path = write_scene(tmp_path_factory.mktemp("ball") / "ball.xml")
    job = Request.from_options({"source": str(path), "sample_count": 20_000, "resolution": (120, 80)}).load()
    return job, job.integrator("two_pass").prepare_scene(job.scene)


def test_the_visible_part_of_a_sphere_is_its_cap(ball):
    job, prepared = ball
    points = prepared.bodies[0].samples.p
    _, seen = draw.project(job.scene, job.sensor, points)
    # A sphere of radius r shows the share (1 - r / d) / 2 of itself from distance d: all points before the horizon.
    distance = np.linalg.norm(CAMERA)
    assert np.mean(seen) == pytest.approx((1 - RADIUS / distance) / 2, rel=0.03)
    before_horizon = points @ CAMERA / (RADIUS * distance) - RADIUS / distance
    clear = np.abs(before_horizon) > 0.02
    np.testing.assert_array_equal(seen[clear], before_horizon[clear] > 0)


def test_points_are_projected_to_the_pixels_that_see_them(ball):
    job, _ = ball
    film = np.array([[10.5, 20.25], [60.0, 40.0], [77.5, 33.0]], np.float32)
    uv = mi.Point2f(film[:, 0] / 120, film[:, 1] / 80)
    ray, _ = job.sensor.sample_ray(0.0, 0.5, uv, mi.Point2f(0.5))
    points = np.array(ray(25.0)).reshape(3, -1).T
    found, _ = draw.project(job.scene, job.sensor, points)
    np.testing.assert_allclose(found, film, atol=1e-3)


def test_an_orthographic_camera_is_refused(ball):
    job, _ = ball
    sensor = mi.load_dict({"type": "orthographic", "film": {"type": "hdrfilm", "width": 8, "height": 8}})
    with pytest.raises(SceneError, match="perspective"):
        draw.project(job.scene, sensor, np.zeros((4, 3), np.float32))


def test_dots_and_light_are_drawn_side_by_side(run, scene_file, ball):
    result = run("samples", scene_file, "-o", "s.exr", "--samples", "60", "--resolution", "120x80")
    assert "ball: 60 samples on 113.1 square scene units" in result.output
    picture = np.array(mi.Bitmap("s.exr"))[..., :3]
    assert picture.shape == (80, 240, 3)
    dots, light = picture[:, :120], picture[:, 120:]
    red = dots[..., 0] > 3 * dots[..., 1] + 0.05
    on_ball = light[..., 0] > 0.5  # an even sky lights every sample alike
    share = on_ball.mean()
    half_angle = np.arcsin(RADIUS / np.linalg.norm(CAMERA))
    disc = np.pi * np.tan(half_angle) ** 2 / ((2 * np.tan(np.radians(12.5))) ** 2 * 80 / 120)
    assert share == pytest.approx(disc, rel=0.05)
    assert 0.02 < red.sum() / on_ball.sum() < 0.4
    y, x = np.nonzero(red)
    assert np.hypot(x + 0.5 - 60, y + 0.5 - 40).max() < np.sqrt(on_ball.sum() / np.pi) + draw.MAX_DOT + 1


def test_dots_have_the_radius_asked_for():
    picture = np.zeros((60, 60, 3))
    draw._scatter_dots(picture, np.array([[20.5, 30.5], [-1.0, 10.0], [59.9, 59.9]]), 8.0)
    ys, xs = np.nonzero(picture[:, :40, 0] * (np.arange(60) > 22)[:, None])
    assert (xs.min(), xs.max(), ys.min(), ys.max()) == (12, 28, 23, 38)
    assert len(xs) == pytest.approx(np.pi * 64, rel=0.1)
