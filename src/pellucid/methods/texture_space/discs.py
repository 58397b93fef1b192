"""Light of samples that enters over discs instead of at points: how large each has to be, and the profiles for all sizes.

Samples drawn in proportion to light are far apart where there is little of it. Each stands for a piece of surface of its
own size: over a disc of that size its light is spread, and the sum is as even where it is dark as where it is bright.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import numpy as np

from ...gather.source import types_of
from ...kernels.morton import interleave
from ...model.medium import Medium
from ...model.profiles import DISC_STEP, SMALLEST_DISC, Profile, ProfileTable, stacked
from ...model.slopes import Slopes, log_slopes
from .pyramid import Pyramid

MOST_SIZES = 30

OVERLAP = 3.5
"""Radius of the soft disc of a sample, in radii of the disc that has the area it stands for."""

NEIGHBOURS = 1.0
"""So many samples are expected in the cell over which the light around a sample is averaged."""


@dataclass
class DiscTables:
    """R_d over discs of ``count`` sizes: a point, and radii from ``smallest`` [mm] on in steps of `DISC_STEP`.

    ``table`` has the ``entries`` of one size behind those of the other; its index is that of one size.
    """

    table: ProfileTable
    smallest: float
    count: int
    entries: int
    slopes: dict[str, Slopes] = field(default_factory=dict)

    @classmethod
    def from_medium(cls, medium: Medium, largest: float, weight: Profile | None = None) -> DiscTables:
        """Tabulate the profile of a medium over discs up to the radius ``largest`` [mm], or a little beyond.

        A ``weight`` multiplies R_d, as for `ProfileTable.from_medium`.
        """
        smallest = SMALLEST_DISC * float(np.min(medium.mfp))
        steps = 0 if largest < smallest else 1 + int(np.ceil(np.log(largest / smallest) / np.log(DISC_STEP)))
        radii = np.append(0.0, smallest * DISC_STEP ** np.arange(min(steps, MOST_SIZES)))
        table = stacked([ProfileTable.from_medium(medium, float(radius), weight) for radius in radii])
        return cls(table, smallest, len(radii), table.last + 1)

    def log_slopes(self, medium: Medium, name: str) -> Slopes:
        """Tabulate how fast the profiles of all sizes change (`slopes.log_slopes`); once for each ``name``."""
        if name not in self.slopes:
            radii = np.append(0.0, self.smallest * DISC_STEP ** np.arange(self.count - 1))
            each = [log_slopes(medium, replace(self.table, disc=float(radius)), name) for radius in radii]
            value, curve = zip(*each, strict=True)
            self.slopes[name] = Slopes(np.concatenate(value), None if curve[0] is None else np.concatenate(curve))
        return self.slopes[name]

    def first(self, radius: Any) -> Any:
        """Find where the table of the disc nearest in size begins, for radii [mm] on the device."""
        Float = type(radius)
        UInt, _ = types_of(Float)
        size = dr.log2(radius * dr.opaque(Float, 1 / self.smallest)) * float(1 / np.log2(DISC_STEP)) + 1.5
        return UInt(dr.clip(size, 0, dr.opaque(Float, self.count - 1))) * dr.opaque(UInt, self.entries)


def disc_radius(light: Pyramid, area: Pyramid, texel: Any, count: int) -> Any:
    """Find the radii of the discs over which the light of samples enters [mm].

    A sample carries the part ``1 / count`` of all light, hence stands for as much surface as has so much light: the area
    of the smallest cell of the pyramid around it that sends out `NEIGHBOURS` samples, times this light, over its light.

    Parameters
    ----------
    light, area : Pyramid
        Of the light and the surface area [mm^2] of the texels.
    texel : UInt32 of ``count`` lanes
        The samples, as numbered by `sample_pyramid`.
    count : int
        How many of them there are.
    """
    UInt, Float = dr.detached_t(type(texel)), type(light.total)
    resolution = dr.opaque(UInt, light.resolution)
    here: Any = dr.detach(texel, preserve_type=False)
    code = interleave(here % resolution, here // resolution)
    share = light.total / dr.opaque(Float, count)
    stands_for = dr.zeros(Float, dr.width(texel))
    for level, (power, surface) in enumerate(zip(light.levels, area.levels, strict=True)):
        cell = code >> (2 * (len(light.levels) - level))
        inside = dr.gather(Float, power, cell)
        enough = (inside >= NEIGHBOURS * share) if level else dr.full(dr.mask_t(Float), True)
        ratio = dr.select(inside > 0, dr.gather(Float, surface, cell) / inside, 0)
        stands_for = dr.select(enough, ratio, stands_for)
    return OVERLAP * dr.sqrt(stands_for * share * (1 / np.pi))
