"""A viewer on a port of its own, and how to look at its page."""

import io
import socket
import threading
import time

import mitsuba as mi
import numpy as np

from worlds.fake_source import ball_scene

PATIENCE = 40.0  # seconds; a page on a loaded machine without a GPU


def wait_for(what, timeout=PATIENCE):
    """Wait until a function gives something else than None and False, and give it."""
    deadline = time.monotonic() + timeout
    while (found := what()) is None or found is False:
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.1)
    return found


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def look_at(page) -> np.ndarray:
    """Take a picture of the left half of a page, where nothing but frames is: (h, w, 3)."""
    from PIL import Image

    size = page.viewport_size
    clip = {"x": 0, "y": 140, "width": size["width"] // 2, "height": size["height"] - 140}
    return np.array(Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")).astype(float)


class Served:
    """A viewer that draws on a thread of its own."""

    def __init__(self, source, name="ball", reason=""):
        from pellucid.viewer.opening import open_server
        from pellucid.viewer.saving import Origin
        from pellucid.viewer.server import Viewer

        self.source, self.port = source, free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        server = open_server("127.0.0.1", self.port, name)
        self.viewer = Viewer(server, source, name, Origin(ball_scene()), reason=reason)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        mi.set_variant("llvm_ad_rgb")
        self.viewer.run()

    @property
    def quiet(self) -> bool:
        """Whether all pictures have settled."""
        views = [page.view for page in list(self.viewer.pages.values())]
        busy = self.viewer.loop.busy
        return bool(views) and not busy and all(view.fresh and view.settled for view in views)

    def stop(self):
        self.viewer.loop.stop()
        self._thread.join(10)
        assert not self._thread.is_alive()


def open_page(browser, served, width, height):
    """Open the page of a viewer, and wait for its settled picture."""
    page = browser.new_page(viewport={"width": width, "height": height})
    before = len(served.viewer.pages)
    page.goto(served.url)
    wait_for(lambda: len(served.viewer.pages) > before)
    wait_for(lambda: served.quiet and look_at(page).std() > 5)
    return page
