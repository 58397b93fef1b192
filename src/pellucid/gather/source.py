"""What the kernels of :mod:`pellucid.gather.gather` read: records and profile in device memory."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

from ..errors import SceneError
from ..kernels.memory import upload
from ..model.profiles import ProfileTable
from .octree import PACKET, SAMPLE_PACKETS, Octree

FAR = 100.0  # squared distance, in mean free paths, from which on `steepness` looks at the profile


@dataclass
class Source:
    """Records, profile and their numbers; opaque, that is inputs of a kernel compiled once and not part of it."""

    records: Any
    end: Any
    profile: Any
    curve: Any
    inv_scale2: Any
    offset: Any
    base: Any
    last: Any
    sizes: Any
    twice_psi: Any
    core: Any


def tree_source(octree: Octree, table: ProfileTable, max_error: float, Float: type) -> Source:
    """Bring the records of a tree to the device, once for each ``max_error``; only the latest are kept."""
    key = (Float, max_error)
    if key not in octree.device:
        octree.device.clear()
        octree.device[key] = upload(octree.records(max_error), Float)
    return make_source(octree.device[key], octree.packet_count, table, Float)


def sample_source(points: ArrayLike, power: ArrayLike, table: ProfileTable, Float: type) -> Source:
    """Bring all samples to the device, without a tree."""
    p, light = np.asarray(points, np.float32), np.asarray(power, np.float32)
    if p.ndim != 2 or p.shape[1] != 3 or p.shape != light.shape:
        raise SceneError(
            f"gather_all: points and power must both have the shape (n, 3); found {p.shape}, {light.shape}."
        )
    records = np.zeros((len(p), SAMPLE_PACKETS, PACKET), np.float32)
    records[:, 0, :3], records[:, 1, :3] = p, light
    return make_source(upload(records, Float), SAMPLE_PACKETS * len(p), table, Float)


def device_source(p: Any, power: Any, table: ProfileTable, first: Any = None) -> Source:
    """Take samples that are on the device already: nothing of them passes through the host.

    Parameters
    ----------
    p : Point3f of n lanes
        Positions [mm].
    power : Color3f of n lanes
        The power that enters there.
    table : ProfileTable
        R_d.
    first : UInt32 of n lanes, optional
        The entry at which the profile of each sample begins, in a table of several (`discs.DiscTables`).
    """
    Float = dr.detached_t(type(p[0]))
    empty = make_source(dr.empty(Float, PACKET), 0, table, Float)
    return with_samples(empty, p, power, first)


def with_samples(source: Source, p: Any, power: Any, first: Any = None) -> Source:
    """Put other samples, from the device, beside the profile of a source; parameters as for `device_source`."""
    Float = type(source.inv_scale2)
    UInt, Packet = types_of(Float)
    count = dr.width(p)
    records = dr.empty(Float, SAMPLE_PACKETS * PACKET * max(count, 1))
    if count == 0:  # no packet is fetched, but kernels refuse to fetch from nothing
        return replace(source, records=records, end=dr.opaque(UInt, 0))
    index = dr.arange(UInt, count) * SAMPLE_PACKETS
    first = UInt(0) if first is None else dr.detach(first, preserve_type=False)
    for k, (part, fourth) in enumerate(((p, dr.reinterpret_array(Float, first)), (power, 0))):
        x, y, z = (Float(dr.detach(part[i], preserve_type=False)) for i in range(3))
        dr.scatter(records, Packet(x, y, z, fourth), index + k)
    dr.eval(records)
    return replace(source, records=records, end=dr.opaque(UInt, SAMPLE_PACKETS * count))


def make_source(records: Any, end: int, table: ProfileTable, Float: type) -> Source:
    """Put records in device memory together with the profile."""
    UInt, _ = types_of(Float)
    psi, core = steepness(table)
    return Source(
        records=records,
        end=dr.opaque(UInt, end),
        profile=upload(table.values, Float),
        curve=None if table.curve is None else upload(table.curve, Float),
        inv_scale2=dr.opaque(Float, table.inv_scale2),
        offset=dr.opaque(Float, table.offset),
        base=dr.opaque(UInt, table.base),
        last=dr.opaque(UInt, table.last),
        sizes=dr.opaque(UInt, table.sizes),
        twice_psi=dr.opaque(Float, 2 * psi),
        core=dr.opaque(Float, core),
    )


def steepness(table: ProfileTable) -> tuple[float, float]:
    """Fit ``-R''/R' = psi / (s + core)`` to the profile as a function of ``s = r^2``: returns psi, core [mm^2].

    A cluster's mean of R_d is, to second order in its size, ``R(s) + R' tr C + 2 R'' d.Cd``, which is R at
    ``s + tr C + 2 (R''/R') d.Cd``. For a power law ``(s + core)^-k`` psi is k + 1, 5/2 for the dipole at distances
    short of the absorption length. The fit weighs each distance by what it adds to the error over a plane under even
    light, so that this error vanishes in the mean.
    """
    step = 8  # entries; coarse enough for differences of single precision
    entry = np.arange(0, table.last, step, dtype=np.uint32)
    u = table.middles(entry)
    s = (u - table.offset) / table.inv_scale2
    profile = table.values[entry, :3].astype(np.float64).mean(axis=1)
    core = table.mfp2
    seen = profile > 1e-9 * profile[0]
    if np.count_nonzero(seen) < 3:
        return 2.5, core
    s, profile = s[seen], profile[seen]
    fall = np.maximum(-np.gradient(profile, s), 1e-30 * profile[0])  # flat in the middle, if light enters over discs
    weight = fall * s**2 * ((s + core) / (s + core * (1 + FAR))) ** 2
    psi = -(weight * s * np.gradient(np.log(fall), s)).sum() / (weight * s / (s + core)).sum()
    return max(float(psi), 0.0), core  # beside the rim of a disc far wider than the profile the fit means nothing


def types_of(Float: type) -> tuple[Any, Any]:
    """Name the types UInt32 and Array4f of the backend of ``Float``."""
    module = sys.modules[Float.__module__]
    return module.UInt32, module.Array4f
