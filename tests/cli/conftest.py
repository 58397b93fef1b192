"""The command line, and a scene file to run it with."""

import pytest
from click.testing import CliRunner

from pellucid.cli.main import pellucid
from worlds.terminal import write_scene


@pytest.fixture
def scene_file(tmp_path):
    return write_scene(tmp_path / "ball.xml")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the command line in an empty folder; ``result.output`` holds both streams, ``result.stderr`` the errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pellucid.cli.reporter.LONG", 600)  # no lines about stages where a machine is busy

    def run(*args, code=0):
        result = CliRunner().invoke(pellucid, [str(arg) for arg in args])
        assert result.exit_code == code, (result.exit_code, result.output, result.exception)
        return result

    return run
