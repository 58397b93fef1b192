"""All light of a scene as point lights: those of its emitters, and virtual ones for what they light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ...model.fresnel import transmitted
from ..lamps import CloseLamps
from .emitters import discretise_emitters, find_emitters, has_extent
from .records import LightRecords, LightSamples, to_device, visible
from .virtual import draw, sent_to, virtual_lights

DEFAULT_DIRECT, DEFAULT_INDIRECT = 3072, 50_000
"""Light samples of emitters with an extent, and virtual point lights; AWB08 figure 7 has about as many of both."""


SOURCES = 1 << 17
"""Points of emitters where photons start: more than the light samples, which would show as so many projectors."""


@dr.syntax
def irradiance_of_all(
    scene: mi.Scene, records: LightRecords, count: int, si: mi.SurfaceInteraction3f, eta
) -> tuple[mi.Color3f, mi.Color3f]:
    """Sum over all lights with a shadow ray for each: the twin of everything that clusters them.

    Parameters
    ----------
    records, count
        The lights, and how many there are.
    si : SurfaceInteraction3f
        Receivers; ``p``, ``n`` and ``sh_frame`` are read.
    eta : float or Float
        Relative index of refraction behind the surface.

    Returns
    -------
    falling, entering : Color3f
        Irradiance, and the part that passes the surface: each direction times its exact Fresnel transmittance.

    Source: the inner sum of AWB08 eq. 7, with the transmittance of each direction inside.
    """
    end = dr.opaque(mi.UInt32, count)
    index = dr.zeros(mi.UInt32, dr.width(si))
    falling, entering = mi.Color3f(0), mi.Color3f(0)
    while dr.hint(index < end, label="pellucid irradiance_of_all"):
        direction, distance, light = records.arriving(index, si.p, si.sh_frame.n, True)
        seen = visible(scene, si, direction, distance, dr.any(light != 0))
        light = dr.select(seen, light, 0)
        falling += light
        entering += light * transmitted(dr.dot(direction, si.sh_frame.n), eta)
        index += 1
    return falling, entering


def discretise(
    scene: mi.Scene,
    direct: int = DEFAULT_DIRECT,
    indirect: int = DEFAULT_INDIRECT,
    seed: int = 0,
    max_depth: int = 6,
    receivers: tuple[ArrayLike, ArrayLike] | None = None,
    close: CloseLamps | None = None,
) -> LightSamples:
    """Turn the light of a scene into point lights: its emitters, and what they light.

    Parameters
    ----------
    direct : int
        Points shared among the emitters that have an extent; see `emitters.discretise_emitters`.
    indirect : int
        About as many virtual point lights, at most; 0 for none. See `virtual_lights.virtual_lights`.
    seed : int
        Same seed, same lights, bit for bit.
    max_depth : int
        As for the paths of `irradiance.gather_irradiance`; 2 is direct light.
    receivers : (m, 3) float, (m, 3) float
        Points that are to be lit, and their normals: where virtual lights are worth most.
    close : CloseLamps, optional
        Lamps that grow no brighter within reach, where rays carry their light.

    Warns
    -----
    PellucidWarning
        For emitters that no point lights can stand for.

    Source: AWB08 section 4.1.
    """

    emitters, many = find_emitters(scene), max(direct, SOURCES)
    if receivers is None:
        lights = discretise_emitters(scene, emitters, direct, seed, close)
    else:
        rng = np.random.default_rng(seed)
        points = discretise_emitters(scene, [e for e in emitters if not has_extent(e)], direct, seed, close)
        others = discretise_emitters(scene, [e for e in emitters if has_extent(e)], many, seed, close)
        sent = sent_to(scene, to_device(others), len(others), receivers, rng)
        lights = LightSamples.join([points, draw(others, sent, direct, rng)])
    if indirect < 1 or max_depth < 3:
        return lights
    if receivers is None:
        sources = discretise_emitters(scene, emitters, many, seed)
    else:
        sources = LightSamples.join([points, others])
    return LightSamples.join([lights, virtual_lights(scene, sources, indirect, max_depth, seed, receivers)])
