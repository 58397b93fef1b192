"""The emitters of a scene as lights that a panel shows and changes; every change goes into the scene."""

from __future__ import annotations

from numbers import Real
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..errors import PellucidError
from ..kernels.memory import opaque
from .checks import is_vector
from .source import Light

KINDS = {
    "PointLight": "point",
    "SpotLight": "spot",
    "Projector": "spot",
    "DirectionalEmitter": "directional",
    "AreaLight": "area",
    "DirectionalArea": "area",
}

STRENGTHS = ("intensity.value", "irradiance.value", "radiance.value", "scale")
"""Names under which emitters keep how bright they are."""


class Lamp:
    """One emitter: what it is, and the numbers of it that can change.

    Attributes
    ----------
    uniform : bool
        One colour for all directions and places; its light is then that colour times one number.
    value : (3,) float
        Colour times intensity.
    spectrum : Color3f
        The same, for kernels.
    """

    def __init__(self, scene: mi.Scene, emitter: mi.Emitter):
        self.scene, self.emitter = scene, emitter
        self.kind = "environment" if emitter.is_environment() else KINDS.get(emitter.class_name(), "other")
        self.parameters = mi.traverse(emitter)
        self.strength = next((key for key in STRENGTHS if key in self.parameters), None)
        varies = bool(emitter.flags() & mi.EmitterFlags.SpatiallyVarying) and self.kind != "area"
        self.uniform = not varies and self.strength is not None and self.strength != "scale"
        self.colour = np.ones(3)  # of a light that is off: the one that it had
        self._read_strength()

    @property
    def is_delta(self) -> bool:
        """Whether it shines from one point or in one direction: one sample finds all of it."""
        return self.kind in ("point", "spot", "directional")

    @property
    def is_on(self) -> bool:
        """Whether it shines at all."""
        return float(self.value.max()) > 0

    def describe(self) -> Light:
        """State the light as it is now."""
        intensity = float(self.value.max())
        return Light(self.emitter.id(), self.kind, self._position(), self._direction(), self.colour, intensity)

    def change(
        self,
        position: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        colour: ArrayLike | None = None,
        intensity: float | None = None,
    ) -> bool:
        """Change what is given; tell whether shapes have moved.

        Raises
        ------
        PellucidError
            For what this kind of light does not have.
        """
        moved = False
        if colour is not None or intensity is not None:
            self._set_strength(colour, intensity)
        if position is not None or direction is not None:
            moved = self._place(position, direction)
        return moved

    # ------------------------------------------------------------------ how bright

    def _read_strength(self) -> None:
        value = np.ravel(np.array(self.parameters[self.strength], float)) if self.strength else np.ones(1)
        self.value = np.broadcast_to(value, 3).copy()
        if self.is_on:
            self.colour = self.value / self.value.max()
        self.spectrum = opaque(mi.Color3f, self.value)

    def _set_strength(self, colour: ArrayLike | None, intensity: float | None) -> None:
        now = self.describe()
        value = np.ravel(now.colour if colour is None else colour)
        if value.size != 3 or not is_vector(value) or value.min() < 0:
            raise PellucidError(f"The colour of a light is three numbers of at least 0; found {colour!r}.")
        if value.max() > 0:
            self.colour = value = value / value.max()
        if intensity is not None and not isinstance(intensity, Real):
            raise PellucidError(f"The intensity of a light is a number of at least 0; found {intensity!r}.")
        value = value * (now.intensity if intensity is None else float(intensity))
        if not is_vector(value) or value.min() < 0:
            raise PellucidError(f"The intensity of a light is a number of at least 0; found {intensity}.")
        if self.strength is None:
            raise PellucidError(f"Light '{self.emitter.id()}' ({self.emitter.class_name()}) has no strength to change.")
        if isinstance(self.parameters[self.strength], mi.Color3f):
            self.parameters[self.strength] = mi.Color3f(*value.tolist())
        elif np.ptp(value) > 1e-6 * value.max():
            raise PellucidError(
                f"Light '{self.emitter.id()}' is grey, its spectrum is one number: to give it a colour write an <rgb> into the scene."
            )
        else:
            self.parameters[self.strength] = type(self.parameters[self.strength])(float(value[0]))
        self.parameters.update()
        self._read_strength()

    # ------------------------------------------------------------------ where

    def _position(self) -> NDArray[np.float64] | None:
        if self.kind == "point":
            return np.array(self.parameters["position"], float).ravel()
        if self.kind == "spot":
            return self._matrix(self.parameters)[:3, 3]
        if self.kind == "area":
            return np.array(self.emitter.get_shape().bbox().center(), float).ravel()
        return None

    def _direction(self) -> NDArray[np.float64] | None:
        if self._is_flat:
            parameters = mi.traverse(self.scene)
            axis = self._matrix(parameters, f"{self.emitter.get_shape().id()}.to_world")[:3, 2]
        elif self.kind in ("spot", "directional"):
            axis = self._matrix(self.parameters)[:3, 2]
        else:
            return None
        return axis / np.linalg.norm(axis)

    @property
    def _is_flat(self) -> bool:
        """Tell whether this is an area light with one normal, which can be aimed."""
        return self.kind == "area" and self.emitter.get_shape().class_name() in ("Rectangle", "Disk")

    def _place(self, position: ArrayLike | None, direction: ArrayLike | None) -> bool:
        area = "position direction" if self._is_flat else "position"
        has = {"point": "position", "area": area, "directional": "direction", "spot": "position direction"}
        for name, value in (("position", position), ("direction", direction)):
            if value is None:
                continue
            if name not in has.get(self.kind, ""):
                raise PellucidError(f"Light '{self.emitter.id()}' ({self.kind}) has no {name} to change.")
            if not is_vector(value):
                raise PellucidError(f"The {name} of a light is three finite numbers; found {value!r}.")
        if self.kind == "area":
            return self._move_shape(position, direction)
        if self.kind == "point":
            self.parameters["position"] = mi.Point3f(*np.asarray(position, float).tolist())
        else:
            self.parameters["to_world"] = self._aimed(position, direction)
        self.parameters.update()
        return False

    def _aimed(self, position: ArrayLike | None, direction: ArrayLike | None) -> mi.ScalarTransform4f:
        """Make the transform of a light that stands at a position and shines along a direction."""
        at = self._matrix(self.parameters)[:3, 3] if position is None else np.asarray(position, float)
        axis = np.asarray(self._direction() if direction is None else direction, float)
        if not np.linalg.norm(axis) > 0:
            raise PellucidError("The direction of a light was given as zero: give any other vector.")
        axis = axis / np.linalg.norm(axis)
        up = np.eye(3)[int(np.argmin(np.abs(axis)))]
        return mi.ScalarTransform4f().look_at(at.tolist(), (at + axis).tolist(), up.tolist())

    def _move_shape(self, position: ArrayLike | None, direction: ArrayLike | None) -> bool:
        """Move the shape of an area light so that its middle lies at a position, and turn it about that."""
        shape = self.emitter.get_shape()
        parameters = mi.traverse(self.scene)
        key = f"{shape.id()}.to_world"
        if key not in parameters:
            raise PellucidError(
                f"Area light '{self.emitter.id()}' shines from a mesh, which cannot be moved: use a rectangle, disk or sphere."
            )
        before = np.asarray(self._position(), float)
        matrix = np.eye(4)
        if direction is not None:
            matrix[:3, :3] = _turn(self._direction(), np.asarray(direction, float))
        matrix[:3, 3] = (before if position is None else np.asarray(position, float)) - matrix[:3, :3] @ before
        parameters[key] = mi.ScalarTransform4f((matrix @ self._matrix(parameters, key)).tolist())
        parameters.update()
        return True

    @staticmethod
    def _matrix(parameters: Any, key: str = "to_world") -> NDArray[np.float64]:
        return np.array(parameters[key].matrix, float).reshape(4, 4)


def _turn(before: ArrayLike | None, after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make the matrix that turns one direction into another the shortest way: ``(3, 3) float``."""
    if not np.linalg.norm(after) > 0:
        raise PellucidError("The direction of a light was given as zero: give any other vector.")
    return Rotation.align_vectors([after / np.linalg.norm(after)], [before])[0].as_matrix()
