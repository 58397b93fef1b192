"""What a page shows now, as a scene of Mitsuba: from the state that the page sends, which is not to be trusted."""

from __future__ import annotations

import re
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..model.medium import Medium
from ..scene.bodies import Body
from .lamps import MOST_LAMPS
from .surface import harmonics

SKY_SIZE = (128, 64)  # of a picture that holds nine spherical harmonics
FLOOR_REFLECTANCE = (0.18, 0.18, 0.185)
FLOOR_REACH = 6.0  # radii of the body
FARTHEST, BRIGHTEST, WIDEST = 1e9, 1e30, 4096

Spec = dict[str, Any]


class Given:
    """What a page has sent; every value is checked when it is read."""

    def __init__(self, values: Any):
        if not isinstance(values, dict):
            raise SceneError("The page has sent something else than a state.")
        self.values = values

    def part(self, name: str) -> Given:
        """Read what has fields of its own."""
        return Given(self.values.get(name))

    def parts(self, name: str, most: int) -> list[Given]:
        """Read a list of those."""
        found = self.values.get(name)
        if not isinstance(found, list) or len(found) > most:
            raise SceneError(f"The page has sent no list of at most {most} as '{name}'.")
        return [Given(each) for each in found]

    def number(self, name: str, low: float, high: float) -> float:
        """Read a number within limits."""
        return float(self._numbers(name, self.values.get(name), (), low, high))

    def vector(self, name: str, low: float = -FARTHEST, high: float = FARTHEST) -> NDArray[np.float64]:
        """Read three numbers within limits."""
        return self._numbers(name, self.values.get(name), (3,), low, high)

    def colours(self, name: str, count: int) -> NDArray[np.float64] | None:
        """Read so many triples, or None for null."""
        value = self.values.get(name)
        return None if value is None else self._numbers(name, value, (count, 3), -BRIGHTEST, BRIGHTEST)

    @staticmethod
    def _numbers(name: str, value: Any, shape: tuple[int, ...], low: float, high: float) -> NDArray[np.float64]:
        try:
            numbers = np.asarray(value)
        except ValueError:  # of rows of different lengths
            numbers = np.array(None)
        good = numbers.shape == shape and numbers.dtype.kind in "iuf" and np.all((numbers >= low) & (numbers <= high))
        if not good:
            raise SceneError(f"The page has sent '{name}' that cannot be: {str(value)[:80]}.")
        return numbers.astype(float)


def restored_scene(body: Body, extent: float, state: Given) -> tuple[Spec, list[tuple[Any, Spec]]]:
    """Describe the scene that a page shows.

    Parameters
    ----------
    body : Body
        One of meshes, none of them instances.
    extent : float
        Its longest side [scene units].
    state : Given
        State of the page, with its ``camera``, and ``width`` and ``height`` of the picture.

    Returns
    -------
    scene : dict
        For ``mi.load_dict``.
    materials : list of (mi.Mesh, dict)
        Of its meshes, as for `viewer.saving.write_dictionary`.

    Raises
    ------
    SceneError, MediumError
        For values that cannot be.
    """
    scene: Spec = {"type": "scene", "integrator": {"type": "pellucid_two_pass"}, "sensor": _sensor(state)}
    material = _material(body, extent, state)
    meshes = [part.shape for part in body.parts]
    scene |= {f"body_{k}" if k else "body": mesh for k, mesh in enumerate(meshes)}
    for k, lamp in enumerate(state.parts("lamps", MOST_LAMPS)):
        scene[f"lamp_{k}"] = _lamp(lamp)
    sky = state.colours("sky", 9)
    if sky is not None:
        scene["sky"] = {"type": "envmap", "bitmap": _sky_picture(sky)}
    if state.values.get("floor") is True:
        scene["floor"] = _floor(meshes, state.part("camera").vector("up"))
    return scene, [(mesh, material) for mesh in meshes]


def _sensor(state: Given) -> Spec:
    camera = state.part("camera")
    origin, target, up = (camera.vector(name).tolist() for name in ("origin", "target", "up"))
    width, height = (int(state.number(name, 8, WIDEST)) for name in ("width", "height"))
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at(origin, target, up),
        "fov": camera.number("fov", 0.1, 179),
        "fov_axis": "y",
        "film": {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb"},
        "sampler": {"type": "multijitter", "sample_count": 16},
    }


def _material(body: Body, extent: float, state: Given) -> Spec:
    """Describe the material: coefficients, or with a texture that and the mean free path."""
    given = state.part("medium")
    coefficients = given.vector("scattering", 0, 1e9), given.vector("absorption", 0, 1e9)
    medium = Medium(
        *coefficients, given.number("g", -0.99, 0.99), given.number("eta", 1, 2), profile=body.medium.profile
    )
    spec: Spec = {"type": "pellucid_translucent", "eta": medium.eta, "g": medium.g, "profile": medium.profile}
    spec["scale"] = state.number("millimetres", 1e-6, FARTHEST) / extent
    spec["alpha"] = state.number("roughness", 0, 1)
    if body.bsdf.texture is None:
        names = {"sigma_s_prime": medium.sigma_s_prime, "sigma_a": medium.sigma_a}
        return spec | {name: {"type": "rgb", "value": value.tolist()} for name, value in names.items()}
    dmfp = np.minimum(medium.dmfp, 1e6).tolist()
    return spec | {"reflectance": _texture(body.bsdf.texture), "dmfp": {"type": "rgb", "value": dmfp}}


def _texture(texture: Any) -> Spec:
    """Describe a texture: a picture, or colours of vertices."""
    parameters = mi.traverse(texture)
    if texture.class_name().startswith("BitmapTexture"):
        picture = mi.Bitmap(np.array(parameters["data"], dtype=np.float32))
        place = mi.ScalarTransform3f(np.array(parameters["to_uv"].matrix, float).reshape(3, 3).tolist())
        return {"type": "bitmap", "bitmap": picture, "raw": True, "to_uv": place}
    if texture.class_name() == "MeshAttribute":
        name = re.search(r'name = "(\w+)"', str(texture))  # which nothing else tells
        assert name is not None
        return {"type": "mesh_attribute", "name": name[1], "scale": float(parameters["scale"])}
    raise SceneError(f"A texture of the kind {texture.class_name()} cannot be written into a scene.")


def _lamp(lamp: Given) -> Spec:
    """Describe a lamp."""
    strength = (lamp.vector("colour", 0, 1) * lamp.number("intensity", 0, BRIGHTEST)).tolist()
    position = lamp.vector("position")
    if lamp.values.get("kind") == "directional":
        return {
            "type": "directional",
            "direction": (-position).tolist(),
            "irradiance": {"type": "rgb", "value": strength},
        }
    return {"type": "point", "position": position.tolist(), "intensity": {"type": "rgb", "value": strength}}


def _sky_picture(sky: NDArray[np.float64]) -> mi.Bitmap:
    """Draw nine spherical harmonics as a latitude-longitude picture, as Mitsuba lays it around a scene."""
    width, height = SKY_SIZE
    v, u = (np.mgrid[:height, :width] + 0.5).reshape(2, -1)
    polar, around = v / height * np.pi, u / width * 2 * np.pi
    across = np.sin(polar)
    directions = np.stack([np.sin(around) * across, np.cos(polar), -np.cos(around) * across], axis=1)
    radiance = np.maximum(harmonics(directions) @ sky, 0)
    return mi.Bitmap(radiance.reshape(height, width, 3).astype(np.float32))


def _floor(meshes: list[Any], up: NDArray[np.float64]) -> Spec:
    """Describe the floor of the page: a square below the body."""
    boxes = [mesh.bbox() for mesh in meshes]
    low = np.min([np.array(box.min, float).ravel() for box in boxes], axis=0)
    high = np.max([np.array(box.max, float).ravel() for box in boxes], axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    up = up / max(float(np.linalg.norm(up)), 1e-30)
    foot = middle - up * float(np.abs(up) @ (high - low)) / 2
    aside = np.eye(3)[int(np.argmin(np.abs(up)))].tolist()
    place = mi.ScalarTransform4f().look_at(foot.tolist(), (foot + up).tolist(), aside)
    return {
        "type": "rectangle",
        "to_world": place @ mi.ScalarTransform4f().scale(FLOOR_REACH * radius),
        "bsdf": {
            "type": "twosided",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(FLOOR_REFLECTANCE)}},
        },
    }
