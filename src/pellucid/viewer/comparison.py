"""The present view by two-pass, rendered beside the viewer by a process of its own, and how far the frame is from it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..metrics import rmse
from ..realtime.source import FrameSource
from ..realtime.tone import tone_map

OUTSIDE = 0.1  # grey of the pixels that show no translucent body: they are not compared
FULL_DEPTH, DIRECT_DEPTH = 6, 2  # of the light paths: with and without light by way of other surfaces


@dataclass
class Comparison:
    """A frame, its reference, and their difference.

    Attributes
    ----------
    frame, reference : (h, w, 3) float
        Tone-mapped as the view is, in [0, 1); grey where no translucent body is seen.
    body : (h, w) bool
        Where translucent bodies are seen.
    """

    frame: np.ndarray
    reference: np.ndarray
    body: np.ndarray

    @classmethod
    def of(cls, frame: np.ndarray, reference: np.ndarray, body: np.ndarray, half: float) -> Comparison:
        """Compare two linear pictures, ``(h, w, 3) float``; ``half`` is the radiance that the view shows as one half."""
        outside = ~body[..., None]
        one, other = (np.where(outside, OUTSIDE, tone_map(picture, half)) for picture in (frame, reference))
        return cls(one, other, body)

    @property
    def error(self) -> float:
        """RMSE of the tone-mapped pictures over the pixels of the bodies."""
        return float(rmse(self.frame[self.body], self.reference[self.body])) if self.body.any() else 0.0

    def difference(self) -> tuple[np.ndarray, float]:
        """Amplify the difference by a round factor, so that its largest values (99.5 %) are about white."""
        difference = np.abs(self.frame - self.reference) * self.body[..., None]
        largest = float(np.quantile(difference[self.body], 0.995)) if self.body.any() else 0.0
        factor = 2.0 ** np.floor(np.log2(1 / max(largest, 1e-3)))
        return np.minimum(factor * difference, 1), float(max(factor, 1))


class ReferenceRun:
    """One reference on its way: renders a saved scene in another process, and tells how far that is.

    ``on_progress(stage, share)`` and ``on_end(picture and body or None, error text)`` are called from a thread of its own.
    """

    def __init__(
        self,
        on_progress: Callable[[str, float], None],
        on_end: Callable[[tuple[np.ndarray, np.ndarray] | None, str], None],
    ):
        self._on_progress, self._on_end = on_progress, on_end
        self._folder = tempfile.TemporaryDirectory(prefix="pellucid-")
        self._process: subprocess.Popen[str] | None = None
        self._cancelled = False

    def start(self, write: Callable[[Path], Path], size: tuple[int, int], depth: int) -> None:
        """Let ``write`` save the scene in a folder, on the thread that owns it, and begin."""
        try:
            path = write(Path(self._folder.name) / "scene")
        except Exception:
            self._folder.cleanup()
            raise
        self._output = Path(self._folder.name) / "reference.npz"
        arguments = [str(path), *map(str, size), str(depth), str(self._output), mi.variant()]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pellucid.viewer.reference", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C reaches it through `cancel`
        )
        threading.Thread(target=self._watch, daemon=True).start()

    def cancel(self) -> None:
        """End it, whatever it has done."""
        self._cancelled = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def _watch(self) -> None:
        """Follow the process until it ends."""
        process = self._process
        assert process is not None and process.stdout is not None
        for line in process.stdout:
            stage, done, total = line.split()
            self._on_progress(stage.replace("_", " "), int(done) / max(int(total), 1))
        _, errors = process.communicate()
        try:
            if process.returncode == 0:
                with np.load(self._output) as result:
                    found = result["picture"], result["body"]
                self._on_end(found, "")
            elif self._cancelled:
                self._on_end(None, "")
            else:
                last = (errors.strip().splitlines() or [f"it ended with code {process.returncode}"])[-1]
                self._on_end(None, last)
        finally:
            self._folder.cleanup()


class ComparisonControls:
    """The folder of the comparison: a button, how far it is, and what came out."""

    def __init__(self, server: Any, viewer: Any):
        self.viewer = viewer
        self.run: ReferenceRun | None = None
        gui = server.gui
        with gui.add_folder("Compare with two-pass", expand_by_default=False):
            self.button = gui.add_button("Render this view by two-pass")
            self.stop = gui.add_button("Stop", visible=False)
            self.bar = gui.add_progress_bar(0, visible=False, animated=True)
            self.text = gui.add_markdown("")

        @self.button.on_click
        async def _(event: Any) -> None:
            self.begin(event.client)

        @self.stop.on_click
        async def _(event: Any) -> None:
            self.close()

    def begin(self, client: Any) -> None:
        """Compare what a client sees now; on the thread of the loop."""
        page = self.viewer.pages.get(client.client_id)
        if page is None or self.run is not None:
            return
        view: list[Any] = []

        def end(found: tuple[np.ndarray, np.ndarray] | None, error: str) -> None:
            frame, half = view
            self._end(client, None if found is None else Comparison.of(frame, *found, half), error)

        self.run = run = ReferenceRun(self._progress, end)
        self._progress("saving", 0.0)

        def start(source: FrameSource) -> None:
            camera, size = page.view.camera, page.view.size(moving=False)
            try:
                view[:] = source.linear(camera, size), source.half()
                depth = FULL_DEPTH if source.settings.gi else DIRECT_DEPTH
                run.start(lambda folder: self.viewer.writer.write(folder, camera, size), size, depth)
            except Exception:
                self._end(client, None, "the scene could not be saved")
                raise

        self.viewer.loop.edit("comparison", start)

    def close(self) -> None:
        """Stop the reference that is on its way, if there is one."""
        if self.run is not None:
            self.run.cancel()

    def _progress(self, stage: str, share: float) -> None:
        self.button.visible, self.stop.visible, self.bar.visible = False, True, True
        self.bar.value = float(np.clip(100 * share, 0, 100))
        self.text.content = f"Two-pass: {stage} …"

    def _end(self, client: Any, result: Comparison | None, error: str) -> None:
        self.run = None
        self.button.visible, self.stop.visible, self.bar.visible = True, False, False
        self.text.content = f"It failed: {error}" if error else "Stopped."
        if result is None:
            return
        difference, factor = result.difference()
        self.text.content = f"**RMSE {result.error:.4f}** of tone-mapped pictures in [0, 1], on translucent pixels"
        with client.gui.add_modal(f"Two-pass: RMSE {result.error:.4f}") as modal:
            for label, picture in (
                ("This view", result.frame),
                ("Two-pass", result.reference),
                (f"Difference × {factor:g}", difference),
            ):
                pixels = (255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)
                client.gui.add_image(pixels, label=label, format="jpeg", jpeg_quality=90)
            close = client.gui.add_button("Close")

        @close.on_click
        async def _(event: Any) -> None:
            modal.close()
