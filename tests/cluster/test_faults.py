"""What is lost, and how it is told: schedulers, memory; and the encrypted connection, on the loopback."""

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner
from dask import config
from distributed import Client
from distributed.security import Security

from pellucid.cli.main import pellucid as command
from pellucid.cluster import cluster as module
from pellucid.cluster import worker
from pellucid.cluster.cluster import Cluster
from pellucid.cluster.parts import Parts
from pellucid.errors import ClusterError, EnvironmentProblem
from pellucid.jobs.frames import FrameFolder
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
    """What has come back is kept, frames and tiles, and is not rendered again."""
    kept: dict[type, list[int]] = {FrameFolder: [], TileFolder: []}
    turn = ["turntable", scene, "--frames", 3, "-o", "turn", "--no-denoise"]
    picture = ["render", scene, "--no-denoise"]
    losing = []

    def count(kind, number, keep):
        def counted(self, *piece):
            keep(self, *piece)
            kept[kind].append(number(*piece))
            if losing and len(kept[kind]) == 1:
                stop(losing.pop())

        return counted

    monkeypatch.setattr(FrameFolder, "keep", count(FrameFolder, lambda frame, _: frame, FrameFolder.keep))
    monkeypatch.setattr(TileFolder, "keep", count(TileFolder, lambda tile: tile.number, TileFolder.keep))

    def lose(dask, arguments):
        losing.append(dask.scheduler)
        with Client(dask.address, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=30)
        with monkeypatch.context() as impatient:
            impatient.setattr(module, "PATIENCE", 2.0)
            told = run(*arguments, "--cluster", dask.address, code=2).stderr
        assert told.startswith(f"error: The scheduler at '{dask.address}' is lost") and told.count("\n") == 1
        return told

    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
    with dask_of(tmp_path / "a", 1) as dask:
        told = lose(dask, turn)
    assert f"{len(kept[FrameFolder])} of 3 frames are in 'turn': the same command goes on" in told
    with dask_of(tmp_path / "b", 1) as dask:
        run(*turn, "--cluster", dask.address)
        told = lose(dask, [*picture, "-o", "all.exr"])
    assert f"{len(kept[TileFolder])} of 6 tiles are in 'all_tiles': the same command goes on" in told
    with dask_of(tmp_path / "c", 1) as dask:
        run(*picture, "-o", "all.exr", "--cluster", dask.address)
    assert sorted(kept[FrameFolder]) == [0, 1, 2] and sorted(kept[TileFolder]) == [1, 2, 3, 4, 5, 6]
    run(*picture, "-o", "once.exr")
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


def test_parts_of_lost_workers_go_to_those_that_have_the_fewest(monkeypatch):
    monkeypatch.setattr("pellucid.cluster.parts.LOOK", 0.0)
    parts = Parts("key", 5, ["a", "b", "c"])
    assert not parts.moved(lambda: ["a", "b", "c"])
    assert not parts.moved(lambda: [])  # another one may come
    assert parts.moved(lambda: ["a", "b"]) and parts.at == {0: "a", 1: "b", 2: "a", 3: "a", 4: "b"}
    assert parts.moved(lambda: ["b"]) and parts.moved(lambda: ["d"])
    with pytest.raises(ClusterError, match="4 workers that kept parts of the samples were lost"):
        parts.moved(lambda: ["e"])


def little_memory():
    worker.WATCHED = 1e-4


def run_out(error):
    with worker._plain_errors():
        raise error


def test_a_worker_that_does_not_have_the_memory_says_how_much_it_needs(scene):
    """Dask ends a worker at its limit; before samples or a picture that would reach it, the number is told."""
    with Cluster("local:1") as cluster:
        name = rf"The worker 0 \({cluster.workers[0]}\)"
        for error in (MemoryError(), RuntimeError("jit_malloc(): out of memory! Could not allocate 8 bytes")):
            with pytest.raises(EnvironmentProblem, match=rf"{name} is out of memory with [\d.]+ GB of the [\d.]+ GB"):
                cluster._client.submit(run_out, error, pure=False).result()
        cluster._client.run(little_memory)
        with pytest.raises(EnvironmentProblem, match=rf"{name}: 300 surface samples need about \S+ GB .* and 0 GB are"):
            cluster.render(scene)
        with pytest.raises(
            EnvironmentProblem, match=rf"{name}: A picture of 8x8 pixels needs about \S+ GB .* 0 GB are"
        ):
            cluster.render(scene, method="sampled")


GLUTTON = """
import time

import numpy as np

from pellucid.jobs.job import Job


def eat(*_):
    eaten = np.ones(1 << 27)
    time.sleep(60)


Job.render_tile = eat
"""


def test_workers_that_end_again_and_again_are_told_with_their_memory(scene, tmp_path):
    """A nanny ends its worker at the limit; the first time is once too often here."""
    (tmp_path / "glutton.py").write_text(GLUTTON)
    with dask_of(tmp_path, 0, {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}) as dask:
        dask.add_worker("--memory-limit", "1GB", "--preload", str(tmp_path / "glutton.py"), nanny=True)
        told = run("render", scene, "--no-denoise", "--cluster", dask.address, code=2).stderr
    assert told.startswith("error: 1 workers were lost at one and the same piece, the last one tcp://127.0.0.1:")
    assert "their memory of 1 GB is not enough" in told and "No tile is finished." in told


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
