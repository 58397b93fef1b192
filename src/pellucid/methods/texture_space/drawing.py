"""From light on the texels of a body to exitance: what the method and the real-time engine share.

They differ in where the light of texels comes from, and in when stages are gone through again::

    texels = CoveredTexels(rasterise(atlas))                     # once a body
    tables = SampleSum.of(medium, extent)                        # once a medium
    bright = texels.sum_up(luminance)                            # when the light has changed
    drawn = draw_samples(texels, bright, count, seed)            # then, or for every frame
    tables.hold(drawn, power).exitance(p, n)                     # power that enters at each sample

In the hybrid method the light of emitters with a translucent shadow map is summed apart from the rest (`BodySum`).
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...gather.derivatives import SampleDerivatives
from ...gather.gather import gather_samples
from ...gather.source import Source, device_source, with_samples
from ...kernels.memory import columns, upload
from ...kernels.sequences import even_numbers, hammersley_set
from ...model.medium import Medium
from ...model.profiles import Profile
from ...model.slopes import Slopes
from ...scene.atlas.texels import Texels
from .discs import DiscTables, disc_radius
from .hybrid import NearLight
from .pyramid import Pyramid, build_pyramid, build_rows, sample_pyramid, sample_rows, warp_points

ORDERS = ("plane", "mipmap", "rows")

LARGEST_DISC = 0.25
"""Radius of the largest disc over which the light of a sample enters, as a share of the extent of the body."""

FAR_DISC = 0.5
"""Radius of the discs for R_g, in those for R_d: R_g has no peak to be spread, only gaps between samples to be closed."""


class CoveredTexels:
    """The texels that a body covers, on the device.

    Attributes
    ----------
    p, area : Point3f, Float of n lanes
        Their positions and surface.
    texel : UInt32 of n lanes
        Where in the square they are, row by row.
    number : UInt32 of resolution^2 lanes
        Which of them lies at each place.
    surface : Pyramid
        Of the area.
    """

    def __init__(self, texels: Texels):
        self.resolution, count = texels.resolution, len(texels.texel)
        self.p = mi.Point3f(*columns(texels.samples.p))
        self.area, self.texel = upload(texels.samples.area), upload(texels.texel)
        number = np.zeros(self.resolution**2, np.uint32)
        number[texels.texel] = np.arange(count)
        self.number = upload(number)
        self._square = dr.zeros(mi.Float, self.resolution**2)
        self.surface = self.sum_up(self.area)

    def over_square(self, values: mi.Float) -> mi.Float:
        """Put values of the covered texels in their places, zeros elsewhere.

        The next call writes the same memory, unless the result is still in use.
        """
        dr.scatter(self._square, values, self.texel)
        return self._square

    def sum_up(self, values: mi.Float) -> Pyramid:
        """Sum values of the covered texels level by level. Source: CLHHC08 section 3, figure 2b."""
        return build_pyramid(self.over_square(values), self.resolution)


@dataclass
class Drawn:
    """Samples drawn from a texture: their covered texels, ``E'_avg / (N E')``, positions, and radii of their discs."""

    index: mi.UInt32
    share: mi.Float
    p: mi.Point3f
    radius: mi.Float


def draw_samples(
    texels: CoveredTexels, bright: Pyramid, count: int, seed: int, order: str = "plane", point_samples: bool = False
) -> Drawn:
    """Draw surface samples in proportion to the light that enters; each stands for ``E'avg / N`` of it.

    Drawn by luminance, a sample has the power of its texel, in the colour of that, times its ``share``: the total over N times
    the luminance of the texel.

    Parameters
    ----------
    bright : Pyramid
        Of the luminance of the power that enters through the texels.
    count : int
        N.
    seed : int
        Another number shifts the samples.
    order : str
        One of `ORDERS`.
    point_samples : bool
        The light of a sample enters at a point.

    Source: CLHHC08 eqs. 9 and 10.
    """
    if order == "plane":
        texel, value = warp_points(bright, *hammersley_set(mi.Float, count, seed))
    elif order == "mipmap":
        texel, value = sample_pyramid(bright, even_numbers(mi.Float, count, seed))
    else:
        rows = build_rows(bright.values, bright.resolution)
        texel, value = sample_rows(rows, even_numbers(mi.Float, count, seed))
    index = dr.gather(mi.UInt32, texels.number, texel)
    share = dr.select(value > 0, mi.Float(bright.total) / (dr.maximum(value, 1e-30) * dr.opaque(mi.Float, count)), 0)
    radius = mi.Float(disc_radius(bright, texels.surface, texel, count))
    radius *= dr.opaque(mi.Float, 0.0 if point_samples else 1.0)
    drawn = Drawn(index, share, dr.gather(mi.Point3f, texels.p, index), radius)
    dr.eval(drawn)
    return drawn


@dataclass
class SampleSum:
    """Samples on the device, and a profile over discs of all sizes by which their light is summed.

    ``shrink`` multiplies the radii of the discs.
    """

    discs: DiscTables
    source: Source
    shrink: float = 1.0

    @classmethod
    def of(cls, medium: Medium, extent: float) -> SampleSum:
        """Tabulate all of R_d for a body of that extent [scene units]; no samples yet."""
        return cls._tabulate(medium, LARGEST_DISC * extent, None, 1.0)

    @classmethod
    def of_far_part(cls, medium: Medium, extent: float, weight: Profile) -> SampleSum:
        """Tabulate R_g, that is R_d times ``weight``, for a body of that extent [scene units]; no samples yet."""
        return cls._tabulate(medium, FAR_DISC * LARGEST_DISC * extent, weight, FAR_DISC)

    @classmethod
    def _tabulate(cls, medium: Medium, largest: float, weight: Profile | None, shrink: float) -> SampleSum:
        discs = DiscTables.from_medium(medium, largest, weight)
        return cls(discs, device_source(mi.Point3f(), mi.Color3f(), discs.table), shrink)

    def hold(self, drawn: Drawn, power: mi.Color3f) -> SampleSum:
        """Hold other samples, with the power that enters at each."""
        dr.eval(power)
        first = self.discs.first(drawn.radius * dr.opaque(mi.Float, self.shrink))
        return SampleSum(self.discs, with_samples(self.source, drawn.p, power, first), self.shrink)

    def exitance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """Sum the exitance at points, whose normals point outside. Source: CLHHC08 eq. 10."""
        return mi.Color3f(gather_samples(self.source, p, n))


class DrawnDerivatives(SampleDerivatives):
    """The derivatives of a `SampleSum` by the light of texels: which of them are drawn, and how likely, is kept.

    A sample has the power of its texel times its ``share``, also where several are drawn from one texel.

    Parameters
    ----------
    total : SampleSum
    drawn : Drawn
        What it holds.
    texels : int
        Number of covered texels.
    slopes : list of Slopes
        Of all sizes of discs (`DiscTables.log_slopes`).
    """

    def __init__(self, total: SampleSum, drawn: Drawn, texels: int, slopes: list[Slopes]):
        super().__init__(total.source, slopes)
        self.index, self.share, self.texels = drawn.index.numpy(), drawn.share.numpy()[:, None], texels

    def in_places(self, power: NDArray[np.float32]) -> NDArray[np.float32]:
        """Give samples the changes of their texels."""
        return super().in_places(power[self.index] * self.share)

    def from_places(self, found: NDArray[np.float32]) -> NDArray[np.float32]:
        """Give texels what their samples have collected."""
        texels = np.zeros((self.texels, 3), np.float32)
        np.add.at(texels, self.index, super().from_places(found) * self.share)
        return texels


@dataclass
class BodySum:
    """What is summed at points of a body.

    Attributes
    ----------
    rest : SampleSum or None
        Light that goes by all of R_d; without the hybrid method that is all light.
    far, near : SampleSum, NearLight or None
        In the hybrid method the light of emitters with a translucent shadow map, by R_g over samples and by R_l over the maps.
    """

    rest: SampleSum | None
    far: SampleSum | None = None
    near: NearLight | None = None

    def exitance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """Sum the exitance at points, whose normals point outside. Source: CLHHC08 eq. 10, section 4."""
        if self.far is None or self.near is None:
            return mi.Color3f(0) if self.rest is None else self.rest.exitance(p, n)
        # In memory after each sum: whatever reads it is the same kernel, with or without the rest.
        total = self.near.exitance(p, n) + self.far.exitance(p, n)
        dr.eval(total)
        if self.rest is not None:
            total += self.rest.exitance(p, n)
            dr.eval(total)
        return total
