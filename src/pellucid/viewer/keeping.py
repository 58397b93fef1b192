"""The folder in which the present view is kept: as a picture, and as a scene."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from ..realtime.source import FrameSource
from .saving import free_name


class KeepingControls:
    """Two buttons: the picture goes to whoever presses, the scene into the folder that the viewer was started in."""

    def __init__(self, server: Any, viewer: Any):
        self.viewer = viewer
        gui = server.gui
        with gui.add_folder("Save"):
            self.picture = gui.add_button("Picture (PNG)", hint="Sent to this browser")
            self.scene = gui.add_button("Scene for Mitsuba", hint="Written where the viewer was started")
            self.text = gui.add_markdown("")

        @self.picture.on_click
        async def _(event: Any) -> None:
            page = viewer.pages.get(event.client_id)
            if page is not None:
                viewer.loop.edit(("picture", event.client_id), lambda source: self._save_picture(source, page))

        @self.scene.on_click
        async def _(event: Any) -> None:
            page = viewer.pages.get(event.client_id)
            if page is not None:
                viewer.loop.edit("scene", lambda source: self._save_scene(page))

    def _save_picture(self, source: FrameSource, page: Any) -> None:
        """Make the settled picture of a page, and send it there as a file."""
        frame = source.frame(page.view.camera, page.view.size(moving=False), False)
        page.client.send_file_download(f"{self.viewer.name}.png", png(frame.pixels), save_immediately=True)

    def _save_scene(self, page: Any) -> None:
        """Write the scene, with the camera of a page."""
        folder = free_name(Path(f"{self.viewer.name}_view"))
        path = self.viewer.writer.write(folder, page.view.camera, page.view.resolution)
        self.text.content = f"Wrote `{path}`: see it again with `pellucid view {path}`."


def png(pixels: np.ndarray) -> bytes:
    """Write a picture, (h, w, 3) uint8, as PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "PNG")
    return buffer.getvalue()
