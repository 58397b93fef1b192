"""The page in a real browser: what is done in it is seen in it."""

import time

import numpy as np

from worlds.fake_source import FakeSource
from worlds.served import Served, look_at, open_page, wait_for

UP = np.array([0.0, 0.0, 1.0])


def change(page, act):
    """Act, and wait until the picture has changed; gives the picture afterwards."""
    before = look_at(page)
    act()
    return wait_for(lambda: differs(before, look_at(page)))


def differs(before, after):
    return after if np.abs(before - after).mean() > 0.5 else None


def choose(page, label, option):
    page.get_by_role("combobox", name=label, exact=True).or_(page.get_by_label(label, exact=True)).first.click()
    page.get_by_role("option", name=option, exact=True).click()


def on_screen(served, point):
    """Project a point of the viewer's page to the screen."""
    view = next(iter(served.viewer.pages.values())).client.camera
    ahead = view.look_at - view.position
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, view.up_direction)
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    offset = np.asarray(point) - view.position
    slope = np.tan(view.fov / 2)
    x, y = offset @ right / (offset @ ahead) / slope, offset @ above / (offset @ ahead) / slope
    return x, y


def test_a_frame_is_seen_undistorted(page, served):
    canvas = page.locator("canvas").first.bounding_box()

    def fits():  # the page may still be laying itself out
        (width, height), moving = served.source.calls[-1]
        return not moving and abs(width / height - canvas["width"] / canvas["height"]) < 0.01

    wait_for(fits)
    picture = look_at(page)
    ball = np.abs(picture - picture[-1, 0]).max(axis=-1) > 20
    assert 0.1 < ball.mean() < 0.9


def test_it_is_said_why_python_draws(page, served):
    page.get_by_text("Drawn by Python, not by this browser. It has two bodies.").wait_for(timeout=60_000)


def test_material_method_samples_and_exposure(page, served):
    change(page, lambda: choose(page, "Preset", "ketchup"))
    assert served.source.bodies[0].medium.name == "ketchup"
    wait_for(lambda: served.viewer.material.sigma_a.value[1] == 0.97)
    change(page, lambda: choose(page, "Method", "hybrid: texture space and shadow map"))
    assert served.source.settings.method == "hybrid"
    choose(page, "Samples N", "2500")
    wait_for(lambda: served.source.settings.samples == 2500)
    change(page, lambda: choose(page, "Preset", "marble"))


def test_the_camera_turns_and_zooms(page, served):
    box = page.locator("canvas").first.bounding_box()
    middle = (box["x"] + box["width"] * 0.3, box["y"] + box["height"] * 0.7)

    def orbit():
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] + 120, middle[1], steps=6)
        page.mouse.up()

    change(page, orbit)
    change(page, lambda: (page.mouse.move(*middle), page.mouse.wheel(0, 600)))
    assert any(moving for _, moving in served.source.calls)
    wait_for(lambda: served.quiet)
    assert served.source.calls[-1][1] is False


def test_the_light_is_dragged(page, served):
    canvas = page.locator("canvas").first.bounding_box()
    before = served.source.lights[0].position
    handle = np.array(served.viewer.light.gizmo.position)

    def pixel(point):
        x, y = on_screen(served, point)
        height = canvas["height"]
        return canvas["x"] + (canvas["width"] + x * height) / 2, canvas["y"] + (1 - y) * height / 2

    def drag():
        page.mouse.move(*pixel(handle + UP * 0.2))  # on the arrow that points up
        page.mouse.down()
        page.mouse.move(*pixel(handle - UP * 1.2), steps=8)
        page.mouse.up()

    change(page, drag)
    after = served.source.lights[0].position
    assert after[2] < before[2] - 20 and np.allclose(after[:2], before[:2], atol=2)
    wait_for(lambda: np.allclose(served.viewer.light.position.value, served.source.lights[0].position, atol=0.01))


def test_samples_are_shown_and_hidden(page, served):
    box = page.get_by_label("Show samples").first
    plain = look_at(page)
    dotted = change(page, lambda: box.click())
    orange = (dotted[..., 0] > 200) & (dotted[..., 2] < 90)
    assert orange.mean() > 0.005
    change(page, lambda: box.click())
    assert wait_for(lambda: np.abs(look_at(page) - plain).mean() < 1.5)


def test_two_clients_have_cameras_of_their_own(browser, page, served):
    one, two = page, open_page(browser, served, 800, 400)
    assert len(served.viewer.pages) == 2
    sizes = {page.view.resolution for page in served.viewer.pages.values()}
    assert len(sizes) == 2
    still = look_at(one)
    two.mouse.move(100, 250)
    two.mouse.down()
    change(two, lambda: (two.mouse.move(330, 250, steps=6), two.mouse.up()))
    wait_for(lambda: served.quiet)
    assert np.abs(look_at(one) - still).mean() < 0.5
    change(one, lambda: choose(two, "Preset", "skimmilk"))  # what is shown is shared
    two.close()
    wait_for(lambda: len(served.viewer.pages) == 1)


def test_idle_cores_are_given_back(page, served):
    wait_for(lambda: served.quiet)
    time.sleep(0.5)
    frames, busy = served.viewer.loop.frames, time.process_time()
    time.sleep(2)
    assert served.viewer.loop.frames == frames
    assert time.process_time() - busy < 0.1


def test_a_client_that_leaves_in_the_middle_of_a_frame(browser):
    slow = Served(FakeSource(seconds=0.4))
    try:
        page = browser.new_page(viewport={"width": 500, "height": 400})
        page.goto(slow.url)
        wait_for(lambda: bool(slow.source.calls))  # the first frame is being made
        page.close()
        wait_for(lambda: not slow.viewer.pages)
        again = browser.new_page(viewport={"width": 500, "height": 400})
        again.goto(slow.url)
        wait_for(lambda: slow.quiet)
        again.close()
    finally:
        slow.stop()


def test_what_cannot_be_is_said_in_the_page(page, served):
    served.viewer.loop.edit("impossible", lambda source: source.set_light(1, position=np.zeros(3)))
    page.get_by_text("light 'sky' has no position").wait_for(timeout=15_000)
    change(page, lambda: choose(page, "Preset", "skin2"))  # and everything goes on


def test_comparison_with_two_pass(page, served):
    page.get_by_text("Compare with two-pass").click()
    page.get_by_text("Render this view by two-pass").click()
    page.get_by_text("Difference ×").wait_for(timeout=60_000)
    assert "RMSE" in served.viewer.comparison.text.content
    assert not served.viewer.comparison.run
    page.get_by_role("button", name="Close").last.click()
    page.get_by_text("Difference ×").wait_for(state="hidden", timeout=10_000)


def test_pictures_and_scenes_are_saved(page, served, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with page.expect_download() as download:
        page.get_by_text("Picture (PNG)").click()
    assert download.value.suggested_filename == "ball.png"
    page.get_by_text("Scene for Mitsuba").click()
    wait_for(lambda: (tmp_path / "ball_view" / "scene.xml").is_file())
    page.get_by_text("Scene for Mitsuba").click()
    wait_for(lambda: (tmp_path / "ball_view_2" / "scene.xml").is_file())
