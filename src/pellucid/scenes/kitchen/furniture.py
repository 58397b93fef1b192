"""The furniture of the kitchen: a table, and cupboards, a worktop and tiles along the wall behind it; millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.boxes import boxes
from ..shapes.lathe import Solid, joined, rounded_block
from ..shapes.patterns import clouds, picture, tiled, wood
from ..stage import Spec, diffuse
from .room import BACK, FLOOR, LEFT, RIGHT

Array = NDArray[np.float64]

TABLE = (800.0, 470.0, 24.0)
"""Half extents of the table top."""
WORKTOP = 98.0
"""Height of the worktop over the table."""
DOORS = ((FLOOR + 120, 40.0, 1290.0), (720.0, 1460.0, 1540.0))
"""Lower and upper edge, and the distance, of the two rows of doors."""
DOOR_WIDTH = 440.0


def furniture() -> Spec:
    """All of it."""
    return _table() | _cupboards() | _wall()


def _mesh(name: str, solid: Solid, bsdf: Spec, uv: Array | None = None) -> Any:
    """A solid as a Mitsuba mesh."""
    return mesh_from_arrays(name, solid.vertices, solid.faces, solid.normals, uv, bsdf)


def _oak(seed: int) -> Spec:
    """Oiled boards."""
    boards = picture(wood((0.11, 0.052, 0.027), (0.37, 0.22, 0.125), seed, 7))
    return {"type": "roughplastic", "diffuse_reflectance": boards, "alpha": 0.2}


def _table() -> Spec:
    """A top of planks on four legs."""
    top = rounded_block(TABLE, 10, (1, 1, 1), 3).moved((0, 0, -TABLE[2]))
    at = [(x, y) for x in (90 - TABLE[0], TABLE[0] - 90) for y in (90 - TABLE[1], TABLE[1] - 90)]
    legs = boxes([((x - 45, y - 45, FLOOR), (x + 45, y + 45, -40)) for x, y in at])
    return {
        "table": _mesh("table", top, _oak(13), top.vertices[:, :2] / 1100 + 0.5),
        "legs": mesh_from_arrays("legs", *legs, bsdf=diffuse(0.16, 0.08, 0.04)),
    }


def _cupboards() -> Spec:
    """Painted doors with panels and knobs on dark bodies."""
    doors, knobs = [], []
    for k, x in enumerate(np.arange(LEFT + 250, RIGHT, DOOR_WIDTH)):
        for row, (low, high, y) in enumerate(DOORS):
            half, middle = 0.5 * (high - low), (x, y, 0.5 * (low + high))
            doors.append(rounded_block((0.5 * DOOR_WIDTH - 4, 12, half - 4), 5, (1, 1, 1)).moved(middle))
            frame = rounded_block((0.5 * DOOR_WIDTH - 70, 6, half - 70), 5, (1, 1, 1))
            doors.append(frame.moved((x, y - 13, middle[2])))
            knob = (x + (180 if k % 2 else -180), y - 30, high - 80 if row == 0 else low + 80)
            knobs.append(rounded_block((14, 14, 14), 13, (1, 1, 1), 4).moved(knob))
    bodies = boxes(
        [
            ((LEFT, 1302, FLOOR + 100), (RIGHT, BACK, 62)),
            ((LEFT, 1345, FLOOR), (RIGHT, BACK, FLOOR + 100)),
            ((LEFT, 1552, 700), (RIGHT, BACK, 1480)),
        ]
    )
    brass = {"type": "roughconductor", "material": "Cu", "alpha": 0.2}
    return {
        "doors": _mesh("doors", joined(doors), diffuse(0.17, 0.25, 0.23)),
        "knobs": _mesh("knobs", joined(knobs), brass),
        "cupboards": mesh_from_arrays("cupboards", *bodies, bsdf=diffuse(0.10, 0.14, 0.13)),
    }


def _wall() -> Spec:
    """A wooden worktop and glazed tiles above it."""
    half = (0.5 * (RIGHT - LEFT), 325, 18)
    worktop = rounded_block(half, 6, (1, 1, 1)).moved((0.5 * (LEFT + RIGHT), BACK - 325, WORKTOP - 18))
    corners, faces = boxes([((LEFT, BACK - 12, WORKTOP - 10), (RIGHT, BACK, 710))])
    glaze = np.array([0.66, 0.65, 0.60]) * (1 + 0.02 * clouds((512, 512), 17)[..., None])
    tiles = picture(tiled(glaze, (8, 8), (0.35, 0.33, 0.30), 0.05, 3, 0.06))
    ceramic = {"type": "roughplastic", "alpha": 0.08, "diffuse_reflectance": tiles}
    return {
        "worktop": _mesh("worktop", worktop, _oak(19), worktop.vertices[:, :2] / 900),
        "splash": mesh_from_arrays("splash", corners, faces, None, corners[:, [0, 2]] / 800, ceramic),
    }
