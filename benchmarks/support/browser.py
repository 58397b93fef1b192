"""An exported page in a browser without a window, which draws in software."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

FLAGS = ["--headless", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FRAME = """([changes, camera, side, mode]) => { const { engine } = pellucid;
    const state = { ...pellucid.forEngine(), highlight: 0, stops: 0, autoExposure: false, floor: false, sky: null,
        background: [0, 0, 0], ...changes };
    const begin = performance.now();
    engine.frame(state, camera, side, side, mode, 0);
    const picture = Array.from(engine.device.read(engine.composite.picture));
    const seconds = (performance.now() - begin) / 1000;
    return [picture, Array.from(engine.device.read(engine.surface.places)), engine.half(state), seconds]; }"""


@contextmanager
def browser() -> Iterator[Any]:
    """Start Chromium."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=program, args=FLAGS)
        yield started
        started.close()


def open_page(browser: Any, path: Path) -> Any:
    """Open an exported page that draws only what it is asked for."""
    page = browser.new_page()
    page.goto(f"{path.as_uri()}#test")
    page.wait_for_selector("body[data-ready=yes]", timeout=120_000)
    return page


def frame(page: Any, camera: dict[str, Any], side: int, mode: str = "pixels", **changes: Any) -> dict[str, Any]:
    """Make a picture: tone-mapped ``picture (side, side, 3)``, ``places`` that its pixels see, ``half``, ``seconds``."""
    picture, places, half, seconds = page.evaluate(FRAME, [changes, camera, side, mode])
    shown, seen = (np.array(v, np.float32).reshape(side, side, 4)[::-1, :, :3] for v in (picture, places))
    return {"picture": shown, "places": seen, "half": half, "seconds": seconds}
