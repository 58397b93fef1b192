"""White and black marble on a kitchen table: the second scene of AWB08."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import SceneError
from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.lathe import Solid
from ..stage import PictureSettings, Spec, material, scaled_to, start
from .furniture import furniture
from .objects import OBJECTS, make, slab
from .room import lights, room

SAMPLES = 3.5e6
# Its mean free paths are those of white marble, but so little of the light comes back that the diffusion approximation,
# which fails where absorption prevails, cannot be off by more than is seen.
BLACK = {
    "type": "pellucid_translucent",
    "sigma_s_prime": (0.084, 0.086, 0.090),
    "sigma_a": (2.92, 2.92, 2.91),
    "eta": 1.5,
    "alpha": 0.05,
}
WHITE = {"type": "pellucid_translucent", "material": "marble", "alpha": 0.08}

# Where each object stands: x, y, z [mm], turned around z and then tilted away from it around y [degrees].
Place = tuple[float, float, float, float, float]
WHITE_OBJECTS: dict[str, list[Place]] = {
    "mortar": [(-175, -95, 0, 0, 0)],
    "pestle": [(-205, -95, 60, -30, 32)],
    "vase": [(-330, 215, 0, 0, 0)],
    "plate": [(405, 130, 11.0 * k, 40.0 * k, 0) for k in range(5)],
    "cup": [(270, -20, 0, 0, 0), (455, -60, 0, 70, 0), (405, 130, 54, 0, 0)],
    "pin": [(215, -235, 52, 22, 90)],
    "squeezer": [(-62, -262, 0, 0, 0)],
    "jug": [(-125, 215, 0, 200, 0)],
    "pear": [(-330, -250, 0, 0, 0), (115, 148, 33, 0, 0), (112, 282, 33, 90, 0)],
    "stand": [(620, 330, 0, 0, 0)],
    "canister": [(-700, 1560, 99, 0, 0), (-500, 1590, 99, 0, 0), (420, 1570, 99, 0, 0)],
}
BLACK_OBJECTS: dict[str, list[Place]] = {
    "bowl": [(115, 215, 0, 0, 0)],
    "slab": [(225, -235, 10, 12, 0)],
    "candlestick": [(-480, 110, 0, 0, 0), (-200, 330, 0, 0, 0)],
    "queen": [(-385, -130, 0, 0, 0)],
    "pawn": [(-440, -60, 0, 0, 0), (-455, -185, 0, 0, 0), (-345, -35, 0, 0, 0), (-60, -80, 0, 0, 0)],
    "apple": [(-232, -292, 0, 0, 0), (48, 214, 33, 40, 0), (182, 216, 33, 130, 0), (620, 330, 115, 0, 0)],
}


def kitchen(settings: PictureSettings, bsdf: Spec | None = None, samples: float = SAMPLES, detail: int = 256) -> Spec:
    """Mortar, bowls, plates, cups, turned pieces: 3.5 million irradiance samples on white and black marble.

    Sun and sky shine through large windows on the left, six lamps from recesses in the ceiling.

    Parameters
    ----------
    bsdf : dict, optional
        Another material for the white objects.
    samples : float
        Irradiance samples of the whole scene, ``sum A / (pi mfp^2)`` over all bodies with ``mfp`` the shortest mean free
        path. It sets the ``scale`` of the media; the scene is in millimetres, and 3.5 million make it two thirds of its
        true size.
    detail : int
        Segments around every object: 256 gives 1.2 million triangles.

    Raises
    ------
    SceneError
        For fewer than one sample.
    """
    if samples < 1:
        raise SceneError(f"samples = {samples:g}: give at least one.")
    scene = start(settings, (110, -1400, 580), (15, 40, 70), 43.0, "x")
    white, black = _solids(WHITE_OBJECTS, detail), _solids(BLACK_OBJECTS, detail)
    areas = [_area(white, WHITE_OBJECTS), _area(black, BLACK_OBJECTS)]
    media = scaled_to(samples, [(material(bsdf, WHITE), areas[0]), (dict(BLACK), areas[1])])
    for solids, places, medium in ((white, WHITE_OBJECTS, media[0]), (black, BLACK_OBJECTS, media[1])):
        scene |= _objects(solids, places, medium)
    return scene | room() | furniture() | lights()


def _solids(places: dict[str, list[Place]], detail: int) -> dict[str, Solid]:
    """Make each kind of object once."""
    return {name: make(name, detail) if name in OBJECTS else slab(detail) for name in places}


def _area(solids: dict[str, Solid], places: dict[str, list[Place]]) -> float:
    """The surface of all objects [mm^2]."""
    return sum(solid.area * len(places[name]) for name, solid in solids.items())


def _objects(solids: dict[str, Solid], places: dict[str, list[Place]], bsdf: Spec) -> dict[str, Any]:
    """Meshes where there is one of a kind, else a group and its instances."""
    import mitsuba as mi

    shared = mi.load_dict(bsdf)
    scene: dict[str, Any] = {}
    for name, solid in solids.items():
        turns = [
            mi.ScalarTransform4f().translate([x, y, z]).rotate([0, 0, 1], turn).rotate([0, 1, 0], tilt)
            for x, y, z, turn, tilt in places[name]
        ]
        if len(turns) == 1:
            solid = _placed(solid, turns[0])
            scene[name] = mesh_from_arrays(name, solid.vertices, solid.faces, solid.normals, bsdf=shared)
            continue
        mesh = mesh_from_arrays(name, solid.vertices, solid.faces, solid.normals, bsdf=shared)
        scene[f"{name}_group"] = {"type": "shapegroup", name: mesh}
        for k, turn in enumerate(turns):
            group = {"type": "ref", "id": f"{name}_group"}
            scene[f"{name}_{k}"] = {"type": "instance", "group": group, "to_world": turn}
    return scene


def _placed(solid: Solid, turn: Any) -> Solid:
    """Move a solid by a rigid transform."""
    matrix = np.array(turn.matrix, float)
    return Solid(solid.vertices @ matrix[:3, :3].T + matrix[:3, 3], solid.faces, solid.normals @ matrix[:3, :3].T)
