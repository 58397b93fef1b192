"""How the viewer begins and ends, and what it says when it cannot begin."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest
import trimesh

from pellucid.errors import EnvironmentProblem
from pellucid.viewer.opening import Opening, check_installed, check_port, page_address
from worlds.served import free_port, wait_for


def pellucid(*arguments, **options):
    command = [sys.executable, "-m", "pellucid", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


def test_a_port_in_use_is_one_line_with_a_remedy():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = pellucid("view", "teapot", "--no-browser", "--port", port)
    assert done.returncode == 2 and not done.stdout
    line = done.stderr.strip()
    assert "\n" not in line and f"127.0.0.1:{port}" in line and f"--port {port + 1}" in line


def test_an_address_that_is_not_ours():
    with pytest.raises(EnvironmentProblem, match="--host"):
        check_port("203.0.113.1", free_port())
    with pytest.raises(EnvironmentProblem, match="cannot listen at nowhere"):
        check_port("nowhere.invalid", free_port())


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(EnvironmentProblem, match=r"pip install '\.\[viewer\]'"):
        check_installed()


def test_an_unknown_scene_is_one_line():
    done = pellucid("view", "teapto", "--no-browser", "--port", free_port())
    assert done.returncode == 2 and "did you mean 'teapot'" in done.stderr and len(done.stderr.splitlines()) == 1


def test_addresses_of_pages():
    assert page_address("127.0.0.1", 8080) == "http://127.0.0.1:8080"
    assert page_address("0.0.0.0", 80) == "http://localhost:80"
    assert page_address("::1", 80) == "http://[::1]:80"


def test_the_page_is_there_before_the_scene_and_needs_one_port_only():
    port = free_port()
    opening = Opening("127.0.0.1", port, "ball")
    server = opening.server()
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=10) as answer:
            page = answer.read().decode()
        assert "<html" in page and f":{port}" not in page and "127.0.0.1" not in page.split("<script")[0]
    finally:
        server.stop()


def test_an_error_while_opening_reaches_who_waits(monkeypatch):
    import viser

    monkeypatch.setattr(viser, "ViserServer", lambda **options: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        Opening("127.0.0.1", free_port(), "ball").server()


@pytest.mark.parametrize("scene", ["ball.xml", "ball.ply"], ids=["streamed", "drawn by the browser"])
def test_control_c_ends_it_as_it_ends_other_commands(scene, tmp_path):
    scene, port = tmp_path / scene, free_port()
    if scene.suffix == ".xml":
        scene.write_text(BALL)
    else:
        trimesh.creation.icosphere(subdivisions=2, radius=20).export(scene)
    command = [sys.executable, "-m", "pellucid", "view", str(scene), "--no-browser", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        first = process.stdout.readline()
        assert f"http://127.0.0.1:{port}" in first, process.stderr.read()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 130 and errors.strip() == "interrupted: the viewer is closed"
    finally:
        process.kill()
    wait_for(lambda: check_port("127.0.0.1", port) is None)


BALL = """<scene version="3.0.0">
  <integrator type="pellucid_two_pass"/>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0, -20, 6" target="0, 0, 0" up="0, 0, 1"/></transform>
    <float name="fov" value="25"/>
  </sensor>
  <emitter type="point"><point name="position" x="9" y="-12" z="14"/><rgb name="intensity" value="300"/></emitter>
  <shape type="sphere" id="ball"><float name="radius" value="3"/><bsdf type="pellucid_translucent"/></shape>
</scene>"""
