"""Who is drawn when: turns, settling, coalesced edits, rest."""

import threading
import time

import numpy as np
import pytest

from pellucid.realtime.source import Camera, Frame, Settings
from pellucid.viewer.loop import MAX_PIXELS, SETTLE, TARGET, RenderLoop, View
from worlds.served import wait_for

CAMERA = Camera([0, 0, 5], [0, 0, 0])


class Counting:
    """A source that needs a few calls to settle, for one camera at a time."""

    def __init__(self, passes=3, seconds=0.0):
        self.settings, self.passes, self.seconds = Settings(), passes, seconds
        self.calls, self._before, self._done = [], None, 0

    def frame(self, camera, resolution, moving):
        time.sleep(self.seconds)
        self.calls.append((camera, resolution, moving))
        self._done = 0 if moving or camera is not self._before else self._done + 1
        self._before = camera
        return Frame(np.zeros((2, 2, 3), np.uint8), still=not moving and self._done >= self.passes)


class Shown(list):
    def __call__(self, frame, moving):
        self.append((frame, moving))

    @property
    def settled(self):
        return bool(self) and self[-1][0].still


@pytest.fixture
def start():
    running = []

    def start(source, on_error=None):
        loop = RenderLoop(source, on_error)
        thread = threading.Thread(target=loop.run)
        thread.start()
        running.append((loop, thread))
        return loop

    yield start
    for loop, thread in running:
        loop.stop()
        thread.join(5)
        assert not thread.is_alive()


def test_a_view_moves_then_settles_then_rests(start):
    source, shown = Counting(), Shown()
    loop = start(source)
    loop.add(View(CAMERA, (64, 48), shown))
    wait_for(lambda: shown.settled, 5)
    assert [moving for _, _, moving in source.calls] == [True] + [False] * 3
    time.sleep(2 * SETTLE)
    assert loop.frames == 4


def test_two_views_settle_one_after_the_other(start):
    """A source refines one picture at a time: views that took turns would never settle."""
    source, one, two = Counting(), Shown(), Shown()
    loop = start(source)
    loop.add(View(CAMERA, (64, 48), one))
    loop.add(View(Camera([0, 5, 0], [0, 0, 0]), (32, 32), two))
    wait_for(lambda: one.settled and two.settled, 5)


def test_movers_take_turns(start):
    source, one, two = Counting(seconds=0.01), Shown(), Shown()
    loop = start(source)
    views = [View(CAMERA, (64, 48), one), View(CAMERA, (32, 32), two)]
    for view in views:
        loop.add(view)
    for _ in range(30):
        for view in views:
            loop.look(view, CAMERA, view.resolution)
        time.sleep(0.01)
    wait_for(lambda: one.settled and two.settled, 5)
    assert abs(len(one) - len(two)) <= 3


def test_edits_of_one_key_become_one(start):
    source, done = Counting(seconds=0.1), []
    loop = start(source)
    loop.add(View(CAMERA, (8, 8), Shown()))
    wait_for(lambda: bool(source.calls), 5)
    for number in range(50):
        loop.edit("slider", lambda source, number=number: done.append(number))
    wait_for(lambda: 49 in done, 5)
    assert len(done) < 10


def test_an_edit_that_cannot_be_is_told_and_the_rest_goes_on(start):
    source, errors, shown = Counting(), [], Shown()
    loop = start(source, errors.append)
    loop.add(View(CAMERA, (8, 8), shown))

    def impossible(source):
        raise ValueError("no such thing")

    loop.edit("bad", impossible)
    loop.edit("good", lambda source: setattr(source.settings, "samples", 49))
    wait_for(lambda: source.settings.samples == 49 and shown.settled, 5)
    assert [str(error) for error in errors] == ["no such thing"]


def test_a_frame_that_fails_is_told_once(start):
    source, errors = Counting(), []
    source.frame = lambda *args: 1 / 0
    loop = start(source, errors.append)
    view = View(CAMERA, (8, 8), Shown())
    loop.add(view)
    wait_for(lambda: bool(errors), 5)
    time.sleep(2 * SETTLE)
    assert len(errors) == 1


def test_who_has_left_is_shown_nothing(start):
    source, shown = Counting(seconds=0.2), Shown()
    loop = start(source)
    view = View(CAMERA, (8, 8), shown)
    loop.add(view)
    time.sleep(0.1)  # its frame is being made
    loop.remove(view)
    loop.remove(view)  # and once more does no harm
    time.sleep(0.4)
    assert not shown and len(source.calls) == 1


def test_slow_frames_shrink_and_fast_ones_grow_again():
    view = View(CAMERA, (800, 600), Shown())
    for _ in range(10):
        view.adapt(4 * TARGET * view.scale**2)
    assert 0.4 < view.scale < 0.6
    width, height = view.size(moving=True)
    assert width / height == pytest.approx(4 / 3, rel=0.01)
    assert view.size(moving=False) == (800, 600)
    for _ in range(20):
        view.adapt(0.1 * TARGET)
    assert view.scale == 1


def test_huge_windows_are_drawn_smaller():
    width, height = View(CAMERA, (3840, 2160), Shown()).size(moving=False)
    assert width * height <= 1.01 * MAX_PIXELS and width / height == pytest.approx(16 / 9, rel=0.01)
