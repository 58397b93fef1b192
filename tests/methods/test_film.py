"""Samples added to films: as Mitsuba adds them, and the same bits each time."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba.python.ad.integrators.common import ADIntegrator

from pellucid.methods.film import add_samples
from pellucid.methods.tiles import Region, film_size
from worlds.fake_source import ball_scene


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
    paths = []

    def count(scene, sensor, sampler, *_):
        paths.append(1920 * 1080 * sampler.sample_count())

    monkeypatch.setattr(integrator, "_render_pass", count)
    integrator.render(scene, spp=4096, develop=False)
    assert sum(paths) == 1920 * 1080 * 4096 and max(paths) <= integrator.method.paths_at_once
