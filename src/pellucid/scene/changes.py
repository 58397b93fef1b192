"""Whether a scene has changed since something was made from it: a record of its parameters, cameras left out."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .bodies import children


class SceneRecord:
    """The parameters that a scene has now. They are kept, not copied, so that a parameter assigned later is another one."""

    def __init__(self, scene: mi.Scene):
        self._values = _parameters(scene)
        self._marks = {key: _mark(value) for key, value in self._values.items()}

    def changed(self, scene: mi.Scene) -> str | None:
        """Name a parameter that has changed, come or gone since; None if all are as they were."""
        now = _parameters(scene)
        for key in [*now, *(key for key in self._marks if key not in now)]:
            if key not in now or key not in self._marks or _mark(now[key]) != self._marks[key]:
                return key
        return None


def _parameters(scene: mi.Scene) -> dict[str, Any]:
    """List the parameters of everything in a scene that may change its light: shapes, materials, emitters."""
    found: dict[str, Any] = {}
    for number, (name, node) in enumerate(children(scene)):
        if isinstance(node, (mi.Sensor, mi.Integrator)):
            continue
        for key, value in mi.traverse(node).items():
            found[f"{name or number}.{key}"] = value
    return found


def _mark(value: Any) -> list[Any]:
    """Tell values apart: arrays by the numbers of their variables, which are unique as long as the arrays are kept."""
    if hasattr(value, "matrix"):
        return _mark(value.matrix)
    if dr.is_tensor_v(value):
        return [*value.shape, *_mark(value.array)]
    if not dr.is_array_v(value):
        return [value]
    if dr.depth_v(value) > 1:
        return [mark for part in value for mark in _mark(part)]
    return [value.index] if dr.is_jit_v(value) else list(value)
