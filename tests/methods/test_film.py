"""Samples added to films: as Mitsuba adds them, and the same bits each time."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba.python.ad.integrators.common import ADIntegrator

from pellucid import progress
from pellucid.methods.film import add_samples
from pellucid.methods.tiles import Region, film_size
from worlds.fake_source import ball_scene
from worlds.reporters import Told


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian", "mitchell", "lanczos"])
@pytest.mark.parametrize(
    "extra", [{}, {"sample_border": True}, {"crop_offset_x": 3, "crop_width": 9, "crop_height": 8}]
)
@pytest.mark.parametrize("pixel_format", ["rgb", "rgba"])
def test_a_film_is_as_mitsuba_fills_it(rfilter, extra, pixel_format):
    film = {"type": "hdrfilm", "width": 17, "height": 12, "pixel_format": pixel_format, **extra}
    sensor = mi.load_dict({"type": "perspective", "film": {**film, "rfilter": {"type": rfilter}}})
    film, integrator = sensor.film(), mi.load_dict({"type": "pellucid_two_pass"})
    sampler = mi.load_dict({"type": "independent", "sample_count": 6})
    sampler.seed(3, 6 * int(np.prod(film_size(film))))
    ray, _, pos = integrator.sample_rays(None, sensor, sampler)
    colour, alpha = mi.Color3f(sampler.next_1d(), ray.d.x, 2.0), mi.Float(sampler.next_1d() < 0.7)
    extra = [sampler.next_1d()]
    dr.eval(pos, colour, alpha, extra)

    film.prepare(["more"])
    block = film.create_block()
    ADIntegrator._splat_to_block(block, film, pos, colour, 1.0, alpha, extra, ray.wavelengths)
    film.put_block(block)
    expected = np.array(film.develop())
    film.prepare(["more"])
    add_samples(film, Region.around(film, film), pos, colour, alpha, extra)
    np.testing.assert_allclose(np.array(film.develop()), expected, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("spp", [4, 24])
def test_two_equal_renders_have_equal_bits(spp):
    spec = ball_scene()
    spec["sensor"]["film"] |= {"width": 320, "height": 240, "rfilter": {"type": "gaussian"}}
    scene = mi.load_dict(spec)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "sampling": "uniform", "sample_count": 400})
    pictures = [np.array(integrator.render(scene, seed=1, spp=spp)) for _ in range(4)]
    assert all(np.array_equal(pictures[0], picture) for picture in pictures)


def test_more_samples_than_two_to_the_32_are_drawn_in_passes(monkeypatch):
    spec = ball_scene()
    spec["sensor"]["film"] |= {"width": 1920, "height": 1080}
    scene = mi.load_dict(spec)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "sampling": "uniform", "sample_count": 400})
    paths, passes = [], []

    def count(scene, sensor, lanes, region, per_pixel, *_):
        paths.append(region.pixels * per_pixel)
        return [mi.Float(0)]

    monkeypatch.setattr(integrator, "_samples", count)
    monkeypatch.setattr(integrator, "_add", lambda tile, wave, layers: passes.append(wave.per_pixel))
    monkeypatch.setattr("pellucid.methods.film.Wave.put", lambda *_: None)
    integrator.render(scene, spp=4096, develop=False)
    assert sum(paths) == 1920 * 1080 * 4096 and max(paths) <= integrator.method.paths_at_once
    assert sum(passes) == 4096


@pytest.mark.parametrize("method", ["two_pass", "single_pass", "sampled"])
def test_a_pass_in_bands_of_rows_has_the_bits_of_the_whole(method, monkeypatch):
    """Each takes about half a second, so that the picture has a time left over all, also where it is one pass."""
    spec = ball_scene()
    spec["sensor"]["film"] |= {"width": 40, "height": 30, "rfilter": {"type": "gaussian"}}
    scene = mi.load_dict(spec)
    few = {"sample_count": 400} | ({"direct": 64, "indirect": 0} if method == "single_pass" else {})
    few = {} if method == "sampled" else few
    integrator = mi.load_dict({"type": f"pellucid_{method}", "aovs": "exitance", **few})
    integrator.prepared = integrator.prepare_scene(scene)
    whole = np.array(integrator.render(scene, seed=3, spp=8))
    monkeypatch.setattr(progress, "FIRST_CHUNK", 2 * 40 * 8)
    monkeypatch.setattr(progress, "PACE", 0.0)
    told = Told()
    with progress.reporting_to(told):
        bands = np.array(integrator.render(scene, seed=3, spp=8))
    assert np.array_equal(bands, whole)
    assert told.done["picture"] == told.total["picture"] == 40 * 30 * 8
    assert told.steps["picture"] > 2
