"""Lamps inside a body, or nearer to it than its texels are to each other: their light is lost, which deserves a line."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..errors import warn
from ..light.lamps import CLOSE, KINDS, distances_of_boxes, find_near_lamps, lamps_inside
from ..scene.bodies import Lookup
from .live_body import LiveBody


class NearLampWarnings:
    """Warns of lamps whose light the texels of bodies miss, each time that one gets there."""

    def __init__(self, scene: mi.Scene, bodies: list[LiveBody], lookup: Lookup):
        self.scene, self.bodies, self.lookup = scene, bodies, lookup
        self.given: set[tuple[str, str]] = set()
        self.give()

    def give(self) -> None:
        """Warn of the lamps that are too near now and were not before."""
        found = self._find() if self._may_be_near() else {}
        for key in sorted(found.keys() - self.given):
            warn(f"The lamp '{key[0]}' {found[key]}. Move it away.")
        self.given = set(found)

    def _may_be_near(self) -> bool:
        """Tell whether the box of any lamp is as near to that of any body: in most scenes none is, and nothing else is looked at."""
        emitters = [e for e in self.scene.emitters() if e.class_name() in KINDS]
        distances = distances_of_boxes(emitters, [body.body for body in self.bodies])
        return bool((distances < CLOSE * np.array([body.spacing for body in self.bodies])).any())

    def _find(self) -> dict[tuple[str, str], str]:
        """Say of lamps and bodies what is wrong."""
        bodies, found = [body.body for body in self.bodies], {}
        near = find_near_lamps(self.scene, bodies, self.lookup)
        for number, body in enumerate(self.bodies):
            scale = body.body.bsdf.scale
            for k in near.too_near(number, body.spacing):
                found[near.names[k], body.body.name] = (
                    f"is {near.distance[k, number] * scale:.2g} mm from the body '{body.body.name}', whose texels are "
                    f"{body.spacing * scale:.2g} mm apart: the real-time engine loses much of its light, 'pellucid render' does not"
                )
        for lamp, name in lamps_inside(self.scene, bodies, self.lookup):
            found[lamp, name] = f"is inside the body '{name}': none of its light gets out"
        return found
