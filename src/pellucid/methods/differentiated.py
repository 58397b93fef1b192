"""The gradients of pictures: paths and sums differentiated where they go, by the parameters that ``mi.traverse`` shows.

Samples of the surface, the paths from the eye and their random numbers are kept; what they carry is differentiated: the exitance by
the medium and by the light that enters, that light by everything it depends on, and what paths meet on their way from the eye.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from math import prod
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import PellucidError
from ..kernels.memory import columns
from ..light.transport import Start, Vertices, trace
from ..scene.bodies import Role, acting_as
from .answer import Answer
from .differentiated_light import KEEP, power_change, send_power_gradient
from .differentiated_medium import DifferentiatedMedium
from .exitance_op import differentiated_exitance
from .preparation import LitScene, entering_power
from .tiles import film_size

PATHS_AT_ONCE = 1 << 17


class DifferentiatedPicture:
    """One picture of a prepared scene, to be differentiated.

    Parameters
    ----------
    integrator : TranslucentIntegrator
    scene, sensor, state
        What is seen, by what, and what the method has prepared of it.
    seed, spp : int
        As for ``mi.render``.
    """

    def __init__(self, integrator: Any, scene: mi.Scene, sensor: mi.Sensor, state: LitScene, seed: int, spp: int):
        self.integrator, self.scene, self.sensor, self.state, self.seed = integrator, scene, sensor, state, seed
        self.method, self.film = integrator.method, sensor.film()
        for lit in state.bodies:
            if lit.close is not None:
                raise PellucidError(
                    f"No gradients flow through lamps that are too near for the samples of the body '{lit.body.name}': move them away, or "
                    "give a larger sample_count."
                )
        self.sampler = sensor.sampler().clone()
        spp = spp or self.sampler.sample_count()
        self.pixels = prod(film_size(self.film))
        at_once = max(PATHS_AT_ONCE // self.pixels, 1)
        self.per_pass = max(d for d in range(1, min(spp, at_once) + 1) if spp % d == 0)
        self.passes = spp // self.per_pass
        self.sampler.set_sample_count(self.per_pass)
        self.per_pass = self.sampler.sample_count()
        self.sampler.set_samples_per_wavefront(self.per_pass)

    def backward(self, gradient: mi.TensorXf) -> list[np.ndarray]:
        """Send the gradient by the picture back to what paths meet and to media; give that by the power of samples, ``(n, 3)`` a body."""
        entering = [entering_power(lit) for lit in self.state.bodies]
        total = [np.zeros_like(one) for one in entering]
        with differentiated_media(self.state) as media:
            for number in range(self.passes):
                power = _with_gradients(entering)
                with self._acting():
                    image = self._image(number, power, media)
                    if dr.grad_enabled(image):
                        dr.set_grad(image, gradient / self.passes)
                        dr.enqueue(dr.ADMode.Backward, image)
                        dr.traverse(dr.ADMode.Backward, flags=KEEP | dr.ADFlag.ClearInput)
                for k, one in enumerate(power):
                    total[k] += np.stack([c.numpy() for c in dr.grad(one)], axis=1)
        return total

    def send_power_gradient(self, gradient: list[np.ndarray]) -> None:
        """Send gradients by the power of samples, ``(n, 3)`` a body, back to the parameters: once for all pictures of a state."""
        with differentiated_media(self.state) as media:
            send_power_gradient(self.method, self.scene, self.state, media, gradient)

    def power_change(self) -> list[np.ndarray]:
        """Find how the power of samples changes in the direction of the gradients of the parameters: once for all pictures."""
        with leaves(self.scene), differentiated_media(self.state) as media:
            return power_change(self.method, self.scene, self.state, media)

    def forward(self, change: list[np.ndarray]) -> mi.TensorXf:
        """Find how the picture changes in the direction of the gradients of the parameters, ``change`` being that of the power."""
        total: Any = 0
        entering = [entering_power(lit) for lit in self.state.bodies]
        for number in range(self.passes):
            power = _with_gradients(entering)
            for one, by in zip(power, change, strict=True):
                dr.set_grad(one, mi.Color3f(*columns(by)))
            with leaves(self.scene), differentiated_media(self.state) as media, self._acting():
                image = self._image(number, power, media)
                if dr.grad_enabled(image):
                    # Calls of materials and lights are differentiated by themselves: no other edges from their parameters may be left then.
                    dr.forward_to(image, flags=KEEP | dr.ADFlag.ClearEdges)
                    total += dr.detach(dr.grad(image)) / self.passes
                shape = image.shape
                del image
        return total if dr.is_tensor_v(total) else dr.zeros(mi.TensorXf, shape)

    def _acting(self) -> Any:
        """Let translucent surfaces act as paths from the eye see them; also while Dr.Jit differentiates, which evaluates them anew."""
        return acting_as(Role.SURFACE, [lit.body for lit in self.state.bodies])

    def _image(self, number: int, power: list[mi.Color3f], media: list[DifferentiatedMedium]) -> mi.TensorXf:
        """Render a pass of the picture with gradients to the power of samples, the media, and what paths meet."""
        integrator, film = self.integrator, self.film
        with dr.suspend_grad():
            film.prepare(integrator.aov_names())
            self.sampler.seed((self.seed + number * self.per_pass * self.pixels) % 2**32, self.per_pass * self.pixels)
            ray, weight, at = integrator.sample_rays(self.scene, self.sensor, self.sampler)
        answer = Answer(self.method, self.scene, self.state, self.seed, True, self.per_pass)
        answer.eta_table = _table(self.state.eta_table, [medium.eta for medium in media])
        answer.leave_table = _table(self.state.leave_table, [dr.inv_pi / medium.t_d for medium in media])
        limits = replace(self.method.limits, differentiated=True)
        with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
            radiance, seen, hit, vertices = trace(
                self.scene, self.sampler, Start.camera(ray), limits, answer, mi.Bool(True)
            )
        radiance += seen + self._emitted(answer, vertices, power, media)
        block = film.create_block()
        type(integrator)._splat_to_block(
            block,
            film,
            at,
            value=radiance * weight,
            weight=1,
            alpha=dr.select(hit, mi.Float(1), mi.Float(0)),
            aovs=[mi.Float(0)] * len(integrator.aov_names()),
            wavelengths=ray.wavelengths,
        )
        film.put_block(block)
        return film.develop()

    def _emitted(
        self, answer: Answer, vertices: Vertices, power: list[mi.Color3f], media: list[DifferentiatedMedium]
    ) -> mi.Color3f:
        """Sum the radiance of the vertices of each path, as `Answer.emitted` does."""
        with dr.suspend_grad():
            points, place = answer.points(dr.detach(vertices))
        if dr.width(points.p) == 0:
            return dr.zeros(mi.Color3f, vertices.width)
        theta = [medium.theta() for medium in media]
        exitance = differentiated_exitance(self.method, self.state, points, power, theta)
        return answer.sum_up(vertices, exitance, place)


@contextmanager
def leaves(scene: mi.Scene) -> Iterator[None]:
    """Cut the parameters of a scene off from what they were computed from, for a while: of such ones Dr.Jit would clear the gradients."""
    params = mi.traverse(scene)
    kept = {name: type(value)(value) for name, value in params.items() if dr.grad_enabled(value)}
    for name, value in kept.items():
        leaf = type(value)(dr.detach(value))
        dr.enable_grad(leaf)
        dr.set_grad(leaf, dr.grad(value))
        params[name] = leaf
    params.update()
    try:
        yield
    finally:
        for name, value in kept.items():
            params[name] = value
        params.update()


@contextmanager
def differentiated_media(state: LitScene) -> Iterator[list[DifferentiatedMedium]]:
    """Let the materials of all bodies act with the gradients of their parameters; give the medium of each body."""
    with ExitStack() as stack:
        bsdfs = {id(lit.body.bsdf): lit.body.bsdf for lit in state.bodies}
        media = {key: stack.enter_context(bsdf.differentiated()) for key, bsdf in bsdfs.items()}
        yield [media[id(lit.body.bsdf)] for lit in state.bodies]


def _with_gradients(entering: list[np.ndarray]) -> list[mi.Color3f]:
    """Make variables with gradients of the power of the samples of all bodies, ``(n, 3)`` each."""
    power = [mi.Color3f(*columns(one)) for one in entering]
    dr.enable_grad(power)
    return power


def _table(values: mi.Float, of_bodies: list[mi.Float]) -> mi.Float:
    """Give the entries of a table by body gradients."""
    number, table = dr.arange(mi.UInt32, dr.width(values)), mi.Float(values)
    for k, value in enumerate(of_bodies, 1):
        table = dr.select(number == k, value, table)
    return table
