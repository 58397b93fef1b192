"""Whether a scene has changed since something was made from it: a record of its parameters, cameras left out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from .bodies import children


class SceneRecord:
    """The parameters that a scene has now. Arrays are kept, not copied: as long as they are, no other has their number."""

    def __init__(self, scene: mi.Scene):
        self._kept = {key: list(_leaves(value)) for key, value in _parameters(scene)}
        self._marks = {key: [_mark(leaf) for leaf in leaves] for key, leaves in self._kept.items()}

    def changed(self, scene: mi.Scene) -> str | None:
        """Name a parameter that has changed, come or gone since; None if all are as they were."""
        gone = set(self._marks)
        for key, value in _parameters(scene):
            gone.discard(key)
            if self._marks.get(key) != [_mark(leaf) for leaf in _leaves(value)]:
                return key
        return min(gone, default=None)


def _parameters(scene: mi.Scene) -> Iterator[tuple[str, Any]]:
    """List the parameters of everything in a scene that may change its light: shapes, materials, emitters."""
    for number, (name, node) in enumerate(children(scene)):
        if not isinstance(node, (mi.Sensor, mi.Integrator)):
            for key, value in mi.traverse(node).items():
                yield f"{name or number}.{key}", value


def _leaves(value: Any) -> Iterator[Any]:
    """List the arrays that a value consists of, or the value."""
    if dr.is_tensor_v(value):
        yield from (value.shape, *_leaves(value.array))
    elif dr.is_array_v(value) and dr.depth_v(value) > 1:
        for part in value:
            yield from _leaves(part)
    elif dr.is_jit_v(value):
        yield type(value)(value)  # the parameter itself takes on other values
    elif hasattr(value, "matrix") and not dr.is_array_v(value):  # of arrays it is a swizzle
        yield from _leaves(value.matrix)
    else:
        yield list(value) if dr.is_array_v(value) else value


def _mark(leaf: Any) -> Any:
    """Tell leaves apart: arrays of the device by their numbers."""
    return leaf.index if dr.is_jit_v(leaf) else leaf
