"""The page: one server, many lookers-on, each with a camera of their own."""

from __future__ import annotations

import time
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import PellucidError
from ..realtime.source import Camera, Frame, FrameSource
from ..realtime.space import Space
from .comparison import ComparisonControls
from .controls import Gui
from .keeping import KeepingControls
from .lights import LightControls
from .loop import RenderLoop, View
from .material import MaterialControls, SizeControl
from .picture import PictureControls
from .saving import Origin, SceneWriter

QUALITY_MOVING, QUALITY_STILL = 75, 92  # of the JPEG
MARGIN = 1.3  # by which a page sees more than the camera of the scene: its panel covers as much
REPORT_PERIOD = 0.3  # seconds between two updates of the table of times
SEEN, HIDDEN = (
    np.array([[255, 140, 40]], np.uint8),
    np.array([[70, 50, 90]], np.uint8),
)  # colours of samples in front, and behind


class Viewer:
    """Connects the clients of a server with the loop that draws for them; ``reason`` says why that is not the browser."""

    def __init__(
        self, server: Any, source: FrameSource, name: str, origin: Origin, sensor: Any = None, reason: str = ""
    ):
        self.server, self.name = server, name
        self.loop = RenderLoop(source, self._tell)
        self.space = Space.of(source.scene)
        self.first_camera = self.space.first_camera(sensor or source.scene.sensors()[0])
        self.writer = SceneWriter(origin, source)
        self.pages: dict[int, Page] = {}
        server.gui.reset()
        server.gui.main_panel.dock_right()
        if reason:
            server.gui.add_markdown(f"Drawn by Python, not by this browser. {reason}")
        self._place_camera()
        self.material = MaterialControls(server.gui, self.loop)
        self.size = SizeControl(server.gui, self.loop)
        self.light = LightControls(server, self.loop, self.space)
        self.picture = PictureControls(server.gui, self.loop)
        self.comparison = ComparisonControls(server, self)
        self.keeping = KeepingControls(server, self)
        server.on_client_connect(self._connect)
        server.on_client_disconnect(self._disconnect)

    def run(self) -> None:
        """Draw until the loop is stopped or interrupted, then close the page."""
        try:
            self.loop.run()
        finally:
            self.comparison.close()
            self.server.stop()

    # ------------------------------------------------------------------ clients

    def _place_camera(self) -> None:
        """Let every page begin at the camera of the scene."""
        camera = self.first_camera
        fov = 2 * float(np.arctan(MARGIN * np.tan(np.deg2rad(camera.fov) / 2)))
        place = {"position": self.space.to_page(camera.origin), "look_at": self.space.to_page(camera.target)}
        self.server.scene.set_up_direction(tuple(np.asarray(camera.up, float)))
        self.server.initial_camera.position = tuple(place["position"])
        self.server.initial_camera.look_at = tuple(place["look_at"])
        self.server.initial_camera.up = tuple(np.asarray(camera.up, float))
        self.server.initial_camera.fov = fov
        for client in self.server.get_clients().values():  # who came while the scene was prepared
            client.camera.up_direction = camera.up
            client.camera.position = place["position"]
            client.camera.look_at = place["look_at"]
            client.camera.fov = fov

    async def _connect(self, client: Any) -> None:
        """Begin to draw for a client."""
        page = Page(self, client)
        self.pages[client.client_id] = page
        self.loop.add(page.view)

        @client.camera.on_update
        async def _(camera: Any) -> None:
            self.loop.look(page.view, *self.look(camera))

    async def _disconnect(self, client: Any) -> None:
        """Draw no more for a client that has left."""
        page = self.pages.pop(client.client_id, None)
        if page is not None:
            self.loop.remove(page.view)

    def look(self, camera: Any) -> tuple[Camera, tuple[int, int]]:
        """Translate the camera of a page: where it is in the scene, and how large its window."""
        seen = Camera(
            self.space.to_scene(camera.position),
            self.space.to_scene(camera.look_at),
            np.array(camera.up_direction, float),
            float(np.rad2deg(camera.fov)),
        )
        return seen, (max(int(camera.image_width), 8), max(int(camera.image_height), 8))

    def _tell(self, error: Exception) -> None:
        """Show an error on all pages."""
        text = " ".join(str(error).split()) or type(error).__name__
        title = "This cannot be" if isinstance(error, PellucidError) else "Something went wrong"
        for client in self.server.get_clients().values():
            client.add_notification(title, text, color="red", auto_close_seconds=8.0)


class Page:
    """What one client sees: frames behind the handles, samples if asked for, and the times of its frames."""

    def __init__(self, viewer: Viewer, client: Any):
        self.viewer, self.client = viewer, client
        camera, resolution = viewer.look(client.camera)
        self.view = View(camera, resolution, self.show)
        self.last: Frame | None = None
        self._reported = 0.0
        self._points: Any = None
        gui: Gui = client.gui
        self._summary = gui.add_markdown("", order=-1)
        with gui.add_folder("Frame time", expand_by_default=False):
            self._times = gui.add_markdown("")

    def show(self, frame: Frame, moving: bool) -> None:
        """Send a frame; on the thread of the loop."""
        self.last = frame
        quality = QUALITY_STILL if frame.still else QUALITY_MOVING
        self.client.scene.set_background_image(frame.pixels, format="jpeg", jpeg_quality=quality)
        self._show_samples(frame)
        self.client.flush()
        now = time.monotonic()
        if frame.still or now > self._reported + REPORT_PERIOD:
            self._report(frame, moving)
            self._reported = now

    def _show_samples(self, frame: Frame) -> None:
        """Show the samples of a frame as points, if asked to."""
        wanted = self.viewer.picture.points.value and len(frame.samples) > 0
        if not wanted:
            if self._points is not None:
                self._points.remove()
                self._points = None
            return
        seen = visible(self.viewer.loop.source.scene, self.view.camera, frame.samples)
        colours = np.where(seen[:, None], SEEN, HIDDEN)
        self._points = self.client.scene.add_point_cloud(
            "/samples",
            self.viewer.space.to_page(frame.samples).astype(np.float32),
            colours,
            point_size=0.008,
            point_shape="circle",
            point_shading="flat",
            precision="float32",
        )

    def _report(self, frame: Frame, moving: bool) -> None:
        """Write the times of a frame by stage [ms]."""
        height, width = frame.pixels.shape[:2]
        whole = frame.seconds.get("whole", sum(frame.seconds.values()))
        state = "still" if frame.still else f"{1 / max(whole, 1e-6):.0f} frames/s" if moving else "settling"
        self._summary.content = f"**{state}** · {width} × {height} · {1e3 * whole:.0f} ms"
        rows = "".join(f"| {stage} | {1e3 * seconds:.1f} |\n" for stage, seconds in frame.seconds.items())
        self._times.content = f"| stage | ms |\n| --- | ---: |\n{rows}"


def visible(scene: mi.Scene, camera: Camera, points: np.ndarray) -> np.ndarray:
    """Tell which points of a surface, (k, 3) float, nothing hides from a camera: ``(k,) bool``."""
    origin = mi.Point3f(*(float(x) for x in np.asarray(camera.origin)))
    p = mi.Point3f(np.ascontiguousarray(points.T, np.float32))
    ray = mi.Ray3f(origin, p - origin)
    ray.maxt = mi.Float(1 - 1e-3)
    return ~np.array(scene.ray_test(ray), bool)
