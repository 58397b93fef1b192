"""Random numbers that are even over neighbouring lanes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .sequences import STREAM, owen_square


@dataclass
class EvenSampler:
    """Owen-scrambled points with the interface of Mitsuba's samplers: in each dimension, runs of lanes fill the unit square evenly."""

    index: mi.UInt32
    key: mi.UInt32

    @classmethod
    def from_indices(cls, index: mi.UInt32, seed: int) -> EvenSampler:
        """Start at the first dimension: equal indices draw the same numbers."""
        return cls(index, dr.opaque(mi.UInt32, mi.sample_tea_32(seed, 0)[0], dr.width(index)))

    def next_1d(self, active: Any = True) -> mi.Float:
        """Draw a number from [0, 1)."""
        return self.next_2d(active).x

    def next_2d(self, active: Any = True) -> mi.Point2f:
        """Draw two numbers, evenly together."""
        self.key += STREAM
        return owen_square(self.index, self.key)
