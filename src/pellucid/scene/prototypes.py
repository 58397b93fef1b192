"""Bodies that are rigid copies of each other share one shape: one set of samples, one tree."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .bodies import Body
from .samples.draw import Surface

RIGID = 1e-4
"""How far a transform may be from a rotation, in any entry of its matrix times its transpose."""


@dataclass
class Prototype:
    """A translucent shape and the bodies that are copies of it.

    Attributes
    ----------
    surface : Surface
        The shape, in a space of its own.
    bodies : list of Body
        Its copies; they have the medium in common.
    to_world : (k, 4, 4) float
        The rigid transform of each.
    """

    surface: Surface
    bodies: list[Body] = field(default_factory=list)
    to_world: list[np.ndarray] = field(default_factory=list)


def find_prototypes(bodies: list[Body]) -> tuple[list[Prototype], np.ndarray]:
    """Group bodies by their shapes.

    Instances that are scaled or sheared are prototypes of their own: their samples are spaced by the mean free path.

    Returns
    -------
    list of Prototype, and (b, 2) int
        For each body: its prototype, and its number among the copies.
    """
    found: dict[tuple, tuple[int, Prototype]] = {}
    places = np.zeros((len(bodies), 2), np.int64)
    for number, body in enumerate(bodies):
        to_world = body.parts[0].to_world
        rigid = to_world is not None and np.abs(to_world[:3, :3] @ to_world[:3, :3].T - np.eye(3)).max() < RIGID
        key = (None if rigid else number, body.side, id(body.bsdf), *(id(part.shape) for part in body.parts))
        if key not in found:
            parts = [(part.shape, None if rigid else part.to_world) for part in body.parts]
            found[key] = len(found), Prototype(Surface(parts, body.side))
        k, prototype = found[key]
        places[number] = k, len(prototype.bodies)
        prototype.bodies.append(body)
        prototype.to_world.append(to_world if rigid and to_world is not None else np.eye(4))
    return [prototype for _, prototype in found.values()], places
