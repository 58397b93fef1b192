"""The way of a camera around translucent objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass
class Orbit:
    """Turns a camera rigidly about an axis: at angle 0 it is where the scene has put it.

    ``start`` is the camera-to-world matrix, ``(4, 4) float``; ``centre`` lies on the axis, ``axis`` is its direction.
    """

    start: np.ndarray
    centre: np.ndarray
    axis: np.ndarray

    @classmethod
    def around(cls, sensor: Any, lit_bodies: list[Any]) -> Orbit:
        """Lay the axis through the middle of the bodies, along the coordinate axis nearest to the camera's up."""
        import mitsuba as mi

        start = np.array(mi.traverse(sensor)["to_world"].matrix, dtype=float).reshape(4, 4)
        boxes = [(part.instance or part.shape).bbox() for lit in lit_bodies for part in lit.body.parts]
        low = np.min([np.array(box.min, float).ravel() for box in boxes], axis=0)
        high = np.max([np.array(box.max, float).ravel() for box in boxes], axis=0)
        up = start[:3, 1]
        axis = np.zeros(3)
        axis[np.argmax(np.abs(up))] = np.sign(up[np.argmax(np.abs(up))])
        return cls(start, (low + high) / 2, axis)

    def matrix(self, angle: float) -> np.ndarray:
        """Find the camera-to-world matrix, ``(4, 4) float``, after a turn [rad], counter-clockwise seen from above."""
        x, y, z = self.axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross  # Rodrigues
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        matrix[:3, 3] = self.centre - turn @ self.centre
        return matrix @ self.start

    def place(self, sensor: Any, angle: float) -> None:
        """Move a camera to an angle."""
        import mitsuba as mi

        parameters = mi.traverse(sensor)
        parameters["to_world"] = mi.AffineTransform4f(mi.Matrix4f(self.matrix(angle)))
        parameters.update()
