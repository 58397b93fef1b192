"""Photons in a half space: the independent check on the dipole, and the measurement behind JB02 figure 1."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from ..errors import MediumError
from .fresnel import fresnel_dielectric

Array = NDArray[np.float64]

LANES = 1 << 13
BINS_PER_OCTAVE = 8
MIN_RADIUS = 2.0**-8
OCTAVES = 18
ROULETTE_BELOW = 0.05


@dataclass
class PhotonTally:
    """What came back out of a half space, per unit of entering flux; lengths in mean free paths ``1 / sigma_t``.

    Attributes
    ----------
    single, multiple : float
        Reflectance due to light that scattered once, and more than once.
    error : float
        Standard error of their sum.
    distance, distance_multiple : float
        Mean distance along the surface from entry to exit, of all light and of that which scattered more than once.
    radii : (m + 1,) float
        Bounds of the rings of the profiles, logarithmic; the first is 0.
    profile_single, profile_multiple : (m,) float
        Exitance in each ring, whose sum over the areas of the rings is the reflectance.
    """

    single: float
    multiple: float
    error: float
    distance: float
    distance_multiple: float
    radii: Array
    profile_single: Array
    profile_multiple: Array

    @property
    def total(self) -> float:
        """Reflectance of all orders of scattering."""
        return self.single + self.multiple


def unreduced_albedo(albedo_prime: float, g: float) -> float:
    """Give the albedo ``sigma_s / sigma_t`` of the medium whose reduced albedo is known. JB02 eq. 4."""
    return albedo_prime / (albedo_prime + (1 - g) * (1 - albedo_prime))


def simulate(
    albedo: float,
    g: float = 0.0,
    eta: float = 1.3,
    photon_count: int = 1 << 20,
    incidence: Literal["diffuse", "normal"] = "diffuse",
    seed: int = 0,
) -> PhotonTally:
    """Trace photons through a half space with Henyey-Greenstein scattering and a refracting boundary.

    Parameters
    ----------
    albedo : float
        Unreduced albedo ``sigma_s / sigma_t``, in (0, 1).
    g, eta : float
        Mean cosine of the scattering angle; index of the inside over the outside, at least 1.
    photon_count : int
        Photons to trace; rounded up to a multiple of 8192.
    incidence : {"diffuse", "normal"}
        Light from random directions (cosine-weighted), or along the normal.
    seed : int
        The same seed gives the same photons.

    Returns
    -------
    PhotonTally
        Reflectances, mean distances and radial profiles.

    Raises
    ------
    MediumError
        For an albedo of 1 (the walks have no end) or outside (0, 1).

    Source
    ------
    JB02 section 2.1; phase function of Henyey and Greenstein 1941.
    """
    if not 0 < albedo < 1:
        raise MediumError(
            f"albedo = {albedo:g}: photons are traced for albedos between 0 and 1; without absorption all return."
        )
    backend = _backend()
    per_lane = -(-photon_count // LANES)
    bins = len(ring_bounds()) - 1
    # A histogram for every lane: shared ones would be added up in another order, and to other digits, in every run.
    histogram = dr.zeros(backend.Float, LANES * 2 * bins)
    rng = backend.PCG32(size=LANES, initseq=dr.arange(backend.UInt64, LANES) + seed * LANES)
    sums = _walk(backend, rng, histogram, dr.opaque(backend.Float, albedo), g, eta, per_lane, incidence == "diffuse")
    dr.eval(sums, histogram)
    rings = histogram.numpy().reshape(LANES, 2, bins).sum(axis=0, dtype=np.float64)
    return _tally([s.numpy().astype(np.float64) for s in sums], rings)


def _backend() -> Any:
    """Choose the module of array types: that of Mitsuba's variant if one is set, else LLVM's."""
    mitsuba = sys.modules.get("mitsuba")
    variant = mitsuba.variant() if mitsuba is not None else None
    return import_module("drjit.cuda" if variant and variant.startswith("cuda") else "drjit.llvm")


def ring_bounds() -> Array:
    """Bounds of the rings of the profiles, in mean free paths: ``(m + 1,) float``; the first is 0."""
    radii = MIN_RADIUS * 2.0 ** (np.arange(OCTAVES * BINS_PER_OCTAVE + 2) / BINS_PER_OCTAVE)
    radii[0] = 0.0
    return radii


def _tally(sums: list[Array], histogram: Array) -> PhotonTally:
    """Turn sums over the photons of each lane into averages per entering flux."""
    entered, single, multiple, distance_single, distance_multiple = sums
    flux = entered.sum()
    by_lane = (single + multiple) / entered
    radii = ring_bounds()
    profiles = histogram / (flux * np.pi * np.diff(radii**2))
    return PhotonTally(
        single=float(single.sum() / flux),
        multiple=float(multiple.sum() / flux),
        error=float(by_lane.std() / np.sqrt(len(by_lane))),
        distance=float((distance_single + distance_multiple).sum() / (single + multiple).sum()),
        distance_multiple=float(distance_multiple.sum() / multiple.sum()),
        radii=radii,
        profile_single=profiles[0],
        profile_multiple=profiles[1],
    )


def _enter(backend: Any, rng: Any, eta: float, diffuse: bool) -> tuple[Any, Any]:
    """Send a photon in: its refracted direction (z points inside), and the share of it that passes the boundary."""
    if not diffuse:
        return backend.Array3f(0, 0, 1), backend.Float(1)
    sin_squared = rng.next_float32()
    cos_outside = dr.sqrt(1 - sin_squared)
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * rng.next_float32())
    sin_inside = dr.sqrt(sin_squared) / eta
    direction = backend.Array3f(sin_inside * cos_phi, sin_inside * sin_phi, dr.sqrt(1 - sin_inside * sin_inside))
    return direction, 1 - fresnel_dielectric(cos_outside, eta)


def _scatter(backend: Any, rng: Any, direction: Any, g: float) -> Any:
    """Turn a direction by an angle of the Henyey-Greenstein phase function."""
    u = rng.next_float32()
    if abs(g) < 1e-3:
        cos_theta = 1 - 2 * u
    else:
        cos_theta = (1 + g * g - dr.square((1 - g * g) / (1 - g + 2 * g * u))) / (2 * g)
    sin_theta = dr.sqrt(dr.maximum(1 - cos_theta * cos_theta, 0))
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * rng.next_float32())
    x, y, z = direction
    sign = dr.select(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    s = backend.Array3f(1 + sign * x * x * a, sign * b, -sign * x)
    t = backend.Array3f(b, sign + y * y * a, -y)
    return dr.normalize(s * (sin_theta * cos_phi) + t * (sin_theta * sin_phi) + direction * cos_theta)


@dr.syntax
def _walk(
    backend: Any, rng: Any, histogram: Any, albedo: Any, g: float, eta: float, per_lane: int, diffuse: bool
) -> tuple[Any, ...]:
    """Walk photons until every lane has finished its share; a lane whose photon ends starts the next one at once."""
    Float = backend.Float
    entered, single, multiple = dr.zeros(Float, LANES), dr.zeros(Float, LANES), dr.zeros(Float, LANES)
    distance_single, distance_multiple = dr.zeros(Float, LANES), dr.zeros(Float, LANES)
    left = dr.full(backend.UInt32, per_lane, LANES)
    position = dr.zeros(backend.Array3f, LANES)
    order = dr.zeros(backend.UInt32, LANES)
    direction, weight = _enter(backend, rng, eta, diffuse)
    entered += weight
    bins = len(histogram) // (2 * LANES)
    first_bin = dr.arange(backend.UInt32, LANES) * (2 * bins)

    while left > 0:
        # Fly: to the next collision, or to the surface if that comes first.
        flight = -dr.log(1 - rng.next_float32())
        to_surface = dr.select(direction.z < 0, -position.z / direction.z, dr.inf)
        surfaced = to_surface <= flight
        position = dr.fma(direction, dr.minimum(flight, to_surface), position)
        position.z = dr.select(surfaced, 0, dr.maximum(position.z, 0))

        # At the surface: leave, or be reflected inside.
        reflected = rng.next_float32() < fresnel_dielectric(direction.z, eta)
        leaves = surfaced & ~reflected
        direction.z = dr.select(surfaced & reflected, -direction.z, direction.z)
        r = dr.sqrt(dr.square(position.x) + dr.square(position.y))
        once = order == 1
        seen = dr.select(leaves & (order > 0), weight, 0)
        single += dr.select(once, seen, 0)
        multiple += dr.select(once, 0, seen)
        distance_single += dr.select(once, seen * r, 0)
        distance_multiple += dr.select(once, 0, seen * r)
        ring = dr.floor(dr.log2(dr.maximum(r / MIN_RADIUS, 1)) * BINS_PER_OCTAVE)
        ring = dr.minimum(backend.UInt32(ring), bins - 1)
        dr.scatter_add(histogram, seen, first_bin + ring + dr.select(once, 0, bins), seen > 0)

        # In the medium: scatter, with roulette for photons that carry little.
        collided = ~surfaced
        direction = dr.select(collided, _scatter(backend, rng, direction, g), direction)
        order += dr.select(collided, 1, 0)
        weight *= dr.select(collided, albedo, 1)
        faint = weight < ROULETTE_BELOW
        survives = ~faint | (rng.next_float32() < 0.5)
        weight = dr.select(faint, dr.select(survives, 2 * weight, 0), weight)

        # Ended: the lane sends its next photon in.
        ended = leaves | ~survives
        left -= dr.select(ended, 1, 0)
        new_direction, new_weight = _enter(backend, rng, eta, diffuse)
        direction = dr.select(ended, new_direction, direction)
        weight = dr.select(ended, new_weight, weight)
        entered += dr.select(ended & (left > 0), new_weight, 0)
        position = dr.select(ended, 0, position)
        order = dr.select(ended, 0, order)

    return entered, single, multiple, distance_single, distance_multiple
