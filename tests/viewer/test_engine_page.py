"""The page with the real engine behind it; and, when asked for, a short film of it for the documents.

``PELLUCID_CAPTURE=docs/gallery/viewer.webp pytest tests/viewer/test_engine_page.py`` writes the film.
"""

import io
import os
from pathlib import Path

import numpy as np
import pytest

from pellucid import load_scene
from worlds.fake_source import ball_scene
from worlds.served import Served, look_at, open_page, wait_for

CAPTURE = os.environ.get("PELLUCID_CAPTURE")
UP = np.array([0.0, 0.0, 1.0])


class Film:
    """Pictures of a page, as an animated WebP."""

    def __init__(self, page):
        self.page, self.pictures = page, []

    def shoot(self, times=1):
        from PIL import Image

        for _ in range(times):
            self.pictures.append(Image.open(io.BytesIO(self.page.screenshot())).convert("RGB"))

    def write(self, path: Path):
        beside = path.with_suffix(".part.webp")
        first, *others = self.pictures
        first.save(beside, save_all=True, append_images=others, duration=150, loop=0, quality=75, method=5)
        beside.replace(path)


@pytest.fixture(scope="module")
def real():
    pytest.importorskip("viser", reason="viser is not installed")
    from pellucid.realtime.engine import Engine

    engine = Engine(load_scene(ball_scene()), resolution=256)
    engine.settings.gi = False
    served = Served(engine)
    yield served
    served.stop()


def changed(page, before):
    """Wait until a page looks different."""
    return wait_for(lambda: after if np.abs((after := look_at(page)) - before).mean() > 0.5 else None)


def test_the_real_engine_answers_to_the_page(browser, real):
    page = open_page(browser, real, 800, 450)
    light, material, picture = real.viewer.light, real.viewer.material, real.viewer.picture
    before = look_at(page)
    light._drag(np.array(light.gizmo.position) - 1.2 * UP)
    before = changed(page, before)
    material.preset.value = "marble"
    material._from_preset()
    changed(page, before)
    real.source.settings.gi = False
    wait_for(lambda: real.quiet)
    before = look_at(page)
    real.viewer.loop.edit("method", lambda source: setattr(source.settings, "method", "hybrid"))
    real.viewer.loop.edit("samples", lambda source: setattr(source.settings, "samples", 100))
    wait_for(lambda: real.quiet)
    wait_for(lambda: real.source.settings.method == "hybrid")
    assert picture.points.value is False and look_at(page).std() > 5
    page.close()


@pytest.mark.skipif(not CAPTURE, reason="PELLUCID_CAPTURE names no file")
def test_capture(browser):
    """Film orbit, light, material, size and samples, on the built-in teapot in marble."""
    from pellucid.realtime.engine import Engine

    engine = Engine(load_scene(film_scene()), resolution=512)
    engine.settings.method = "hybrid"
    served = Served(engine, "teapot")
    try:
        page = open_page(browser, served, 960, 540)
        for close in page.locator(".mantine-Notification-closeButton").all():
            close.click()
        page.wait_for_timeout(1000)
        film, viewer = Film(page), served.viewer
        film.shoot(4)
        page.mouse.move(240, 420)
        page.mouse.down()
        for step in range(10):
            page.mouse.move(240 + 18 * step, 420)
            film.shoot()
        page.mouse.up()
        place = np.array(viewer.light.gizmo.position)
        for turn in np.linspace(0, 1.6 * np.pi, 14):
            x, y = np.cos(turn) * place[0] - np.sin(turn) * place[1], np.sin(turn) * place[0] + np.cos(turn) * place[1]
            viewer.light.gizmo.position = (x, y, place[2])
            viewer.light._drag(np.array([x, y, place[2]]))
            page.wait_for_timeout(200)
            film.shoot()
        for name in ("skin1", "skimmilk", "apple", "ketchup", "marble"):
            viewer.material.preset.value = name
            viewer.material._from_preset()
            page.wait_for_timeout(600)
            film.shoot(3)
        for millimetres in (28.0, 20.0, 14.0, 10.0):
            viewer.size._set(millimetres)
            page.wait_for_timeout(500)
            film.shoot(2)
        viewer.picture.points.value = True
        viewer.loop.edit("points", lambda source: None)
        page.wait_for_timeout(1000)
        film.shoot(6)
        film.write(Path(CAPTURE))
        page.close()
    finally:
        served.stop()
    assert Path(CAPTURE).stat().st_size < 1.5e6


def film_scene():
    """Describe a teapot between two lamps that shine from points."""
    from pellucid.scenes.loading import scene_dict

    scene = scene_dict("teapot", size=40.0, bsdf={"type": "pellucid_translucent", "material": "marble"})
    lamps = {"key", "fill"}
    lamp = {"type": "point", "position": [-60.0, -20.0, 60.0], "intensity": {"type": "rgb", "value": [9e4, 8e4, 7e4]}}
    fill = {
        "type": "point",
        "position": [70.0, -70.0, 40.0],
        "intensity": {"type": "rgb", "value": [1.5e4, 1.8e4, 2e4]},
    }
    return {name: part for name, part in scene.items() if name not in lamps} | {"lamp": lamp, "other": fill}
