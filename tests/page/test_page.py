"""The exported page in a browser without a window: its pixels, its work, its controls. One page for all tests."""

import io
import json

import numpy as np
import pytest
import trimesh

from pellucid.model.decomposition import decompose
from pellucid.model.medium import Medium
from pellucid.model.profiles import curve_over_disc
from pellucid.page.assemble import page as written
from pellucid.page.scene import page_scene
from pellucid.page.surface import RESOLUTION
from pellucid.realtime.engine import Engine
from pellucid.realtime.tone import tone_map
from pellucid.scene.atlas.layout import build_atlas
from pellucid.scene.atlas.texels import rasterise
from pellucid.scene.bodies import find_bodies
from worlds.exported import PLAIN, SAMPLES, SIDE, coefficients, coloured_scene, frame, model_scene, seen_places
from worlds.served import wait_for

SKIN = Medium.from_preset("skin1")


@pytest.fixture(scope="module")
def scene():
    return model_scene()


@pytest.fixture(scope="module")
def contents(scene):
    return page_scene(scene, "bumps")


def new_engine(scene):
    engine = Engine(scene, RESOLUTION)
    for name, value in {"gi": False, "specular": 0.0, "samples": SAMPLES}.items():
        setattr(engine.settings, name, value)
    return engine


@pytest.fixture(scope="module")
def engine(scene):
    return new_engine(scene)


def write_page(folder, contents, name="page.html", **more):
    path = folder / name
    path.write_text(written(contents, **more), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(browser, contents, tmp_path_factory):
    path = write_page(tmp_path_factory.mktemp("page"), contents, command="pellucid export bumps.ply")
    page = browser.new_page(viewport={"width": 640, "height": 420})
    page.said, page.asked = [], []
    page.on("console", lambda message: page.said.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: page.said.append(str(error)))
    page.on("request", lambda request: page.asked.append(request.url))
    page.goto(f"{path.as_uri()}#test")  # draws only what it is asked for
    page.wait_for_selector("body[data-ready]")
    assert page.get_attribute("body", "data-ready") == "yes", page.text_content("#message")
    yield page
    page.close()


def rmse(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2)))


# ------------------------------------------------------------------ pixels


@pytest.fixture(scope="module")
def seen(scene, contents):
    from support.realtime import see_pixels

    return see_pixels(scene, contents.camera, (SIDE, SIDE), 1.5)


@pytest.fixture(scope="module")
def exact(scene, seen):
    """The sum over all samples under the same light, tone-mapped."""
    from support.realtime import reference

    truth = reference(scene, seen, "exact", sample_count=8000)
    return tone_map(truth.picture, truth.average)


def alike(page, seen):
    """Tell where a pixel of the page sees what a ray through its middle sees: rasterisers round the corners of triangles."""
    places = np.zeros((SIDE, SIDE, 3))
    places[seen.mask] = seen.points
    same = np.linalg.norm(seen_places(page) - places, axis=2) < 0.1  # of a pixel of 0.4
    assert same.mean() > 0.995
    return same


@pytest.mark.parametrize(("method", "worse"), [("texture_space", 0.002), ("hybrid", 0.001)])
def test_pixels_are_those_of_the_engine(page, engine, contents, seen, exact, method, worse):
    engine.settings.method = method
    ours = tone_map(engine.linear(contents.camera, (SIDE, SIDE)), engine.half())
    shown = frame(page, hybrid=method == "hybrid")
    same = alike(page, seen)
    assert np.any(shown > 0.3)
    assert rmse(shown[same], exact[same]) < rmse(ours[same], exact[same]) + worse


def test_another_medium_and_another_size(page, engine, contents, seen):
    engine.settings.method = "texture_space"
    engine.set_medium(0, SKIN)
    engine.set_size(40.0)
    try:
        ours = tone_map(engine.linear(contents.camera, (SIDE, SIDE)), engine.half())
    finally:
        engine.set_medium(0, Medium.from_preset("marble"))
        engine.set_size(contents.head["state"]["millimetres"])
    shown = frame(page, medium=coefficients(SKIN), millimetres=40.0)
    same = alike(page, seen)
    assert rmse(shown[same], ours[same]) < 0.004


@pytest.fixture(scope="module")
def curved(browser, tmp_path_factory):
    """A scene whose profile follows the curve, and its page."""
    scene = model_scene(material={"material": "marble", "profile": "curved"})
    path = write_page(tmp_path_factory.mktemp("curved"), page_scene(scene, "bumps"))
    page = browser.new_page()
    page.goto(f"{path.as_uri()}#test")
    page.wait_for_selector("body[data-ready=yes]")
    yield scene, page
    page.close()


@pytest.mark.filterwarnings("ignore:The real-time engine follows the curve")
def test_a_curved_profile_is_that_of_the_engine(page, curved, contents, seen):
    """Also where all of the body is so tightly curved that mu is bounded; the longer comparison has `exact` beside it."""
    scene, curved_page = curved
    engine = new_engine(scene)
    for method, millimetres in (("texture_space", 20.0), ("hybrid", 4.0)):
        engine.settings.method = method
        engine.set_size(millimetres)
        ours = tone_map(engine.linear(contents.camera, (SIDE, SIDE)), engine.half())
        state = {"hybrid": method == "hybrid", "millimetres": millimetres}
        shown = frame(curved_page, **state)
        same = alike(curved_page, seen)
        assert rmse(shown[same], ours[same]) < 0.004
        assert rmse(shown, frame(page, **state)) > 0.02  # of a flat one


def test_a_curved_profile_at_the_vertices(curved):
    _, page = curved
    assert 0 < rmse(frame(page, mode="vertices"), frame(page)) < 0.012


def test_colours_and_skies_are_those_of_the_engine(browser, tmp_path):
    scene = coloured_scene({"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 0.8, 0.6]}})
    contents = page_scene(scene, "colours")
    engine = Engine(scene, RESOLUTION)
    engine.settings.gi, engine.settings.specular, engine.settings.samples = False, 0.0, SAMPLES
    ours = tone_map(engine.linear(contents.camera, (SIDE, SIDE)), engine.half())
    page = browser.new_page()
    page.goto(f"{write_page(tmp_path, contents).as_uri()}#test")
    page.wait_for_selector("body[data-ready=yes]")
    shown = frame(page, sky=contents.head["state"]["sky"])
    body = np.abs(seen_places(page)).max(axis=2) > 0
    assert rmse(shown[body], ours[body]) < 0.02
    assert np.allclose(shown[body].mean(axis=0), ours[body].mean(axis=0), rtol=0.02)
    assert np.ptp(shown[body][:, 0] / shown[body][:, 2]) > 1  # red and blue
    page.close()


def test_light_that_grazes_draws_no_stripes(browser, tmp_path):
    """In the middle of a plate that is lit evenly, along and across the light."""
    mesh = trimesh.creation.box([20, 20, 4])
    lamp = {"type": "directional", "direction": [1.0, 0.6, -0.12], "irradiance": 3.0}
    normals = np.array(mesh.face_normals)[np.arange(12).repeat(3)]
    corners = np.array(mesh.vertices)[mesh.faces].reshape(-1, 3)
    scene = model_scene((corners, normals, np.arange(36).reshape(-1, 3)), {"material": "cream"}, lamp)
    page = browser.new_page()
    page.goto(f"{write_page(tmp_path, page_scene(scene, 'plate')).as_uri()}#test")
    page.wait_for_selector("body[data-ready=yes]")
    found = frame(page, hybrid=True, samples=1024)
    places = seen_places(page)
    on_top = (np.abs(places[..., 2] - 2) < 0.05) & (np.abs(places[..., :2]).max(axis=2) < 3)
    radiance = (found / (1 - found))[on_top]
    assert on_top.sum() > 40 and np.all(radiance.std(axis=0) < 0.04 * radiance.mean(axis=0))
    page.close()


@pytest.mark.parametrize(("mode", "bound"), [("quarter", 0.012), ("sixteenth", 0.025), ("vertices", 0.012)])
def test_fewer_sums_are_interpolated(page, mode, bound):
    assert 0 < rmse(frame(page, mode=mode, hybrid=True), frame(page, hybrid=True)) < bound


def test_as_much_light_enters(page, engine, contents):
    frame(page)
    engine.settings.method = "texture_space"
    engine.linear(contents.camera, (8, 8))
    ours = float(engine.half())
    shown = page.evaluate(
        """() => { const { engine } = pellucid, { sums, levels } = engine.irradiance;
        return engine.device.read(sums, levels)[0] / Math.PI / engine.body.area; }"""
    )
    assert shown == pytest.approx(ours, rel=3e-3)


def test_texels_are_those_of_python(page, scene):
    (body,) = find_bodies(scene)
    texels = rasterise(build_atlas(body, RESOLUTION))
    some = texels.texel[:: len(texels.texel) // 3000]
    total, places = page.evaluate(
        """(some) => { const { places } = pellucid.body.texels;
        let total = 0;
        for (let k = 3; k < places.length; k += 4) total += places[k];
        return [total, some.map((k) => Array.from(places.slice(4 * k, 4 * k + 4)))]; }""",
        some.tolist(),
    )
    shown, ours = np.array(places), texels.samples.p[:: len(texels.texel) // 3000]
    covered = shown[:, 3] > 0
    assert covered.mean() > 0.995  # corners are rounded to 1/32 of a texel
    apart = np.linalg.norm(shown[covered, :3] - ours[covered], axis=1)
    assert np.percentile(apart, 99) < 0.02  # of texels of 0.08 mm
    assert total == pytest.approx(texels.samples.area.sum(dtype=float), rel=1e-4)


@pytest.mark.parametrize(("eta", "g"), [(1.37, 0.0), (1.3, 0.9), (1.5, 0.3), (1.1, -0.5)])
def test_profiles_are_those_of_python(page, eta, g):
    r = np.array([0.02, 0.1, 0.5, 2.0, 8.0, 20.0])
    medium = Medium([0.3, 1.7, 9.0], [0.002, 0.3, 4.0], eta=eta, g=g)
    state = {"medium": coefficients(medium), "millimetres": 17.0}
    values = page.evaluate(
        """([change, radii]) => { const { engine, state } = pellucid;
        engine.frame((PLAIN)(change), state.camera, 8, 8);
        const { medium } = engine;
        return [radii.map((r) => medium.profile(r)), medium.reflectance]; }""".replace("PLAIN", PLAIN),
        [state, r.tolist()],
    )
    unit = 17.0 / page.evaluate("() => pellucid.body.extent")
    expected = medium.scaled(unit).diffuse_reflectance(r)
    near = expected > 1e-4 * expected.max(axis=0)
    assert np.allclose(np.array(values[0])[near], expected[near], rtol=0.02)
    assert np.allclose(values[1], medium.total_diffuse_reflectance, rtol=0.01)


def test_curves_are_those_of_python(curved):
    """Beta by itself, and of the far part of R_d over a disc, as the sums look it up."""
    _, page = curved
    medium, millimetres = Medium([0.5, 1.7, 9.0], [0.002, 0.3, 1.0], eta=1.37, profile="curved"), 40.0
    found, (disc, extent) = page.evaluate(
        """([change]) => { const { engine, state } = pellucid;
        engine.frame((PLAIN)(change), state.camera, 8, 8);
        const { texture, rows, smallest, slope, perSquare } = engine.rows.main, { width } = texture;
        const all = engine.device.read(texture), row = rows - 4, result = [];
        for (let column = 350; column < 800; column += 50) {
            const r = Math.sqrt((2 ** ((column / width) / slope) - 1) / perSquare);
            const beta = [0, row].map((k) => Array.from(all.slice(4 * ((rows + k) * width + column)).slice(0, 3)));
            result.push([r, engine.medium.curve(r), ...beta]);
        }
        return [result, [smallest * 2 ** ((row - 1) / 2), pellucid.body.extent]]; }""".replace("PLAIN", PLAIN),
        [{"medium": coefficients(medium), "millimetres": millimetres, "hybrid": True}],
    )
    r, beta, first, far = (np.array(values) for values in zip(*found, strict=True))
    medium = medium.scaled(millimetres / extent)
    weight = decompose(medium, scale=millimetres / extent).global_weight
    assert np.allclose(beta, medium.curve(r), atol=0.05)
    assert np.allclose(first, beta, rtol=1e-3)
    fine = np.geomspace(r[0], r[-1], 1600)
    over_disc = curve_over_disc(medium, fine, disc, weight)
    assert np.allclose(far.T, [np.interp(r, fine, over_disc[:, k]) for k in range(3)], atol=0.05)


def test_a_floor_is_lit_and_takes_a_shadow(page, contents):
    """Of a white lamp far away: albedo times irradiance over pi, and nothing where the body is on the way."""
    way = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2)
    lamp = {"kind": "directional", "position": way.tolist(), "colour": [1, 1, 1], "intensity": 3.0}
    shown = frame(page, floor=True, lamps=[lamp])
    half, places = page.evaluate(
        "() => [pellucid.engine.half({}), Array.from(pellucid.engine.device.read(pellucid.engine.surface.places))]"
    )
    places = np.array(places).reshape(SIDE, SIDE, 4)[::-1]
    centre = np.array(contents.head["body"]["low"]) + np.array(contents.head["body"]["size"]) / 2
    radius = page.evaluate("pellucid.body.radius")
    p = places[..., :3] - centre
    floor = (places[..., 3] == 2) & (np.linalg.norm(p, axis=2) < 2.4 * radius)
    beside = np.linalg.norm(np.cross(p, way), axis=2)
    lit = np.array(contents.head["constants"]["floorColour"]) * 3 * way[2] / np.pi / half
    free, covered = floor & (beside > radius), floor & (beside < 3)  # no bump is lower
    assert free.sum() > 20 and covered.sum() > 5
    assert np.allclose(shown[free], lit / (1 + lit), rtol=2e-3)
    assert np.all(shown[covered] == 0)


def test_exposure_follows_the_light_and_the_stops(page):
    plain = {"autoExposure": True, "hybrid": False}
    one = frame(page, 32, **plain)
    lamps = [{**lamp, "intensity": 8 * lamp["intensity"]} for lamp in state(page)["lamps"]]
    assert np.allclose(frame(page, 32, **plain, lamps=lamps), one, atol=2e-3)
    more = frame(page, 32, **plain, stops=1.0)
    body = one > 0
    assert np.allclose(more[body] / (1 - more[body]), 2 * one[body] / (1 - one[body]), rtol=0.02)


def test_highlights_are_as_wide_as_the_surface_is_rough(page):
    plain = frame(page, 32)
    added = [frame(page, 32, highlight=1.0, roughness=roughness) - plain for roughness in (0.3, 0.8)]
    narrow, wide = (np.sum(more.max(axis=2) > 0.02) for more in added)
    assert min(more.min() for more in added) >= 0 and wide > 5 * narrow > 0


# ------------------------------------------------------------------ work


def counts(page, changes, camera=None, mode="pixels"):
    """Make a frame, and tell which stages it went through, and how many pairs it had."""
    return page.evaluate(
        """([changes, turn, mode]) => { const { engine, state } = pellucid;
        const before = { ...engine.counts, pairs: engine.pairs }, camera = structuredClone(state.camera);
        camera.origin[0] += turn;
        engine.frame((PLAIN)(changes), camera, 48, 48, mode, 0);
        const after = { ...engine.counts, pairs: engine.pairs };
        return Object.fromEntries(Object.entries(after).map(([key, value]) => [key, value - before[key]])
            .filter(([, value]) => value > 0)); }""".replace("PLAIN", PLAIN),
        [changes, camera or 0, mode],
    )


def test_nothing_is_made_again_that_did_not_change(page):
    hybrid = {"hybrid": True}
    counts(page, hybrid)
    assert counts(page, hybrid) == {}
    assert counts(page, {**hybrid, "stops": 1.0, "highlight": 0.5, "roughness": 0.3}) == {}
    taps = 401
    pairs = 48 * 48 * (SAMPLES + taps)
    assert counts(page, hybrid, camera=1.0) == {"surface": 1, "pixels": 1, "pairs": pairs}
    counts(page, {**hybrid, "samples": 16}, mode="vertices")
    vertices = page.evaluate("() => { const { width, height } = pellucid.body.vertexPlaces; return width * height; }")
    assert counts(page, hybrid, mode="vertices") == {
        "samples": 1,
        "surface": 1,
        "vertices": 1,
        "pairs": vertices * (SAMPLES + taps),
    }
    assert counts(page, hybrid, camera=1.0, mode="vertices") == {"surface": 1}  # turning sums nothing
    counts(page, hybrid)
    assert set(counts(page, {**hybrid, "medium": coefficients(SKIN)})) >= {"profiles", "samples", "pixels"}
    assert "shadow" not in counts(page, {**hybrid, "millimetres": 31.0})
    lamp = {"kind": "directional", "position": [1, 0, 1], "colour": [1, 1, 1], "intensity": 3}
    counts(page, {**hybrid, "lamps": [lamp]})
    moved = counts(page, {**hybrid, "lamps": [{**lamp, "position": [0, 0, 1]}]})
    assert "profiles" not in moved and moved["shadow"] == moved["nearMap"] == moved["irradiance"] == 1
    brighter = counts(page, {**hybrid, "lamps": [{**lamp, "position": [0, 0, 1], "intensity": 4}]})
    assert "shadow" not in brighter and brighter["irradiance"] == 1


def test_memory_does_not_grow(page):
    used = []
    for changes in ({"samples": 900}, {"samples": 100}, {"hybrid": True}, {"sky": [[1, 1, 1]] + [[0, 0, 0]] * 8}, {}):
        frame(page, 32, **changes)
        frame(page, 32)
        used.append(page.evaluate("() => pellucid.device.bytes"))
    assert used[1:] == used[:-1]
    assert used[0] < 80e6


@pytest.mark.parametrize(
    ("rate", "mode"), [(6e10, "pixels"), (2e10, "quarter"), (1e10, "sixteenth"), (1e8, "vertices")]
)
def test_where_to_sum_follows_from_what_the_device_does(page, rate, mode):
    """At 1920 x 1080, of which a fifth shows the body, a sum has 900 + 401 pairs: half a billion a picture, in 12 ms."""
    chosen = page.evaluate(
        """([rate]) => { const { engine, loop } = pellucid, before = loop.pace.rate;
        Object.assign(loop.pace, { rate, covered: 0.2 });
        const state = (PLAIN)({ samples: 900, hybrid: true });
        engine.frame(state, pellucid.state.camera, 8, 8);
        const mode = loop.pace.mode(engine, state, 1920, 1080);
        loop.pace.rate = before;
        return mode; }""".replace("PLAIN", PLAIN),
        [rate],
    )
    assert chosen == mode


# ------------------------------------------------------------------ controls


def state(page):
    return page.evaluate("() => pellucid.state")


def test_it_is_one_file_that_asks_for_nothing(page, contents):
    frame(page)
    assert len(page.asked) == 1 and page.asked[0].startswith("file:")
    assert not [text for text in page.said if "GPU stall" not in text], page.said
    text = written(contents)
    assert len(text.encode()) < 150_000
    assert "default-src 'none'" in text and "unsafe" not in text


def test_keys_turn_the_view_and_home_brings_it_back(page, contents):
    first = state(page)["camera"]
    page.focus("#view")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")
    turned = state(page)["camera"]
    assert np.linalg.norm(turned["origin"]) < np.linalg.norm(first["origin"])
    assert not np.allclose(turned["origin"], first["origin"])
    page.keyboard.press("Shift+ArrowUp")
    assert not np.allclose(state(page)["camera"]["target"], first["target"])
    page.keyboard.press("Home")
    assert state(page)["camera"] == first


def test_pointers_turn_move_and_zoom(page):
    first = state(page)["camera"]
    page.mouse.move(200, 200)
    page.mouse.down()
    page.mouse.move(260, 220)
    page.mouse.up()
    turned = state(page)["camera"]
    arm = np.linalg.norm(np.subtract(first["origin"], first["target"]))
    assert np.linalg.norm(np.subtract(turned["origin"], turned["target"])) == pytest.approx(arm, rel=1e-6)
    assert not np.allclose(turned["origin"], first["origin"])
    page.mouse.wheel(0, 300)
    assert np.linalg.norm(state(page)["camera"]["origin"]) > 1.2 * np.linalg.norm(first["origin"])
    page.evaluate("document.getElementById('resetView').click()")
    assert state(page)["camera"] == first


def test_two_fingers_pinch_and_move(page):
    first = state(page)["camera"]
    hand = page.context.new_cdp_session(page)

    def touch(kind, *places):
        fingers = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    touch("touchStart", (150, 200))
    touch("touchStart", (150, 200), (200, 200))
    touch("touchMove", (125, 180), (225, 180))
    touch("touchEnd")
    after = state(page)["camera"]
    near, far = (np.linalg.norm(np.subtract(view["origin"], view["target"])) for view in (after, first))
    assert near == pytest.approx(far / 2, rel=0.05)
    assert not np.allclose(after["target"], first["target"])
    page.evaluate("document.getElementById('resetView').click()")


def test_lamps_are_dragged(page):
    """Around the body, as far away as before, to where the hand is."""
    frame(page)
    page.evaluate("pellucid.view.place(pellucid.engine.matrix, 0)")
    before = state(page)["lamps"][0]["position"]
    camera = state(page)["camera"]
    box = page.locator(".lamp").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] - 60, middle[1])
    page.mouse.up()
    after = state(page)["lamps"][0]["position"]
    centre = page.evaluate("pellucid.body.centre")
    assert np.linalg.norm(np.subtract(after, centre)) == pytest.approx(np.linalg.norm(np.subtract(before, centre)))
    assert state(page)["camera"] == camera
    assert after[0] < before[0] - 5
    page.evaluate("document.getElementById('resetLight').click()")
    assert state(page)["lamps"][0]["position"] == before


def choose(page, control, value):
    page.evaluate(
        """([id, value]) => { const control = document.getElementById(id);
        if (control.type === "checkbox") control.checked = value; else control.value = value;
        control.dispatchEvent(new Event("input")); control.dispatchEvent(new Event("change")); }""",
        [control, value],
    )


def test_the_material_can_be_given_in_every_way(page):
    choose(page, "material", "skin1")
    assert np.allclose(state(page)["medium"]["scattering"], SKIN.sigma_s_prime)
    shown = page.evaluate("[...document.querySelectorAll('#reflectances input')].map((field) => Number(field.value))")
    assert np.allclose(shown[:3], SKIN.total_diffuse_reflectance, rtol=0.01)
    assert np.allclose(shown[3:], SKIN.dmfp, rtol=0.01)
    page.evaluate(
        """() => { const [red] = document.querySelectorAll("#reflectances input");
        red.value = "0.7"; red.dispatchEvent(new Event("change")); }"""
    )
    medium = state(page)["medium"]
    found = Medium(medium["scattering"], medium["absorption"], eta=medium["eta"])
    assert found.total_diffuse_reflectance[0] == pytest.approx(0.7, abs=0.003)
    assert found.dmfp[0] == pytest.approx(SKIN.dmfp[0], rel=0.02)
    assert state(page)["material"] == ""
    choose(page, "material", "marble")
    choose(page, "other", "skin1")
    choose(page, "share", 0.25)
    mixed = 0.75 * Medium.from_preset("marble").sigma_a + 0.25 * SKIN.sigma_a
    assert np.allclose(state(page)["medium"]["absorption"], mixed)
    page.evaluate("document.getElementById('resetAll').click()")


def test_lamps_are_added_moved_and_removed(page):
    page.evaluate("document.getElementById('addLamp').click()")
    page.evaluate("pellucid.view.place(pellucid.engine.matrix, 1)")
    assert len(state(page)["lamps"]) == 2
    before = state(page)["lamps"][1]
    page.focus(".lamp:nth-child(2)")
    page.keyboard.press("ArrowUp")
    after = state(page)["lamps"][1]
    assert not np.allclose(before["position"], after["position"])
    assert np.linalg.norm(before["position"]) == pytest.approx(np.linalg.norm(after["position"]), rel=1e-3)
    choose(page, "lampColour", "#ff0000")
    assert state(page)["lamps"][1]["colour"] == [1, 0, 0]
    choose(page, "lampStops", 1)
    choose(page, "lampKind", "directional")
    assert state(page)["lamps"][1]["kind"] == "directional"
    red = frame(page, 24, lamps=[state(page)["lamps"][1]])
    assert red[..., 0].max() > 0.1 and red[..., 1:].max() < 1e-4
    for count in (1, 0):
        page.evaluate("document.getElementById('removeLamp').click()")
        assert len(state(page)["lamps"]) == count
    assert np.all(frame(page, 24, hybrid=True, autoExposure=True) == 0)  # and not what is no number
    page.evaluate("document.getElementById('resetAll').click()")


def test_a_lamp_that_is_too_near_is_said(page):
    """At one and a half times the distance between texels from one, and at three."""
    said = page.evaluate(
        """() => { const { body, engine, loop } = pellucid, { places, directions } = body.texels;
        const top = [...places.keys()].filter((k) => k % 4 === 2).reduce((a, b) => (places[b] > places[a] ? b : a)) - 2;
        return [1.5, 3].map((far) => {
            const position = [0, 1, 2].map((k) => places[top + k] + far * body.spacing * directions[top + k]);
            const lamp = { kind: "point", position, colour: [1, 1, 1], intensity: 1 };
            loop.report(engine, (PLAIN)({ lamps: [lamp], millimetres: body.extent }), 8, 8, "pixels", true);
            return document.getElementById("status").textContent; }); }""".replace("PLAIN", PLAIN)
    )
    spacing = page.evaluate("pellucid.body.spacing")
    assert f"Lamp 1 is {1.5 * spacing:.2g} mm from the object, whose texels are {spacing:.2g} mm apart" in said[0]
    assert "Lamp" not in said[1]


def test_light_and_material_are_reset_apart(page):
    first = state(page)
    choose(page, "material", "skin1")
    choose(page, "size", 2)
    choose(page, "lampColour", "#ff0000")
    choose(page, "sky", "an evening")
    page.evaluate("document.getElementById('resetMaterial').click()")
    now = state(page)
    assert now["medium"] == first["medium"] and now["millimetres"] == first["millimetres"]
    assert now["sky"] == "an evening"
    page.evaluate("document.getElementById('resetLight').click()")
    assert state(page) == first


def test_credits_and_colours_of_the_system(page):
    assert page.text_content("#command") == "pellucid export bumps.ply"
    assert "Made with pellucid. To cite it: The pellucid developers" in page.text_content("#about")
    behind = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        behind.append(page.evaluate("pellucid.forEngine().background"))
    assert min(behind[0]) > 0.8 and max(behind[1]) < 0.2


def test_a_link_holds_the_state(page):
    choose(page, "size", 2)
    choose(page, "roughness", 0.5)
    page.evaluate("pellucid.set({ sky: 'an evening' })")
    page.evaluate("history.replaceState(null, '', '#')")  # in a test links are not written
    link = page.evaluate("(pellucid.writeLink(), location.hash)")
    page.evaluate("location.hash = '#test'")
    page.wait_for_timeout(50)
    assert state(page)["millimetres"] != 100
    page.evaluate("(link) => { location.hash = link; }", link)
    page.wait_for_timeout(50)
    now = state(page)
    assert (now["millimetres"], now["roughness"], now["sky"]) == (100, 0.5, "an evening")
    wrong = json.dumps(
        {
            "millimetres": "x",
            "camera": {"fov": 900, "origin": [1, None, 2]},
            "medium": {"scattering": [-1, 2, 3]},
            "mode": "all",
            "sky": "toString",
            "other": "constructor",
        }
    )
    page.evaluate("(text) => { location.hash = '#' + encodeURIComponent(text); }", wrong)
    page.wait_for_timeout(50)
    now = state(page)
    assert now["camera"]["fov"] == 170 and now["camera"]["origin"] == page.evaluate("pellucid.initial.camera.origin")
    assert now["medium"]["scattering"][0] > 0
    assert (now["mode"], now["sky"], now["other"]) == ("auto", "none", "")
    nowhere = page.evaluate(
        "encodeURIComponent(JSON.stringify({ camera: { target: pellucid.initial.camera.origin } }))"
    )
    page.evaluate("(text) => { location.hash = '#' + text; }", nowhere)
    page.wait_for_timeout(50)
    assert state(page)["camera"] == page.evaluate("pellucid.initial.camera")
    page.evaluate("location.hash = '#test'")
    page.evaluate("document.getElementById('resetAll').click()")


def test_pictures_are_saved_at_a_chosen_size(page):
    from PIL import Image

    page.evaluate("() => { pellucid.loop.pace.rate = 1e9; pellucid.set({ samples: 16, hybrid: false }); }")
    choose(page, "pictureWidth", "50")
    choose(page, "pictureHeight", "30")
    with page.expect_download() as saved:
        page.evaluate("document.getElementById('save').click()")
    picture = Image.open(io.BytesIO(saved.value.path().read_bytes()))
    assert picture.size == (50, 30)
    assert np.array(picture.convert("L")).std() > 10
    page.evaluate("() => { pellucid.device.gl.isContextLost = () => true; document.getElementById('save').click(); }")
    page.wait_for_selector("text=This device draws no picture of 50 × 30 pixels: choose a smaller one.")
    page.evaluate("() => { delete pellucid.device.gl.isContextLost; pellucid.loop.stop(); }")
    page.evaluate("document.getElementById('resetAll').click()")


def test_everything_has_a_name_and_can_be_reached_by_keys(page):
    """A name has letters: a sign as that of the button for the controls tells nothing to who hears it."""
    wrong = page.evaluate(
        """() => [...document.querySelectorAll("input, select, button, canvas, summary, dialog")].filter((control) => {
            const label = control.getAttribute("aria-label") ?? control.labels?.[0]?.textContent ?? control.textContent;
            return !/[a-z]{2}/i.test(label) || (control.tabIndex < 0 && control.tagName !== "DIALOG"); })
        .map((control) => control.outerHTML)"""
    )
    assert wrong == []


@pytest.mark.parametrize(("width", "height"), [(390, 800), (820, 1100), (1400, 800)])
def test_picture_and_controls_share_the_window(page, width, height):
    page.set_viewport_size({"width": width, "height": height})
    view, panel = page.locator("#view").bounding_box(), page.locator("#panel").bounding_box()
    assert panel["x"] + panel["width"] <= width + 1 and panel["y"] + panel["height"] <= height + 1
    assert view["width"] * view["height"] > 0.45 * width * height
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.set_viewport_size({"width": 640, "height": 420})


def test_a_lost_context_comes_back(page):
    before = frame(page, 24)
    page.evaluate(
        """async () => { const lose = pellucid.device.gl.getExtension("WEBGL_lose_context");
        const wait = (name) => new Promise((done) => pellucid.canvas.addEventListener(name, done, { once: true }));
        const lost = wait("webglcontextlost"); lose.loseContext(); await lost;
        const back = wait("webglcontextrestored"); setTimeout(() => lose.restoreContext()); await back;
        pellucid.loop.stop(); }"""
    )
    assert page.locator("#message").is_hidden()
    assert rmse(frame(page, 24), before) < 1e-6


@pytest.mark.parametrize(
    ("lacks", "said"),
    [
        ("HTMLCanvasElement.prototype.getContext = () => null;", "This browser has no WebGL2. Below"),
        ("WebGL2RenderingContext.prototype.getExtension = () => null;", "textures of floats"),
    ],
)
def test_without_graphics_there_is_a_message_and_a_picture(browser, contents, tmp_path, lacks, said):
    path = write_page(tmp_path, contents, still=b"\xff\xd8\xff\xd9")
    page = browser.new_page()
    page.add_init_script(lacks)
    page.goto(path.as_uri())
    page.wait_for_selector("body[data-ready=no]")
    assert said in page.text_content("#message")
    assert page.locator("#still").is_visible() and not page.locator("#view").is_visible()
    page.goto(write_page(tmp_path, contents, served=True).as_uri())  # as from Python, where there is another way
    page.wait_for_selector("body[data-ready=no]")
    assert "pellucid view --streamed" in page.text_content("#message")
    page.close()


def test_it_settles_and_then_rests(browser, contents, tmp_path):
    path = write_page(tmp_path, contents)
    page = browser.new_page(viewport={"width": 340, "height": 90})
    page.goto(f"{path.as_uri()}#{'%7B%22samples%22%3A16%2C%22hybrid%22%3Afalse%7D'}")
    page.wait_for_selector("body[data-ready=yes]")
    page.wait_for_selector("text=settled", timeout=30000)
    frames = page.evaluate("pellucid.loop.frames")
    page.wait_for_timeout(300)
    assert page.evaluate("pellucid.loop.frames") == frames
    assert state(page)["samples"] == 16
    hide = """(hidden) => { Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
        document.dispatchEvent(new Event("visibilitychange")); pellucid.changed(); }"""
    page.evaluate(hide, True)
    page.wait_for_timeout(300)
    assert page.evaluate("pellucid.loop.frames") == frames  # what nobody sees is not drawn
    page.evaluate(hide, False)
    page.set_viewport_size({"width": 360, "height": 100})
    wait_for(
        lambda: page.evaluate("(before) => pellucid.loop.frames > before && pellucid.canvas.width === 360", frames)
    )
    screen = {"width": 360, "height": 100, "deviceScaleFactor": 1.5, "mobile": False}
    page.context.new_cdp_session(page).send("Emulation.setDeviceMetricsOverride", screen)
    wait_for(lambda: page.evaluate("pellucid.canvas.width") == 540)
    page.evaluate("() => { pellucid.engine.picture = () => { throw new Error('no such pass'); }; pellucid.changed(); }")
    page.wait_for_selector("#message:visible")
    assert page.text_content("#message") == "no such pass"
    assert not page.locator("#view").is_visible()
    page.close()
