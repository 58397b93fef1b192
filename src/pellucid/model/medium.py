"""A homogeneous translucent material, and the light that a flat half space of it sends back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MediumError
from .dipole import Dipole
from .flat_profile import FlatProfile
from .fresnel import boundary_mismatch
from .materials import CHANNELS, find_material, spelled
from .tabulated import Curved, Tabulated

Array = NDArray[np.float64]

# A black channel scatters this much all the same: no medium can reflect exactly nothing and still have a profile.
MIN_REFLECTANCE = 1e-7
MAX_REFLECTANCE = 1 - 1e-7
MAX_ETA = 4.0

PROFILES: dict[str, FlatProfile] = {profile.name: profile for profile in (Tabulated(), Curved(), Dipole())}
DEFAULT_PROFILE = Tabulated.name


def _triple(value: ArrayLike, name: str) -> Array:
    """Read one number for all channels, or three."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise MediumError(f"{name} = {value!r} is no number: give one, or three for red, green and blue.") from None
    if array.shape not in ((), (1,), (3,)):
        raise MediumError(f"{name} has shape {array.shape}: give one number, or three for red, green and blue.")
    return np.broadcast_to(array, 3).copy()


def _refuse(bad: NDArray[np.bool_], name: str, value: Array, remedy: str) -> None:
    """Raise for the first channel in which ``value`` cannot be."""
    if bad.any():
        i = int(np.argmax(bad))
        raise MediumError(f"{name} = {value[i]:g} in the {CHANNELS[i]} channel: {remedy}.")


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Medium:
    """A homogeneous translucent material.

    Parameters
    ----------
    sigma_s_prime : (3,) float
        Reduced scattering coefficient ``(1 - g) sigma_s`` [1/mm]; one number stands for all three channels.
    sigma_a : (3,) float
        Absorption coefficient [1/mm]; 0 is allowed.
    g : float
        Mean cosine of the scattering angle, in (-1, 1).
    eta : float
        Index of refraction over that of the outside.
    name : str, optional
        What to call it in messages.
    profile : str
        How light spreads: ``tabulated`` as that of photons in a flat body, for g in [-0.5, 0.95] and eta in [1, 2]; ``curved`` with what
        curve and thickness change; or by the papers' ``dipole``.

    Raises
    ------
    MediumError
        For coefficients that no material can have.

    Examples
    --------
    >>> Medium.from_preset("marble").total_diffuse_reflectance.round(2)
    array([0.81, 0.77, 0.73])
    """

    sigma_s_prime: Array
    sigma_a: Array
    g: float = 0.0
    eta: float = 1.3
    name: str | None = None
    profile: str = DEFAULT_PROFILE

    def __init__(
        self,
        sigma_s_prime: ArrayLike,
        sigma_a: ArrayLike,
        g: float = 0.0,
        eta: float = 1.3,
        name: str | None = None,
        profile: str = DEFAULT_PROFILE,
    ):
        given = {
            "sigma_s_prime": _triple(sigma_s_prime, "sigma_s_prime"),
            "sigma_a": _triple(sigma_a, "sigma_a"),
            "g": float(g),
            "eta": float(eta),
            "name": name,
            "profile": profile,
        }
        for field, value in given.items():
            object.__setattr__(self, field, value)
        self._check()

    def _check(self) -> None:
        """Refuse what no material can have."""
        for field, value in (("sigma_s_prime", self.sigma_s_prime), ("sigma_a", self.sigma_a)):
            _refuse(~np.isfinite(value), field, value, "it must be finite")
            _refuse(value < 0, field, value, "a coefficient [1/mm] cannot be negative")
            value.flags.writeable = False
        remedy = (
            "light must scatter to be diffuse; give a small value such as 1e-3, or use 'dielectric' for clear glass"
        )
        _refuse(self.sigma_s_prime == 0, "sigma_s_prime", self.sigma_s_prime, remedy)
        if not -1 < self.g < 1:
            raise MediumError(f"g = {self.g:g}: the mean cosine of the scattering angle lies between -1 and 1.")
        if not 1 <= self.eta <= MAX_ETA:
            raise MediumError(
                f"eta = {self.eta:g}: the index of the inside over the outside must lie in [1, {MAX_ETA:g}]."
            )
        if self.profile not in PROFILES:
            raise MediumError(f"There is no profile {self.profile!r}; choose one of: {', '.join(PROFILES)}.")

    def __repr__(self) -> str:
        rows = {
            name: [f"{value:.4g}" for value in getattr(self, name)]
            for name in ("sigma_s_prime", "sigma_a", "albedo_prime", "mfp", "dmfp", "total_diffuse_reflectance")
        }
        table = [
            f"  {name:<27}{''.join(f'{v:<10}' for v in row)}".rstrip() for name, row in ({"": CHANNELS} | rows).items()
        ]
        name = f" {self.name!r}" if self.name else ""
        head = f"<Medium{name}: eta {self.eta:g}, g {self.g:g}, {self.profile}; mm and 1/mm, or scene units once scaled"
        return "\n".join([head, *table]) + ">"

    def _key(self) -> tuple[Any, ...]:
        return (*self.sigma_s_prime, *self.sigma_a, self.g, self.eta, self.profile)

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Medium) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    @classmethod
    def from_preset(cls, name: str, scale: float = 1.0, profile: str = DEFAULT_PROFILE) -> Medium:
        """Make one of the measured materials, in units of ``scale`` mm.

        The reduced coefficients are those of every channel; g is the mean of the channels.

        Raises
        ------
        MediumError
            For an unknown name, with the nearest known one, and for a material with a channel that does not scatter.

        Source
        ------
        JMLH01 figure 5; NGDRNJ06.
        """
        row = find_material(name)
        return cls(row.sigma_s_prime, row.sigma_a, row.mean_g, row.eta, spelled(name), profile).scaled(scale)

    @classmethod
    def from_reflectance(
        cls,
        reflectance: ArrayLike,
        dmfp: ArrayLike,
        eta: float = 1.3,
        g: float = 0.0,
        profile: str = DEFAULT_PROFILE,
    ) -> Medium:
        """Find the medium that has a given colour and blurs over a given distance.

        Solves the profile's total reflectance for its absorption; how fast light then decays gives sigma_t'.

        Parameters
        ----------
        reflectance : (3,) float
            Total diffuse reflectance in [0, 1). Below 1e-7 it is raised to 1e-7, as a channel must scatter.
        dmfp : (3,) float
            Diffuse mean free path ``1 / sigma_tr`` [mm].

        Raises
        ------
        MediumError
            For a reflectance outside [0, 1). A reflectance of 1 means no absorption, hence no finite dmfp.

        Source
        ------
        JB02 eqs. 15 and 16, for the dipole.
        """
        reflectance, dmfp = _triple(reflectance, "reflectance"), _triple(dmfp, "dmfp")
        remedy = (
            "it must be at least 0 and below 1; without absorption there is no finite dmfp: "
            "give at most 0.999, or sigma_s_prime with sigma_a = 0"
        )
        _refuse(~((reflectance >= 0) & (reflectance <= MAX_REFLECTANCE)), "reflectance", reflectance, remedy)
        _refuse(
            ~((dmfp > 0) & np.isfinite(dmfp)),
            "dmfp",
            dmfp,
            "the diffuse mean free path [mm] must be positive and finite",
        )
        # eta, g and profile are checked before the root is sought, so that their message is the one the user sees.
        flat = cls(1.0, 0.0, g, eta, None, profile).flat_profile
        s = np.array([flat.s_of_total(value, g, eta) for value in np.maximum(reflectance, MIN_REFLECTANCE)])
        sigma_t_prime = 1 / (dmfp * np.array([flat.decay(value, g) for value in s]))  # eq. 16
        return cls(sigma_t_prime * (1 - s * s / 3), sigma_t_prime * (s * s / 3), g, eta, None, profile)

    def scaled(self, scale: float) -> Medium:
        """Express the coefficients per scene unit, when one scene unit is ``scale`` mm."""
        if not (np.isfinite(scale) and scale > 0):
            raise MediumError(f"scale = {scale:g}: one scene unit must be a positive number of millimetres.")
        return Medium(self.sigma_s_prime * scale, self.sigma_a * scale, self.g, self.eta, self.name, self.profile)

    @property
    def flat_profile(self) -> FlatProfile:
        """How light spreads in a flat half space."""
        return PROFILES[self.profile]

    @property
    def s(self) -> Array:
        """Absorption ``sqrt(3 (1 - a')) = sqrt(3 sigma_a / sigma_t')``: ``(3,) float``."""
        return np.sqrt(3 * self.sigma_a / self.sigma_t_prime)

    @property
    def sigma_t_prime(self) -> Array:
        """Reduced extinction coefficient [1/mm]: ``(3,) float``."""
        return self.sigma_s_prime + self.sigma_a

    @property
    def albedo_prime(self) -> Array:
        """Reduced albedo ``sigma_s' / sigma_t'``: ``(3,) float``."""
        return self.sigma_s_prime / self.sigma_t_prime

    @property
    def sigma_tr(self) -> Array:
        """How fast light dies far from where it entered [1/mm]: ``(3,) float``; ``sqrt(3 sigma_a sigma_t')`` of the dipole."""
        return self.sigma_t_prime * np.array([self.flat_profile.decay(s, self.g) for s in self.s])

    @property
    def mfp(self) -> Array:
        """Reduced mean free path ``1 / sigma_t'`` [mm]: ``(3,) float``."""
        return 1 / self.sigma_t_prime

    @property
    def dmfp(self) -> Array:
        """Diffuse mean free path ``1 / sigma_tr`` [mm], infinite without absorption: ``(3,) float``. JB02 eq. 11."""
        with np.errstate(divide="ignore"):
            return 1 / self.sigma_tr

    @property
    def sigma_s(self) -> Array:
        """Scattering coefficient [1/mm]: ``(3,) float``. JB02 eq. 4."""
        return self.sigma_s_prime / (1 - self.g)

    @property
    def sigma_t(self) -> Array:
        """Extinction coefficient [1/mm]: ``(3,) float``."""
        return self.sigma_s + self.sigma_a

    @property
    def albedo(self) -> Array:
        """Scattering albedo ``sigma_s / sigma_t``: ``(3,) float``."""
        return self.sigma_s / self.sigma_t

    @property
    def z_r(self) -> Array:
        """Depth of the real source [mm]: ``(3,) float``. JB02, text after eq. 9."""
        return self.mfp

    @property
    def z_v(self) -> Array:
        """Height of the virtual source [mm]: ``(3,) float``. JB02, text after eq. 9."""
        return self.mfp * (1 + 4 / 3 * boundary_mismatch(self.eta))

    @property
    def total_diffuse_reflectance(self) -> Array:
        """Fraction of the *entering* flux that a half space sends back: ``(3,) float``. JB02 eq. 15 of the dipole."""
        return np.array([self.flat_profile.total(s, self.g, self.eta) for s in self.s])

    def diffuse_reflectance(self, r: ArrayLike) -> Array:
        """Spread one unit of entering flux over the surface.

        Parameters
        ----------
        r : (...) float
            Distance from where the light enters [mm].

        Returns
        -------
        (..., 3) float
            Exitance per unit of entering flux [1/mm^2]; over the plane it integrates to `total_diffuse_reflectance`.

        Source
        ------
        JB02 eqs. 8 to 10 of the dipole.
        """
        return self.sigma_t_prime**2 * self._by_distance(self.flat_profile.density, r)

    def curve(self, r: ArrayLike) -> Array:
        """Evaluate beta, by which a curved surface changes the profile: ``R_d(r) exp(beta mu)`` with mu the cosine between the normal
        where light leaves and the way there from where it enters.

        Parameters
        ----------
        r : (...) float
            Distance from where the light enters [mm].

        Returns
        -------
        (..., 3) float
            Zero everywhere for the dipole.
        """
        return self._by_distance(self.flat_profile.curve, r)

    def _by_distance(self, function: Callable[[Array, float, float, float], Array], r: ArrayLike) -> Array:
        """Evaluate a function of `FlatProfile` of the distances ``r (...)`` [mm] in all channels: ``(..., 3) float``."""
        r = np.asarray(r, dtype=np.float64)
        channels = zip(self.sigma_t_prime, self.s, strict=True)
        return np.stack([function(r * t, s, self.g, self.eta) for t, s in channels], axis=-1)

    def thin(self, own: ArrayLike, white: ArrayLike) -> Array:
        """Evaluate what the light that enters is multiplied by where the profile, summed over the body itself, is not what it should be.

        Parameters
        ----------
        own : (..., 3) float
            The sum of the curved profile: the total reflectance where the body is flat and thick, more where it is thin.
        white : (..., 3) float
            The sum without absorption, which should be 1.

        Returns
        -------
        (..., 3) float
            1 everywhere for the dipole.
        """
        own, white = np.asarray(own, np.float64) / self.total_diffuse_reflectance, np.asarray(white, np.float64)
        channels = [self.flat_profile.thin(own[..., k], white[..., k], s, self.eta) for k, s in enumerate(self.s)]
        return np.stack(channels, axis=-1)
