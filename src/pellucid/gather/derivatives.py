"""How the sums of :mod:`pellucid.gather.gather` change with the profile and with the power of samples, in both directions.

The sum is ``B(x) = sum_j P_j R(|x - x_j|; theta)``. Its change is

    dB(x) = sum_j R (P_j sum_k D_k dtheta_k + dP_j),    D_k = d log R / d theta_k,

and its transpose turns weights lambda of the points, which are the gradient of a number by B, into the gradients by theta and P:

    theta_k: sum_j P_j sum_i lambda_i R D_k,    P_j: sum_i lambda_i R.

On a curved surface R is ``R_d exp(beta mu)``, D_k has the slope of beta times mu in it, and one more parameter follows the others: that
with which the largest mu grows (`slopes.BOUND`). Its D is ``beta mu`` where mu is the largest, and zero elsewhere.

The clusters that stand for their samples, their centroids and spreads are those of the sum itself, and are kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, final

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from ..kernels.memory import rows, upload
from ..model.profiles import ProfileTable, bounded, curved, interpolate
from ..model.slopes import Slopes
from .gather import (
    POINTS_PER_LANE,
    Collect,
    Color,
    Record,
    deal,
    detached,
    find_entry,
    in_order,
    queries,
    split,
    sweep,
    walk,
)
from .octree import PACKET, SAMPLE_PACKETS, Octree
from .source import Source, tree_source, types_of

Array = NDArray[np.float32]

LEAST, MOST, HALF = -48.0, 16.0, 65535
"""Bounds of a slope, whose table has numbers of 16 bits: steps of a thousandth. Farther out light is negligible."""


class SumDerivatives(ABC):
    """The derivatives of one sum.

    Parameters
    ----------
    source : Source
        What is summed.
    slopes : list of Slopes
        For every theta_k (`slopes.log_slopes`), but for the bound of mu.
    """

    def __init__(self, source: Source, slopes: list[Slopes]):
        self.source, self.count = source, len(slopes)
        self.of_value = self._packed([each.value for each in slopes])
        self.of_curve = self._packed([each.curve for each in slopes if each.curve is not None])

    @abstractmethod
    def run(self, points: list[Any], sums: Any, collect: Collect) -> Any:
        """Go through what is summed."""

    @abstractmethod
    def in_places(self, power: Array) -> Array:
        """Lay changes of power ``(n, 3)`` out as the power is: ``(k, 4)`` packets."""

    @abstractmethod
    def from_places(self, found: Array) -> Array:
        """Give the samples ``(n, 3)`` what packets ``(k, 3)`` have collected: the transpose of `in_places`."""

    @final
    def change(self, p: Any, theta: list[NDArray[np.float64]], power: Array | None, n: Any = None) -> Color:
        """Evaluate dB at points from changes ``dtheta_k (3,)`` and ``dP (n, 3)`` in the caller's order; None is no change.

        Normals ``n`` are asked for where the profile has a curve.
        """
        points = queries(self.source.curve, p, n)
        Float = type(points[0])
        _, Packet = types_of(Float)
        steps = [[dr.opaque(Float, float(v)) for v in step] for step in theta]
        tangent = None if power is None else upload(self.in_places(power), Float)

        def collect(sums: Any, records: list[Record]) -> Any:
            here = records[0].here
            added = [Float(0)] * 3 if tangent is None else [*dr.gather(Packet, tangent, here + 1)][:3]
            for three, record in zip(sums, records, strict=True):
                value, slopes = self._look_up(record)
                for c in range(3):
                    share = sum((slope[c] * step[c] for slope, step in zip(slopes, steps, strict=True)), Float(0))
                    three[c] = dr.fma(value[c], dr.fma(record.power[c], share, added[c]), three[c])
            return sums

        zeros = [[Float(0)] * 3 for _ in range(POINTS_PER_LANE)]
        return in_order(self.run(points, zeros, collect), dr.width(points[0]))

    @final
    def gradient(
        self, p: Any, weights: Any, of_power: bool = True, n: Any = None
    ) -> tuple[list[NDArray[np.float64]], Array | None]:
        """Transpose the sum.

        Parameters
        ----------
        p, weights : of m lanes
            Points, and lambda there.
        of_power : bool
            Whether the gradient by the power is asked for.
        n
            Normals, where the profile has a curve.

        Returns
        -------
        theta : list of (3,) float
            The gradient by every theta_k in the three channels.
        power : (n, 3) float32 or None
            The gradient by the power of every sample, in the caller's order.
        """
        points = queries(self.source.curve, p, n)
        Float, packets = type(points[0]), dr.width(self.source.records) // PACKET
        collected = [dr.zeros(Float, packets) for _ in range(3)] if of_power else []
        zeros = [[Float(0)] * 3 for _ in range(self.count + (self.source.curve is not None))]
        sums, collected = self.run(points, (zeros, collected), self._transposed(self._shares(weights)))
        dr.eval(sums, collected)
        theta = [np.array([x.numpy().sum(dtype=np.float64) for x in three]) for three in sums]
        return theta, self.from_places(rows(collected)) if of_power else None

    def _transposed(self, shares: list[list[Any]]) -> Collect:
        """Say how the sums of `gradient` go on: those by theta, and what is collected at records if it is."""

        def collect(state: Any, records: list[Record]) -> Any:
            sums, collected = state
            Float, power = type(records[0].r2), records[0].power
            weighed, found = [Float(0)] * 3, [[Float(0)] * 3 for _ in sums]
            for record, share in zip(records, shares, strict=True):
                value, slopes = self._look_up(record)
                product = [a * b for a, b in zip(share, value, strict=True)]
                weighed = [a + b for a, b in zip(weighed, product, strict=True)]
                for three, slope in zip(found, slopes, strict=True):
                    three[:] = [dr.fma(a, b, s) for a, b, s in zip(product, slope, three, strict=True)]
            for target, x in zip(collected, weighed, strict=False):
                dr.scatter_add(target, x, records[0].here, x != 0)
            pairs = zip(found, sums, strict=True)
            return [[dr.fma(*terms) for terms in zip(power, *pair, strict=True)] for pair in pairs], collected

        return collect

    def _shares(self, weights: Any) -> list[list[Any]]:
        """Deal the weights of points to lanes as the points are dealt; those beyond the last point are zero."""
        shares, index, size = deal(detached(weights))
        return [[dr.select(i < size, x, 0) for x in share] for share, i in zip(shares, index, strict=True)]

    def _look_up(self, record: Record) -> tuple[Any, list[list[Any]]]:
        """Look up R and every D_k for what a point finds at a record."""
        Packet = types_of(type(record.r2))[1]
        entry, bits = find_entry(self.source, record.r2, record.first)
        value = interpolate(dr.gather(Packet, self.source.profile, entry, record.accepted), bits)
        slopes = self._unpack(self.of_value, entry, record.accepted)
        if self.source.curve is None:
            return value, slopes
        beta = dr.gather(Packet, self.source.curve, entry, record.accepted)
        mu = bounded(record.mu, beta)
        bent = self._unpack(self.of_curve, entry, record.accepted)
        slopes = [[dr.fma(b, mu, s) for b, s in zip(*pair, strict=True)] for pair in zip(bent, slopes, strict=True)]
        slopes.append([dr.select(mu == record.mu, 0, b * mu) for b in split(beta)[0]])
        return curved(value, beta, record.mu), slopes

    def _packed(self, slopes: list[Array]) -> list[Any]:
        """Bring tables of slopes to the device, two in one."""
        Float = type(self.source.inv_scale2)
        return [upload(_pack(slopes[k : k + 2]), Float) for k in range(0, len(slopes), 2)]

    def _unpack(self, tables: list[Any], entry: Any, active: Any) -> list[list[Any]]:
        """Look up one slope in each channel for every theta_k."""
        Float = type(self.source.inv_scale2)
        UInt, Packet = types_of(Float)
        slopes = []
        for table in tables:
            words = [dr.reinterpret_array(UInt, word) for word in split(dr.gather(Packet, table, entry, active))[0]]
            for half in ([word & HALF for word in words], [word >> 16 for word in words]):
                slopes.append([dr.fma(Float(x), (MOST - LEAST) / HALF, LEAST) for x in half])
        return slopes[: self.count]


def _pack(slopes: list[Array]) -> Array:
    """Pack one or two tables of slopes into the halves of three words: one packet an entry."""
    packed = np.zeros(slopes[0].shape, np.uint32)
    for k, values in enumerate(slopes):
        steps = np.rint((np.clip(values, LEAST, MOST) - LEAST) / (MOST - LEAST) * HALF)
        packed |= steps.astype(np.uint32) << np.uint32(16 * k)
    packed[:, 3] = 0
    return packed.view(np.float32)


@final
class TreeDerivatives(SumDerivatives):
    """The derivatives of `gather.gather`; parameters as there."""

    def __init__(
        self,
        octree: Octree,
        table: ProfileTable,
        slopes: list[Slopes],
        max_error: float,
        coarser: float,
        Float: type,
    ):
        super().__init__(tree_source(octree, table, max_error, Float), slopes)
        self.octree, self.coarser = octree, coarser

    def run(self, points: list[Any], sums: Any, collect: Collect) -> Any:
        """Walk the tree."""
        return walk(self.source, points, sums, collect, self.coarser)

    def in_places(self, power: Array) -> Array:
        """Sum up the changes of the samples of every voxel."""
        tree, power = self.octree, np.asarray(power, np.float32)[self.octree.order]
        packets = np.zeros((tree.packet_count, PACKET), np.float32)
        packets[tree.sample_places() + 1, :3] = power
        packets[tree.place + 1, :3] = np.stack([tree.combine(np.add, power[:, c]) for c in range(3)], axis=1)
        return packets

    def from_places(self, found: Array) -> Array:
        """Give every sample what it and its voxels have collected."""
        tree = self.octree
        voxels = found[tree.place].astype(np.float64)
        for first, end in zip(tree.level_start[1:-1], tree.level_start[2:], strict=True):
            voxels[first:end] += voxels[tree.parent[first:end]]
        result = np.empty((tree.sample_count, 3), np.float32)
        result[tree.order] = found[tree.sample_places()] + voxels[tree.sample_parent]
        return result


class SampleDerivatives(SumDerivatives):
    """The derivatives of `gather.gather_samples`; parameters as there."""

    @final
    def run(self, points: list[Any], sums: Any, collect: Collect) -> Any:
        """Weigh all samples."""
        return sweep(self.source, points, sums, collect)

    def in_places(self, power: Array) -> Array:
        """Put the change of each sample in its place."""
        packets = np.zeros((len(power), SAMPLE_PACKETS, PACKET), np.float32)
        packets[:, 1, :3] = power
        return packets

    def from_places(self, found: Array) -> Array:
        """Leave every sample what it has collected."""
        return found[::SAMPLE_PACKETS]
