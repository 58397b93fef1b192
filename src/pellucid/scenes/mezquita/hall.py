"""What encloses the arcades: floor, walls, a ceiling of beams with skylights, sun and sky above, lamps below."""

from __future__ import annotations

import numpy as np

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.boxes import Extent, box, boxes, perforated
from ..shapes.patterns import picture, stone, tiled, wood
from ..stage import Spec, diffuse, rgb
from .arches import BAY, CEILING, shaft

NAVE = 5.2
"""Distance between arcades [m]."""
SKYLIGHT = (3.0, 6.0)
"""Width and length of an opening in the ceiling [m]; one every other nave, one every eight bays."""
SLAB, WALL = 0.6, 0.8
BEAM_SPACING = 0.75
LAMP_HEIGHT, LAMP_EVERY = 6.9, 4


def extent_of(arcades: int, length: int) -> tuple[float, float, float]:
    """Where the walls stand: width from x = 0, lowest and highest y [m]. The first columns stand free, the last arches end in a wall."""
    return NAVE * (arcades + 1), -0.6, BAY * length


def skylights(arcades: int, length: int) -> list[tuple[float, float]]:
    """Middles (x, y) of the openings in the ceiling."""
    rows = [BAY * (3.5 + 8 * k) for k in range(max(round(length / 8), 1)) if BAY * (3.5 + 8 * k) + 4 < BAY * length]
    return [(NAVE * (i + 0.5), y) for y in rows for i in range(0, arcades + 1, 2)]


def hall(arcades: int, length: int) -> Spec:
    """Floor, walls, ceiling and the sun and sky above it."""
    width, low, high = extent_of(arcades, length)
    scene: Spec = {}
    corners, faces = box((0, low, -0.2), (width, high, 0))
    slabs = tiled(
        stone((0.30, 0.22, 0.16), (0.52, 0.42, 0.33), 21, 0.05, 1024), (8, 8), (0.10, 0.08, 0.06), 0.02, 4, 0.16
    )
    polish = {"type": "roughplastic", "diffuse_reflectance": picture(slabs), "alpha": 0.15}
    scene["floor"] = mesh_from_arrays("floor", corners, faces, None, corners[:, :2] / (8 * 0.65), polish)
    walls = boxes(
        [
            ((-WALL, low - WALL, -0.2), (0, high + WALL, CEILING + SLAB)),
            ((width, low - WALL, -0.2), (width + WALL, high + WALL, CEILING + SLAB)),
            ((0, low - WALL, -0.2), (width, low, CEILING + SLAB)),
            ((0, high, -0.2), (width, high + WALL, CEILING + SLAB)),
        ]
    )
    scene["walls"] = mesh_from_arrays("walls", *walls, bsdf=diffuse(0.50, 0.40, 0.30))
    corners, faces = boxes(_ceiling(arcades, length))
    boards = picture(wood((0.20, 0.10, 0.05), (0.50, 0.31, 0.17), 8, 6))
    planks = {"type": "diffuse", "reflectance": boards}
    scene["ceiling"] = mesh_from_arrays("ceiling", corners, faces, None, corners[:, [1, 0]] / 2.4, planks)
    corners, faces = boxes(_beams(arcades, length))
    scene["beams"] = mesh_from_arrays("beams", corners, faces, bsdf=diffuse(0.30, 0.15, 0.07))
    scene["sunsky"] = {
        "type": "sunsky",
        "sun_direction": [-0.40, 0.36, 0.84],
        "sun_scale": 10.0,
        "sky_scale": 20.0,
        "turbidity": 3.0,
        "sampling_weight": 45.0,
    }
    return scene


def _ceiling(arcades: int, length: int) -> list[Extent]:
    """The slab as boxes around its openings."""
    width, low, high = extent_of(arcades, length)
    half = (0.5 * SKYLIGHT[0], 0.5 * SKYLIGHT[1])
    holes = [((x - half[0], y - half[1]), (x + half[0], y + half[1])) for x, y in skylights(arcades, length)]
    return perforated((-WALL, low - WALL, CEILING), (width + WALL, high + WALL, CEILING + SLAB), 2, holes)


def _beams(arcades: int, length: int) -> list[Extent]:
    """Beams across every nave, except where it is open to the sky."""
    _, low, high = extent_of(arcades, length)
    open_at = skylights(arcades, length)
    beams: list[Extent] = []
    for i in range(arcades + 1):
        for y in np.arange(low + 0.5 * BEAM_SPACING, high, BEAM_SPACING):
            if not any(abs(x - NAVE * (i + 0.5)) < 0.1 and abs(y - at) < 0.5 * SKYLIGHT[1] + 0.12 for x, at in open_at):
                beams.append(((NAVE * i, y - 0.11, CEILING - 0.26), (NAVE * (i + 1), y + 0.11, CEILING + 0.01)))
    return beams


def lamps(arcades: int, length: int) -> Spec:
    """A grid of point lights, one to every nave and four bays: 15 by 6 in the whole hall. Nothing that shines is drawn."""
    rows = max(round(length / LAMP_EVERY), 1)
    scene: Spec = {}
    for i in range(arcades + 1):
        for j in range(rows):
            where = [NAVE * (i + 0.5), BAY * length * (j + 0.5) / rows, LAMP_HEIGHT]
            scene[f"lamp_{i}_{j}"] = {"type": "point", "position": where, "intensity": rgb(21.0, 14.4, 8.3)}
    return scene


def shafts(arcades: int, length: int, detail: int) -> Spec:
    """The shafts of all columns in three kinds of polished stone, one mesh each."""
    kinds = {
        "jasper": stone((0.035, 0.040, 0.045), (0.10, 0.10, 0.11), 31, -0.25),
        "granite": stone((0.16, 0.09, 0.075), (0.36, 0.24, 0.20), 41, 0.1),
        "serpentine": stone((0.03, 0.055, 0.05), (0.12, 0.16, 0.14), 51, -0.2),
    }
    one = shaft(max(detail // 6, 12))
    kind = np.random.default_rng(7).choice(3, (arcades, length), p=(0.5, 0.28, 0.22))
    scene: Spec = {}
    for k, (name, surface) in enumerate(kinds.items()):
        places = np.argwhere(kind == k)
        if len(places) == 0:
            continue
        at = np.column_stack([NAVE * (places[:, 0] + 1), BAY * places[:, 1], np.zeros(len(places))])
        vertices = (at[:, None] + one.vertices).reshape(-1, 3)
        faces = (np.arange(len(at))[:, None, None] * len(one.vertices) + one.faces).reshape(-1, 3)
        uv = np.tile(one.uv if one.uv is not None else np.zeros((0, 2)), (len(at), 1))
        uv = uv + np.repeat(np.random.default_rng(k).random((len(at), 2)), len(one.vertices), 0)
        polish = {"type": "roughplastic", "diffuse_reflectance": picture(surface), "alpha": 0.12}
        scene[name] = mesh_from_arrays(name, vertices, faces, np.tile(one.normals, (len(at), 1)), uv, polish)
    return scene
