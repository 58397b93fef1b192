"""Tiles of a picture: together they are the picture of one run, bit for bit."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import SceneError
from pellucid.methods.layers import LayerSums
from pellucid.methods.tiles import Region, make_tile, put_sums, sums_of
from worlds.fake_source import ball_scene

SETTINGS = {"sampled": {}, "texture_space": {"sample_count": 200}}


def view(sampler="independent", **film):
    spec = ball_scene()
    spec["sensor"]["film"] |= {"width": 23, "height": 17, **film}
    spec["sensor"]["sampler"] = {"type": sampler, "sample_count": 4}
    return mi.load_dict(spec)


def pictures(scene, integrator, count, spp=4):
    """Render a picture at once, and in tiles that are put together."""
    sensor, film = scene.sensors()[0], scene.sensors()[0].film()
    integrator.prepared = integrator.prepare_scene(scene, sensor)
    integrator.render(scene, sensor, seed=1, spp=spp, develop=False)
    once = sums_of(film)
    pieces = []
    for number in range(1, count + 1):
        tile = make_tile(film, number, count)
        integrator.render_tile(scene, sensor, tile, seed=1, spp=spp)
        pieces.append((sums_of(tile), tile.crop_offset()))
    film.prepare(integrator.aov_names())
    for sums, offset in pieces:
        put_sums(film, sums, offset)
    return once, sums_of(film)


@pytest.mark.parametrize("method", ["two_pass", "exact", "single_pass", "texture_space", "sampled"])
def test_every_method_gives_the_picture_of_one_run(method):
    settings = {"sample_count": 400, "sampling": "uniform"} if method in ("two_pass", "exact") else {}
    integrator = mi.load_dict(
        {"type": f"pellucid_{method}", **settings, **SETTINGS.get(method, {}), "aovs": "exitance"}
    )
    once, together = pictures(view(rfilter={"type": "gaussian"}), integrator, 6)
    np.testing.assert_array_equal(once, together)
    assert once.std() > 0


BOX, LANCZOS, GAUSSIAN = ({"rfilter": {"type": name}} for name in ("box", "lanczos", "gaussian"))
CROP = {"crop_offset_x": 3, "crop_offset_y": 2, "crop_width": 14, "crop_height": 11}


@pytest.mark.parametrize(
    ("sampler", "film"),
    [
        ("independent", LANCZOS | {"sample_border": True, "pixel_format": "rgba"}),
        ("stratified", BOX),
        ("multijitter", GAUSSIAN | CROP),
        ("ldsampler", BOX),
        ("orthogonal", GAUSSIAN),
    ],
)
def test_every_sampler_and_film_in_several_passes(sampler, film, monkeypatch):
    integrator = mi.load_dict({"type": "pellucid_two_pass", "sampling": "uniform", "sample_count": 100})
    monkeypatch.setattr("pellucid.methods.film.PATHS_A_PASS", 1000)
    once, together = pictures(view(sampler, **film), integrator, 5)
    np.testing.assert_array_equal(once, together)


def test_layers_of_tiles_are_those_of_the_picture():
    scene = view(rfilter={"type": "gaussian"}, sample_border=True)
    sensor, integrator = scene.sensors()[0], mi.load_dict({"type": "pellucid_two_pass", "sample_count": 100})
    whole = integrator.render_layers(scene, sensor, seed=1, spp=4)
    for number in range(1, 5):
        tile = make_tile(sensor.film(), number, 4)
        sums = LayerSums(tile, Region.around(tile, sensor.film()))
        integrator.render_tile(scene, sensor, tile, seed=1, spp=4, layers=sums)
        (x, y), (width, height) = tile.crop_offset(), tile.crop_size()
        for name, image in vars(sums.means()).items():
            np.testing.assert_array_equal(image, getattr(whole, name)[y : y + height, x : x + width], name)


def test_a_tile_needs_the_pixels_that_the_filter_reaches_and_no_others():
    film = view(rfilter={"type": "gaussian"}).sensors()[0].film()
    tiles = [make_tile(film, number, 6) for number in range(1, 7)]
    assert [tuple(tile.crop_offset()) for tile in tiles[:4]] == [(0, 0), (7, 0), (15, 0), (0, 8)]
    assert sum(int(np.prod(tile.crop_size())) for tile in tiles) == 23 * 17
    assert Region.around(tiles[0], film) == Region(0, 0, 9, 10, (0, 0))
    assert Region.around(tiles[4], film) == Region(5, 6, 12, 11, (2, 2))


@pytest.mark.parametrize("pixel_format", ["rgb", "rgba", "luminance_alpha"])
@pytest.mark.parametrize("component_format", ["float16", "float32"])
def test_a_tile_is_stored_as_the_whole_is(pixel_format, component_format):
    film = view(pixel_format=pixel_format, component_format=component_format).sensors()[0].film()
    tile = make_tile(film, 1, 1)
    for one in (film, tile):
        one.prepare(["more"])
    assert str(film.bitmap()) == str(tile.bitmap()) and str(film) == str(tile)


def test_more_tiles_than_pixels_are_refused():
    film = view().sensors()[0].film()
    with pytest.raises(SceneError, match="23x17 pixels has no 29 x 1 tiles: ask for fewer"):
        make_tile(film, 1, 29)
