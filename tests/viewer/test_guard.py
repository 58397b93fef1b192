"""What a hostile page or program gets from the viewer: nothing."""

import http.client
import http.server
import threading
import time

import numpy as np
import pytest

import pellucid
from pellucid.viewer.guard import Door, is_loopback
from pellucid.viewer.loop import MAX_PIXELS, View
from pellucid.viewer.opening import other_address
from worlds.served import free_port, wait_for


@pytest.mark.parametrize(
    ("listens", "host", "origin", "admitted"),
    [
        ("127.0.0.1", "localhost:8080", "http://localhost:8080", True),
        ("127.0.0.1", "127.0.0.1:8080", None, True),
        ("127.0.0.1", "localhost:9000", "http://localhost:9000", True),  # the other end of an SSH tunnel
        ("127.0.0.1", "[::1]:8080", "http://[::1]:8080", True),
        ("127.0.0.1", "localhost:8080", "http://localhost:3000", False),  # another page of this machine
        ("127.0.0.1", "localhost:8080", "https://evil.example", False),
        ("127.0.0.1", "localhost:8080", "null", False),
        ("127.0.0.1", "localhost:8080", "http://[", False),  # no address at all
        ("127.0.0.1", "evil.example:8080", "http://evil.example:8080", False),  # its name leads here
        ("127.0.0.1", "evil.example", None, False),
        ("127.0.0.1", "192.168.1.7:8080", None, False),
        ("127.0.0.1", "", None, False),
        ("127.0.0.1", "[::1", None, False),
        ("box.lan", "box.lan:8080", "http://box.lan:8080", True),
        ("box.lan", "other.lan:8080", None, False),
        ("0.0.0.0", "192.168.1.7:8080", "http://192.168.1.7:8080", True),
        ("0.0.0.0", "evil.example:8080", "http://evil.example:8080", False),
    ],
)
def test_who_is_admitted(listens, host, origin, admitted):
    assert Door(listens).admits([host], [] if origin is None else [origin]) is admitted


def test_headers_that_come_twice_or_not_at_all():
    door = Door("127.0.0.1")
    assert not door.admits([], [])
    assert not door.admits(["localhost", "evil.example"], [])
    assert not door.admits(["localhost"], ["http://localhost", "http://evil.example"])


def test_addresses_for_other_machines():
    assert other_address("127.0.0.1", 80) is None and other_address("localhost", 80) is None
    assert is_loopback("::1") and is_loopback("127.0.0.9") and not is_loopback("box.lan")
    assert other_address("10.1.2.3", 80) == "http://10.1.2.3:80"
    everywhere = other_address("0.0.0.0", 80)
    assert everywhere.startswith("http://") and "0.0.0.0" not in everywhere and "localhost" not in everywhere


def test_a_forged_host_gets_no_page(served):
    for host, expected in (("evil.example", 403), (f"localhost:{served.port}", 200)):
        connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=10)
        connection.request("GET", "/", headers={"Host": host})
        answer = connection.getresponse()
        assert answer.status == expected
        assert (b"<html" in answer.read()) is (expected == 200)
        connection.close()


EVIL = """<html><script>
const socket = new WebSocket("ws://127.0.0.1:PORT", ["viser-vVERSION"]);
socket.onopen = () => document.title = "open"; socket.onerror = () => document.title = "refused";
</script></html>"""


def test_a_page_on_another_origin_gets_no_connection(browser, served):
    import viser

    text = EVIL.replace("PORT", str(served.port)).replace("VERSION", viser.__version__).encode()

    class Evil(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_):
            pass

    port = free_port()
    elsewhere = http.server.HTTPServer(("127.0.0.1", port), Evil)
    threading.Thread(target=elsewhere.serve_forever, daemon=True).start()
    try:
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_function("document.title != ''", timeout=20_000)
        assert page.title() == "refused"
        page.close()
    finally:
        elsewhere.shutdown()
    assert not served.viewer.pages


# ------------------------------------------------------------------ values


def send(served, messages):
    """Say something over a connection as a program can."""
    import msgspec
    import viser
    from websockets.sync.client import connect

    protocol = f"viser-v{viser.__version__}"
    with connect(f"ws://127.0.0.1:{served.port}", subprotocols=[protocol], max_size=None) as socket:
        for message in messages:
            socket.send(msgspec.msgpack.encode(message))
        time.sleep(1.0)


def camera(**changes):
    view = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -5.0, 0.0), "look_at": (0.0, 0.0, 0.0)}
    view |= {"up_direction": (0.0, 0.0, 1.0), "fov": 0.6, "near": 0.1, "far": 100.0}
    return {"type": "ViewerCameraMessage", **view, "image_width": 64, "image_height": 48, **changes}


def update(control, value):
    return {"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": {"value": value}}


def test_values_out_of_range_change_nothing(page, served):
    viewer, source = served.viewer, served.source
    before = (source.bodies[0].size_mm, source.lights[0].position.tolist(), source.settings.exposure)
    bad = [
        *(update(viewer.size.size, value) for value in (1e300, -1.0, 0.0, float("nan"), "large", [1.0], None, True)),
        update(viewer.size.scale, 40.0),
        *(update(viewer.light.position, v) for v in ([1e300, 0, 0], [float("inf")] * 3, [1.0, 2.0], "abc")),
        update(viewer.light.colour, [300, 0, 0]),
        update(viewer.light.visible, 3),
        update(viewer.material.preset, "gold"),
        update(viewer.material.preset, 7),
        update(viewer.material.eta, 0.1),
        update(viewer.material.dmfp, [0.0, 1.0, 1.0]),
        {"type": "GuiUpdateMessage", "uuid": viewer.size.size._impl.uuid, "updates": {"removed": True}},
        {"type": "TransformControlsUpdateMessage", "name": "/lamp", "wxyz": [1, 0, 0, 0], "position": [1e30, 0, 0]},
    ]
    send(served, [camera(), *bad])
    assert (source.bodies[0].size_mm, source.lights[0].position.tolist(), source.settings.exposure) == before
    assert viewer.size.size.value == pytest.approx(before[0]) and viewer.material.preset.value == "skin1"
    send(served, [camera(), update(viewer.size.size, 55)])  # and what can be is done
    wait_for(lambda: source.bodies[0].size_mm == 55)
    send(served, [camera(), update(viewer.size.size, before[0])])
    wait_for(lambda: served.quiet)


def test_a_connection_over_which_nonsense_comes_is_closed_with_one_line(page, served):
    """Not with the traceback of a library."""
    view = camera()
    for message in ([], {**view, "position": "abc"}):
        with pytest.warns(pellucid.PellucidWarning, match="no message; its connection is closed"):
            send(served, [view, message])
    send(served, [view])
    wait_for(lambda: served.quiet)


def test_a_fault_of_the_viewer_is_not_said_to_be_of_a_page(served, caplog):
    """It is told as what it is."""
    connected = served.viewer.server._websock_server._client_connect_cb
    connected.append(lambda client: 1 / 0)
    try:
        send(served, [])
    finally:
        connected.pop()
    assert "no message" not in caplog.text and "ZeroDivisionError" in caplog.text


def test_windows_and_cameras_that_cannot_be_are_not_drawn(page, served):
    wait_for(lambda: served.quiet)
    served.source.calls.clear()
    nan = float("nan")
    bad = [
        *(camera(image_width=10_000_000, image_height=8), camera(image_width=-4), camera(fov=nan), camera(fov=9.0)),
        *(camera(position=(nan, 0, 0)), camera(position=(1e300, 0, 0)), camera(position=(0.0, 0.0, 0.0))),
        *(camera(up_direction=(0, 0, 0)), camera(look_at=(1.0, 2.0)), camera(image_width="wide")),
    ]
    send(served, bad)
    assert served.source.calls == []
    send(served, [camera(), *bad[:-1]])  # the same from someone who is looking
    assert {size for size, _ in served.source.calls} == {(64, 48)}
    wait_for(lambda: len(served.viewer.pages) == 1)
    assert wait_for(lambda: served.quiet)


@pytest.mark.parametrize("window", [(10_000_000, 8), (8, 10_000_000), (16_384, 16_384), (1 << 40, 1)])
def test_no_window_passes_the_limit_of_pixels(window):
    width, height = View(None, window, print).size(moving=False)
    assert width * height <= MAX_PIXELS and min(width, height) >= 8


def test_a_frame_that_fails_does_not_spoil_the_next(page, served):
    """One looker-on asks for what fails; the others, and the next frame, are as ever."""
    source, view = served.source, next(iter(served.viewer.pages.values())).view
    wait_for(lambda: served.quiet)
    make = source.frame
    source.frame = lambda *_: 1 / 0
    try:
        served.viewer.loop.edit("fails", lambda source: None)
        page.get_by_text("division by zero").wait_for(timeout=15_000)
        time.sleep(0.6)
    finally:
        source.frame = make
    source.calls.clear()
    served.viewer.loop.look(view, view.camera, view.resolution)
    wait_for(lambda: served.quiet and any(not moving for _, moving in source.calls))


def test_the_comparison_is_exposed_as_the_view_is():
    from pellucid.realtime.tone import tone_map
    from pellucid.viewer.comparison import Comparison

    frame, body = np.full((4, 5, 3), 0.3), np.ones((4, 5), bool)
    average, exposure = 0.7, 2.0
    shown = Comparison.of(frame, 2 * frame, body, average / 2**exposure)
    np.testing.assert_allclose(shown.frame, tone_map(frame, average, exposure))
    np.testing.assert_allclose(shown.reference, tone_map(2 * frame, average, exposure))
