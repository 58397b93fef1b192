"""What the built-in scenes share: camera, lamps and the paper sweep of a photographer's table. Up is z, units are mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene.meshes.buffers import mesh_from_arrays

Vector = Sequence[float] | NDArray[np.floating]
Spec = dict[str, Any]

NEAREST, FARTHEST = 1e-3, 1e4
"""Clip planes of the camera, over the distance of what it looks at."""


@dataclass
class PictureSettings:
    """What the caller of a built-in scene may choose about the picture, whatever the scene.

    Attributes
    ----------
    resolution : (int, int)
        Width and height [pixels].
    spp : int
        Samples a pixel.
    camera_angle : float
        The camera goes around the object by this angle, counter-clockwise seen from above [degrees]. The light stays.
    integrator : dict
        For ``mi.load_dict``.
    """

    resolution: tuple[int, int] = (1024, 768)
    spp: int = 4
    camera_angle: float = 0.0
    integrator: Spec = field(default_factory=lambda: {"type": "pellucid_two_pass"})


def rgb(*value: float) -> Spec:
    """A colour, or a radiance, for ``mi.load_dict``."""
    return {"type": "rgb", "value": list(value) * (3 if len(value) == 1 else 1)}


def diffuse(*value: float) -> Spec:
    """A diffuse BSDF of that reflectance."""
    return {"type": "diffuse", "reflectance": rgb(*value)}


def start(settings: PictureSettings, origin: Vector, target: Vector, fov: float, fov_axis: str = "smaller") -> Spec:
    """Begin a scene: integrator and a camera at ``origin`` that turns around the vertical through ``target``.

    ``fov`` is the field of view [degrees] along the side of the picture that ``fov_axis`` names: the one that the object
    fills, so that it is not cut off when the picture becomes taller or wider.
    """
    import mitsuba as mi

    turn = np.deg2rad(settings.camera_angle)
    x, y, z = np.subtract(origin, target)
    moved = np.add(target, (x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z))
    width, height = settings.resolution
    distance = float(np.linalg.norm((x, y, z)))
    sensor = {
        "type": "perspective",
        "fov": fov,
        "fov_axis": fov_axis,
        "near_clip": NEAREST * distance,
        "far_clip": FARTHEST * distance,
        "to_world": mi.ScalarTransform4f().look_at(origin=moved.tolist(), target=list(target), up=[0, 0, 1]),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "rfilter": {"type": "gaussian"},
        },
        "sampler": {"type": "multijitter", "sample_count": settings.spp},
    }
    return {"type": "scene", "integrator": dict(settings.integrator), "sensor": sensor}


def lamp(origin: Vector, target: Vector, extent: float, radiance: Vector, weight: float = 1.0) -> Spec:
    """A square lamp of side ``extent`` [mm] at ``origin`` that shines towards ``target``; black from behind.

    A path chooses among the lamps in proportion to their ``weight``.
    """
    import mitsuba as mi

    place = mi.ScalarTransform4f().look_at(origin=list(origin), target=list(target), up=[0, 0.6, 0.8])
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale([extent / 2, extent / 2, 1]),
        "emitter": {"type": "area", "radiance": rgb(*radiance), "sampling_weight": weight},
        "bsdf": diffuse(0.0),
    }


def environment_light(picture: str | Path) -> Spec:
    """Light from all around, from a latitude-longitude picture whose up is y as is usual for them.

    Raises
    ------
    SceneError
        When there is no such file.
    """
    import mitsuba as mi

    if not Path(picture).is_file():
        raise SceneError(f"environment '{picture}': no such file; give a latitude-longitude .exr or .hdr picture")
    return {"type": "envmap", "filename": str(picture), "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90)}


def sweep(reach: float, behind: float, reflectance: Vector) -> Any:
    """A sheet of paper that lies on z = 0 and bends up into a wall ``behind`` the object (towards +y), ``reach`` wide."""
    bend = 0.5 * behind
    angle = np.linspace(0, np.pi / 2, 33)
    y = np.concatenate([[-reach], behind - bend + bend * np.sin(angle), [behind]])
    z = np.concatenate([[0.0], bend - bend * np.cos(angle), [reach]])
    ny = np.concatenate([[0.0], -np.sin(angle), [-1.0]])
    nz = np.concatenate([[1.0], np.cos(angle), [0.0]])
    x = np.array([[-reach], [reach]])
    vertices = np.stack(np.broadcast_arrays(x, y, z), -1).reshape(-1, 3)
    normals = np.stack(np.broadcast_arrays(0 * x, ny, nz), -1).reshape(-1, 3)
    a = np.arange(len(y) - 1)
    b = a + len(y)
    faces = np.concatenate([np.stack([a, b, b + 1], -1), np.stack([a, b + 1, a + 1], -1)])
    return mesh_from_arrays("sweep", vertices, faces, normals, bsdf={"type": "twosided", "bsdf": diffuse(*reflectance)})


def studio(target: Vector, reach: float) -> Spec:
    """Paper sweep and lamps around an object of about ``reach`` [mm] across: warm from behind and the side, a cool fill.

    Light from behind is what shows that a thing is translucent: it comes through where the thing is thin. The lamps hang
    above and beyond the circle on which a camera goes around the object.
    """
    middle = np.asarray(target, float)
    return {
        "table": sweep(12 * reach, 3.4 * reach, (0.17, 0.172, 0.18)),
        "key": lamp(middle + np.multiply(reach, (-3.0, 1.05, 2.0)), middle, 1.55 * reach, (36, 30, 23), weight=2.0),
        "fill": lamp(middle + np.multiply(reach, (2.9, -2.9, 2.6)), middle, 2.9 * reach, (0.7, 0.8, 0.96)),
    }


def material(given: Spec | None, default: Spec) -> Spec:
    """Combine the material a caller gives with the scene's own: another medium replaces it, the surface is kept."""
    if given is None:
        return dict(default)
    medium = {"material", "sigma_a", "sigma_s_prime", "reflectance", "dmfp"}
    if given.get("type") != default["type"]:
        return dict(given)
    kept = {key: value for key, value in default.items() if not (medium & set(given) and key in medium | {"eta", "g"})}
    return kept | given


def scaled_to(samples: float, bodies: Sequence[tuple[Spec, float]]) -> list[Spec]:
    """Set the ``scale`` of translucent materials so that the bodies made of them need that many irradiance samples.

    Their number is ``sum A / (pi mfp^2)``, with the shortest mean free path over the channels; it grows with the square
    of the scale.

    Parameters
    ----------
    samples : float
        The sum wanted.
    bodies : list of (dict, float)
        A material, and the surface [scene units squared] of everything that is made of it.

    Returns
    -------
    list of dict
        The materials; one that is not translucent is returned as it is.

    Source
    ------
    JB02 section 3.
    """
    import mitsuba as mi

    media = [
        getattr(mi.load_dict(bsdf | {"scale": 1.0} if "scale" in bsdf else bsdf), "medium", None) for bsdf, _ in bodies
    ]
    count = sum(
        area / (np.pi * medium.mfp.min() ** 2)
        for medium, (_, area) in zip(media, bodies, strict=True)
        if medium is not None
    )
    return [
        bsdf if medium is None else bsdf | {"scale": float(np.sqrt(samples / count))}
        for medium, (bsdf, _) in zip(media, bodies, strict=True)
    ]
