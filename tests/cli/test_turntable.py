import sys

import mitsuba as mi
import numpy as np
import pytest

from pellucid.jobs.job import Job, Request
from pellucid.jobs.orbit import Orbit
from worlds.terminal import control_c, control_c_while_recording


def read(path):
    return np.array(mi.Bitmap(str(path)))


@pytest.fixture
def orbit(scene_file):
    job = Request.from_options({"source": str(scene_file)}).load()
    integrator = job.integrator()
    return Orbit.around(job.sensor, integrator.prepare_scene(job.scene).bodies)


def test_the_camera_keeps_its_distance_height_and_aim(orbit):
    np.testing.assert_allclose(orbit.centre, 0, atol=1e-5)
    np.testing.assert_allclose(orbit.axis, [0, 0, 1])
    np.testing.assert_allclose(orbit.matrix(0), orbit.start, atol=1e-12)
    for angle in np.linspace(0, 2 * np.pi, 7):
        matrix = orbit.matrix(angle)
        place, forward = matrix[:3, 3], matrix[:3, 2]
        # Counter-clockwise from (0, -20), always towards the centre.
        np.testing.assert_allclose(place, [20 * np.sin(angle), -20 * np.cos(angle), 6], atol=1e-5)
        np.testing.assert_allclose(forward, -place / np.linalg.norm(place), atol=1e-6)
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(np.linalg.det(orbit.start[:3, :3]))


def test_the_axis_goes_through_a_body_off_the_origin():
    start = np.eye(4)
    start[:3, 1], start[:3, 2], start[:3, 3] = [0, 1, 0], [0, 0, 1], [5, 2, -7]
    orbit = Orbit(start, np.array([5.0, 0, 3]), np.array([0.0, 1, 0]))
    np.testing.assert_allclose(orbit.matrix(np.pi)[:3, 3], [5, 2, 13], atol=1e-12)
    np.testing.assert_allclose(orbit.matrix(np.pi / 2)[:3, 3], [5 - 10, 2, 3], atol=1e-12)


def test_light_is_prepared_once_and_every_frame_is_written(run, scene_file, tmp_path, monkeypatch):
    from pellucid.methods.integrator import TranslucentIntegrator

    prepared = []
    original = TranslucentIntegrator.prepare_scene
    monkeypatch.setattr(TranslucentIntegrator, "prepare_scene", lambda *a: prepared.append(1) or original(*a))
    run("turntable", scene_file, "--frames", "4", "-o", "turn")
    assert prepared == [1]
    assert sorted(path.name for path in (tmp_path / "turn").iterdir()) == [
        *(f"frame_{k:05d}.png" for k in range(4)),
        "turntable.json",
    ]
    run("render", scene_file, "-o", "still.png")
    # The first frame is the picture that `render` makes; under an even sky a ball looks alike from all sides.
    np.testing.assert_array_equal(read("turn/frame_00000.png"), read("still.png"))
    first, third = (read(f"turn/frame_0000{k}.png")[4:12, 8:16].mean() for k in (0, 2))
    assert first == pytest.approx(third, rel=0.05)


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
def test_a_video_has_all_frames(run, scene_file, tmp_path, kind):
    import imageio_ffmpeg

    run("turntable", scene_file, "--frames", "5", "--fps", "10", "-o", f"turn.{kind}", "--resolution", "32x24")
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / f"turn.{kind}"))
    assert (count, seconds) == (5, pytest.approx(0.5, abs=0.11))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ball.xml", f"turn.{kind}"]


def test_a_video_that_fails_keeps_the_frames(run, scene_file, tmp_path, monkeypatch):
    import imageio_ffmpeg

    monkeypatch.setattr(imageio_ffmpeg, "count_frames_and_secs", lambda path: (2, 0.1))
    assert (
        "frames are in 'turn_frames'" in run("turntable", scene_file, "--frames", "3", "-o", "turn.mp4", code=2).stderr
    )
    assert len(list((tmp_path / "turn_frames").glob("*.png"))) == 3
    assert not (tmp_path / "turn.mp4").exists()


def test_interrupted_keeps_the_finished_frames(run, scene_file, tmp_path, monkeypatch):
    render, calls = Job.render, []

    def interrupted(self, integrator, paths):
        calls.append(1)
        if len(calls) == 3:
            control_c_while_recording()
        return render(self, integrator, paths)

    monkeypatch.setattr(Job, "render", interrupted)
    result = run("turntable", scene_file, "--frames", "9", "-o", "turn.mp4", code=130)
    assert result.stderr == "interrupted: 2 of 9 frames are in 'turn_frames': the same command goes on\n"
    assert len(list((tmp_path / "turn_frames").glob("*.png"))) == 2
    assert not (tmp_path / "turn.mp4").exists()

    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "turn_frames").glob("*.png")}
    other = run("turntable", scene_file, "--frames", "9", "--spp", "3", "-o", "turn.mp4", code=2).stderr
    assert "spp was 0, and is 3" in other and "name another folder" in other
    calls[:] = [1] * 3  # nothing interrupts any more
    result = run("turntable", scene_file, "--frames", "9", "-o", "turn_frames")
    assert "(9 frames, 2 of them were there)" in result.output and len(calls) == 3 + 7
    assert {path: path.stat().st_mtime_ns for path in times} == times
    run("turntable", scene_file, "--frames", "9", "-o", "turn.mp4")
    assert len(calls) == 3 + 7 and (tmp_path / "turn.mp4").is_file() and not (tmp_path / "turn_frames").exists()


@pytest.mark.parametrize("stage", ["load", "encode"])
def test_interrupted_before_and_after_the_frames_says_where_they_are(run, scene_file, tmp_path, monkeypatch, stage):
    """Nothing was written, it said, and frames or their settings were in the folder."""
    done = 0 if stage == "load" else 2
    monkeypatch.setattr(
        "pellucid.jobs.job.Request.load" if stage == "load" else "pellucid.cli.turntable.encode", control_c
    )
    stderr = run("turntable", scene_file, "--frames", "2", "-o", "turn.mp4", code=130).stderr
    assert stderr == f"interrupted: {done} of 2 frames are in 'turn_frames': the same command goes on\n"
    assert len(list((tmp_path / "turn_frames").glob("*.png"))) == done


def test_frames_of_other_settings_are_not_mixed(run, scene_file, tmp_path):
    run("turntable", scene_file, "--frames", "3", "-o", "turn")
    before = {path: path.read_bytes() for path in (tmp_path / "turn").iterdir()}
    assert "frames was 3, and is 2" in run("turntable", scene_file, "--frames", "2", "-o", "turn", code=2).stderr
    assert {path: path.read_bytes() for path in (tmp_path / "turn").iterdir()} == before
    result = run("turntable", scene_file, "--frames", "3", "-o", "turn")  # complete: done anew
    assert "(3 frames)" in result.output
    scene_file.write_text(scene_file.read_text().replace("25", "20"))
    assert "its contents was" in run("turntable", scene_file, "--frames", "3", "-o", "turn", code=2).stderr
    (tmp_path / "turn" / "turntable.json").unlink()
    assert "no turntable.json" in run("turntable", scene_file, "--frames", "3", "-o", "turn", code=2).stderr
    (tmp_path / "turn" / "turntable.json").write_text("{")
    assert "cannot be read" in run("turntable", scene_file, "--frames", "3", "-o", "turn", code=2).stderr


def test_a_video_without_ffmpeg_says_what_to_install(run, scene_file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert "'.[video]'" in run("turntable", scene_file, "-o", "turn.mp4", code=2).stderr
    assert [path.name for path in tmp_path.iterdir()] == ["ball.xml"]


def test_a_turn_that_fails_before_its_first_frame_leaves_no_folder(run, tmp_path):
    """Another turn may be put there."""
    (tmp_path / "ball.ply").write_text("ply")
    assert "damaged" in run("turntable", "ball.ply", "--frames", "3", "-o", "turn", code=2).stderr
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]


def test_settings_hold_the_contents_of_pictures_and_material_files(tmp_path):
    picture = tmp_path / "sky.exr"
    settings = []
    for contents in (b"old", b"new", b"old"):
        picture.write_bytes(contents)
        settings.append(Request.of("teapot_env", envmap=picture, material="skin1").settings())
    assert settings[0] == settings[2] != settings[1]
    assert settings[0]["material"] == "skin1" and settings[0]["envmap"].startswith(str(picture))
