"""The emitters of a Mitsuba scene as point lights."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, warn
from ...kernels.memory import rows
from ...kernels.sequences import hammersley_set
from ..lamps import CloseLamps
from ..places import places_on
from .records import DIRECTIONAL, OMNI, ORIENTED, LightSamples

FEWEST = 64
"""Points of an emitter with an extent, however many there are."""


def find_emitters(scene: mi.Scene) -> list[mi.Emitter]:
    """List the emitters of a scene that point lights can stand for.

    Warns
    -----
    PellucidWarning
        For each of the others.
    """
    found = []
    for emitter in scene.emitters():
        if builder_of(emitter) is not None:
            found.append(emitter)
            continue
        warn(
            f"The emitter '{emitter.id()}' ({emitter.class_name()}) cannot be turned into point lights and is left out: "
            "use another emitter, or another integrator."
        )
    return found


def discretise_emitters(
    scene: mi.Scene, emitters: list[mi.Emitter], direct: int, seed: int, close: CloseLamps | None = None
) -> LightSamples:
    """Turn emitters into point lights.

    A point, a spot and a directional light become one light each, exactly. An area light becomes points on its shape,
    ``I = L dA``. Whatever shines from infinitely far away becomes directions, sampled by its radiance: the sum of their
    intensities is unbiased, and exact where the radiance is constant.

    Parameters
    ----------
    emitters : list of Emitter
        Of those that `find_emitters` lists.
    direct : int
        Points that the emitters with an extent share evenly, at least ``FEWEST`` each.
    close : CloseLamps, optional
        Those that grow no brighter within reach.

    Raises
    ------
    SceneError
        For negative light.

    Source: AWB08 section 4.1.
    """
    builders = [(emitter, builder_of(emitter)) for emitter in emitters]
    extended = sum(has_extent(emitter) for emitter in emitters)
    share = max(FEWEST, direct // max(extended, 1))
    centre = np.array(scene.bbox().center()) if scene.bbox().valid() else np.zeros(3)
    parts = []
    for number, (emitter, build) in enumerate(builders):
        assert build is not None
        lights = build(emitter, share, seed + number, centre)
        if close is not None and any(emitter is one for one in close.emitters(scene)):
            lights.reach2[:] = close.reach**2
        if np.any(lights.intensity < 0):
            raise SceneError(f"The emitter '{emitter.id()}' takes light away, its strength is below 0: give 0 or more.")
        bright = np.any(lights.intensity != 0, axis=1) & np.isfinite(lights.intensity).all(axis=1)
        parts.append(lights.take(bright))  # one that sends nothing may answer with NaN
    return LightSamples.join(parts)


Builder = Callable[..., LightSamples]


def builder_of(emitter: mi.Emitter) -> Builder | None:
    """Choose what turns an emitter into point lights; None if nothing can."""
    if emitter.is_environment():
        return _environment
    textured = bool(emitter.flags() & mi.EmitterFlags.SpatiallyVarying)
    return {
        "AreaLight": _area,
        "DirectionalEmitter": _directional,
        "PointLight": _point,
        "SpotLight": None if textured else _spot,
    }.get(emitter.class_name())


def has_extent(emitter: mi.Emitter) -> bool:
    """Tell whether many point lights stand for an emitter, not one."""
    return builder_of(emitter) in (_area, _environment)


def _area(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    """Points on the shape of an area light, where its texture is bright; each is as bright as its part of the surface.

    ``near2 = dA / pi`` keeps its irradiance below the radiosity ``pi L`` of that part.
    """
    si, area = places_on([emitter], count, seed)
    light = mi.Color3f(emitter.eval(si)) * area
    return LightSamples.make(
        ORIENTED, rows(si.spawn_ray(mi.Vector3f(si.n)).o), rows(si.n), rows(light), area.numpy() / np.pi
    )


def _environment(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    """Directions of a sky, where it is bright."""
    ds, weight = emitter.sample_direction(_at(centre, count), mi.Point2f(*hammersley_set(mi.Float, count, seed)))
    return LightSamples.make(DIRECTIONAL, 0, rows(ds.d), rows(weight) / count)


def _directional(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    ds, weight = emitter.sample_direction(_at(centre), mi.Point2f(0.5))
    return LightSamples.make(DIRECTIONAL, 0, rows(ds.d), rows(weight))


def _point(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    position = rows(emitter.sample_direction(_at(centre), mi.Point2f(0.5))[0].p)
    return LightSamples.make(OMNI, position, 0, _intensity(emitter, position[0], np.array([0, 0, 1])))


def _spot(emitter: mi.Emitter, count: int, seed: int, centre: NDArray) -> LightSamples:
    position = rows(emitter.sample_direction(_at(centre), mi.Point2f(0.5))[0].p)
    axis = rows(emitter.world_transform() @ mi.Vector3f(0, 0, 1))[0]
    axis /= np.linalg.norm(axis)
    found = mi.traverse(emitter)
    cutoff, beam = (float(np.deg2rad(np.ravel(found[key])[0])) for key in ("cutoff_angle", "beam_width"))
    return LightSamples.make(
        OMNI, position, axis, _intensity(emitter, position[0], axis), cutoff=cutoff, beam=min(beam, cutoff)
    )


def _intensity(emitter: mi.Emitter, position: NDArray, axis: NDArray) -> NDArray[np.float32]:
    """Measure the intensity of a point light along an axis: ``(1, 3) float32`` [W/sr]."""
    reach = 1 + float(np.abs(position).max())  # far enough that the difference of positions keeps its digits
    ds, weight = emitter.sample_direction(_at(position + reach * axis), mi.Point2f(0.5))
    return rows(weight * dr.square(ds.dist))


def _at(p: NDArray, count: int = 1) -> mi.Interaction3f:
    """Stand at a point."""
    it = dr.zeros(mi.SurfaceInteraction3f, count)
    it.p = mi.Point3f(*(dr.opaque(mi.Float, float(x), count) for x in p))
    return it
