"""A hall of columns after the Mezquita of Cordoba: the third scene of AWB08."""

from __future__ import annotations

import numpy as np

from ...errors import SceneError
from ...scene.meshes.buffers import mesh_from_arrays
from ..shapes.lathe import Solid, joined
from ..stage import PictureSettings, Spec, diffuse, material, scaled_to, start
from .arches import BAY, LOWER, SHAFT_HIGH, UPPER, foot, masonry, voussoirs
from .capital import capital
from .hall import NAVE, hall, lamps, shafts

SAMPLES = 64e6


def mezquita(
    settings: PictureSettings,
    bsdf: Spec | None = None,
    samples: float = SAMPLES,
    bays: tuple[int, int] = (14, 24),
    detail: int = 224,
) -> Spec:
    """A forest of columns in sun and lamp light: 336 bays, two by two to an instance, with three bodies of marble each.

    Parameters
    ----------
    bsdf : dict, optional
        Another material for the marble.
    samples : float
        Irradiance samples of the whole hall, ``sum A / (pi mfp^2)`` over all bodies with ``mfp`` the shortest mean free
        path. It sets the ``scale`` of the medium: the hall is in metres, so 64 million make it a model of about 1 : 18.
    bays : (int, int)
        Number of arcades and of bays in each. A larger hall of the same marble needs ``samples`` in proportion.
    detail : int
        Segments around a capital.

    Raises
    ------
    SceneError
        For fewer than one arcade or bay, or fewer than one sample.
    """
    arcades, length = bays
    if arcades < 1 or length < 1:
        raise SceneError(f"bays = {bays}: give at least one arcade of one bay, (1, 1).")
    if samples < 1:
        raise SceneError(f"samples = {samples:g}: give at least one.")
    marble = {
        "capital": capital(detail).moved((0, 0, SHAFT_HIGH)),
        "lower": voussoirs(LOWER, 1, max(detail // 56, 1)),
        "upper": voussoirs(UPPER, 1, max(detail // 56, 1)),
    }
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "marble", "alpha": 0.18})
    area = sum(solid.area for solid in marble.values()) * arcades * length
    (bsdf,) = scaled_to(samples, [(bsdf, area)])
    # Between two arcades, where the light of a skylight falls through the next one.
    x, y = NAVE * (min(2, arcades) + 0.38), 2.2 + (24.0 if length >= 16 else 0.0)
    scene = start(settings, (x, y, 1.7), (x + 4.4, y + 9.5, 2.6), 68.0, "x")
    # Two by two bays to an instance: what it costs to prepare a kernel grows with the square of the number of instances.
    block = (2 - arcades % 2, 2 - length % 2)
    scene["block"] = {"type": "shapegroup"} | _block(marble, bsdf, detail, block)
    return (
        scene
        | _places(arcades, length, block)
        | shafts(arcades, length, detail)
        | hall(arcades, length)
        | lamps(arcades, length)
    )


def _block(marble: dict[str, Solid], bsdf: Spec, detail: int, block: tuple[int, int]) -> Spec:
    """The meshes of a block of bays: three bodies of marble, brick, the masonry and the feet of the columns."""
    import mitsuba as mi

    solids = {
        **marble,
        "lower_brick": voussoirs(LOWER, 0, 1),
        "upper_brick": voussoirs(UPPER, 0, 1),
        "foot": foot(max(detail // 4, 16)),
    }
    brick, grey = mi.load_dict(diffuse(0.36, 0.085, 0.045)), mi.load_dict(diffuse(0.42, 0.37, 0.30))
    # The stones of an arch are one solid, although they do not touch each other.
    solid = bsdf["type"] == "pellucid_translucent"
    materials = {name: mi.load_dict(bsdf | ({"body": name} if solid else {})) for name in marble}
    materials |= {"lower_brick": brick, "upper_brick": brick, "foot": grey}
    places = np.array([[NAVE * i, BAY * j, 0] for i in range(block[0]) for j in range(block[1])])
    meshes = {}
    for name, solid in solids.items():
        copies = joined([solid.moved(place) for place in places])
        meshes[name] = mesh_from_arrays(name, copies.vertices, copies.faces, copies.normals, bsdf=materials[name])
    vertices, faces = masonry()
    plaster = {"type": "twosided", "bsdf": diffuse(0.50, 0.40, 0.29)}
    meshes["masonry"] = mesh_from_arrays(
        "masonry",
        np.concatenate([vertices + place for place in places]),
        np.concatenate([faces + k * len(vertices) for k in range(len(places))]),
        bsdf=plaster,
    )
    return meshes


def _places(arcades: int, length: int, block: tuple[int, int]) -> Spec:
    """An instance of the block for every so many columns."""
    import mitsuba as mi

    group = {"type": "ref", "id": "block"}
    return {
        f"block_{i}_{j}": {
            "type": "instance",
            "group": group,
            "to_world": mi.ScalarTransform4f().translate([NAVE * (i + 1), BAY * j, 0]),
        }
        for i in range(0, arcades, block[0])
        for j in range(0, length, block[1])
    }
