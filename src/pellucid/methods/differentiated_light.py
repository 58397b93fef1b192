"""The power of samples with gradients to all that it depends on: lights, other surfaces, and the body's own reflectance.

Light is traced anew for its derivatives, by few paths a sample: the exitance averages over many samples. A few samples are differentiated
at a time, so that what Dr.Jit keeps of paths stays small.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import columns, rows
from ..kernels.morton import morton_order
from ..light.irradiance import measure_some
from ..light.transport import Limits
from ..model.slopes import BOUND
from ..scene.bodies import Role, acting_as
from .preparation import LitBody, LitScene, effective_area
from .reflectance import differentiated_texture
from .thin import thin_slope

PATHS, FEWEST_PATHS, MOST_PATHS = 1 << 19, 16, 64
"""To all samples of a body, and to one of them at least and at most; not more than the irradiance itself got."""

PATHS_AT_ONCE = 1 << 16
KEEP = dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad
"""The graph of parameters is traversed many times, and what is traversed need not depend on all of them."""

Array = np.ndarray


def power_change(method: Any, scene: mi.Scene, state: LitScene, media: list[Any]) -> list[Array]:
    """Find how the power of all samples changes with the parameters, in the direction of their gradients: ``(n, 3)`` a body."""
    changes = []
    for lit, medium in zip(state.bodies, media, strict=True):
        change, summed = np.zeros((len(lit.samples), 3)), method.summed(lit)
        area = effective_area(lit)
        change[summed] = _change(_by_factor(lit, medium, area, summed))
        for here, light in _by_light(method, scene, state, lit, medium):
            change[here] += _change(light) * area[here]
            del light  # what is still there of it would be in the way of the next one
        changes.append(change)
    return changes


def send_power_gradient(method: Any, scene: mi.Scene, state: LitScene, media: list[Any], gradient: list[Array]) -> None:
    """Send the gradients by the power of samples, ``(n, 3)`` a body, back to the parameters."""
    for lit, medium, by_power in zip(state.bodies, media, gradient, strict=True):
        summed, area = method.summed(lit), effective_area(lit)
        _send(_by_factor(lit, medium, area, summed), by_power[summed])
        for here, light in _by_light(method, scene, state, lit, medium):
            _send(light, by_power[here] * area[here])


def _change(value: mi.Color3f) -> Array:
    if not dr.grad_enabled(value):
        return np.zeros((dr.width(value), 3))
    dr.forward_to(value, flags=KEEP)
    return rows(dr.grad(value)).astype(float)


def _send(value: mi.Color3f, gradient: Array) -> None:
    if dr.grad_enabled(value):
        dr.set_grad(value, mi.Color3f(*columns(gradient)))
        dr.enqueue(dr.ADMode.Backward, value)
        dr.traverse(dr.ADMode.Backward, flags=KEEP | dr.ADFlag.ClearInput)


def _by_factor(lit: LitBody, medium: Any, area: Array, summed: Array) -> mi.Color3f:
    """Give the power of some samples gradients by what multiplies it: the texture of the reflectance, and the factor of thin parts."""
    power = mi.Color3f(*columns((lit.irradiance.entering * area)[summed]))
    for name, log_theta in medium.theta().items():
        slope = None if name == BOUND else thin_slope(lit.body, lit.samples, name)
        if slope is not None:
            power *= 1 + mi.Color3f(*columns(slope[summed])) * (log_theta - dr.detach(log_theta))
    texture = lit.body.bsdf.texture
    if texture is None:
        return power
    colour = differentiated_texture(texture, lit.body, lit.samples.take(summed)) / medium.reflectance
    return power * dr.select(dr.detach(colour) > 0, colour / dr.detach(colour), 0)


def _by_light(
    method: Any, scene: mi.Scene, state: LitScene, lit: LitBody, medium: Any
) -> Iterator[tuple[Array, mi.Color3f]]:
    """Light a few of the samples that are summed at a time, with gradients: give their numbers, and what enters."""
    number = next(k for k, other in enumerate(state.bodies) if other is lit)
    order = morton_order(lit.samples.p)
    summed = np.flatnonzero(np.isin(order, method.summed(lit))).astype(np.uint32)  # as places along the curve
    enough = min(max(PATHS // len(summed), FEWEST_PATHS), MOST_PATHS)
    paths = min(method.paths_by_body(state, [len(other.samples) for other in state.bodies])[number], enough)
    limits = replace(method.light_limits, differentiated=True)
    size = max(1, PATHS_AT_ONCE // paths)
    with acting_as(Role.DIFFUSE, [other.body for other in state.bodies]):  # also while they are differentiated
        for first in range(0, len(summed), size):
            place = summed[first : first + size]
            yield order[place], _entering(scene, lit, medium, limits, paths, method.seed, order[place], place)


def _entering(
    scene: mi.Scene, lit: LitBody, medium: Any, limits: Limits, paths: int, seed: int, index: Array, place: Array
) -> mi.Color3f:
    """Estimate what enters at some samples, in loops and calls that Dr.Jit evaluates: it differentiates those in both directions."""
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False), dr.scoped_set_flag(dr.JitFlag.SymbolicCalls, False):
        return measure_some(scene, lit.samples, medium.eta, limits, paths, seed, None, index, place, None).entering
