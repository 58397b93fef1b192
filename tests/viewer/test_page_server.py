"""The exported page, served: who may ask, what is refused, what becomes of the state that a page sends."""

import http.client
import json
import socket
import struct
import threading
import time

import mitsuba as mi
import numpy as np
import pytest

from pellucid import load_scene
from pellucid.errors import PellucidError, SceneError
from pellucid.page.restored import Given, restored_scene
from pellucid.page.scene import page_scene
from pellucid.page.surface import harmonics, sphere_directions
from pellucid.scene.bodies import find_bodies
from pellucid.viewer.page_server import PageServer
from pellucid.viewer.page_session import PageSession
from pellucid.viewer.saving import write_dictionary
from worlds.exported import bumpy, model_scene
from worlds.served import free_port, wait_for


class Answering:
    """A server with a session on threads of their own."""

    def __init__(self, host="127.0.0.1"):
        self.port, self.loaded = free_port(), []
        self.session = PageSession(page_scene(model_scene(), "bumps"), self.load)
        self.server = PageServer(host, self.port, self.session)
        self.threads = [threading.Thread(target=self.work), threading.Thread(target=self.server.serve_forever)]
        for thread in self.threads:
            thread.start()

    def work(self):
        mi.set_variant("llvm_ad_rgb")
        self.session.run()

    def load(self, path):
        if not path.startswith("other"):
            raise SceneError(f"There is no file '{path}'.")
        return page_scene(model_scene(bumpy(2)), "other")

    def ask(self, method, path, body=None, **headers):
        names = {"Host": f"127.0.0.1:{self.port}", "Authorization": f"Bearer {self.server.token}"}
        if body is not None:
            names["Content-Type"] = "application/json"
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request(method, path, None if body is None else json.dumps(body), names | headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, content, answer.headers

    def stop(self):
        self.session.end()
        self.server.shutdown()
        self.server.server_close()
        for thread in self.threads:
            thread.join(10)
            assert not thread.is_alive()


@pytest.fixture(scope="module")
def answering():
    answering = Answering()
    yield answering
    answering.stop()


def state_of(contents, **changes):
    """The state that a page sends when it has just been opened."""
    head = contents.head
    return {**head["state"], "camera": head["camera"], "width": 48, "height": 40, **changes}


def test_the_page_comes_with_a_policy_of_its_own(answering):
    status, content, headers = answering.ask("GET", "/")
    text = content.decode()
    assert status == 200 and "connect-src 'self'" in text and '"served":true' in text
    assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert headers["X-Content-Type-Options"] == "nosniff" and headers["Cache-Control"] == "no-store"
    assert answering.ask("GET", "/etc/passwd")[0] == answering.ask("GET", "http://[")[0] == 404


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Origin": "https://evil.example"},
        {"Origin": "http://["},
        {"Host": "evil.example", "Origin": "http://evil.example"},
    ],
)
def test_other_pages_are_refused(answering, headers):
    for method, path, body in (("GET", "/", None), ("GET", "/comparison", None), ("POST", "/scene", {})):
        assert answering.ask(method, path, body, **headers)[0] == 403


def test_forms_and_floods_are_refused(answering):
    form = {"Content-Type": "application/x-www-form-urlencoded"}
    assert answering.ask("POST", "/scene", {}, **form)[0] == 400
    assert answering.ask("POST", "/scene", {}, **{"Content-Length": str(1 << 30)})[0] == 400
    assert answering.ask("POST", "/elsewhere", {})[0] == 400


def test_nonsense_and_those_who_have_gone_are_no_traceback(answering, capfd):
    """Brackets within brackets that no JSON ends, and a connection that is cut before the answer."""
    request = f"POST /scene HTTP/1.1\r\nHost: 127.0.0.1:{answering.port}\r\nContent-Type: application/json\r\n"
    for body in (b"[" * 100_000, b"{}"):
        with socket.create_connection(("127.0.0.1", answering.port)) as connection:
            connection.sendall(request.encode() + b"Content-Length: %d\r\n\r\n" % len(body) + body)
            if body == b"{}":
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            else:
                assert b" 422 " in connection.recv(100)
    time.sleep(0.3)
    assert capfd.readouterr().err == ""


def test_beyond_this_machine_a_token_is_asked_for():
    answering = Answering("0.0.0.0")
    try:
        token = answering.server.token
        assert len(token) >= 20
        assert answering.ask("GET", "/")[0] == 403
        assert answering.ask("GET", f"/?token={token}")[0] == 200
        assert answering.ask("GET", "/comparison")[0] == 200
        assert answering.ask("GET", "/comparison", Authorization="Bearer x")[0] == 403
        assert answering.ask("POST", "/scene", {}, Authorization="")[0] == 403
    finally:
        answering.stop()


def test_another_mesh_takes_the_place_of_the_first(answering):
    status, content, _ = answering.ask("POST", "/open", {"path": "nowhere.ply"})
    assert status == 422 and json.loads(content)["error"] == "There is no file 'nowhere.ply'."
    assert answering.ask("POST", "/open", {"path": 7})[0] == 422
    assert json.loads(answering.ask("POST", "/open", {"path": "other.ply"})[1]) == {"name": "other"}
    assert '"name":"other"' in answering.ask("GET", "/")[1].decode()


def test_a_scene_is_written_where_the_viewer_was_started(answering, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    state = state_of(answering.session.contents)
    path = json.loads(answering.ask("POST", "/scene", state)[1])["path"]
    assert path.endswith("_view/scene.xml")
    scene = load_scene(tmp_path / path)
    assert tuple(scene.sensors()[0].film().size()) == (48, 40)
    assert json.loads(answering.ask("POST", "/scene", state)[1])["path"] != path


def test_the_saved_scene_has_the_state_of_the_page(tmp_path):
    contents = page_scene(model_scene(), "bumps")
    lamps = [
        {"kind": "directional", "position": [0, 0, 2], "colour": [1, 0.5, 0], "intensity": 3},
        {"kind": "point", "position": [9, 40, 1], "colour": [1, 1, 1], "intensity": 500},
    ]
    medium = {"scattering": [1, 2, 3], "absorption": [0.1, 0.2, 0.3], "eta": 1.4, "g": 0.2}
    sky = np.zeros((9, 3))
    sky[0], sky[2], sky[3] = 3.0, [1.0, 0.5, 0.0], [0.3, 0, 0]
    state = Given(state_of(contents, lamps=lamps, medium=medium, millimetres=50, sky=sky.tolist(), floor=True))
    spec, materials = restored_scene(contents.body, contents.extent, state)
    scene = load_scene(write_dictionary(spec, materials, tmp_path / "scene"))
    saved = page_scene(scene, "again")
    found = saved.head["state"]
    assert np.allclose(found["medium"]["scattering"], medium["scattering"], rtol=1e-4)
    assert found["medium"]["eta"] == pytest.approx(1.4) and found["millimetres"] == pytest.approx(50, rel=1e-3)
    assert found["floor"]
    for lamp, again in zip(lamps, sorted(found["lamps"], key=lambda lamp: lamp["kind"]), strict=True):
        assert lamp["kind"] == again["kind"] and lamp["intensity"] == pytest.approx(again["intensity"], rel=1e-4)
        scale = 2 if lamp["kind"] == "directional" else 1  # directions come back as unit vectors
        assert np.allclose(lamp["position"], np.array(again["position"]) * scale, atol=1e-3)
    d = sphere_directions(100)
    assert np.allclose(harmonics(d) @ np.array(found["sky"]), harmonics(d) @ sky, atol=0.03)
    assert np.allclose(saved.head["camera"]["origin"], contents.head["camera"]["origin"], rtol=1e-4)


@pytest.mark.parametrize("kind", ["bitmap", "mesh_attribute"])
def test_the_saved_scene_has_the_texture_of_the_body(kind, tmp_path):
    """Also where a picture is turned and repeated, and colours have a name and a factor of their own."""
    vertices, normals, faces = bumpy(2)
    picture = mi.Bitmap(np.random.default_rng(1).uniform(0.1, 0.9, (4, 8, 3)).astype(np.float32))
    places = mi.ScalarTransform3f().rotate(30).scale([2, 3])
    textures = {
        "bitmap": {"type": "bitmap", "bitmap": picture, "raw": True, "to_uv": places},
        "mesh_attribute": {"type": "mesh_attribute", "name": "vertex_tint", "scale": 0.5},
    }
    mesh, uv = (vertices, normals, faces), vertices[:, :2] / 30 + 0.5
    scene = model_scene(mesh, {"reflectance": textures[kind], "dmfp": 2.0}, uv=uv)
    colours = np.clip(0.5 + 0.05 * vertices, 0.1, 1)
    scene.shapes()[0].add_attribute("vertex_tint", 3, colours.ravel().tolist())
    contents = page_scene(scene, "texture")
    spec, materials = restored_scene(contents.body, contents.extent, Given(state_of(contents)))
    saved = load_scene(write_dictionary(spec, materials, tmp_path / "scene"))
    seen = []
    for each in (scene, saved):
        ray = mi.Ray3f(mi.Point3f(np.linspace(-5, 5, 20), 0, 40), mi.Vector3f(0, 0, -1))
        si = each.ray_intersect(ray)
        seen.append(find_bodies(each)[0].bsdf.texture.eval(si).numpy())
    assert np.ptp(seen[0]) > 0.1 and np.allclose(*seen, atol=1e-4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"medium": {"scattering": [1, 2], "absorption": [0, 0, 0], "eta": 1.3, "g": 0}},
        {"medium": {"scattering": [1, 2, float("nan")], "absorption": [0, 0, 0], "eta": 1.3, "g": 0}},
        {"millimetres": "50"},
        {"millimetres": -1},
        {"lamps": [{}] * 5},
        {"lamps": [{"kind": "point", "position": [1, 2, 3], "colour": [2, 0, 0], "intensity": 1}]},
        {"camera": None},
        {"width": 1e9},
        {"sky": [[1, 1, 1]]},
    ],
    ids=str,
)
def test_states_that_cannot_be_are_refused(wrong):
    contents = page_scene(model_scene(), "bumps")
    with pytest.raises(PellucidError):
        restored_scene(contents.body, contents.extent, Given(state_of(contents, **wrong)))


def test_a_comparison_in_the_page(browser):
    answering = Answering()
    try:
        page = browser.new_page(viewport={"width": 560, "height": 320})
        page.goto(f"http://127.0.0.1:{answering.port}/#test")
        page.wait_for_selector("body[data-ready=yes]")
        page.evaluate(
            "() => { pellucid.loop.size = () => [64, 48]; pellucid.loop.pace.rate = 1e9; pellucid.loop.start = () => {}; }"
        )
        page.evaluate("document.getElementById('compare').click()")
        wait_for(lambda: page.evaluate("document.getElementById('comparison').open"), 60)
        text = page.text_content("#comparisonText")
        assert 0.0005 < float(text.split()[1]) < 0.04, text
        assert page.locator("#pictures canvas").count() == 3
        page.evaluate("document.querySelector('dialog button').click()")
        assert not page.evaluate("document.getElementById('comparison').open")
        page.evaluate("document.getElementById('compare').click()")
        wait_for(lambda: answering.session.progress()["state"] == "running")
        page.goto("about:blank")  # nobody waits for it any more
        wait_for(lambda: answering.session.progress()["state"] != "running")
        page.close()
    finally:
        answering.stop()
