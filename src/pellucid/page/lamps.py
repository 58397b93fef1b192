"""Emitters of a scene as the lamps and the sky of the page, and what is lost on the way."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..kernels.memory import columns
from ..realtime.lights import Lamp
from .surface import harmonics, sphere_directions

MOST_LAMPS = 4
SKY_DIRECTIONS = 8192

Described = dict[str, Any]


def page_lamps(
    scene: mi.Scene, centre: NDArray[np.float64]
) -> tuple[list[Described], list[list[float]] | None, list[str]]:
    """Describe the emitters of a scene to the page.

    Parameters
    ----------
    centre : (3,) float
        Middle of the body, which lamps with an extent face.

    Returns
    -------
    lamps : list of dict
        Kind (``point`` or ``directional``), position (of a directional lamp: the direction to it), colour, intensity.
    sky : (9, 3) list of float, or None
        Radiance of the environment in spherical harmonics.
    notes : list of str
        What the page shows otherwise than the scene has it.
    """
    lamps: list[Described] = []
    sky, notes = None, []
    for emitter in scene.emitters():
        lamp = Lamp(scene, emitter)
        if lamp.kind == "environment":
            sky = _sky(emitter)
            notes.append("the environment is blurred to nine spherical harmonics")
        elif lamp.is_on and lamp.kind in ("point", "spot", "area", "directional"):
            described, note = _lamp(lamp, centre)
            lamps.append(described)
            notes += [note] if note else []
        elif lamp.is_on:
            notes.append(f"the light '{emitter.id()}' ({emitter.class_name()}) is left out")
    if len(lamps) > MOST_LAMPS:
        notes.append(f"of {len(lamps)} lamps the {MOST_LAMPS} brightest are kept")
        lamps = sorted(lamps, key=lambda lamp: _strength(lamp, centre), reverse=True)[:MOST_LAMPS]
    return lamps, sky, list(dict.fromkeys(notes))


def _lamp(lamp: Lamp, centre: NDArray[np.float64]) -> tuple[Described, str]:
    """Describe one lamp, with what is lost of it."""
    light = lamp.describe()
    position, intensity, note = light.position, light.intensity, ""
    if lamp.kind == "directional":
        assert light.direction is not None
        return _described("directional", -light.direction, light.colour, intensity), note
    assert position is not None
    if lamp.kind == "spot":
        note = "spot lights shine all around"
    if lamp.kind == "area":
        note = "lamps with an extent are points: their shadows are sharp"
        area = float(np.array(lamp.emitter.get_shape().surface_area()).ravel()[0])
        # What a flat lamp sends along a direction falls with the cosine; a closed one shows a quarter of its surface.
        away = (centre - position) / max(float(np.linalg.norm(centre - position)), 1e-30)
        intensity *= area * (max(float(light.direction @ away), 0.0) if light.direction is not None else 0.25)
    return _described("point", position, light.colour, intensity), note


def _described(kind: str, position: NDArray[np.float64], colour: NDArray[np.float64], intensity: float) -> Described:
    return {"kind": kind, "position": position.tolist(), "colour": colour.tolist(), "intensity": float(intensity)}


def _strength(lamp: Described, centre: NDArray[np.float64]) -> float:
    """Evaluate how bright a lamp is at the body."""
    if lamp["kind"] == "directional":
        return float(lamp["intensity"])
    return float(lamp["intensity"]) / float(np.sum((np.array(lamp["position"]) - centre) ** 2))


def _sky(emitter: mi.Emitter) -> list[list[float]]:
    """Project the radiance of an environment onto nine spherical harmonics."""
    directions = sphere_directions(SKY_DIRECTIONS)
    si = dr.zeros(mi.SurfaceInteraction3f, SKY_DIRECTIONS)
    si.wi = -mi.Vector3f(*columns(directions.astype(np.float32)))
    radiance = emitter.eval(si).numpy() + np.zeros((3, SKY_DIRECTIONS))
    projected: list[list[float]] = (harmonics(directions).T @ radiance.T * (4 * np.pi / SKY_DIRECTIONS)).tolist()
    return projected
