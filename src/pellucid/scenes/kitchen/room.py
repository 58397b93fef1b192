"""The kitchen around the table: walls, windows, a tiled floor, cupboards, and the lights; millimetres, the table top is z = 0."""

from __future__ import annotations

import numpy as np

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.boxes import Extent, boxes, perforated
from ..shapes.patterns import picture, stone, tiled
from ..stage import Spec, diffuse, rgb

# The room: left, right, front (behind the camera), back, floor and ceiling.
LEFT, RIGHT, FRONT, BACK, FLOOR, CEILING = -2300.0, 2100.0, -3000.0, 1900.0, -780.0, 1800.0
WALL = 250.0
# Windows in the left wall, as (y, z) of two corners: beside the picture, so that they light it and are not in it.
WINDOWS = [((-1500.0 + 1150 * k, 40.0), (-500.0 + 1150 * k, 1550.0)) for k in range(3)]
LAMPS = [(x, y) for y in (-600.0, 500.0, 1350.0) for x in (-750.0, 750.0)]
LAMP_HALF = 55.0


def room() -> Spec:
    """Walls with their windows, the ceiling with its recesses, the floor."""
    t = WALL
    lamps = [((x - LAMP_HALF, y - LAMP_HALF), (x + LAMP_HALF, y + LAMP_HALF)) for x, y in LAMPS]
    walls = perforated((LEFT - t, FRONT - t, FLOOR), (LEFT, BACK + t, CEILING), 0, WINDOWS)
    walls += [
        ((RIGHT, FRONT - t, FLOOR), (RIGHT + t, BACK + t, CEILING)),
        ((LEFT, FRONT - t, FLOOR), (RIGHT, FRONT, CEILING)),
        ((LEFT, BACK, FLOOR), (RIGHT, BACK + t, CEILING)),
        *perforated((LEFT - t, FRONT - t, CEILING), (RIGHT + t, BACK + t, CEILING + 60), 2, lamps),
        ((LEFT - t, FRONT - t, CEILING + 60), (RIGHT + t, BACK + t, CEILING + t)),
    ]
    bars: list[Extent] = []
    for (y0, z0), (y1, z1) in WINDOWS:
        x = LEFT - 0.6 * t
        bars += [((x, y - 11, z0), (x + 40, y + 11, z1)) for y in np.linspace(y0 + 16, y1 - 16, 3)]
        bars += [((x + 5, y0, z - 16), (x + 35, y1, z + 16)) for z in np.linspace(z0 + 16, z1 - 16, 4)]
    corners, faces = boxes([((LEFT - t, FRONT - t, FLOOR - t), (RIGHT + t, BACK + t, FLOOR))])
    checks = np.kron(np.tile([[1.0, 0.0], [0.0, 1.0]], (2, 2)), np.ones((128, 128)))[..., None]
    clay = checks * stone((0.55, 0.52, 0.46), (0.72, 0.69, 0.63), 3) + (1 - checks) * stone(
        (0.05, 0.05, 0.055), (0.11, 0.11, 0.115), 7
    )
    tiles = {
        "type": "roughplastic",
        "diffuse_reflectance": picture(tiled(clay, (4, 4), (0.3, 0.28, 0.25), 0.03, 1, 0.05)),
        "alpha": 0.15,
    }
    return {
        "walls": mesh_from_arrays("walls", *boxes(walls), bsdf=diffuse(0.72, 0.68, 0.60)),
        "bars": mesh_from_arrays("bars", *boxes(bars), bsdf=diffuse(0.65, 0.63, 0.6)),
        "floor": mesh_from_arrays("floor", corners, faces, None, corners[:, :2] / 1200, tiles),
    }


def lights() -> Spec:
    """Six square lamps recessed into the ceiling, warm; the sun through the windows, and the sky."""
    import mitsuba as mi

    scene: Spec = {
        "sunsky": {
            "type": "sunsky",
            "sun_direction": [-0.86, 0.22, 0.40],
            "sun_scale": 10.5,
            "sky_scale": 22.0,
            "turbidity": 3.0,
            "sampling_weight": 8.0,
        }
    }
    for k, (x, y) in enumerate(LAMPS):
        place = (
            mi.ScalarTransform4f()
            .translate([x, y, CEILING + 50])
            .rotate([1, 0, 0], 180)
            .scale([LAMP_HALF, LAMP_HALF, 1])
        )
        scene[f"lamp_{k}"] = {
            "type": "rectangle",
            "to_world": place,
            "emitter": {"type": "area", "radiance": rgb(95.0, 70.0, 45.0)},
            "bsdf": diffuse(0.0),
        }
    return scene
