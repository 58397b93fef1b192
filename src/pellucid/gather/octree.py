"""The octree over surface samples: built by array operations alone, laid out so that one loop without a stack walks it.

The samples are sorted along a Morton curve. A voxel is then a range of samples whose codes share their leading octal
digits, so the whole topology follows from one array: how many digits each code shares with its predecessor.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from ..kernels.morton import LEVELS, morton_codes, shared_digits
from ..progress import stage_of
from .moments import Clusters, Voxels, find_clusters

LEAF_SIZE = 8  # JB02 section 3.2: at most eight samples in a leaf voxel
PACKET = 4  # floats, which the device fetches at once
VOXEL_PACKETS, SAMPLE_PACKETS = 3, 2

Floats = NDArray[np.float32]
Indices = NDArray[np.uint32]


@dataclass
class Octree(Voxels):
    """The division of samples into voxels, and the light on them.

    Attributes
    ----------
    p, power : (n, 3) float32
        Positions of the samples in Morton order [mm] and their power: irradiance times area.
    order : (n,) uint32
        The caller's number of each sample.
    start : (v,) uint32
        First sample of each voxel.
    place, skip : (v,) uint32
        Where each voxel, and what follows its subtree, stands among the records, in packets.
    area : (v,) float32
        Total area of each voxel's samples [mm^2].
    device : dict
        Records that were copied to a device, kept by :mod:`pellucid.gather.gather`.
    """

    p: Floats
    power: Floats
    order: Indices
    start: Indices
    place: Indices
    skip: Indices
    area: Floats
    device: dict = field(default_factory=dict)

    @property
    def sample_count(self) -> int:
        """Number of samples."""
        return len(self.order)

    @property
    def packet_count(self) -> int:
        """Number of packets in the records."""
        return SAMPLE_PACKETS * self.sample_count + VOXEL_PACKETS * self.voxel_count

    @property
    def nbytes(self) -> int:
        """Bytes of a tree in use: on the host, and the records of one ``max_error`` on the device."""
        return 4 * PACKET * self.packet_count + sum(v.nbytes for v in vars(self).values() if isinstance(v, np.ndarray))

    def clusters(self) -> Clusters:
        """Sum up what the samples of each voxel amount to."""
        return find_clusters(self, self.p, self.power)

    def records(self, max_error: float) -> Floats:
        """Lay the tree out for device code: ``(k, 4) float32`` packets, in preorder.

        A voxel takes three packets: centroid and opening distance, power and skip, spread. A sample takes the first
        two. Skip (the bits of an integer) is the packet that follows the subtree. The opening distance is squared: a
        point nearer than this has to look inside. A voxel of area A stands for its samples where its solid angle
        ``A / r^2`` is at most ``max_error`` and the point lies outside of it, hence opens below
        ``max(A / max_error, cover)``; with ``max_error = 0`` everywhere. A is the area of its samples or, if larger,
        that of the disk over which they spread: a few samples far apart are not a small thing. A voxel without power
        contributes nothing and never opens. Of a sample it is zero: there is nothing inside.

        Source: JB02 eq. 12.
        """
        if not max_error >= 0:
            raise SceneError(f"max_error is a solid angle [sr], at least 0; found {max_error:g}.")
        clusters = self.clusters()
        packets = np.zeros((self.packet_count, PACKET), np.float32)
        skips = packets.view(np.uint32)[:, 3]
        at = self.sample_places()
        packets[at, :3] = self.p
        packets[at + 1, :3] = self.power
        skips[at + 1] = at + SAMPLE_PACKETS
        with np.errstate(over="ignore"):
            area = np.maximum(self.area, clusters.disk_area())
            opening = np.maximum(area / np.float32(max_error), clusters.cover) if max_error else np.inf
        packets[self.place, :3] = clusters.centroid
        packets[self.place, 3] = np.where(clusters.power.any(axis=1), opening, 0)
        packets[self.place + 1, :3] = clusters.power
        skips[self.place + 1] = self.skip
        packets[self.place + 2] = clusters.spread
        return packets

    def sample_places(self) -> NDArray[np.int64]:
        """Tell where each sample, in Morton order, stands among the records: ``(n,)``, in packets."""
        voxels_before = np.cumsum(np.bincount(self.start, minlength=self.sample_count))
        return SAMPLE_PACKETS * np.arange(self.sample_count) + VOXEL_PACKETS * voxels_before

    def with_power(self, power: ArrayLike) -> Octree:
        """Pour other light on the same samples: ``power (n, 3)`` in the caller's order. The division is shared."""
        return replace(self, power=_rows(power, 3, "power", self.sample_count)[self.order], device={})


def build_octree(p: ArrayLike, area: ArrayLike, power: ArrayLike, leaf_size: int = LEAF_SIZE) -> Octree:
    """Sort samples into an octree with at most ``leaf_size`` samples a leaf (more only where they coincide).

    Voxels that hold all samples of their parent are left out, so every voxel below the root divides its parent.

    Parameters
    ----------
    p : (n, 3) float
        Positions [mm].
    area : (n,) float
        Areas the samples stand for [mm^2].
    power : (n, 3) float
        Irradiance times area, of the light that enters.
    leaf_size : int
        Most samples of a voxel that is not divided further.

    Raises
    ------
    SceneError
        No samples, numbers that are not finite, or arrays of unequal length.

    Source: JB02 section 3.2.
    """
    points = _rows(p, 3, "p", None)
    areas = _rows(np.reshape(area, (-1, 1)), 1, "area", len(points))
    powers = _rows(power, 3, "power", len(points))
    with stage_of("tree", 3, "parts") as advance:
        codes = morton_codes(points)
        order = np.argsort(codes, kind="stable")
        advance(1)
        voxels = _voxels(shared_digits(codes[order]), leaf_size)
        advance(1)
        tree = _lay_out(points, powers, order, voxels)
        tree.area = tree.combine(np.add, areas[order, 0]).astype(np.float32)
        advance(1)
    return tree


def _lay_out(points: Floats, powers: Floats, order: NDArray[np.int64], voxels: tuple[NDArray[np.int64], ...]) -> Octree:
    """Decide where samples and voxels stand among the records."""
    start, end, parent, owner, level_start = voxels

    # Voxels are numbered level by level, so a stable sort by first sample puts ancestors before descendants. A voxel
    # follows all samples before its first one, and a sample all voxels that start at it or earlier.
    preorder = np.argsort(start, kind="stable")
    rank = np.empty_like(preorder)
    rank[preorder] = np.arange(len(start))
    voxels_before = np.cumsum(np.bincount(start, minlength=len(order)))
    place = SAMPLE_PACKETS * start + VOXEL_PACKETS * rank
    skip = SAMPLE_PACKETS * end + VOXEL_PACKETS * voxels_before[end - 1]
    return Octree(
        p=points[order],
        power=powers[order],
        order=order.astype(np.uint32),
        sample_parent=owner.astype(np.uint32),
        parent=parent.astype(np.uint32),
        start=start.astype(np.uint32),
        place=place.astype(np.uint32),
        skip=skip.astype(np.uint32),
        area=np.zeros(0, np.float32),
        level_start=level_start,
    )


def _rows(values: ArrayLike, width: int, name: str, count: int | None) -> Floats:
    """Check an array of ``width`` columns: finite, ``count`` rows."""
    rows = np.asarray(values, np.float32)
    if rows.ndim != 2 or rows.shape[1] != width or len(rows) == 0 or (count is not None and len(rows) != count):
        wanted = f"({'n' if count is None else count}, {width})"
        raise SceneError(f"octree: {name} must have the shape {wanted} with n > 0; found {rows.shape}.")
    if not np.isfinite(rows).all():
        raise SceneError(f"octree: {name} has values that are not finite; check the mesh and the lights.")
    return rows


def _voxels(shared: NDArray[np.int8], leaf_size: int) -> tuple[NDArray[np.int64], ...]:
    """List the voxels level by level: first sample, end, parent; the last voxel of each sample; where levels begin."""
    n = len(shared) - 1
    owner = np.zeros(n, np.int64)
    large = np.ones(n, bool)  # does the cell of the level above, around each sample, have to be divided?
    found = []
    level_start = np.zeros(LEVELS + 2, np.int64)
    count = 0
    for level in range(LEVELS + 1):
        edge = np.flatnonzero(shared < level)
        start, size = edge[:-1], np.diff(edge)
        divides = np.zeros(len(start), bool)
        divides[np.searchsorted(start, np.flatnonzero(shared == level), side="right") - 1] = True
        # A cell too large for a leaf whose samples all lie in one child is left to that child, but not at the end.
        keep = large[start] & (size > 1) & (divides | (size <= leaf_size) | (level == LEVELS))
        keep[0] |= level == 0
        number = np.arange(count, count + np.count_nonzero(keep))
        found.append((start[keep], start[keep] + size[keep], owner[start[keep]]))
        owner[np.repeat(keep, size)] = np.repeat(number, size[keep])
        large = np.repeat(size > leaf_size, size)
        count += len(number)
        level_start[level + 1 :] = count
        if not large.any():
            break
    start, end, parent = (np.concatenate(column) for column in zip(*found, strict=True))
    return start, end, parent, owner, level_start
