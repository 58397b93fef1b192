"""Pictures on a real scheduler with two real workers, on the loopback: the same bits as one process makes."""

import sys

import cloudpickle
import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from distributed import Client

import pellucid
from pellucid.cli.main import pellucid as command
from pellucid.cluster import cluster as module
from pellucid.cluster import worker
from pellucid.cluster.bundle import Bundle
from pellucid.cluster.cluster import Cluster
from pellucid.errors import ClusterError, PellucidError, SceneError
from pellucid.jobs.job import Request
from pellucid.jobs.tiles import merge
from pellucid.progress import reporting_to
from worlds.daskers import dask_of, stop
from worlds.reporters import Told
from worlds.terminal import control_c, write_scene


def read(path):
    return np.array(mi.Bitmap(str(path)))


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    stays = {"DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING": "False"}  # who does what is then known
    with dask_of(tmp_path_factory.mktemp("dask"), 2, stays) as running:
        yield running


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A scene file that names another file, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "TILE_SIDE", 8)
    path = write_scene(tmp_path / "ball.xml")
    mi.Bitmap(np.full((4, 8, 3), 0.7, np.float32)).write("sky.exr")
    sky = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    path.write_text(path.read_text().replace('<emitter type="constant"/>', sky).replace('"box"', '"gaussian"'))
    return path


def run(*arguments, code=0):
    result = CliRunner().invoke(command, [*map(str, arguments), "-q"])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def test_tiles_and_frames_are_those_of_one_process(dask, scene, tmp_path):
    run("render", scene, "-o", "once.png", "-o", "once.exr")
    run("render", scene, "-o", "all.png", "-o", "all.exr", "--cluster", dask.address)
    for kind in ("png", "exr"):
        np.testing.assert_array_equal(read(f"all.{kind}"), read(f"once.{kind}"))
    run("turntable", scene, "--frames", 3, "-o", "once")
    run("turntable", scene, "--frames", 3, "-o", "turn", "--cluster", dask.address)
    for k in range(3):
        assert (tmp_path / f"turn/frame_0000{k}.png").read_bytes() == (
            tmp_path / f"once/frame_0000{k}.png"
        ).read_bytes()
    assert not (tmp_path / "all_tiles").exists()


@pytest.mark.parametrize("method", ["exact", "single_pass", "texture_space", "sampled"])
def test_every_method(dask, scene, method, monkeypatch):
    monkeypatch.setattr(module, "TILE_SIDE", 16)
    few = [] if method == "sampled" else ["--samples", 100]
    common = ["render", scene, "--method", method, *few, "--no-denoise"]
    run(*common, "-o", "once.exr")
    run(*common, "-o", "all.exr", "--cluster", dask.address)
    np.testing.assert_array_equal(read("all.exr"), read("once.exr"))


def test_light_that_workers_share(dask, scene, monkeypatch):
    """Each lights a part of the samples, and they are put together; what was on a worker that is killed then is lit again."""
    monkeypatch.setattr(module, "SHARED_PATHS", 1)
    stages, third, collect = [], dask.add_worker(), Cluster._collect

    def collected(self, stage, tasks, *arguments, **options):
        stages.append((stage, len(tasks)))
        done = collect(self, stage, tasks, *arguments, **options)
        if stage == "irradiance":
            held = [address for places in self._client.who_has([*done.values()]).values() for address in places]
            assert len({*held}) == 3
            stop(third)
        return done

    monkeypatch.setattr(Cluster, "_collect", collected)
    common = ["render", scene, "--samples", "6000", "--irradiance-paths", 256, "--no-denoise"]
    run(*common, "-o", "once.exr")
    with Client(dask.address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=60)
    run(*common, "-o", "all.exr", "--cluster", dask.address)
    np.testing.assert_array_equal(read("all.exr"), read("once.exr"))
    assert stages == [("scene", 3), ("samples", 1), ("irradiance", 3), ("tiles", 6)]


def bytes_of_parts():
    """Add up the samples of each part that a worker keeps, their light and the trees of them."""
    lit = [part.bodies for opened in worker._opened.values() for part in opened.parts.values()]
    return [sum(worker._size([each.samples, each.irradiance, each.state]) for each in bodies) for bodies in lit]


def test_samples_that_stay_in_parts(dask, scene, monkeypatch):
    """The picture is that of one process but for the places of samples, and has the same bits on any workers, one that is killed included:
    what it kept is lit anew by another."""
    held, third, collect = [], None, Cluster._collect

    def collected(self, stage, *arguments, **options):
        done = collect(self, stage, *arguments, **options)
        if stage in ("irradiance", "tiles", "frames"):
            held.append([*self._client.run(bytes_of_parts).values()])
        if stage == "irradiance" and third is not None:
            stop(third)
        return done

    monkeypatch.setattr(Cluster, "_collect", collected)
    common, parts = ["--samples", 6000, "--no-denoise"], ["--sample-parts", 3, "--cluster", dask.address]
    cloudpickle.register_pickle_by_value(here := sys.modules[__name__])
    run("render", scene, "-o", "once.exr", *common)
    run("render", scene, "-o", "cut.exr", "-o", "cut.png", *common, *parts)
    run("turntable", scene, "-o", "turn", "--frames", 1, *common, *parts)
    third = dask.add_worker()
    with Client(dask.address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=60)
    run("render", scene, "-o", "again.exr", *common, *parts)
    cloudpickle.unregister_pickle_by_value(here)
    np.testing.assert_array_equal(read("again.exr"), read("cut.exr"))
    np.testing.assert_array_equal(read("turn/frame_00000.png"), read("cut.png"))
    cut, once = (np.array(mi.Bitmap(f"{name}.exr"), np.float32) for name in ("cut", "once"))
    assert np.sqrt(np.mean((cut - once) ** 2)) < 0.01 * once.mean()
    assert cut.mean() == pytest.approx(once.mean(), rel=2e-3)
    assert [sorted(map(len, workers)) for workers in held] == [[1, 2]] * 4 + [[1, 1, 1], [1, 2]]
    sizes = [size for workers in held for kept in workers for size in kept]
    assert max(sizes) < 250 * 6000 / 3  # of 165 bytes a sample, and the profile


def test_methods_without_parts_and_parts_without_workers_are_refused(dask, scene):
    told = run("render", scene, "--sample-parts", 2, code=2).stderr
    assert told == "error: --sample-parts: one process holds all samples; add --cluster, or leave it out.\n"
    other = ["--method", "sampled", "--cluster", dask.address, "--sample-parts", 2]
    told = run("render", scene, *other, code=2).stderr
    assert told.count("\n") == 1 and "add up for two_pass and exact, not for sampled: leave it out" in told


@pytest.mark.parametrize("parts", [-1, 5000, 0.5])
def test_numbers_of_parts_that_cannot_be_are_refused(scene, parts):
    with pytest.raises(SceneError, match="sample_parts is a whole number from 1 to 1024"):
        Request.of(scene, sample_parts=parts)


def test_parts_of_few_samples_are_refused_and_nothing_is_left(dask, scene):
    told = run("render", scene, "--samples", 500, "--sample-parts", 20, "--cluster", dask.address, code=2).output
    assert "ask for at most 5 parts" in told and not list(scene.parent.glob("*_tiles"))


def test_an_option_of_the_command_line_is_known_by_its_other_name(scene):
    with pytest.raises(PellucidError, match=r"no option 'samples' \(did you mean 'sample_count'\?\)"):
        Request.of(scene, samples=500)


def test_a_worker_that_is_killed_in_the_middle_changes_no_bit(dask, scene):
    request = Request.from_options({"source": str(scene), "denoise": False})
    run("render", scene, "-o", "once.exr", "--no-denoise")
    third, tiles = dask.add_worker(), []

    def keep(tile):
        if not tiles:
            stop(third)
        tiles.append(tile)

    with Cluster(dask.address) as cluster:
        cluster._client.wait_for_workers(3, timeout=30)
        cluster.render_tiles(request, lambda picture: set(), keep)
        assert len(cluster.workers) == 2
    film, _ = merge(tiles)
    np.testing.assert_array_equal(np.array(film.bitmap()), read("once.exr"))


def test_what_goes_wrong_on_a_worker_is_told_in_one_line(dask, scene):
    scene.write_text(scene.read_text().replace("sky.exr", "none.exr"))
    told = run("render", scene, "--cluster", dask.address, code=2).stderr
    assert told.startswith("error: ") and "none.exr" in told and told.count("\n") == 1


def test_interrupted_keeps_the_finished_tiles_and_goes_on(dask, scene, tmp_path, monkeypatch):
    from pellucid.jobs.tiles import TileFolder

    keep, kept = TileFolder.keep, []

    def interrupted(self, tile):
        keep(self, tile)
        kept.append(tile.number)
        if len(kept) == 2:
            control_c()

    monkeypatch.setattr(TileFolder, "keep", interrupted)
    told = run("render", scene, "-o", "all.png", "--cluster", dask.address, code=130).stderr
    assert told == "interrupted: 2 of 6 tiles are in 'all_tiles': the same command goes on\n"
    other = run("render", scene, "-o", "all.png", "--seed", 1, "--cluster", dask.address, code=2).stderr
    assert "holds tiles of another picture" in other and "seed" in other
    run("render", scene, "-o", "all.png", "--cluster", dask.address)
    assert sorted(kept) == [1, 2, 3, 4, 5, 6]
    assert (tmp_path / "all.png").is_file() and not (tmp_path / "all_tiles").exists()


def test_another_version_is_refused_by_name(dask, scene, tmp_path):
    """At the start, and where it comes later: then the others go on."""
    other = tmp_path / "other.py"
    other.write_text('import pellucid.version\n\npellucid.version.__version__ = "0.0.7"\n')
    told = rf"tcp://\S+\)? .*pellucid 0\.0\.7 instead of {pellucid.__version__}"
    run("render", scene, "-o", "once.exr", "--spp", 1, "--no-denoise")
    once = np.array(mi.Bitmap("once.exr").convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    with Cluster(dask.address) as cluster:
        before, late = {*cluster.workers}, dask.add_worker("--preload", str(other))
        try:
            cluster._client.wait_for_workers(3, timeout=60)
            (address,) = {*cluster.workers} - before
            with pytest.raises(ClusterError, match=told):
                Cluster(dask.address)
            with (
                pytest.warns(pellucid.PellucidWarning, match=told + r".* It is sent away\."),
                cluster._working(Request.of(scene)) as (key, _),
            ):
                cluster._collect("scene", {address: (worker.survey, key)}, None, at={address: address})
            late.wait(60)
            np.testing.assert_array_equal(cluster.render(scene, spp=1), once)
        finally:
            stop(late)


def test_progress_inside_a_piece(dask, scene, monkeypatch):
    """A picture of one tile: what its worker has done of it arrives while it goes on, and before that what it prepares."""
    monkeypatch.setattr(module, "NEWS", 0.0)
    monkeypatch.setattr(module, "TILE_SIDE", 256)
    with Cluster(dask.address) as cluster, reporting_to(told := Told()):
        cluster.render_tiles(
            Request.of(scene, denoise=False, resolution=(256, 192), seed=5), lambda _: set(), lambda _: None
        )
    assert told.open == [] and told.done["tiles"] == pytest.approx(1)
    assert told.steps["tiles"] > 1 and {"samples", "irradiance"} <= {*told.done}


def test_no_scheduler_and_no_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 0.5)
    with pytest.raises(ClusterError, match=r"No scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        Cluster("tcp://127.0.0.1:9")
    with dask_of(tmp_path, 0) as empty, pytest.raises(ClusterError, match="has no workers"):
        monkeypatch.setattr(module, "PATIENCE", 2.0)
        Cluster(empty.address)


def count_scenes():
    """Let a worker count the scenes that it unpacks and loads."""
    from pellucid.cluster import work

    unpack, work.loaded = work.Work.request_in, 0

    def counted(self, folder):
        work.loaded += 1
        return unpack(self, folder)

    work.Work.request_in = counted


def counted_scenes():
    from pellucid.cluster import work

    return work.loaded


def test_a_scene_goes_to_a_worker_once(dask, scene, monkeypatch):
    """Not once a task, of which there are six."""
    sent = []
    here = sys.modules[__name__]
    cloudpickle.register_pickle_by_value(here)  # workers do not find the folder of tests
    monkeypatch.setattr(Bundle, "__getstate__", lambda self: sent.append(self) or vars(self), raising=False)
    with Cluster(dask.address) as cluster:
        cluster._client.run(count_scenes)
        cluster.render(scene, spp=1)
        assert max(cluster._client.run(counted_scenes).values()) == 1
    cloudpickle.unregister_pickle_by_value(here)
    assert len(sent) == 1


def test_the_python_interface(dask, scene, tmp_path):
    run("render", scene, "-o", "once.exr", "--spp", 3, "--no-denoise")
    once = np.array(mi.Bitmap("once.exr").convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    with pellucid.Cluster(dask.address) as cluster:
        picture = cluster.render(scene, spp=3)
        assert picture.shape == (16, 24, 3) and picture.dtype == np.float32
        np.testing.assert_array_equal(picture, once)
        cluster.turntable(scene, tmp_path / "turn", frames=2, spp=1)
        with pytest.raises(pellucid.PellucidError, match=r"no option 'ssp' \(did you mean 'spp'\?\)"):
            cluster.render(scene, ssp=3)
    assert len(list((tmp_path / "turn").glob("*.png"))) == 2
