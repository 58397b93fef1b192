"""Random numbers that depend on a key of each lane alone, whatever its place in the array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from .sequences import ROUNDS


@dataclass
class KeyedSampler:
    """Independent random numbers with the interface of Mitsuba's samplers; lanes of equal keys draw the same ones."""

    rng: mi.PCG32

    @classmethod
    def from_keys(cls, key: mi.UInt32) -> KeyedSampler:
        """Start one sequence a lane."""
        state, sequence = mi.sample_tea_32(key, 0, ROUNDS)
        return cls(mi.PCG32(initstate=mi.UInt64(state), initseq=mi.UInt64(sequence)))

    def next_1d(self, active: Any = True) -> mi.Float:
        """Draw a number from [0, 1)."""
        return self.rng.next_float32(active)

    def next_2d(self, active: Any = True) -> mi.Point2f:
        """Draw two numbers."""
        x = self.next_1d(active)
        return mi.Point2f(x, self.next_1d(active))
