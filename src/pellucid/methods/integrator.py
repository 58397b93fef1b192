"""The path tracer that makes a plug-in of a method: surfaces reflect by their BSDFs, translucent ones also emit their exitance."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import prod
from typing import Any, final

import drjit as dr
import mitsuba as mi
import numpy as np
from mitsuba.python.ad.integrators.common import ADIntegrator

from ..kernels.sampler_lanes import SamplerLanes
from ..light.transport import Start, trace
from ..progress import paced
from ..scene.bodies import Role, acting_as
from ..scene.changes import SceneRecord
from . import aovs
from .answer import Answer, Part
from .contract import Method, Points
from .differentiated import DifferentiatedPicture
from .film import Wave, add_samples, check_pass, samples_a_pass
from .gradients import check_gradients, enabled_gradients
from .layers import NAMES, Layers, LayerSums
from .preparation import LitScene, open_scene, warn_of_units
from .stretch import refuse_stretched
from .tiles import Region, border, film_size

Prepare = Callable[[mi.Scene, LitScene], LitScene]


@final
class TranslucentIntegrator(ADIntegrator):
    """Renders by a method. ``prepared`` is what the method has made of a scene, for several pictures of it."""

    def __init__(self, properties: mi.Properties, method: type[Method[Any]]):
        self.method = method.from_properties(properties)
        super().__init__(properties)
        self.prepared: LitScene | None = None
        self._rendered: LitScene | None = None
        """What a picture was rendered from whose gradients are still to come."""
        self._viewed: tuple[LitScene, LitScene] | None = None
        """What was made of ``prepared`` for the view of another camera, the last time."""

    def prepare_scene(
        self, scene: mi.Scene, sensor: int | mi.Sensor | None = 0, prepare: Prepare | None = None
    ) -> LitScene:
        """Prepare a scene once, for static light and geometry.

        Assign the result to ``prepared`` and every later ``render`` starts from it (a turntable); else each prepares anew.

        Parameters
        ----------
        sensor : int or Sensor, optional
            The camera for whose view some methods prepare. Another view is prepared for when it is rendered.
        prepare : callable, optional
            Prepares what does not depend on a view, in place of the method's own ``prepare``.
        """
        if isinstance(sensor, int):
            sensor = next(iter(scene.sensors()[sensor : sensor + 1]), None)
        check_gradients(scene, self.method)
        with dr.suspend_grad():
            opened = open_scene(scene)
            if not self.method.stretches:
                refuse_stretched([lit.body for lit in opened.bodies], f"pellucid_{self.method.name}")
            state = (prepare or self.method.prepare)(scene, opened)
            warn_of_units(opened)
            state.record = SceneRecord(scene)
            return self._for_view(scene, state, sensor)

    def state_of(self, scene: mi.Scene, sensor: mi.Sensor | None) -> LitScene:
        """Give what is prepared for a scene and a camera; what has become stale is prepared again."""
        state = self.prepared or self._rendered
        if state is None or state.record.changed(scene):
            state = self.prepare_scene(scene, sensor)
            if self.prepared is not None:
                self.prepared = state
            self._rendered = state if enabled_gradients(scene) else None
            return state
        check_gradients(scene, self.method)
        if self._viewed is not None and self._viewed[0] is state and self._viewed[1].view == _view(sensor):
            return self._viewed[1]
        viewed = self._for_view(scene, state, sensor)
        self._viewed = (state, viewed) if viewed is not state else None
        return viewed

    def _for_view(self, scene: mi.Scene, state: LitScene, sensor: mi.Sensor | None) -> LitScene:
        """Prepare for the view of a camera, unless that was done last."""
        if not self.method.uses_view:
            return state
        view = _view(sensor)
        if state.view != view:
            points = None if sensor is None else self._seen(scene, sensor, state)
            state = self.method.prepare_view(scene, state, points)
            state.view = view
        return state

    def _seen(self, scene: mi.Scene, sensor: mi.Sensor, state: LitScene) -> Points:
        """Find the translucent points that a few paths through each pixel of a camera meet."""
        pixels = prod(film_size(sensor.film()))
        paths = max(min(self.method.view_paths, self.method.paths_at_once // pixels), 1)
        sampler = mi.load_dict({"type": "independent", "sample_count": paths})
        sampler.seed(self.method.seed, pixels * paths)
        ray, _, _ = self.sample_rays(scene, sensor, sampler)
        answer = Answer(self.method, scene, state, self.method.seed, True, paths)
        with acting_as(Role.SURFACE, [lit.body for lit in state.bodies]):
            *_, vertices = trace(scene, sampler, Start.camera(ray), self.method.limits, answer, mi.Bool(True))
            return answer.points(vertices)[0]

    # ------------------------------------------------------------------ pictures

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render as Mitsuba's integrators do, in as many passes over the picture as memory asks for."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        film = sensor.film()
        self.render_tile(scene, sensor, film, seed, spp)
        return film.develop() if develop else None

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        """Send the gradient by a picture back to the parameters of a scene, see :mod:`differentiated`."""
        self.render_backward_views(scene, [grad_in], [sensor], [seed], spp)

    def render_backward_views(self, scene, gradients, sensors, seeds, spp=0) -> None:
        """Do what `render_backward` does for several cameras: the light, which takes longest, is differentiated once."""
        total: list[np.ndarray] = []
        for gradient, sensor, seed in zip(gradients, sensors, seeds, strict=True):
            with self._differentiated(scene, sensor, seed, spp) as picture:
                found = picture.backward(gradient)
                total = [a + b for a, b in zip(total, found, strict=True)] if total else found
        with self._differentiated(scene, sensors[0], seeds[0], spp) as picture:
            picture.send_power_gradient(total)

    def render_forward(self, scene, params, sensor=0, seed=0, spp=0):
        """Find how a picture changes in the direction of the gradients of the parameters."""
        return self.render_forward_views(scene, [sensor], [seed], spp)[0]

    def render_forward_views(self, scene, sensors, seeds, spp=0) -> list[mi.TensorXf]:
        """Do what `render_forward` does for several cameras: the light, which takes longest, is differentiated once."""
        changes: list[mi.TensorXf] = []
        power = None
        for sensor, seed in zip(sensors, seeds, strict=True):
            with self._differentiated(scene, sensor, seed, spp) as picture:
                power = picture.power_change() if power is None else power
                changes.append(picture.forward(power))
        return changes

    @contextmanager
    def _differentiated(self, scene, sensor, seed, spp) -> Iterator[DifferentiatedPicture]:
        """Prepare a scene and a picture of it to be differentiated."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        with dr.suspend_grad():
            state = self.state_of(scene, sensor)
            with dr.resume_grad():
                yield DifferentiatedPicture(self, scene, sensor, state, _whole(seed), spp)

    def render_layers(self, scene: mi.Scene, sensor: int | mi.Sensor = 0, seed: int = 0, spp: int = 0) -> Layers:
        """Render into the film as `render` does; also return what a denoiser needs to know of each pixel."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        layers = LayerSums(sensor.film(), Region.around(sensor.film(), sensor.film()))
        self.render_tile(scene, sensor, sensor.film(), seed, spp, layers)
        return layers.means()

    def render_tile(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        tile: mi.Film,
        seed: int = 0,
        spp: int = 0,
        layers: LayerSums | None = None,
    ) -> None:
        """Fill a film that is a part of that of a camera (`tiles.make_tile`), or all of it; and layers if there are any.

        Passes, random numbers and sums are those of the whole picture: a pixel has the same bits in every tile that it belongs to.
        """
        whole = sensor.film()
        region = Region.around(tile, whole)
        sampler = sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        spp = sampler.sample_count()
        check_pass(tile, whole, spp)
        with dr.suspend_grad():
            state = self.state_of(scene, sensor)
            seed = _whole(seed)
            tile.prepare(self.aov_names())
            pixels, at_once = prod(film_size(whole)), self.method.paths_at_once
            per_pass = samples_a_pass(whole, spp)
            sampler.set_sample_count(per_pass)  # some samplers round it up to what they can stratify
            sampler.set_samples_per_wavefront(sampler.sample_count())
            with acting_as(Role.SURFACE, [lit.body for lit in state.bodies]):
                wave = Wave(region, sampler.sample_count())
                lanes = SamplerLanes(sampler, pixels * wave.per_pixel)
                rows, row_paths = spp // per_pass * region.height, region.width * wave.per_pixel
                for first, size in paced("picture", rows, "paths", row_paths, region.height, at_once):
                    number, row = divmod(first, region.height)
                    pass_seed = (seed + number * per_pass * pixels) % 2**32
                    if row == 0:
                        lanes.seed(pass_seed)
                    band = region.rows(row, size)
                    values = self._samples(
                        scene, sensor, lanes, band, wave.per_pixel, state, pass_seed, layers is not None
                    )
                    wave.put(row, values)
                    if row + size == region.height:
                        self._add(tile, wave, layers)

    def sample(self, scene, sampler, ray, active=True, **_):
        """Evaluate rays for an integrator of Mitsuba around this one (``aov``), as `ADIntegrator.sample` does.

        Without a prepared state, one is made at the first call and kept until the scene changes.

        Returns
        -------
        radiance, hit, channels, None
        """
        with dr.suspend_grad():
            sensor = next(iter(scene.sensors()), None)
            if self.prepared is None:
                self.prepared = self.prepare_scene(scene)
            answer = Answer(self.method, scene, self.state_of(scene, sensor), self.method.seed, True)
            with acting_as(Role.SURFACE, [lit.body for lit in answer.state.bodies]):
                channels = self.method.channels
                return *self._trace(scene, sampler, ray, answer, channels, mi.Bool(active)), None

    def _trace(
        self, scene, sampler, ray, answer: Answer, names: list[str], active
    ) -> tuple[mi.Color3f, mi.Bool, list[mi.Float]]:
        """Trace one path along each ray and add the exitance of what it meets; evaluate the channels that are named."""
        limits = self.method.limits
        radiance, seen, hit, vertices = trace(scene, sampler, Start.camera(ray), limits, answer, active)
        radiance += seen
        dr.eval(radiance, hit, vertices)
        emitted, first = answer.emitted(vertices)
        channels = aovs.evaluate(names, scene, sampler, ray, answer.state, first, limits, answer)
        return radiance + emitted, hit, channels

    def _samples(
        self, scene, sensor, lanes: SamplerLanes, region, per_pixel, state, seed, with_layers: bool
    ) -> list[mi.Float]:
        """Trace a few samples of every pixel of a region: positions on the film, radiance, whether there is anything, and channels."""
        width, height = film_size(sensor.film())
        pixel, number = region.samples(width, per_pixel)
        part, sampler = Part(number, width * height * per_pixel), lanes.take(number)
        answer = Answer(self.method, scene, state, seed, True, per_pixel, part)
        ray, weight, pos = _camera_rays(sensor, sampler, pixel)
        dr.schedule(weight, pos)
        names = [*self.method.channels, *(NAMES if with_layers else ())]
        radiance, hit, channels = self._trace(scene, sampler, ray, answer, names, mi.Bool(True))
        return [*mi.Vector2f(pos), *(radiance * weight), dr.select(hit, mi.Float(1), mi.Float(0)), *channels]

    def _add(self, tile: mi.Film, wave: Wave, layers: LayerSums | None) -> None:
        """Add the samples of a region to a tile, and to layers if there are any."""
        x, y, red, green, blue, hit, *channels = wave.values
        own = len(self.aov_names())
        radiance = mi.Color3f(red, green, blue)
        add_samples(tile, wave.region, mi.Vector2f(x, y), radiance, hit, channels[:own])
        if layers:
            layers.add(radiance, channels[own:], wave.per_pixel)
        tile.schedule_storage()
        dr.eval()

    def aov_names(self):
        """Name the extra channels."""
        return aovs.channel_names(self.method.channels)

    def to_string(self):
        """Describe the integrator in Mitsuba's form."""
        settings = ", ".join(f"{name} = {value}" for name, value in self.method.parameters().items())
        return f"pellucid_{self.method.name}[{settings}]"


def _camera_rays(
    sensor: mi.Sensor, sampler: mi.Sampler, pixel: mi.Vector2i
) -> tuple[mi.RayDifferential3f, mi.Color3f, mi.Vector2f]:
    """Sample rays of a camera as `ADIntegrator.sample_rays` does, through pixels that are counted with the border of its film.

    Returns
    -------
    ray, weight, position on the film [pixels]
    """
    film = sensor.film()
    pixel = pixel - border(film) + mi.Vector2i(film.crop_offset())
    at = mi.Vector2f(pixel) + sampler.next_2d()
    scale = dr.rcp(mi.ScalarVector2f(film.crop_size()))
    on_film = dr.fma(at, scale, -mi.ScalarVector2f(film.crop_offset()) * scale)
    aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Vector2f(0)
    time = sensor.shutter_open()
    if sensor.shutter_open_time() > 0:
        time += sampler.next_1d() * sensor.shutter_open_time()
    ray, weight = sensor.sample_ray_differential(time, 0, on_film, aperture)
    return ray, weight, mi.Vector2f(pixel) if film.rfilter().is_box_filter() else at


def _whole(seed: Any) -> int:
    """Make a plain number of a seed, which may come as a Dr.Jit number."""
    return int(np.asarray(seed).ravel()[0])


def _view(sensor: mi.Sensor | None) -> dict[str, str]:
    """Write down what a camera sees by: equal for equal views; nothing without one."""
    return {} if sensor is None else {key: str(value) for key, value in mi.traverse(sensor).items()}
