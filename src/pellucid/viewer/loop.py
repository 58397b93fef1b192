"""Who is drawn when: one thread makes all frames, for all who look, and rests as soon as nothing changes."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from ..realtime.source import Camera, Frame, FrameSource

SETTLE = 0.25  # seconds without a change after which the settled picture is made
TARGET = 1 / 15  # seconds that a frame may take while something moves, before its resolution is lowered
LOWEST_SCALE = 0.35
MAX_PIXELS = 1 << 20  # a larger window is drawn smaller and stretched

Edit = Callable[[FrameSource], None]


@dataclass(eq=False)
class View:
    """One looker-on: what they see, how large, and where their frames go.

    ``show`` is called on the thread of the loop with every frame, and whether something moves. ``scale`` is the share of
    the full width and height that moving frames have. A view is *fresh* when its last frame shows the present state,
    *settled* when that frame was a still one.
    """

    camera: Camera
    resolution: tuple[int, int]
    show: Callable[[Frame, bool], None]
    scale: float = 1.0
    fresh: bool = False
    settled: bool = False
    changed: float = field(default_factory=time.monotonic)
    served: float = 0.0

    def touch(self) -> None:
        """Note that something in this view has changed."""
        self.fresh = self.settled = False
        self.changed = time.monotonic()

    def size(self, moving: bool) -> tuple[int, int]:
        """Choose the size of the next frame, of the proportions of the window."""
        width, height = self.resolution
        scale = min(self.scale if moving else 1.0, math.sqrt(MAX_PIXELS / (width * height)))
        width, height = max(8, round(width * scale)), max(8, round(height * scale))
        width = min(width, MAX_PIXELS // 8)  # of a window that is a line
        return width, min(height, MAX_PIXELS // width)

    def adapt(self, seconds: float) -> None:
        """Let moving frames shrink when they take too long, and grow again when there is time."""
        wanted = self.scale * math.sqrt(TARGET / max(seconds, 1e-4))
        if seconds > 1.2 * TARGET or (seconds < 0.7 * TARGET and self.scale < 1):
            self.scale = min(1.0, max(LOWEST_SCALE, 0.5 * (self.scale + wanted)))


class RenderLoop:
    """Makes frames for all views and carries out all edits, on the one thread that calls `run`.

    Other threads may call every other method. Edits with the same key that have not been carried out yet are one edit:
    the last. Nothing runs between a settled picture and the next change.

    Attributes
    ----------
    frames : int
        How many have been made.
    busy : bool
        Whether edits are being carried out, or a frame is being made.
    """

    def __init__(self, source: FrameSource, on_error: Callable[[Exception], None] | None = None):
        self.source = source
        self.frames, self.busy = 0, True
        self._on_error = on_error or (lambda error: None)
        self._wake = threading.Condition()
        self._views: list[View] = []
        self._edits: dict[Hashable, Edit] = {}
        self._stopped = False

    # ------------------------------------------------------------------ from any thread

    def add(self, view: View) -> None:
        """Draw for one more."""
        with self._wake:
            self._views.append(view)
            self._wake.notify()

    def remove(self, view: View) -> None:
        """Draw no more for a view; a frame of it that is being made now is thrown away."""
        with self._wake:
            if view in self._views:
                self._views.remove(view)

    def look(self, view: View, camera: Camera, resolution: tuple[int, int]) -> None:
        """Move the camera of a view."""
        with self._wake:
            view.camera, view.resolution = camera, resolution
            view.touch()
            self._wake.notify()

    def edit(self, key: Hashable, change: Edit) -> None:
        """Have the scene or the settings changed before the next frame."""
        with self._wake:
            self._edits.pop(key, None)  # the last one goes to the end
            self._edits[key] = change
            self._wake.notify()

    def stop(self) -> None:
        """Let `run` return after the frame that is being made."""
        with self._wake:
            self._stopped = True
            self._wake.notify()

    # ------------------------------------------------------------------ on the thread of the loop

    def run(self) -> None:
        """Make frames until `stop` is called."""
        while not self._stopped:
            with self._wake:
                edits, self._edits = self._edits, {}
            self._carry_out(edits)
            view, moving, rest = self._next()
            if view is not None:
                self._draw(view, moving)
                continue
            with self._wake:
                if not (self._stopped or self._edits):
                    self.busy = False
                    self._wake.wait(rest)
                    self.busy = True

    def _carry_out(self, edits: dict[Hashable, Edit]) -> None:
        """Apply edits; one that cannot be is reported, and the others are applied all the same."""
        for change in edits.values():
            try:
                change(self.source)
            except Exception as error:
                self._on_error(error)
        if edits:
            with self._wake:
                for view in self._views:
                    view.touch()

    def _next(self) -> tuple[View | None, bool, float | None]:
        """Choose who is drawn now, and whether they move; or how long to rest [s], None for until something happens.

        Who moves comes first, in turns. Pictures settle one after the other: a source may refine only one at a time.
        """
        with self._wake:
            for view in sorted(self._views, key=lambda view: view.served):
                if not view.fresh:
                    return view, True, 0
            now = time.monotonic()
            unsettled = [view for view in self._views if not view.settled]
            for view in unsettled:
                if now >= view.changed + SETTLE:
                    return view, False, 0
            return None, False, min((view.changed + SETTLE - now for view in unsettled), default=None)

    def _draw(self, view: View, moving: bool) -> None:
        """Make one frame and show it, unless its view has gone meanwhile."""
        with self._wake:
            camera, size = view.camera, view.size(moving)
            view.fresh = True  # a change from now on asks for another frame
            view.settled = not moving
        began = time.monotonic()
        try:
            frame = self.source.frame(camera, size, moving)
            self.frames += 1
            with self._wake:
                view.served = time.monotonic()
                if moving:
                    view.adapt(view.served - began)
                elif not frame.still:
                    view.settled = False
                present = view in self._views
            if present:
                view.show(frame, moving)
        except Exception as error:
            view.settled = True  # do not try the same again until something changes
            self._on_error(error)
