"""The exitance at points: power times R_d, summed over the clusters of an octree or over all samples.

Each lane of the machine walks the records, in preorder, for several points at once; they are close to each other when
points come in the order of pixels. A lane stops at every record that one of its points wants, so records are fetched
once for all; but each point keeps a pointer of its own and takes part only where that points. Its sum is the same, bit
for bit, whatever the other points of its lane are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

from ..kernels.morton import morton_order
from ..model.profiles import DISC_STEP, SHIFT, ProfileTable, curved, interpolate
from .octree import SAMPLE_PACKETS, VOXEL_PACKETS, Octree
from .source import Source, sample_source, tree_source, types_of

DEFAULT_MAX_ERROR = 0.1  # [sr]; docs/theory/tree.md has the error that this leaves
POINTS_PER_LANE = 8

Color = tuple[Any, Any, Any]


def gather(
    octree: Octree,
    table: ProfileTable,
    p: Any,
    max_error: float = DEFAULT_MAX_ERROR,
    coarser: float = 1.0,
    scattered: bool = False,
    n: Any = None,
    stretch: Any = None,
) -> Color:
    """Sum ``power R_d(|x - p|)`` over the clusters that may stand for their samples at each point.

    R_d of a cluster is looked up at the distance at which it equals its mean over the cluster's samples, to second
    order in their spread C: ``r^2 + tr C - 2 psi (d . C d) / (r^2 + core)``, d from the point to the centroid; psi and
    core as `device.steepness` has them.

    Parameters
    ----------
    octree : Octree
        Samples with the power that enters.
    table : ProfileTable
        R_d.
    p : Point3f of m lanes
        Points [mm]; neighbours in the array should be neighbours in space.
    max_error : float
        Largest solid angle under which a cluster may stand for its samples [sr]; with 0 every sample is weighed.
    coarser : float
        Multiplies ``max_error`` for these points alone, from the same records; at most ``1 / max_error``, up to where
        a point cannot be inside a cluster that is accepted.
    scattered : bool
        The points come in no order: sort them first, so that those of a lane are neighbours. Several times faster then.
    n : Normal3f of m lanes, optional
        Normals of the surface at the points, away from the inside: where R_d knows of the curve. Without them it is flat.
    stretch : Color3f of m lanes, optional
        How many times wider R_d is at the points than in the table: ``R_d(r / stretch) / stretch^2``, by channel.

    Returns
    -------
    tuple of three Floats of m lanes
        Radiant exitance in red, green and blue, without gradients.

    Source: JB02 eqs. 12-13; the second moment is ours.
    """
    points = queries(table.curve, p, n, stretch)
    if dr.width(points[0]) == 0:
        return points[0], points[1], points[2]
    source = tree_source(octree, table, max_error, type(points[0]))
    if not scattered:
        return in_order(walk(source, points, *_exitance(source, type(points[0])), coarser), dr.width(points[0]))
    order = types_of(type(points[0]))[0](morton_order(np.stack([x.numpy() for x in points[:3]], axis=1)))
    points = [dr.gather(type(x), x, order) for x in points]
    dr.eval(points)
    sums = in_order(walk(source, points, *_exitance(source, type(points[0])), coarser), dr.width(order))
    result = tuple(dr.empty(type(x), dr.width(order)) for x in sums)
    for target, value in zip(result, sums, strict=True):
        dr.scatter(target, value, order)
    return result


def gather_all(
    points: ArrayLike, power: ArrayLike, table: ProfileTable, p: Any, n: Any = None, stretch: Any = None
) -> Color:
    """Sum ``power R_d(|x - p|)`` over all samples, the twin of `gather`.

    Parameters
    ----------
    points, power : (n, 3) float
        Positions of samples [mm] and the power that enters there.
    table, p, n, stretch
        As for `gather`.

    Returns
    -------
    tuple of three Floats of m lanes
        Radiant exitance in red, green and blue, without gradients.

    Source: JB02 eq. 13.
    """
    return gather_samples(sample_source(points, power, table, dr.detached_t(type(p[0]))), p, n, stretch)


def gather_samples(source: Source, p: Any, n: Any = None, stretch: Any = None) -> Color:
    """Sum ``power R_d(|x - p|)`` over the samples of a `device.sample_source` or `device.device_source`.

    Parameters
    ----------
    source : Source
        Samples and profile on the device.
    p, n, stretch
        As for `gather`.

    Returns
    -------
    tuple of three Floats of m lanes
        Radiant exitance in red, green and blue, without gradients.

    Source: JB02 eq. 13, CLHHC08 eq. 10.
    """
    asked = queries(source.curve, p, n, stretch)
    if dr.width(asked[0]) == 0:
        return asked[0], asked[1], asked[2]
    return in_order(sweep(source, asked, *_exitance(source, type(asked[0]))), dr.width(asked[0]))


def count_evaluations(octree: Octree, table: ProfileTable, p: Any, max_error: float) -> tuple[int, int, int]:
    """Count, over all points, the records weighed and those accepted, and the records at which lanes stopped."""
    points = detached(p)
    UInt, _ = types_of(type(points[0]))

    def count(counts: Any, records: list[Record]) -> Any:
        weighed, accepted, stops = counts
        for record in records:
            weighed = weighed + dr.select(record.wanted, 1, 0)
            accepted = accepted + dr.select(record.accepted, 1, 0)
        return weighed, accepted, stops + 1

    counts = walk(tree_source(octree, table, max_error, type(points[0])), points, (UInt(0), UInt(0), UInt(0)), count)
    weighed, accepted, stops = (int(np.asarray(c).astype(np.int64).sum()) for c in counts)
    return weighed, accepted, stops


@dataclass
class Record:
    """What one point of a lane finds at a record.

    Attributes
    ----------
    here : UInt32
        The place of the record, in packets.
    power : list of three Floats
        That enters there.
    r2 : Float
        The squared distance at which R_d is looked up [mm^2].
    wanted, accepted : Bool
        Whether the point looks at the record, and whether it takes it as a whole.
    first : UInt32 or int
        Entry at which the profile of the record begins.
    mu : Float, optional
        Cosine between the normal at the point and the way there; None where no normals are asked about.
    narrow : tuple of list of three Floats and list of three UInt32s, optional
        What squared distances are multiplied by before R_d is looked up, and R_d after it, and the table that it is looked up in, by
        channel; None where all points have the same R_d.
    """

    here: Any
    power: list[Any]
    r2: Any
    wanted: Any
    accepted: Any
    first: Any = 0
    mu: Any = None
    narrow: Any = None


Collect = Callable[[Any, list[Record]], Any]
"""Adds what the points of a lane find at one record, a `Record` each, to the sums of the lane."""


def walk(source: Source, points: list[Any], sums: Any, collect: Collect, coarser: float = 1.0) -> Any:
    """Walk the tree of a `source.tree_source`; return the sums of all lanes. ``POINTS_PER_LANE`` points share one."""
    Float = type(points[0])
    UInt, Packet = types_of(Float)
    position, index, size = deal(points)
    end = source.end
    nearer = dr.opaque(Float, 1 / coarser)
    # Places beyond the last point are at the end from the start.
    pointers = [dr.select(i < size, UInt(0), end) for i in index]
    narrow = [_narrow(source, x[6:]) for x in position]
    cores = [source.core / reduce(dr.maximum, x[6:]) if x[6:] else source.core for x in position]

    def visit(here, pointers, sums):
        place, opening = split(dr.gather(Packet, source.records, here))
        opening = opening * nearer
        power, skip = split(dr.gather(Packet, source.records, here + 1))
        skip = dr.reinterpret_array(UInt, skip)
        # The spread C = c I - v v^T of voxels; samples have none: tr C - 2 psi c, and v times the root of 2 psi.
        v, c = split(dr.gather(Packet, source.records, here + 2, opening > 0))
        shift = dr.fma(3 - source.twice_psi, c, -dot(v, v))
        v = [x * dr.sqrt(source.twice_psi) for x in v]
        records = []
        for j in range(POINTS_PER_LANE):
            d = [a - b for a, b in zip(position[j][:3], place, strict=True)]
            r2 = dot(d, d)
            wanted = pointers[j] == here
            far = r2 >= opening  # JB02 eq. 12
            along = dot(d, v)
            r2_mean = dr.fma(along * along, dr.rcp(r2 + cores[j]), r2 + shift)
            mu = cosine(position[j][3:6], d, r2)
            records.append(Record(here, power, r2_mean, wanted, wanted & far, mu=mu, narrow=narrow[j]))
            pointers[j] = dr.select(wanted, dr.select(far, skip, here + VOXEL_PACKETS), pointers[j])
        return reduce(dr.minimum, pointers), pointers, collect(sums, records)

    state = (reduce(dr.minimum, pointers), pointers, sums)
    return dr.while_loop(state, lambda here, *_: here < end, visit, label="pellucid gather")[2]


def sweep(source: Source, points: list[Any], sums: Any, collect: Collect) -> Any:
    """Weigh all samples of a `source.sample_source`; return the sums of all lanes."""
    UInt, Packet = types_of(type(points[0]))
    position, _, _ = deal(points)
    narrow = [_narrow(source, x[6:]) for x in position]

    def visit(here, sums):
        place, first = split(dr.gather(Packet, source.records, here))
        power, _ = split(dr.gather(Packet, source.records, here + 1))
        first = dr.reinterpret_array(UInt, first)  # entry of the profile of this sample, among those of several
        records = []
        for x, own in zip(position, narrow, strict=True):
            d = [a - b for a, b in zip(x[:3], place, strict=True)]
            r2 = dot(d, d)
            records.append(Record(here, power, r2, True, True, first, cosine(x[3:6], d, r2), own))
        return here + SAMPLE_PACKETS, collect(sums, records)

    return dr.while_loop((UInt(0), sums), lambda here, _: here < source.end, visit, label="pellucid gather_all")[1]


def _exitance(source: Source, Float: type) -> tuple[list[list[Any]], Collect]:
    """Begin the sums of the exitance at the points of a lane, and say how they go on (JB02 eq. 13)."""

    def collect(sums: Any, records: list[Record]) -> Any:
        return [
            [dr.fma(a, b, s) for a, b, s in zip(found.power, _profile(source, found), three, strict=True)]
            for three, found in zip(sums, records, strict=True)
        ]

    return [[Float(0)] * 3 for _ in range(POINTS_PER_LANE)], collect


def _profile(source: Source, found: Record) -> Color:
    """Look up R_d of a record, channel by channel where it is narrower or wider than in the table."""
    if found.narrow is None:
        return lookup(source, found.r2, found.accepted, found.first, found.mu)
    red, green, blue = (
        factor * lookup(source, found.r2 * factor, found.accepted, first, found.mu)[k]
        for k, (factor, first) in enumerate(zip(*found.narrow, strict=True))
    )
    return red, green, blue


def _narrow(source: Source, factors: list[Any]) -> tuple[list[Any], list[Any]] | None:
    """Choose the tables for points whose squared distances are multiplied by three factors: over discs that keep their size."""
    if not factors:
        return None
    UInt, _ = types_of(type(factors[0]))
    steps = [dr.log2(x) * float(-0.5 / np.log2(DISC_STEP)) + 0.5 for x in factors]
    return factors, [dr.minimum(UInt(dr.maximum(x, 0)), source.sizes - 1) * (source.last + 1) for x in steps]


def lookup(source: Source, r2: Any, active: Any, first: Any = 0, mu: Any = None) -> Color:
    """Look R_d up where ``active``, as `ProfileTable.lookup` does but from opaque numbers; zero elsewhere."""
    entry, bits = find_entry(source, r2, first)
    Packet = types_of(type(r2))[1]
    value = interpolate(dr.gather(Packet, source.profile, entry, active), bits)
    if mu is None or source.curve is None:
        return value
    return curved(value, dr.gather(Packet, source.curve, entry, active), mu)


def cosine(n: Any, d: Any, r2: Any) -> Any:
    """Evaluate the cosine between a normal and the way d of squared length r2; None without a normal."""
    return None if n is None or len(n) == 0 else dot(n, d) * dr.rsqrt(dr.maximum(r2, 1e-20))


def find_entry(source: Source, r2: Any, first: Any = 0) -> tuple[Any, Any]:
    """Number the entry of a squared distance, and give the bits that say where in the entry it is."""
    UInt, _ = types_of(type(r2))
    bits: Any = dr.reinterpret_array(UInt, dr.fma(r2, source.inv_scale2, source.offset))
    return dr.minimum((bits >> SHIFT) - source.base, source.last) + first, bits


def split(packet: Any) -> tuple[list[Any], Any]:
    """Take the fourth number off a packet."""
    return [packet[0], packet[1], packet[2]], packet[3]


def dot(a: list[Any], b: list[Any]) -> Any:
    """Multiply vectors by components."""
    return dr.fma(a[0], b[0], dr.fma(a[1], b[1], a[2] * b[2]))


def queries(curve: Any, p: Any, n: Any, stretch: Any = None) -> list[Any]:
    """Take the components of points, of their normals where there is a curve to know of or more to come, and of ``1 / stretch^2``."""
    normals = [] if curve is None or n is None else [*n]
    if stretch is None:
        return detached([*p, *normals])
    return detached([*p, *(normals or [dr.zeros(type(p[0]))] * 3), *(dr.rcp(dr.square(x)) for x in stretch)])


def detached(p: Any) -> list[Any]:
    """Take the components of points, without gradients, all of one width and in memory."""
    size = dr.width(p)
    points = [dr.detach(x, preserve_type=False) for x in p]
    points = [x if dr.width(x) == size else x + dr.zeros(type(x), size) for x in points]
    dr.eval(points)
    return points


def deal(points: list[Any]) -> tuple[list[list[Any]], list[Any], Any]:
    """Deal consecutive points to each lane: their components, their numbers, and how many there are; the last fills up."""
    Float = type(points[0])
    UInt, _ = types_of(Float)
    size = dr.width(points[0])
    lanes = (size + POINTS_PER_LANE - 1) // POINTS_PER_LANE
    count = dr.opaque(UInt, size)  # an input of the kernel, which is then the same for every number of points
    last = count - 1
    index = [dr.arange(UInt, lanes) * POINTS_PER_LANE + j for j in range(POINTS_PER_LANE)]
    position = [[dr.gather(Float, x, dr.minimum(i, last)) for x in points] for i in index]
    return position, index, count


def in_order(sums: list[list[Any]], size: int) -> Color:
    """Put the sums of all lanes back in the order of the points; four of a lane at a time, each into memory of its own,
    for Dr.Jit makes a kernel of every further write to the same memory."""
    Float = type(sums[0][0])
    UInt, Packet = types_of(Float)
    lanes = dr.width(sums)
    quads: list[list[Any]] = [[], [], []]
    for channel, first in product(range(3), range(0, POINTS_PER_LANE, 4)):
        quad = dr.empty(Float, 4 * lanes)
        dr.scatter(quad, Packet(*(sums[first + k][channel] for k in range(4))), dr.arange(UInt, lanes))
        quads[channel].append(quad)
    dr.eval(quads)
    index = dr.arange(UInt, size)
    place, part = ((index // POINTS_PER_LANE) << 2) | (index & 3), (index % POINTS_PER_LANE) >> 2
    red, green, blue = (
        sum((dr.gather(Float, quad, place, part == k) for k, quad in enumerate(four)), Float(0)) for four in quads
    )
    return red, green, blue
