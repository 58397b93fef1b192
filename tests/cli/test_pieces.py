"""Work in pieces by plain commands: tiles, parts of a turn, and how they are merged."""

import shlex

import mitsuba as mi
import numpy as np
import pytest

from worlds.terminal import write_scene


def read(path):
    return np.array(mi.Bitmap(str(path)))


def run_printed(run, printed):
    for line in printed.splitlines():
        program, *arguments = shlex.split(line.removeprefix("# then: "))
        assert program == "pellucid"
        run(*arguments, "-q")


def test_tiles_merge_to_the_picture_of_one_run(run, tmp_path):
    """Rays of a wide filter, colour denoised, extra channels: all the same bits."""
    scene = write_scene(
        tmp_path / "my ball.xml", emitter='<emitter type="constant"/><integrator type="pellucid_two_pass"/>'
    )
    text = scene.read_text().replace('"box"', '"gaussian"')
    aovs = '<string name="aovs" value="exitance, irradiance"/> <string name="sampling"'
    scene.write_text(
        text.replace('<integrator type="pellucid_two_pass"/>', "").replace('<string name="sampling"', aovs)
    )
    common = ["render", scene, "-D", "sigma_a=0.002, 0.004, 0.02", "--seed", "3"]
    run(*common, "-o", "once.png", "-o", "once.exr", "-q")
    printed = run(*common, "-o", "all.png", "--output=all.exr", "--print-commands", "3")
    lines = printed.stdout.splitlines()
    assert len(lines) == 3 and "--tile 2/3 -o all_tile_00002_of_00003.exr" in lines[1]
    assert not list(tmp_path.glob("all*"))
    run_printed(run, printed.stdout + printed.stderr)
    for kind in ("png", "exr"):
        np.testing.assert_array_equal(read(f"all.{kind}"), read(f"once.{kind}"))
    names = [name for name, _ in mi.Bitmap("all.exr").split()]
    assert {"denoised", "exitance", "irradiance", "albedo"} <= {*names}
    run(*common, "-o", "raw.png", "--no-denoise", "-q")
    run("merge", "noisy.png", *sorted(tmp_path.glob("all_tile*")), "--no-denoise", "-q")
    np.testing.assert_array_equal(read("noisy.png"), read("raw.png"))


def test_tiles_that_do_not_belong_together(run, scene_file, tmp_path):
    tile = ["render", scene_file, "--no-denoise", "-q", "--tile"]
    run(*tile, "1/2")
    assert "1 of 2 tiles are missing (2)" in run("merge", "all.png", "ball_tile_00001_of_00002.exr", code=2).stderr
    run(*tile, "2/2", "--seed", "1", "-o", "b.exr")
    told = run("merge", "all.png", "ball_tile_00001_of_00002.exr", "b.exr", code=2).stderr
    assert "Tile 2 belongs to another picture (seed is 1 there, and 0 in the first one)" in told
    run(*tile, "2/3", "-o", "b.exr")
    told = run("merge", "all.png", "ball_tile_00001_of_00002.exr", "b.exr", code=2).stderr
    assert "Tile 2 is one of 3, and the first one of 2" in told
    assert "'ball.xml' is no tile" in run("merge", "all.png", "ball.xml", code=2).stderr
    run("render", scene_file, "-q", "-o", "ball.exr")
    assert "'ball.exr' is no tile" in run("merge", "all.png", "ball.exr", code=2).stderr
    assert "'none.exr' cannot be read" in run("merge", "all.png", "none.exr", code=2).stderr
    assert not (tmp_path / "all.png").exists()


@pytest.mark.parametrize("asked", ["0/4", "5/4", "3", "1/x", "1/70000"])
def test_no_tile(run, scene_file, asked):
    assert f"'{asked}' is no tile" in run("render", scene_file, "--tile", asked, code=2).stderr


def test_of_another_kind_of_file_nothing_is_read(run, tmp_path, monkeypatch):
    """Of a Radiance picture that was cut off Mitsuba read until the memory was full."""
    monkeypatch.setattr(mi, "Bitmap", lambda *_: pytest.fail("it was read"))
    (tmp_path / "cut.hdr").write_bytes(b"#?RADI")
    assert "'cut.hdr' is no tile" in run("merge", "all.exr", "cut.hdr", code=2).stderr


def test_a_tile_is_one_exr(run, scene_file):
    assert "name ends in .exr" in run("render", scene_file, "--tile", "1/2", "-o", "a.png", code=2).stderr
    assert "has no" in run("render", scene_file, "--tile", "1/9973", "-q", code=2).stderr


def test_parts_of_a_turn_share_a_folder_and_become_a_video(run, scene_file, tmp_path):
    import imageio_ffmpeg

    common = ["turntable", scene_file, "--frames", "5", "--resolution", "16x12", "--fps", "10"]
    run(*common, "-o", "once", "-q")
    printed = run(*common, "-o", "turn.mp4", "--print-commands", "2")
    assert [line.split("--range ")[1] for line in printed.stdout.splitlines()] == [
        "0-1 -o turn_frames",
        "2-4 -o turn_frames",
    ]
    run_printed(run, printed.stdout)
    for k in range(5):
        np.testing.assert_array_equal(read(f"once/frame_0000{k}.png"), read(f"turn_frames/frame_0000{k}.png"))
    (merging,) = printed.stderr.splitlines()
    run(*shlex.split(merging.removeprefix("# then: "))[1:])
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "turn.mp4"))[0] == 5
    (tmp_path / "turn_frames" / "frame_00003.png").unlink()
    told = run("merge", "turn.mp4", "turn_frames", code=2).stderr
    assert "1 of 5 frames are missing, the first is number 3" in told
    assert "(2 frames, 1 of them were there)" in run(*common, "--range", "3-4", "-o", "turn_frames").output


def test_a_frame_does_not_depend_on_those_before(run, scene_file, tmp_path):
    """Not where a method prepares for each view either."""
    common = ["turntable", scene_file, "--frames", 3, "--method", "single_pass", "--samples", 60, "--no-denoise", "-q"]
    run(*common, "-o", "once")
    run(*common, "-o", "apart", "--range", 2)
    assert (tmp_path / "apart/frame_00002.png").read_bytes() == (tmp_path / "once/frame_00002.png").read_bytes()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (["--range", "4-9"], "the last one is 4"),
        (["--range", "3-2"], "'3-2' are no frames"),
        (["--range", "0-1", "-o", "turn.mp4"], "a part of the turn is no video"),
    ],
)
def test_no_part_of_the_turn(run, scene_file, asked, told):
    assert told in run("turntable", scene_file, "--frames", "5", *asked, code=2).stderr


def test_no_folder_of_frames(run, scene_file):
    assert "'ball.xml' is no folder of frames" in run("merge", "a.mp4", "ball.xml", code=2).stderr
