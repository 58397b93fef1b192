"""The page's own world: the bodies fill its unit sphere, so that orbit, zoom and handles feel alike in every scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene.bodies import find_bodies
from .source import Camera

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Space:
    """The similarity between scene and page: ``scene = centre + radius * page``.

    Attributes
    ----------
    centre : (3,) float
        Middle of all bodies [scene units].
    radius : float
        Half the diagonal of their box [scene units].
    extent : float
        Its longest side [scene units].
    """

    centre: Vector
    radius: float
    extent: float

    @classmethod
    def of(cls, scene: mi.Scene) -> Space:
        """Lay the unit sphere around the bodies of a scene."""
        boxes = [body.bbox() for body in find_bodies(scene)]
        low = np.min([np.array(box.min, float).ravel() for box in boxes], axis=0)
        high = np.max([np.array(box.max, float).ravel() for box in boxes], axis=0)
        return cls((low + high) / 2, float(np.linalg.norm(high - low)) / 2, float(np.max(high - low)))

    def to_page(self, p: ArrayLike) -> Vector:
        """Map points (..., 3) of the scene to the page."""
        return (np.asarray(p, float) - self.centre) / self.radius

    def to_scene(self, p: ArrayLike) -> Vector:
        """Map points (..., 3) of the page to the scene."""
        return np.asarray(p, float) * self.radius + self.centre

    def first_camera(self, sensor: Any) -> Camera:
        """Read a perspective camera; it looks at the point of its axis that is as far away as the bodies.

        ``up`` is the coordinate axis nearest to the camera's, around which the page orbits.
        """
        parameters = mi.traverse(sensor)
        matrix = np.array(parameters["to_world"].matrix, dtype=float).reshape(4, 4)
        origin, ahead, above = matrix[:3, 3], matrix[:3, 2], matrix[:3, 1]
        ahead = ahead / np.linalg.norm(ahead)
        depth = float((self.centre - origin) @ ahead)
        up = np.zeros(3)
        largest = int(np.argmax(np.abs(above)))
        up[largest] = np.sign(above[largest])
        width, height = (int(n) for n in sensor.film().size())
        across = np.deg2rad(float(np.array(parameters["x_fov"]).ravel()[0]))
        fov = 2 * np.arctan(np.tan(across / 2) * height / width)
        return Camera(origin, origin + max(depth, 0.1 * self.radius) * ahead, up, float(np.rad2deg(fov)))
