"""The one interface between whoever shows frames and whatever makes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.decomposition import IMPORTANCE_BOUND
from ..model.medium import Medium

METHODS = ("texture_space", "hybrid", "image_space")


@dataclass
class Camera:
    """A perspective camera: where it stands, what it looks at, which way is up, and its vertical angle of view [degrees]."""

    origin: ArrayLike
    target: ArrayLike
    up: ArrayLike = (0.0, 1.0, 0.0)
    fov: float = 40.0


@dataclass
class Settings:
    """How frames are made; every field may change between any two of them.

    Attributes
    ----------
    samples : int
        Surface samples N, drawn anew for each frame and shared by all its points (CLHHC08 eq. 11).
    point_samples : bool
        Let the light of a sample enter at a point, as in the paper, instead of over a disc around it.
    method : str
        One of `METHODS`: the sum over samples in texture space, that sum with the local part from a translucent shadow
        map (CLHHC08 section 4), or the image-space baseline of MKBVR03.
    exposure : float
        Stops by which the picture is brightened before tone mapping.
    interpolated : bool
        While something moves, sum the exitance at every fourth pixel of every fourth row, and interpolate.
    denoised : bool
        Take the noise out of the settled picture.
    gi : bool
        While nothing moves, path-trace the light that reaches the bodies by way of other surfaces.
    specular : float
        Factor on the highlight; 0 removes it.
    shininess : float
        Exponent of the highlight (Phong).
    importance_bound : float
        Bound c on ``2 pi r R_d(r)`` [1/mm] that divides local from global light (CLHHC08 section 4.1).
    rings, per_ring : int
        Circular filter of the local part: ``rings * per_ring + 1`` places around a point (CLHHC08 section 4.2).
    timed : bool
        Wait for the end of each stage, so that `Frame.seconds` tells them apart; without it frames are a little faster.
    """

    samples: int = 900
    point_samples: bool = False
    method: str = "texture_space"
    exposure: float = 0.0
    interpolated: bool = True
    denoised: bool = True
    gi: bool = True
    specular: float = 0.5
    shininess: float = 60.0
    importance_bound: float = IMPORTANCE_BOUND
    rings: int = 20
    per_ring: int = 20
    timed: bool = False


@dataclass
class Light:
    """An emitter of the scene, as a panel shows it.

    Attributes
    ----------
    kind : str
        'point', 'spot', 'directional', 'area' or 'environment'.
    position : (3,) float or None
        Where it stands [scene units]; None for what is infinitely far away.
    direction : (3,) float or None
        Unit vector along which it shines; None for lights that shine all around.
    colour : (3,) float
        RGB, the largest of the three is 1.
    intensity : float
        Factor on the colour, in the unit of the emitter (W/sr, W/m^2 or radiance; 1 is an environment as it was loaded).
    """

    name: str
    kind: str
    position: NDArray[np.float64] | None
    direction: NDArray[np.float64] | None
    colour: NDArray[np.float64]
    intensity: float


@dataclass
class BodyState:
    """A translucent body, as a panel shows it: its medium [1/mm], and its largest extent [mm]."""

    name: str
    medium: Medium
    size_mm: float


@dataclass
class Frame:
    """A picture for the screen, and what it cost.

    Attributes
    ----------
    pixels : (h, w, 3) uint8
        sRGB.
    seconds : dict
        Time by stage [s]: irradiance, pyramid, samples, gbuffer, integration, shading (those that the frame went through
        and only with `Settings.timed`), and whole.
    samples : (k, 3) float32
        Positions of the surface samples that were drawn, of all bodies [scene units].
    still : bool
        The picture has settled: as long as nothing changes, asking again gives the same one.
    """

    pixels: NDArray[np.uint8]
    seconds: dict[str, float] = field(default_factory=dict)
    samples: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    still: bool = False


class FrameSource(Protocol):
    """Makes frames of one scene. Edits go into the scene itself, so that any integrator renders the same picture of it."""

    scene: mi.Scene
    settings: Settings

    @property
    def lights(self) -> list[Light]:
        """List the emitters of the scene as they are now."""

    @property
    def bodies(self) -> list[BodyState]:
        """List the translucent bodies of the scene as they are now."""

    def set_light(self, index: int, **changes: Any) -> None:
        """Change ``position``, ``direction``, ``colour`` or ``intensity`` of a light; the rest stays.

        Raises
        ------
        PellucidError
            For a light that is not there, and for what its kind does not have.
        """

    def set_medium(self, index: int, medium: Medium) -> None:
        """Give a body another medium [1/mm]; its size stays."""

    def set_size(self, millimetres: float) -> None:
        """Let the largest extent of all bodies together be so many millimetres: changes ``scale``, no geometry."""

    def frame(self, camera: Camera, resolution: tuple[int, int], moving: bool) -> Frame:
        """Make one frame, ``resolution`` = (width, height); ``moving`` promises that another one follows at once."""

    def linear(self, camera: Camera, resolution: tuple[int, int]) -> NDArray[np.float32]:
        """Make the settled picture before tone mapping and without highlight, for comparisons: ``(h, w, 3) float32``."""

    def half(self) -> float:
        """Find the radiance that tone mapping shows as one half, in the light of the last picture."""
