"""The profile R_d(r) as a small table for device code, indexed by the bits of r^2."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .medium import Medium

BINS_PER_OCTAVE = 128
SHIFT = 16  # 23 bits of mantissa, of which the upper 7 number the bin within its octave
MAX_OCTAVES = 50
DISC_RADII, DISC_ANGLES = 8, 12  # nodes of the quadrature over a disc
RINGS = 1024
CLOSE = 2.5  # radii of the disc: nearer to its centre its rings are weighed
Profile = Callable[[NDArray[np.float64]], NDArray[np.float64]]

SMALLEST_DISC = 0.05
"""In shortest mean free paths: R_d over a smaller disc is as good as at a point."""

DISC_STEP = 2.0**0.5
"""From one disc to the next, where there are tables over several."""

NEGLIGIBLE = 1e-13  # of the value at a mean free path: a profile that has fallen this far is cut off

# Nodes of the spline through means over a disc: to an octave of u, and every so many entries within RIM octaves of its rim.
NODES_PER_OCTAVE, RIM, RIM_STEP = 8, 0.5, 4
TINY = 1e-30

# Three relative slopes share the fourth float of an entry: 10 bits each, in units of STEEPEST / 1023 per bin.
SLOPE_BITS = 10
SLOPE_MASK = (1 << SLOPE_BITS) - 1
STEEPEST = 0.25

TIGHTEST = 2.0
"""Radius of the smallest sphere on which mu is believed [mean free paths]: there it is half the distance over the radius. Beside an edge
it would be far larger, and edges too bright."""

STEEPEST_CURVE = 8.0
"""Beta of a disc grows without end towards its centre, where mu ends at zero."""


@dataclass
class ProfileTable:
    """A table of R_d for device code: one gather of four floats gives all three channels.

    With ``u = r^2 inv_scale2 + offset``, where the scale is the distance within which R_d is nearly even, R_d is nearly a
    power law of u: for the dipole u is the squared distance to the real source in units of its depth. The upper bits of u as
    a float number the entry::

        index = min((bits(fma(r2, inv_scale2, offset)) >> shift) - base, last)

    Within an entry R_d is a straight line: the fourth float packs its three slopes as integers of 10 bits. With them
    the error is below 1e-3 wherever R_d exceeds 1e-9 of its peak; the bare values are off by up to 0.6 % where R_d is
    a power law, and by more far out.

    Attributes
    ----------
    values : (m, 4) float32
        Value in the middle of each entry for red, green, blue [1/mm^2], and the packed slopes. The last entry is zero.
    inv_scale2, offset : float
        Scale of r^2 [1/mm^2], and what is added to it.
    mfp2 : float
        Square of the shortest mean free path [mm^2].
    curve : (m, 4) float32, optional
        Beta of each entry for red, green, blue, and the largest mu: on a curved surface values are multiplied by ``exp(beta mu)``, mu the
        cosine between the normal and the way from where light enters. None where beta is zero.
    shift, base, last : int
        How the bits of u become an index.
    disc : float
        Radius over which the entering light is spread [mm].
    sizes : int
        Tables of ``last + 1`` entries each, one behind the other, over discs each of which is `DISC_STEP` smaller than the one before.
    """

    values: NDArray[np.float32]
    inv_scale2: float
    mfp2: float
    curve: NDArray[np.float32] | None = None
    offset: float = 1.0
    shift: int = SHIFT
    base: int = 0x3F800000 >> SHIFT
    last: int = 0
    disc: float = 0.0
    sizes: int = 1
    device: Any = None
    curve_on_device: Any = None

    @classmethod
    def from_medium(cls, medium: Medium, disc: float = 0.0, weight: Profile | None = None) -> ProfileTable:
        """Tabulate the profile of a medium, out to where it is negligible in all channels.

        Parameters
        ----------
        medium : Medium
            Whose R_d.
        disc : float
            Radius of a soft disc in the surface over which the entering light is spread [mm]: the table then holds the mean of
            R_d over it (`mean_over_disc`), which has the same integral over the plane. 0 is a point.
        weight : callable, optional
            Multiplies R_d before that: distances ``(n,)`` [mm] to factors ``(n, 3)`` or ``(n, 1)``. The table is that of a
            part of R_d (`decomposition.Decomposition`). Where a part grows with distance it is a staircase of 256 steps
            an octave of r.
        """
        return replace(_tabulated(medium, disc, weight))

    @classmethod
    def for_stretch(cls, medium: Medium, disc: float, widest: float) -> ProfileTable:
        """Tabulate the profile for points where it is up to ``widest`` times wider: beside it, the disc is so many times smaller."""
        smallest = SMALLEST_DISC * float(medium.mfp.min())
        steps = np.log(max(min(widest, disc / smallest), 1)) / np.log(DISC_STEP)
        tables = [cls.from_medium(medium, disc / DISC_STEP**k) for k in range(1 + int(np.ceil(steps)))]
        return replace(stacked(tables), sizes=len(tables))

    def to_device(self, float_type: type) -> ProfileTable:
        """Copy the values to the device of ``float_type``, for `lookup` and for kernels; returns the table itself."""
        if not isinstance(self.device, float_type):
            self.device = float_type(self.values.ravel())
            self.curve_on_device = None if self.curve is None else float_type(self.curve.ravel())
        return self

    def index(self, r2: Any) -> tuple[Any, Any]:
        """Number the entry of a squared distance, and give the bits of ``u`` that the number came from."""
        u = dr.fma(dr.detach(r2), self.inv_scale2, self.offset)
        bits: Any = dr.reinterpret_array(dr.uint32_array_t(type(r2)), u)
        return dr.minimum((bits >> self.shift) - self.base, self.last), bits

    def middles(self, entry: NDArray[np.uint32]) -> NDArray[np.float64]:
        """Give the ``u`` in the middle of entries."""
        return (((entry + self.base) << self.shift) + (1 << (self.shift - 1))).view(np.float32).astype(np.float64)

    def bounding(self) -> ProfileTable:
        """Give a table of no less than any value at an entry or beyond, whatever the cosines."""
        if self.curve is None:
            return self
        values = self.values.copy()
        largest = values[:, :3] * (1 + STEEPEST / 2) * np.exp(np.abs(self.curve[:, :3]) * self.curve[:, 3:])
        values[:, :3] = np.maximum.accumulate(largest[::-1], axis=0)[::-1]
        values[:, 3] = 0
        return replace(self, values=values, curve=None, device=None)

    def lookup(self, r2: Any, mu: Any = None, stretch: Any = None) -> tuple[Any, Any, Any]:
        """Look R_d up at squared distances.

        Parameters
        ----------
        r2 : Dr.Jit float
            Squared distance [mm^2], not negative. No gradient flows through it.
        mu : Dr.Jit float, optional
            Cosine between the normal where light leaves and the way there from where it enters; 0 on a flat surface.
        stretch : three Dr.Jit floats, optional
            How many times wider R_d is than in the table, by channel.

        Returns
        -------
        tuple of three Dr.Jit floats
            R_d for red, green and blue [1/mm^2].
        """
        if stretch is not None:
            narrowing = [dr.rcp(dr.square(x)) for x in stretch]
            red, green, blue = (x * self.lookup(r2 * x, mu)[k] for k, x in enumerate(narrowing))
            return red, green, blue
        float_type = type(r2)
        index, bits = self.index(r2)
        packet_type = sys.modules[float_type.__module__].Array4f
        entry = dr.gather(packet_type, self.to_device(float_type).device, index)
        value = interpolate(entry, bits)
        if mu is None or self.curve is None:
            return value
        return curved(value, dr.gather(packet_type, self.curve_on_device, index), mu)


@lru_cache(maxsize=128)
def _tabulated(medium: Medium, disc: float, weight: Profile | None) -> ProfileTable:
    """Make the table of `ProfileTable.from_medium`, once: a scene that is prepared anew has mostly the media that it had."""
    inv_scale2 = float(np.float32(1 / _even_within(medium) ** 2))
    u = 2.0 ** np.arange(MAX_OCTAVES + 1)
    edges = (u[:-1, None] * (1 + np.arange(BINS_PER_OCTAVE) / BINS_PER_OCTAVE)).ravel()
    edges = np.append(edges, u[-1])
    values, slopes = _fit_lines(medium, disc, weight, edges, inv_scale2)

    alive = np.any(values > NEGLIGIBLE * medium.diffuse_reflectance(medium.mfp.min()), axis=1)
    count = int(np.flatnonzero(alive).max(initial=0)) + 1
    table = np.zeros((count + 1, 4), dtype=np.float32)
    table[:count, :3] = values[:count]
    table.view(np.uint32)[:count, 3] = _pack(slopes[:count])
    ends = np.append(edges, 2 * edges[-1])  # the last entry of a table that goes on to the end lies beyond
    mean = np.sqrt((0.5 * (ends[: count + 1] + ends[1 : count + 2]) - 1) / inv_scale2)
    beta = np.zeros_like(table)
    beta[:, :3] = curve_over_disc(medium, mean, disc, weight)
    beta[:, 3] = np.minimum(mean * medium.sigma_t_prime.mean() / (2 * TIGHTEST), 1)
    curve = beta if beta[:, :3].any() else None
    return ProfileTable(table, inv_scale2, float(medium.mfp.min()) ** 2, curve, last=count, disc=disc)


def stacked(tables: list[ProfileTable]) -> ProfileTable:
    """Put tables of one scale behind each other, each filled up with zeros to the length of the longest; ``last`` is that of one."""
    entries = max(len(table.values) for table in tables)

    def joined(rows: list[NDArray[np.float32]]) -> NDArray[np.float32]:
        return np.concatenate([np.pad(values, ((0, entries - len(values)), (0, 0))) for values in rows])

    curves = [table.curve for table in tables if table.curve is not None]
    values = joined([table.values for table in tables])
    return replace(tables[0], values=values, curve=joined(curves) if curves else None, last=entries - 1, device=None)


def interpolate(entry: Any, bits: Any) -> tuple[Any, Any, Any]:
    """Follow the three lines of a gathered entry to the place within it that the lower bits of ``u`` name."""
    float_type, uint_type = type(entry[0]), type(bits)
    position = float_type(bits & ((1 << SHIFT) - 1)) - float((1 << SHIFT) // 2)
    step = position * (-STEEPEST / SLOPE_MASK / (1 << SHIFT))
    packed: Any = dr.reinterpret_array(uint_type, entry[3])
    slopes = (packed & SLOPE_MASK, (packed >> SLOPE_BITS) & SLOPE_MASK, packed >> (2 * SLOPE_BITS))
    red, green, blue = (dr.fma(value * step, float_type(q), value) for value, q in zip(entry, slopes, strict=False))
    return red, green, blue


def curved(value: tuple[Any, Any, Any], beta: Any, mu: Any) -> tuple[Any, Any, Any]:
    """Multiply a flat profile by ``exp(beta mu)``, mu within its bounds."""
    mu = bounded(mu, beta)
    red, green, blue = (v * dr.exp(b * mu) for v, b in zip(value, beta, strict=False))
    return red, green, blue


def bounded(mu: Any, beta: Any) -> Any:
    """Keep mu within the bounds that an entry of beta has."""
    return dr.clip(mu, -beta[3], beta[3])


def mean_over_disc(
    medium: Medium, r: NDArray[np.float64], disc: float, weight: Profile | None = None, like: Medium | None = None
) -> NDArray[np.float64]:
    """Average R_d, or R_d times a weight, over a soft disc whose centre is at the distances ``r (n,)`` [mm]: ``(n, 3) float``.

    The light on the disc falls towards its rim as ``(1 - t)^2``, t the squared distance from the centre over that of the rim: a sharp rim
    would show in a sum over many discs. The nodes of the quadrature are those for the medium ``like``, if it is given: media that are
    compared have the same.
    """

    def profile(distance: NDArray[np.float64]) -> NDArray[np.float64]:
        value = medium.diffuse_reflectance(distance)
        return value if weight is None else value * weight(distance)

    if disc == 0:
        return profile(r)
    mean = np.empty((len(r), 3))
    # A disc no wider than the peak of R_d needs no care; beside a wider one the peak is too narrow for a few nodes.
    even_within = _even_within(like or medium)
    close = (r < CLOSE * disc) & (disc > 3 * even_within)
    if close.any():
        mean[close] = _share_of_rings(profile, 1e-2 * even_within, r[close], disc)
    mean[~close] = _quadrature(profile, r[~close], disc)
    return mean


def curve_over_disc(
    medium: Medium, r: NDArray[np.float64], disc: float, weight: Profile | None = None, like: Medium | None = None
) -> NDArray[np.float64]:
    """Find beta of the mean of R_d over a disc at the distances ``r (n,)`` [mm], ascending: ``(n, 3) float``; ``like`` as above.

    On a sphere mu grows with the distance, so that to first order in its curvature beta of the mean is the mean of ``beta r R_d`` over r
    times that of R_d.
    """
    if disc == 0 or not medium.curve(r).any():
        return medium.curve(r)

    def moment(distance: NDArray[np.float64]) -> NDArray[np.float64]:
        value = medium.curve(distance) * distance[:, None]
        return value if weight is None else value * weight(distance)

    nodes = r[:: BINS_PER_OCTAVE // NODES_PER_OCTAVE]
    light = np.maximum(mean_over_disc(medium, nodes, disc, weight, like), TINY)
    beta = np.clip(mean_over_disc(medium, nodes, disc, moment, like) / (light * nodes[:, None]), 0, STEEPEST_CURVE)
    beta = np.where(light > NEGLIGIBLE * light.max(axis=0), beta, medium.curve(nodes))
    return np.stack([np.interp(r, nodes, beta[:, k]) for k in range(3)], axis=1)


def _even_within(medium: Medium) -> float:
    """Find the distance within which R_d is nearly even in all channels [mm]."""
    return medium.flat_profile.even_within * float(medium.mfp.min())


def _share_of_rings(profile: Profile, finest: float, r: NDArray[np.float64], disc: float) -> NDArray[np.float64]:
    """Weigh rings around the point by the light of the disc on each, however narrow R_d is beside it."""
    smallest = min(finest, 1e-3 * disc)
    inner, outer = np.geomspace(smallest, disc, RINGS), np.geomspace(disc, (CLOSE + 1) * disc, RINGS // 8)
    edges = np.concatenate([[0.0], inner, outer[1:]])
    rho = np.sqrt(0.5 * (edges[1:] ** 2 + edges[:-1] ** 2))
    mass = profile(rho) * (np.pi * np.diff(edges**2))[:, None]
    # Along a ring 1 - t is a + b cos(angle), up to the angle at which the ring leaves the disc.
    a, b = 1 - (r[:, None] ** 2 + rho**2) / disc**2, 2 * r[:, None] * rho / disc**2
    cosine = np.clip(-a / np.maximum(b, 1e-300), -1, 1)
    angle, sine = np.arccos(cosine), np.sqrt(1 - cosine**2)
    light = a * a * angle + 2 * a * b * sine + 0.5 * b * b * (angle + sine * cosine)
    return 3 / (np.pi * disc) ** 2 * light @ mass


def _quadrature(profile: Profile, r: NDArray[np.float64], disc: float) -> NDArray[np.float64]:
    """Integrate over the disc: Gauss-Legendre in the squared radius, where area is even, midpoints over half a turn."""
    node, share = np.polynomial.legendre.leggauss(DISC_RADII)
    share = share * 3 * ((1 - node) / 2) ** 2
    rho = (disc * np.sqrt((node + 1) / 2))[:, None, None]
    cosine = np.cos((np.arange(DISC_ANGLES) + 0.5) * np.pi / DISC_ANGLES)[:, None]
    distance = np.sqrt(np.maximum(r * r + rho * rho - 2 * r * rho * cosine, 0))
    value = profile(distance.ravel()).reshape(*distance.shape, 3)
    return np.einsum("i,ijkl->kl", share / 2 / DISC_ANGLES, value)


def _fit_lines(
    medium: Medium, disc: float, weight: Profile | None, edges: NDArray[np.float64], inv_scale2: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a line to R_d in each entry: value in the middle and relative fall over the entry, each ``(n, 3) float``."""

    def profile(u: NDArray[np.float64]) -> NDArray[np.float64]:
        return mean_over_disc(medium, np.sqrt(np.maximum(u - 1, 0) / inv_scale2), disc, weight)

    middles = 0.5 * (edges[:-1] + edges[1:])
    if disc == 0:
        at_edges, middle = profile(edges), profile(middles)
    else:
        at_edges, middle = _between_nodes(profile, edges, middles, 1 + disc**2 * inv_scale2)
    chord = 0.5 * (at_edges[:-1] + at_edges[1:])
    fall = at_edges[:-1] - at_edges[1:]
    values = 0.5 * (chord + middle)  # halfway between chord and tangent: half the error of either
    slopes = np.divide(fall, values, out=np.zeros_like(fall), where=values > 0)
    return values, slopes


def _between_nodes(
    profile: Profile, edges: NDArray[np.float64], middles: NDArray[np.float64], rim: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Evaluate a mean over a disc at edges and middles of entries, by a spline through few of them: means are dear.

    Nodes are close to each other around the ``rim`` of the disc, where the mean may fall within a hundredth of its radius.
    """
    entry = np.arange(len(edges))
    at_rim = np.abs(np.log2(edges / rim)) < RIM
    nodes = np.flatnonzero((entry % (BINS_PER_OCTAVE // NODES_PER_OCTAVE) == 0) | (at_rim & (entry % RIM_STEP == 0)))
    at_edges, middle = np.zeros((len(edges), 3)), np.zeros((len(middles), 3))
    found = profile(edges[nodes])
    count = int(np.max(np.flatnonzero(found.max(axis=1) > TINY * found.max()), initial=-1)) + 1
    if count < 2:  # a weight that leaves nothing
        return at_edges, middle
    nodes, found = nodes[:count], found[:count]
    inside = edges <= edges[nodes[-1]]
    spline = CubicSpline(np.log(edges[nodes]), np.log(np.maximum(found, TINY**2)), axis=0)
    at_edges[inside] = np.exp(spline(np.log(edges[inside])))
    middle[inside[1:]] = np.exp(spline(np.log(middles[inside[1:]])))
    return at_edges, middle


def _pack(slopes: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Pack three relative slopes into one word; its top two bits stay clear, so that as a float it is finite."""
    steps: NDArray[np.uint32] = np.clip(np.rint(slopes / STEEPEST * SLOPE_MASK), 0, SLOPE_MASK).astype(np.uint32)
    shifts = np.array([0, SLOPE_BITS, 2 * SLOPE_BITS], dtype=np.uint32)
    return np.bitwise_or.reduce(steps << shifts, axis=1)
