"""What a voxel's samples amount to seen from far: total power, centroid, extent, spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..kernels.morton import LEVELS

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


@dataclass
class Voxels:
    """How sorted samples are divided into voxels, which are numbered level by level.

    Attributes
    ----------
    sample_parent, parent : (n,) and (v,) uint32
        The voxel that holds each sample, and each voxel (the root: itself).
    level_start : (23,) int64
        Where each level of voxels begins.
    """

    sample_parent: NDArray[np.uint32]
    parent: NDArray[np.uint32]
    level_start: NDArray[np.int64]

    @property
    def voxel_count(self) -> int:
        """Number of voxels: root, inner and leaf."""
        return len(self.parent)

    def combine(self, operation: np.ufunc, values: NDArray) -> Doubles:
        """Combine ``values (n,)`` of the samples, in Morton order, over every voxel, from the leaves up: ``(v,) float``."""
        neutral = {"add": 0.0, "minimum": np.inf, "maximum": -np.inf}[operation.__name__]
        result = np.full(self.voxel_count, neutral)
        operation.at(result, self.sample_parent, values.astype(np.float64))
        for level in range(LEVELS, 0, -1):
            voxels = slice(self.level_start[level], self.level_start[level + 1])
            operation.at(result, self.parent[voxels], result[voxels])
        return result


@dataclass
class Clusters:
    """The voxels of an octree under one light.

    Attributes
    ----------
    power : (v, 3) float32
        Sum of the power of the voxel's samples.
    centroid : (v, 3) float32
        Their mean position, weighted by power (mean over channels) [mm].
    cover : (v,) float32
        Squared radius around the centroid that contains their bounding box [mm^2].
    spread : (v, 4) float32
        Second moment about the centroid, taken for that of a disk, ``c I - v v^T``: the vector v along the disk's
        normal [mm], then c [mm^2].
    """

    power: Floats
    centroid: Floats
    cover: Floats
    spread: Floats

    def disk_area(self) -> Floats:
        """Return the area of an even disk with the second moment of each voxel, ``2 pi tr C``: ``(v,)`` [mm^2]."""
        return np.float32(2 * np.pi) * (3 * self.spread[:, 3] - (self.spread[:, :3] ** 2).sum(axis=1))


def find_clusters(voxels: Voxels, p: Floats, power: Floats) -> Clusters:
    """Sum the power of every voxel, and find its centroid, cover radius and spread; ``p``, ``power (n, 3)`` in Morton order."""
    # Without light the centroid is that of the samples alone; a trace of equal weight does this without a branch.
    weight = power.mean(axis=1, dtype=np.float64)
    weight += 1e-12 * weight.max() or 1.0
    total = voxels.combine(np.add, weight)
    origin = p[0].astype(np.float64)
    x = p.T - origin[:, None]
    mean = np.stack([voxels.combine(np.add, weight * x[i]) / total for i in range(3)])
    moments = [voxels.combine(np.add, weight * x[i] * x[j]) / total - mean[i] * mean[j] for i, j in PAIRS]
    total_power = np.stack([voxels.combine(np.add, power[:, i]) for i in range(3)], axis=1)
    centroid = (mean + origin[:, None]).T.astype(np.float32)
    return Clusters(
        power=total_power.astype(np.float32),
        centroid=centroid,
        cover=(_cover(voxels, p, centroid) * (1 + 1e-6)).astype(
            np.float32
        ),  # rounded up: the farthest sample lies inside
        spread=disks(moments).astype(np.float32),
    )


def _cover(voxels: Voxels, p: Floats, centroid: Floats) -> Doubles:
    """Square the distance from the centroid to the farthest corner of the bounds of each voxel's samples."""
    cover = np.zeros(voxels.voxel_count)
    for x, middle in zip(p.T, centroid.T, strict=True):
        cover += np.maximum(middle - voxels.combine(np.minimum, x), voxels.combine(np.maximum, x) - middle) ** 2
    return cover


PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
"""Coordinates of second moments, in the order that `disks` takes them in."""


def disks(moments: list[Doubles]) -> Doubles:
    """Take second moments (xx, yy, zz, xy, yz, zx) for those of disks: ``(v, 4)``, see `Clusters.spread`.

    The normal is the direction of least moment: the longest column of the adjugate, which is the outer product of the
    normal but for terms of the least moment itself. Samples on a line or at a point have no normal: a ball.
    """
    xx, yy, zz, xy, yz, zx = moments
    columns = np.array(
        [
            [yy * zz - yz**2, yz * zx - xy * zz, xy * yz - yy * zx],
            [yz * zx - xy * zz, xx * zz - zx**2, xy * zx - xx * yz],
            [xy * yz - yy * zx, xy * zx - xx * yz, xx * yy - xy**2],
        ]
    )
    trace = np.maximum(xx + yy + zz, 0)
    longest = np.argmax(np.einsum("iiv->iv", columns), axis=0)
    normal = np.take_along_axis(columns, longest[None, None], axis=1)[:, 0]
    length = np.sqrt((normal**2).sum(axis=0))
    flat = length > 1e-6 * trace**2
    x, y, z = normal = np.where(flat, normal / np.where(flat, length, 1), 0)
    least = np.maximum(xx * x**2 + yy * y**2 + zz * z**2 + 2 * (xy * x * y + yz * y * z + zx * z * x), 0)
    c = np.where(flat, (trace - least) / 2, trace / 3)
    return np.concatenate([normal * np.sqrt(np.maximum(c - least, 0)), c[None]]).T
