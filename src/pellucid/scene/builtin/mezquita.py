"""A hall of columns after the Mezquita of Cordoba: the third scene of AWB08."""

from __future__ import annotations

from ...errors import SceneError
from ..mesh_arrays import mesh_from_arrays
from .kitchen_lathe import Solid
from .mezquita_arches import BAY, LOWER, SHAFT_HIGH, UPPER, foot, masonry, voussoirs
from .mezquita_capital import capital
from .mezquita_hall import NAVE, hall, lamps, shafts
from .stage import Spec, View, diffuse, material, scaled_to, start

SAMPLES = 64e6


def mezquita(
    view: View, bsdf: Spec | None = None, samples: float = SAMPLES, bays: tuple[int, int] = (14, 24), detail: int = 224
) -> Spec:
    """A forest of columns in sun and lamp light: 336 bays with three bodies of marble each.

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
    scene = start(view, (x, y, 1.7), (x + 4.4, y + 9.5, 2.6), 68.0, "x")
    scene["bay"] = {"type": "shapegroup"} | _bay(marble, bsdf, detail)
    return (
        scene
        | _places(arcades, length)
        | shafts(arcades, length, detail)
        | hall(arcades, length)
        | lamps(arcades, length)
    )


def _bay(marble: dict[str, Solid], bsdf: Spec, detail: int) -> Spec:
    """The meshes of one bay: three bodies of marble, brick, the masonry and the foot of the column."""
    import mitsuba as mi

    stone = mi.load_dict(bsdf)
    meshes = {name: _mesh(name, solid, stone) for name, solid in marble.items()}
    brick, plaster = diffuse(0.36, 0.085, 0.045), {"type": "twosided", "bsdf": diffuse(0.50, 0.40, 0.29)}
    for name, arch in (("lower_brick", LOWER), ("upper_brick", UPPER)):
        meshes[name] = _mesh(name, voussoirs(arch, 0, 1), mi.load_dict(brick))
    meshes["masonry"] = mesh_from_arrays("masonry", *masonry(), bsdf=plaster)
    meshes["foot"] = _mesh("foot", foot(max(detail // 4, 16)), mi.load_dict(diffuse(0.42, 0.37, 0.30)))
    return meshes


def _mesh(name: str, solid: Solid, bsdf: object) -> object:
    """A solid as a Mitsuba mesh."""
    return mesh_from_arrays(name, solid.vertices, solid.faces, solid.normals, bsdf=bsdf)


def _places(arcades: int, length: int) -> Spec:
    """One instance of the bay at every column."""
    import mitsuba as mi

    group = {"type": "ref", "id": "bay"}
    return {
        f"bay_{i}_{j}": {
            "type": "instance",
            "group": group,
            "to_world": mi.ScalarTransform4f().translate([NAVE * (i + 1), BAY * j, 0]),
        }
        for i in range(arcades)
        for j in range(length)
    }
