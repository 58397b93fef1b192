"""What a served page works on: one scene at a time, changed on the one thread that owns Mitsuba's state."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..errors import PellucidError, SceneError
from ..page.assemble import page
from ..page.restored import Given, restored_scene
from ..page.scene import PageScene
from .comparison import DIRECT_DEPTH, ReferenceRun
from .saving import free_name, write_dictionary

T = TypeVar("T")
MOST_PIXELS = 1 << 20  # of a comparison


class PageSession:
    """The scene that a page shows, and what the page may do with it. Threads of requests call its methods; `run` does the work.

    Parameters
    ----------
    contents : PageScene
    load : callable
        Loads another scene from a path, or raises `SceneError` where a page cannot show it.
    """

    def __init__(self, contents: PageScene, load: Callable[[str], PageScene]):
        self.contents, self._load = contents, load
        self._jobs: queue.Queue[tuple[Callable[[], Any], Future[Any]] | None] = queue.Queue()
        self._lock = threading.Lock()
        self._run: ReferenceRun | None = None
        self._progress: dict[str, Any] = {"state": "none"}
        self._found: tuple[np.ndarray, np.ndarray] | None = None

    # ------------------------------------------------------------------ the thread that owns the scene

    def run(self) -> None:
        """Carry out what is asked for, until `end`."""
        while (job := self._jobs.get()) is not None:
            act, future = job
            try:
                future.set_result(act())
            except Exception as error:
                future.set_exception(error)

    def end(self) -> None:
        """Carry out nothing more."""
        self._cancel()
        self._jobs.put(None)

    def _do(self, act: Callable[[], T]) -> T:
        future: Future[T] = Future()
        self._jobs.put((act, future))
        return future.result()

    # ------------------------------------------------------------------ what a page may ask for

    def page(self) -> str:
        """Write the page."""
        return page(self.contents, served=True)

    def compare(self, given: Any) -> dict[str, Any]:
        """Begin to render what a page shows by two-pass, in a process of its own."""
        state = Given(given)
        size = int(state.number("width", 8, 4096)), int(state.number("height", 8, 4096))
        if size[0] * size[1] > MOST_PIXELS:
            raise SceneError(
                f"A picture of {size[0]} x {size[1]} is too large to be compared: make the window smaller."
            )
        with self._lock:
            if self._run is not None:
                raise PellucidError("A comparison is on its way: stop it first.")
            run = self._run = ReferenceRun(self._advance, self._finish)
            self._progress = {"state": "running", "stage": "saving", "share": 0.0}
        try:
            self._do(lambda: run.start(lambda folder: self._write(folder, state), size, DIRECT_DEPTH))
        except BaseException:
            self._run = None
            raise
        return self._progress

    def progress(self) -> dict[str, Any]:
        """Tell how far the comparison is."""
        return self._progress

    def picture(self) -> bytes:
        """Hand out the reference: radiance in red, green and blue, and whether a body is seen, as float32, row by row."""
        if self._found is None:
            raise PellucidError("There is no comparison that has ended.")
        radiance, body = self._found
        return np.concatenate([radiance, body[..., None]], axis=2).astype("<f4").tobytes()

    def stop(self, given: Any) -> dict[str, Any]:
        """End the comparison."""
        self._cancel()
        return {}

    def save(self, given: Any) -> dict[str, Any]:
        """Write what a page shows as a scene of Mitsuba, into the folder in which the viewer was started."""
        state = Given(given)
        folder = free_name(Path(f"{self.contents.head['name']}_view"))
        return {"path": str(self._do(lambda: self._write(folder, state)))}

    def open(self, given: Any) -> dict[str, Any]:
        """Show another mesh or scene."""
        path = Given(given).values.get("path")
        if not isinstance(path, str) or not path:
            raise SceneError("Name a mesh or a scene to open.")
        self._do(lambda: self._show(path))
        return {"name": self.contents.head["name"]}

    # ------------------------------------------------------------------ on the thread of the scene

    def _show(self, path: str) -> None:
        self.contents = self._load(path)

    def _write(self, folder: Path, state: Given) -> Path:
        return write_dictionary(*restored_scene(self.contents.body, self.contents.extent, state), folder)

    # ------------------------------------------------------------------ on the thread of the comparison

    def _advance(self, stage: str, share: float) -> None:
        self._progress = {"state": "running", "stage": stage, "share": share}

    def _finish(self, found: tuple[np.ndarray, np.ndarray] | None, error: str) -> None:
        self._found = found
        state = "done" if found is not None else "failed" if error else "stopped"
        self._progress = {"state": state, "error": error}
        self._run = None

    def _cancel(self) -> None:
        if self._run is not None:
            self._run.cancel()
