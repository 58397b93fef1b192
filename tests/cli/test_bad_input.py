"""What bad input gets from the command line: one clear line, exit code 2, and no picture."""

import os
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest

from worlds.terminal import write_scene


def refuse(run, *args):
    """Run a command that must fail; return its one line."""
    result = run(*args, code=2)
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    assert "Traceback" not in result.output
    return lines[0]


@pytest.fixture
def nothing_renders(monkeypatch):
    """Fail when a command gets as far as loading a scene."""

    def too_late(*_):
        raise AssertionError("the scene was loaded")

    monkeypatch.setattr("pellucid.jobs.job.Request.load", too_late)


@pytest.mark.parametrize("command", ["render", "compare", "samples", "turntable"])
@pytest.mark.parametrize(
    ("output", "expected"),
    [("missing/a.png", "create it first"), ("a.xyz", "no kind of file"), ("ball.xml/a.png", "is a file")],
)
def test_the_output_is_checked_before_the_work(run, scene_file, nothing_renders, command, output, expected):
    if command == "turntable":
        output = output.replace(".png", ".mp4")
    if (command, output) == ("compare", "a.xyz"):
        output, expected = "ball.xml", "is a file"  # whatever is no picture is the name of a folder
    assert expected in refuse(run, command, scene_file, "-o", output)


@pytest.mark.parametrize("name", ["missing.xml", "missing.ply", "folder/missing.glb"])
def test_a_missing_file(run, nothing_renders, name):
    assert f"There is no file '{name}'" in refuse(run, "render", name)


def test_a_fifo_is_not_read(run, nothing_renders):
    os.mkfifo("pipe.ply")
    assert "'pipe.ply' is no ordinary file" in refuse(run, "render", "pipe.ply")


def test_an_environment_that_is_no_picture_is_named(run, tmp_path):
    (tmp_path / "sky.hdr").write_bytes(b"no picture" * 30)
    assert "sky.hdr' cannot be read as a picture" in refuse(run, "render", "teapot_env", "--envmap", "sky.hdr")


def test_a_standard_output_that_is_full_or_closed():
    """As ``pellucid materials > /dev/full``, and with all closed."""
    command = [sys.executable, "-m", "pellucid", "materials"]
    with open("/dev/full", "w") as full:
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert result.returncode == 2 and result.stderr == "error: No space left on device.\n"
    closed = subprocess.run(["sh", "-c", '"$@" >&- 2>&-', "sh", *command])
    assert closed.returncode == 0


def test_an_unknown_scene_gets_the_nearest_name(run):
    assert "did you mean 'teapot'" in refuse(run, "render", "teapto")


def test_an_unknown_material_gets_the_nearest_name(run):
    line = refuse(run, "render", "teapot", "--material", "marbel")
    assert "There is no measured material 'marbel' (did you mean 'marble'?)" in line


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--sigma-a", "-1,0,0", "--sigma-s-prime", "1"], "sigma_a = -1 in the red channel"),
        (["--sigma-a", "0.1", "--sigma-s-prime", "1,0,1"], "sigma_s_prime = 0 in the green channel"),
        (["--sigma-a", "nan", "--sigma-s-prime", "1"], "finite"),
        (["--sigma-a", "0.1"], "both are needed"),
        (["--reflectance", "0.5,0.5,1.5", "--dmfp", "1"], "reflectance = 1.5 in the blue channel"),
        (["--material", "skin1", "--reflectance", "0.5", "--dmfp", "1"], "keep one of them"),
        (["--eta", "0.2"], "eta = 0.2"),
        (["--g", "1"], "g = 1"),
        (["--max-error", "-1"], "max_error is a solid angle"),
        (["--method", "exact", "--max-error", "1"], "belongs to the method two_pass"),
        (["-D", "key=1"], "only a scene file"),
        (["--size", "1e-30"], "'--size'"),
        (["--spp", "99999999999"], "'--spp'"),
    ],
)
def test_values_that_cannot_be(run, options, expected):
    assert expected in refuse(run, "render", "teapot", "--samples", "100", *options)


def test_a_scene_file_has_its_own_materials(run, scene_file, nothing_renders):
    assert "--material: a scene file has its own" in refuse(run, "render", scene_file, "--material", "skin1")
    assert "--envmap: a scene file has its own" in refuse(run, "render", scene_file, "--envmap", "sky.exr")
    assert "--size: a scene file has its own" in refuse(run, "render", scene_file, "--size", "3")


def test_a_million_times_too_large_is_explained_by_the_unit(run):
    line = refuse(run, "render", "teapot", "--size", "200000000")
    assert "max_samples" in line and "mm" in line and "divide them by 1000" in line


def test_a_scene_without_translucent_objects(run, tmp_path):
    path = write_scene(tmp_path / "ball.xml", medium="")
    assert "no translucent shape" in refuse(run, "render", path, "-D", "bsdf=diffuse")


def test_a_scene_without_light_is_rendered_black_with_a_warning(run, tmp_path):
    result = run("render", write_scene(tmp_path / "dark.xml", emitter=""), "-o", "dark.exr")
    assert "warning: The scene has no light" in result.stderr
    assert not np.array(mi.Bitmap("dark.exr").split()[0][1]).any()


def test_a_missing_texture_is_named(run, tmp_path):
    medium = """<texture type="bitmap" name="reflectance"><string name="filename" value="albedo.png"/></texture>
        <float name="dmfp" value="1"/>"""
    line = refuse(run, "render", write_scene(tmp_path / "ball.xml", medium=medium))
    assert "albedo.png" in line and "No such file" in line and "FileStream" not in line and "I/O" not in line


def test_a_broken_scene_file(run, scene_file):
    scene_file.write_text("<scene version='3.0.0'><shape></scene>")
    assert "ball.xml" in refuse(run, "render", scene_file)


def test_an_unused_definition_is_named(run, scene_file):
    assert "$colour" in refuse(run, "render", scene_file, "-D", "colour=1")


def test_a_misspelt_parameter_in_a_scene_file_is_named(run, tmp_path):
    medium = '<string name="material" value="marble"/><float name="etta" value="1.4"/>'
    assert "etta" in refuse(run, "render", write_scene(tmp_path / "ball.xml", medium=medium))


def test_a_mesh_with_nan(run, tmp_path):
    vertices = "0 0 0\n1 0 0\n0 nan 0\n0 0 1\n"
    header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n"
    text = f"{header}element face 4\nproperty list uchar int vertex_index\nend_header\n{vertices}{faces}"
    (tmp_path / "broken.ply").write_text(text)
    assert "broken.ply" in refuse(run, "render", "broken.ply", "--size", "10")


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        ("scalar_rgb", "compiled RGB"),
        ("llvm_ad_rbg", "did you mean 'llvm_ad_rgb'"),
        ("llvm_ad_spectral", "compiled RGB"),
    ],
)
def test_a_variant_that_cannot_be_used(run, scene_file, variant, expected):
    assert expected in refuse(run, "render", scene_file, "-m", variant)


def test_an_environment_map_that_is_missing_or_has_no_place(run):
    assert "sky.exr" in refuse(run, "render", "teapot_env", "--envmap", "sky.exr")
    assert "environment" in refuse(run, "render", "teapot", "--envmap", "sky.exr")


def test_verbose_shows_where_an_error_came_from(run, tmp_path):
    path = write_scene(tmp_path / "ball.xml", medium='<string name="material" value="marbel"/>')
    result = run("render", path, "-v", code=2)
    assert "Traceback" in result.stderr and "find_material" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("error: ")


@pytest.mark.parametrize("command", ["render", "compare", "samples", "turntable"])
def test_a_picture_too_large_for_the_memory(run, scene_file, monkeypatch, command):
    monkeypatch.setattr("pellucid.methods.film.free_memory", lambda: 1_000_000_000)
    monkeypatch.setattr("pellucid.methods.integrator.TranslucentIntegrator.prepare_scene", lambda *_: 1 / 0)
    line = refuse(run, command, scene_file, "--resolution", "12000x12000")
    assert "12000x12000 pixels needs about" in line and "1 GB are free" in line


def test_a_picture_that_is_cut_off_is_named_in_our_words(run, tmp_path):
    mi.Bitmap(np.ones((8, 8, 3), np.float32)).write("whole.exr")
    (tmp_path / "cut.exr").write_bytes((tmp_path / "whole.exr").read_bytes()[:300])
    line = refuse(run, "render", "teapot_env", "--envmap", "cut.exr")
    assert "cut.exr" in line and "ends too early" in line


def test_kernels_that_cannot_be_kept_are_one_warning(run, scene_file, monkeypatch):
    monkeypatch.setattr("pellucid._kernel_folder.OBSTACLE", "there is no HOME")
    lines = run("render", scene_file).stderr.splitlines()
    assert len(lines) == 1 and lines[0].startswith("warning: Compiled kernels cannot be kept (there is no HOME)")


@pytest.mark.parametrize("size", ["1e-9", "1e12"])
def test_a_size_that_single_precision_does_not_hold(run, nothing_renders, size):
    """NumPy told of it, or an octree."""
    assert "'--size'" in refuse(run, "render", "teapot", "--size", size)


# ------------------------------------------------------------------ damaged files, in our words


@pytest.fixture
def pictures(tmp_path):
    """Pictures that are damaged, each in a way that Mitsuba tells of in words of its own."""
    whole = mi.Bitmap(np.linspace(0, 1, 1152, dtype=np.float32).reshape(16, 24, 3))
    whole.write(str(tmp_path / "whole.exr"))
    whole.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write(str(tmp_path / "whole.jpg"))
    exr, jpeg = ((tmp_path / f"whole.{kind}").read_bytes() for kind in ("exr", "jpg"))
    (tmp_path / "cut.exr").write_bytes(exr[: len(exr) // 2])
    (tmp_path / "kind.exr").write_bytes(
        exr.replace(b"B\0\2\0\0\0", b"B\0\7\0\0\0").replace(b"B\0\1\0\0\0", b"B\0\7\0\0\0")
    )
    (tmp_path / "cut.jpg").write_bytes(jpeg[: len(jpeg) - 20])
    return ["cut.exr", "kind.exr", "cut.jpg"]


def is_ours(line, name):
    """Tell whether a line names a file and quotes no library."""
    return name in line and not any(
        word in line for word in ("[", "Stream", "Bitmap", "site-packages", "codec", "Error(")
    )


def test_a_picture_that_is_damaged_is_named_in_our_words(run, scene_file, pictures, tmp_path):
    card = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    (tmp_path / "card.obj").write_text(card)
    for name in pictures:
        assert is_ours(refuse(run, "fit", scene_file, name), name)
        assert is_ours(refuse(run, "fit", scene_file, "whole.exr", "--mask", name), name)
        assert is_ours(refuse(run, "render", "teapot_env", "--envmap", name), name)
        result = run("render", "card.obj", "--reflectance", name, "--dmfp", "1", code=2)
        assert is_ours(result.stderr.splitlines()[-1], name)


def test_a_damaged_exr_in_a_scene_does_not_end_the_process(pictures, tmp_path):
    """Mitsuba, which would read it in several threads inside of several threads, ends the process in one of ten times."""
    code = """
import pellucid, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
bsdf = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": "cut.exr"}}
for _ in range(100):
    try:
        pellucid.load_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}})
    except pellucid.PellucidError as error:
        assert "ends too early" in str(error)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "Expecting value"),
        (b"\xff\xfe{", "Expecting value"),
        (b"[]", "it has no names"),
        (b"{}", "there is no 'g'"),
        (b'{"g": 0, "eta": 1.3, "profile": "dipole", "reflectance": "cut.exr", "dmfp": [1, 1, 1]}', "ends too early"),
    ],
)
def test_a_material_file_that_is_damaged_is_named_in_our_words(run, pictures, tmp_path, content, expected):
    (tmp_path / "wax.json").write_bytes(content)
    line = refuse(run, "render", "teapot", "--material", "wax.json")
    assert is_ours(line, "wax.json") and "is no material file" in line and expected in line


def test_a_mesh_whose_damage_is_no_text_is_named(run, tmp_path, scene_file):
    (tmp_path / "ball.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n\xb5\xff\n"
    )
    mesh = '<shape type="ply" id="ball"><string name="filename" value="ball.ply"/>'
    text = scene_file.read_text().replace('<shape type="sphere" id="ball">', mesh)
    scene_file.write_text(text.replace('<float name="radius" value="3"/>', ""))
    assert "ball.ply" in refuse(run, "render", scene_file)
    (tmp_path / "ball.ply").write_bytes(b"")  # of which Mitsuba says that it does not exist, or that all went well
    line = refuse(run, "render", scene_file)
    assert "ball.ply" in line and "No such file" not in line and "Success" not in line
