"""What is lost, and how it is told: schedulers, memory; and the encrypted connection, on the loopback."""

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from dask import config
from distributed import Client, KilledWorker
from distributed.security import Security

from pellucid.cli.main import pellucid as command
from pellucid.cluster import cluster as module
from pellucid.cluster import worker
from pellucid.cluster.cluster import Cluster
from pellucid.errors import ClusterError, EnvironmentProblem
from pellucid.jobs.job import Request
from pellucid.jobs.tiles import TileFolder
from worlds.daskers import dask_of, stop
from worlds.terminal import write_scene

ROLES = [(role, part) for role in ("CLIENT", "SCHEDULER", "WORKER") for part in ("CERT", "KEY")]


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "TILE_SIDE", 8)
    return write_scene(tmp_path / "ball.xml")


def run(*arguments, code=0):
    result = CliRunner().invoke(command, [*map(str, arguments), "-q"])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def read(path):
    return np.array(mi.Bitmap(str(path)))


def test_the_scheduler_is_lost_and_the_same_command_goes_on(scene, tmp_path, monkeypatch):
    keep, kept = TileFolder.keep, []
    common = ["render", scene, "--no-denoise"]
    with dask_of(tmp_path, 1) as dask:

        def lose(self, tile):
            keep(self, tile)
            kept.append(tile.number)
            if len(kept) == 2:
                stop(dask.scheduler)

        monkeypatch.setattr(TileFolder, "keep", lose)
        with Client(dask.address, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=30)
        with monkeypatch.context() as impatient:
            impatient.setattr(module, "PATIENCE", 2.0)
            told = run(*common, "-o", "all.exr", "--cluster", dask.address, code=2).stderr
    assert told.startswith(f"error: The scheduler at '{dask.address}' is lost") and told.count("\n") == 1
    assert f"{len(kept)} of 6 tiles are in 'all_tiles': the same command goes on" in told and len(kept) < 6
    (tmp_path / "again").mkdir()
    with dask_of(tmp_path / "again", 1) as dask:
        run(*common, "-o", "all.exr", "--cluster", dask.address)
    assert sorted(kept) == [1, 2, 3, 4, 5, 6]
    run(*common, "-o", "once.exr")
    np.testing.assert_array_equal(read("all.exr"), read("once.exr"))


def test_an_encrypted_connection(scene, tmp_path, monkeypatch):
    """As the page on many machines shows it: certificates by Dask's own settings, and nobody without one."""
    made = Security.temporary()
    variables = {}
    for name, text in {
        "CA_FILE": made.tls_ca_file,
        **{f"{role}__{part}": getattr(made, f"tls_{role.lower()}_{part.lower()}") for role, part in ROLES},
    }.items():
        path = tmp_path / f"{name}.pem"
        path.write_text(text)
        variables[f"DASK_DISTRIBUTED__COMM__TLS__{name}"] = str(path)
    variables["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] = "True"
    with dask_of(tmp_path, 1, variables, "tls") as dask:
        assert dask.address.startswith("tls://")
        refused = run("render", scene, "--cluster", dask.address, code=2).stderr
        assert "needs certificates" in refused and refused.count("\n") == 1
        with monkeypatch.context() as patch:
            for name, value in variables.items():
                patch.setenv(name, value)
            config.refresh()
            run("render", scene, "-o", "all.exr", "--no-denoise", "--cluster", dask.address)
        config.refresh()
    run("render", scene, "-o", "once.exr", "--no-denoise")
    np.testing.assert_array_equal(read("all.exr"), read("once.exr"))


def little_memory():
    worker.WATCHED = 1e-4


def test_a_worker_that_does_not_have_the_memory_says_how_much_it_needs(scene):
    """Dask ends a worker at its limit; before a picture that would reach it, the number is told."""
    with Cluster("local:1") as cluster:
        cluster._client.run(little_memory)
        with pytest.raises(EnvironmentProblem, match=r"8x8 pixels needs about \S+ GB of memory, and 0 GB are free"):
            cluster.render(scene)


def test_workers_that_end_again_and_again_are_told_with_their_memory(monkeypatch):
    class Last:
        address, memory_limit = "tcp://10.0.0.7:1234", 8 * 10**9

    def lost():
        raise KilledWorker("tile", Last, 3)

    cluster = Cluster.__new__(Cluster)
    with (
        pytest.raises(ClusterError, match=r"4 workers were lost .* tcp://10\.0\.0\.7:1234\. .* memory of 8 GB"),
        cluster._losses(),
    ):
        lost()


def test_files_travel_by_name_and_stay_in_their_folder(scene, tmp_path):
    """A request reads the same on a worker as here, also where the two have no files in common."""
    from pellucid.cluster.bundle import Bundle
    from pellucid.cluster.work import Work

    (tmp_path / "maps").mkdir()
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n")
    (tmp_path / "a.mtl").write_text("map_Kd -s 1 1 1 maps/skin.png\n")
    (tmp_path / "maps/skin.png").write_bytes(b"skin")
    scene.write_text(f'<scene version="3.0.0"><string value="a.obj"/><x y="../{tmp_path.name}/ball.xml"/></scene>')
    request = Request.of(scene, definitions={"colour": "maps/skin.png", "number": "3"})
    work = Work.of(request, {})
    there = work.request_in(tmp_path / "there")
    assert sorted(work.bundle.files) == [
        "option-colour/skin.png",
        "scene/a.mtl",
        "scene/a.obj",
        "scene/ball.xml",
        "scene/maps/skin.png",
    ]
    assert there.source == str(tmp_path / "there/scene/ball.xml") and there.definitions["number"] == "3"
    assert (tmp_path / "there/scene/maps/skin.png").read_bytes() == b"skin"
    with pytest.raises(ValueError, match="does not lie below"):
        Bundle({"../b": b""}).unpack(tmp_path / "there")
