"""A head of skin with a painted reflectance under key, fill and rim light, in place of the face in figure 6 of JB02."""

from __future__ import annotations

import numpy as np

from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.level_set import surface_mesh
from ..stage import PictureSettings, Spec, lamp, material, start, sweep
from .albedo import bust_albedo, cylinder_uv
from .shape import BASE, HIGH, LOW, bust_distance

LIFE_SIZE = 340.0

# Diffuse mean free paths [mm] of skin1 (JMLH01 figure 5), for red, green and blue; the reflectance is painted.
SKIN_DMFP = (3.67, 1.37, 0.68)


def bust(settings: PictureSettings, bsdf: Spec | None = None, size: float = LIFE_SIZE, edge: float = 2.0) -> Spec:
    """A head with closed eyes, generated from a distance field, of skin with a painted reflectance.

    Parameters
    ----------
    size : float
        Height [mm]. The material stays what it is: a small head is more translucent than a life-sized one.
    edge : float
        Side of the triangles on a head of life size [mm].
    """
    import mitsuba as mi

    unit = size / LIFE_SIZE
    vertices, normals, faces = surface_mesh(bust_distance, LOW, HIGH, edge)
    source, uv, faces = cylinder_uv(vertices, faces)
    painted = {"type": "bitmap", "bitmap": mi.Bitmap(bust_albedo(vertices)), "wrap_mode": "repeat"}
    skin = {"type": "pellucid_translucent", "reflectance": painted, "eta": 1.3, "alpha": 0.35}
    skin["dmfp"] = {"type": "rgb", "value": list(SKIN_DMFP)}
    placed = unit * (vertices - np.array([0, 0, BASE]))[source]

    eyes = (0.0, 0.0, -BASE * unit)
    target = np.array([0, 0, 168 * unit])
    scene = start(settings, (-330 * unit, -1010 * unit, 205 * unit), target, 20.5, "y")
    scene["bust"] = mesh_from_arrays("bust", placed, faces, normals[source], uv, material(bsdf, skin))
    scene["table"] = sweep(5000 * unit, 1700 * unit, (0.085, 0.09, 0.10))
    for name, place, extent, radiance, weight in (
        ("key", (-900, -800, 640), 470, (27.0, 24.0, 20.5), 2.0),
        ("fill", (1000, -1100, 900), 1000, (0.72, 0.85, 1.05), 1.0),
        ("rim", (900, 690, 680), 480, (30.0, 27.5, 25.5), 1.5),
    ):
        scene[name] = lamp(np.add(eyes, np.multiply(place, unit)), eyes, extent * unit, radiance, weight)
    return scene
