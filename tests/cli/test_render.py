import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.jobs.job import Request
from worlds.terminal import control_c_while_recording, write_scene


def read(path):
    return np.array(mi.Bitmap(str(path)))[..., :3]


def test_a_scene_file_becomes_the_pictures_asked_for(run, scene_file, tmp_path):
    result = run("render", scene_file, "-o", "a.exr", "-o", "a.png")
    assert read("a.exr").shape == read("a.png").shape == (16, 24, 3)
    centre = read("a.exr")[7:9, 11:13].mean()
    assert 0.5 < centre < 1.0  # marble under an even sky of radiance 1: about its reflectance, 0.79
    assert "wrote a.exr, a.png" in result.output
    for stage in ("load", "irradiance", "picture", "in all"):
        assert stage in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "a.png", "ball.xml"]


def test_it_is_the_picture_that_mitsuba_renders(run, scene_file):
    run("render", scene_file, "-o", "a.exr", "--seed", "0", "-q")
    scene = mi.load_file(str(scene_file), optimize=False)
    np.testing.assert_allclose(read("a.exr"), np.array(mi.render(scene)), rtol=1e-5, atol=1e-6)


def test_the_name_of_the_scene_is_the_default_name(run, scene_file, tmp_path):
    assert run("render", scene_file, "--quiet").output == ""
    assert (tmp_path / "ball.png").is_file()


def test_picture_options_overrule_the_scene(run, scene_file):
    run("render", scene_file, "--resolution", "10x6", "--spp", "64", "-o", "fine.exr")
    run("render", scene_file, "--resolution", "10x6", "--spp", "64", "-o", "other.exr", "--seed", "5")
    run("render", scene_file, "--resolution", "10x6", "--spp", "64", "-o", "again.exr", "--seed", "5")
    assert read("fine.exr").shape == (6, 10, 3)
    assert not np.array_equal(read("fine.exr"), read("other.exr"))
    np.testing.assert_array_equal(read("other.exr"), read("again.exr"))


def test_the_camera_is_chosen_by_its_index(run, scene_file):
    run("render", scene_file, "-s", "1", "-o", "away.exr")
    assert read("away.exr").shape == (8, 8, 3)
    np.testing.assert_allclose(read("away.exr"), 1, atol=1e-3)  # it looks past the ball, into the sky
    assert "2 camera(s)" in run("render", scene_file, "-s", "2", code=2).stderr


def test_definitions_reach_the_scene(run, scene_file):
    run("render", scene_file, "-o", "clear.exr")
    run("render", scene_file, "-o", "dark.exr", "-D", "sigma_a=5, 5, 5")
    assert read("dark.exr")[7:9, 11:13].mean() < 0.3 * read("clear.exr")[7:9, 11:13].mean()


def load(source, **options):
    return Request.from_options({"source": str(source), **options}).load()


def method_of(integrator, name):
    """The parameters of an integrator, whose method has this name."""
    assert integrator.method.name == name
    return integrator.method.parameters()


def test_an_integrator_of_the_scene_is_kept_and_its_parameters_can_be_overruled(scene_file):
    kept = method_of(load(scene_file).integrator(), "two_pass")
    assert (kept["max_depth"], kept["max_error"], kept["sampling"], kept["sample_count"]) == (3, 0.7, "uniform", 300)
    changed = method_of(load(scene_file, max_error=0.2, sample_count=40).integrator(), "two_pass")
    assert changed == kept | {"max_error": 0.2, "sample_count": 40}
    changed = method_of(load(scene_file, method="exact").integrator(), "exact")
    assert changed == {name: value for name, value in kept.items() if name != "max_error"}


@pytest.mark.parametrize("depth", [-1, 4])
def test_every_parameter_survives_the_copy(tmp_path, depth):
    xml = f"""<integrator type="pellucid_exact">
      <integer name="max_depth" value="{depth}"/> <integer name="rr_depth" value="9"/>
      <integer name="irradiance_depth" value="7"/> <integer name="translucent_passes" value="2"/>
      <integer name="max_samples" value="999"/> <integer name="irradiance_paths" value="6"/>
      <integer name="seed" value="3"/> <boolean name="hide_emitters" value="true"/>
      <string name="aovs" value="exitance, irradiance"/> </integrator>"""
    job = load(write_scene(tmp_path / "ball.xml", integrator=xml))
    copy, original = job.integrator(), job.scene.integrator()
    assert type(copy) is type(original) and copy is not original
    assert copy.method == original.method and copy.method is not original.method
    assert copy.method.max_depth == depth and copy.method.irradiance_depth == 7 and copy.method.max_samples == 999


def test_an_integrator_of_mitsuba_gives_way_to_two_pass(tmp_path):
    path = write_scene(tmp_path / "ball.xml", integrator='<integrator type="path"/>')
    assert load(path).integrator().method.name == "two_pass"


def test_extra_channels_go_into_the_exr(run, tmp_path):
    xml = '<integrator type="pellucid_two_pass"><string name="aovs" value="exitance"/></integrator>'
    run("render", write_scene(tmp_path / "ball.xml", integrator=xml), "-o", "a.exr", "-o", "a.png")
    channels = [field.name for field in mi.Bitmap("a.exr").struct_()]
    assert {"R", "G", "B", "exitance.R"} <= set(channels)
    assert np.array(mi.Bitmap("a.png")).shape == (16, 24, 3)


def test_materials_and_sizes_reach_a_built_in_scene(run):
    tiny = ["--resolution", "16x12", "--spp", "2", "--samples", "400", "--sampling", "uniform"]
    run("render", "teapot", *tiny, "-o", "marble.exr")
    run("render", "teapot", *tiny, "-o", "ketchup.exr", "--material", "ketchup", "--size", "100")
    middle = (slice(6, 9), slice(6, 9))
    marble, ketchup = read("marble.exr")[middle].mean((0, 1)), read("ketchup.exr")[middle].mean((0, 1))
    assert ketchup[2] / ketchup[0] < 0.5 * marble[2] / marble[0]
    run("render", "teapot", *tiny, "-o", "white.exr", "--reflectance", "0.9", "--dmfp", "1,2,3", "--eta", "1.4")
    run("render", "teapot", *tiny, "-o", "grey.exr", "--sigma-a", "0.1", "--sigma-s-prime", "1,1,1", "--g", "0.5")
    assert read("grey.exr")[middle].mean() < read("white.exr")[middle].mean()


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "glb"])
def test_a_bare_mesh_is_put_on_a_table(run, kind):
    trimesh.creation.icosphere(subdivisions=3).export(f"ball.{kind}")
    run("render", f"ball.{kind}", "--size", "8", "--resolution", "20x30", "--spp", "4", "-o", "ball.exr", "-q")
    picture = read("ball.exr")
    assert picture.shape == (30, 20, 3)
    assert picture[13:17, 8:12].mean() > 0.02


def test_the_upward_axis_of_a_mesh_can_be_given(run):
    trimesh.creation.box((1, 1, 8)).export("pole.ply")
    common = ["--size", "20", "--resolution", "24x24", "--spp", "4", "-q"]
    run("render", "pole.ply", *common, "-o", "upright.exr")
    run("render", "pole.ply", *common, "-o", "lying.exr", "--up", "y")
    assert not np.allclose(read("upright.exr"), read("lying.exr"), rtol=0.1)


def test_a_pipe_gets_the_summary_and_a_line_for_each_long_stage(scene_file, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "pellucid", "render", str(scene_file), "-t", "1"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0
    assert all(line.endswith(" ...") for line in done.stderr.splitlines())  # of a machine that is busy
    assert len(done.stdout.splitlines()) == 2


def test_interrupted_leaves_nothing(run, scene_file, tmp_path, monkeypatch):
    monkeypatch.setattr("pellucid.jobs.job.Job.render", control_c_while_recording)
    assert run("render", scene_file, code=130).stderr == "interrupted: nothing was written\n"
    assert [path.name for path in tmp_path.iterdir()] == ["ball.xml"]


def test_a_picture_can_be_the_reflectance(run):
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[..., 0] = 220
    mi.Bitmap(picture).write("red.png")
    tiny = ["--resolution", "16x12", "--spp", "2", "--samples", "400", "--sampling", "uniform", "-q"]
    run("render", "bust", "--reflectance", "red.png", "--dmfp", "1", *tiny, "-o", "bust.exr")
    red, green, blue = read("bust.exr")[5:8, 7:9].mean((0, 1))
    assert red > 3 * max(green, blue)
    assert "no picture 'none.png'" in run("render", "bust", "--reflectance", "none.png", "--dmfp", "1", code=2).stderr


def test_a_scene_of_mitsuba_0_5_renders_as_it_is(run, tmp_path):
    (tmp_path / "old.xml").write_text("""<scene version="0.5.0">
      <integrator type="path"><integer name="maxDepth" value="3"/></integrator>
      <sensor type="perspective"><float name="fov" value="30"/>
        <transform name="toWorld"><lookAt origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film>
        <sampler type="ldsampler"><integer name="sampleCount" value="2"/></sampler></sensor>
      <shape type="sphere"><bsdf type="plastic"><spectrum name="diffuseReflectance" value="0"/></bsdf>
        <subsurface type="dipole"><string name="material" value="marble"/> <float name="scale" value="0.2"/>
          <float name="sampleMultiplier" value="2"/></subsurface></shape>
      <emitter type="constant"/></scene>""")
    result = run("render", "old.xml", "-o", "old.exr")
    assert read("old.exr")[7:9, 11:13].mean() == pytest.approx(0.79, abs=0.1)
    said = [line for line in result.stderr.splitlines() if "Mitsuba 0.x" in line]
    assert len(said) == 1 and "sampleMultiplier" in said[0]


def test_denoised_by_default_and_raw_where_that_is_asked_for(run, scene_file):
    """PNG shows the denoised picture, and EXR keeps the raw one beside it."""
    common = ["render", scene_file, "--spp", "2", "-q"]
    run(*common, "-o", "a.png", "-o", "a.exr", "-o", "a.hdr")
    run(*common, "-o", "raw.png", "-o", "raw.exr", "-o", "raw.hdr", "--no-denoise")
    layers = {name: np.array(part) for name, part in mi.Bitmap("a.exr").split()}
    assert layers.keys() == {"<root>", "denoised", "albedo", "normal", "depth", "exitance"}
    np.testing.assert_array_equal(layers["<root>"], read("raw.exr"))
    np.testing.assert_array_equal(read("a.hdr"), read("raw.hdr"))
    assert mi.Bitmap("raw.exr").channel_count() == 3
    mi.Bitmap(layers["denoised"]).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, True).write("layer.png")
    assert np.abs(read("a.png").astype(int) - read("layer.png")).max() <= 1  # Mitsuba dithers
    assert np.abs(read("a.png").astype(int) - read("raw.png")).max() > 1


def test_what_is_measured_against_is_never_denoised(run, scene_file):
    for method in ("exact", "sampled"):
        run("render", scene_file, "--method", method, "-o", "a.exr", "-q")
        assert mi.Bitmap("a.exr").channel_count() == 3
    refused = run("render", scene_file, "--method", "exact", "--denoise", code=2).stderr
    assert refused.startswith("error: --denoise: the method exact")


def test_without_a_denoiser_one_line_and_the_raw_picture(run, scene_file, monkeypatch):
    common = ["render", scene_file, "--spp", "2", "-q"]
    run(*common, "-o", "raw.png", "--no-denoise")
    monkeypatch.setattr("pellucid.methods.denoising.MODULE", "no_such_denoiser")
    told = run(*common, "-o", "a.png", "-o", "a.exr").stderr
    assert told.startswith("warning: The picture keeps its noise") and told.count("\n") == 1
    np.testing.assert_array_equal(read("a.png"), read("raw.png"))
    assert mi.Bitmap("a.exr").channel_count() == 3


def test_a_picture_can_be_the_mean_free_path(run):
    mi.Bitmap(np.full((4, 4, 3), 128, np.uint8)).write("grey.png")
    tiny = ["--resolution", "16x12", "--spp", "1", "--samples", "400", "--sampling", "uniform", "-q"]
    given = {"picture": ["grey.png", "--dmfp-scale", "5"], "number": [str(5 * 128 / 255)]}
    for name, dmfp in given.items():
        run("render", "sphere", "--reflectance", "0.5", "--dmfp", *dmfp, *tiny, "-o", f"{name}.exr")
    assert read("picture.exr") == pytest.approx(read("number.exr"), rel=1e-3)
