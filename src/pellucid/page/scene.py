"""What a page shows: one translucent body under lamps, taken from a scene of Mitsuba."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SceneError
from ..methods.reflectance import settle_reflectances
from ..methods.stretch import refuse_stretched
from ..methods.texture_space.discs import MOST_SIZES, OVERLAP
from ..methods.texture_space.drawing import FAR_DISC, LARGEST_DISC
from ..model.materials import PRESETS
from ..model.medium import Medium
from ..model.profiles import SMALLEST_DISC, STEEPEST_CURVE, TIGHTEST
from ..realtime.source import Camera, Settings
from ..realtime.space import Space
from ..scene.bodies import Body, find_bodies
from .lamps import page_lamps
from .medium_table import MediumTable
from .packing import NORMAL_STEPS, PLACE_STEPS, Planes, add_mesh
from .restored import FLOOR_REACH, FLOOR_REFLECTANCE
from .surface import RESOLUTION, colour_picture, openness, page_surface

SAMPLES = 900
"""N at the start."""

NO_THIN_PARTS = (
    "parts so thin that light passes through them are too bright: profile = 'curved' has no factor for them here"
)
"""Said in the page alone: the real-time engine, in whose place it draws, leaves the factor out as well."""

SHIFTS = 16
"""Of the samples, one a picture that a settled one is the mean of."""


@dataclass
class PageScene:
    """The contents of a page.

    Attributes
    ----------
    head : dict
        What the page reads as JSON.
    data : str
        The planes of numbers that ``head`` describes, packed.
    notes : list of str
        What the page shows otherwise than the scene has it.
    camera : Camera
    body : Body
    """

    head: dict[str, Any]
    data: str
    camera: Camera
    body: Body
    notes: list[str] = field(default_factory=list)

    @property
    def extent(self) -> float:
        """The longest side of the body [scene units]."""
        return max(self.head["body"]["size"])


def page_scene(scene: mi.Scene, name: str, sensor: Any = None) -> PageScene:
    """Take the translucent body, the lamps and the camera of a scene.

    Raises
    ------
    SceneError
        When the scene has several translucent bodies, or one that is open or no mesh.
    """
    body = _one_body(scene, name)
    surface, atlas = page_surface(body)
    planes = Planes()
    low, size, corner = add_mesh(planes, surface.corners, surface.normals, surface.uv)
    values, scale = openness(surface, corner, body.medium.eta)
    planes.add("openness", values, "delta")
    table = MediumTable.make(body.medium.flat_profile).add_to(planes)
    sensor = sensor or scene.sensors()[0]
    camera = Space.of(scene).first_camera(sensor)
    width, height = (int(side) for side in sensor.film().size())
    lamps, sky, notes = page_lamps(scene, low + size / 2)
    opaque = len(scene.shapes()) > len({id(part.in_scene) for part in body.parts})
    if opaque:
        notes.append("opaque shapes are left out; a floor stands for them")
    if any(part.has_holes for part in body.parts):
        notes.append("what a mask cuts out is solid")
    millimetres = float(body.bsdf.scale)
    medium = body.medium.scaled(1 / millimetres)
    head = {
        "name": name,
        "body": {
            "low": low.tolist(),
            "size": size.tolist(),
            "normalSteps": NORMAL_STEPS,
            "placeSteps": PLACE_STEPS,
            "resolution": RESOLUTION,
            "colours": colour_picture(body, atlas),
        },
        "planes": planes.describe,
        "table": table,
        "constants": _constants(scale, body.medium),
        "shifts": [np.random.default_rng(turn).random(2).tolist() for turn in range(SHIFTS)],
        "materials": {key: _coefficients(Medium.from_preset(key)) for key in PRESETS},
        "camera": _camera(camera),
        "aspect": width / height,
        "notes": [*notes, NO_THIN_PARTS] if body.medium.flat_profile.is_curved else notes,
        "state": {
            "material": medium.name if medium.name in PRESETS else "",
            "medium": _coefficients(medium),
            "millimetres": float(size.max()) * millimetres,
            "lamps": lamps,
            "sky": sky,
            "samples": SAMPLES,
            "hybrid": True,
            "autoExposure": True,
            "stops": 0.0,
            "highlight": Settings.specular,
            "roughness": round(float(np.clip(body.bsdf.alpha, 0.05, 1)), 3),
            "floor": opaque,
        },
    }
    return PageScene(head, planes.packed(), camera, body, notes)


def _one_body(scene: mi.Scene, name: str) -> Body:
    """Find the one closed translucent body of a scene."""
    bodies = find_bodies(scene)
    if bodies[0].side:
        raise SceneError(
            f"The page shows closed bodies, and '{bodies[0].name}' is an open surface: close its holes, give it thickness, or look at it "
            "with 'pellucid view'."
        )
    if len(bodies) > 1:
        raise SceneError(
            f"The page shows one translucent body, and '{name}' has {len(bodies)}: "
            "give them one 'body' name if they are one solid, or look at them with 'pellucid view'."
        )
    settle_reflectances(bodies)
    refuse_stretched(bodies, "the page")
    return bodies[0]


def _constants(openness_scale: float, medium: Medium) -> dict[str, Any]:
    """List the constants that the page shares with the methods in Python."""
    return {
        "evenWithin": medium.flat_profile.even_within,
        "smallestDisc": SMALLEST_DISC,
        "largestDisc": LARGEST_DISC,
        "farDisc": FAR_DISC,
        "overlap": OVERLAP,
        "discSizes": MOST_SIZES,
        "steepestCurve": STEEPEST_CURVE,
        "tightest": TIGHTEST,
        "opennessScale": openness_scale,
        "floorColour": FLOOR_REFLECTANCE,
        "floorReach": FLOOR_REACH,
    }


def _coefficients(medium: Medium) -> dict[str, Any]:
    """Write a medium as its coefficients [1/mm], index of refraction and mean cosine of the scattering angle."""
    coefficients = {"scattering": medium.sigma_s_prime.tolist(), "absorption": medium.sigma_a.tolist()}
    return {**coefficients, "eta": medium.eta, "g": medium.g}


def _camera(camera: Camera) -> dict[str, Any]:
    vectors = {key: np.asarray(getattr(camera, key), float).tolist() for key in ("origin", "target", "up")}
    return {**vectors, "fov": camera.fov}
