"""Media from photographs: what a fit is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, overload

import mitsuba as mi

from ..errors import PellucidError
from .medium_fit import OF_PARAMETERS, fit_medium
from .result import Fit, TextureFit
from .texture_fit import fit_texture
from .views import Views

EXPOSURES = ("known", "free", "shared")
TEXTURE = "texture"
PARAMETERS = (*OF_PARAMETERS, TEXTURE)


@overload
def fit(
    scene: mi.Scene,
    photos: Sequence[Any],
    masks: Sequence[Any] | None = ...,
    parameters: Literal["coefficients", "reflectance"] = ...,
    exposure: str = ...,
    linearise: bool = ...,
    spp: int = ...,
    max_evaluations: int = ...,
    **settings: Any,
) -> Fit: ...


@overload
def fit(
    scene: mi.Scene,
    photos: Sequence[Any],
    masks: Sequence[Any] | None = ...,
    *,
    parameters: Literal["texture"],
    exposure: str = ...,
    linearise: bool = ...,
    spp: int = ...,
    max_evaluations: int = ...,
    **settings: Any,
) -> TextureFit: ...


def fit(
    scene: mi.Scene,
    photos: Sequence[Any],
    masks: Sequence[Any] | None = None,
    parameters: str = "coefficients",
    exposure: str = "known",
    linearise: bool = False,
    spp: int = 16,
    max_evaluations: int = 40,
    **settings: Any,
) -> Fit | TextureFit:
    """Find the translucent medium of a scene from photographs of it.

    Least squares over logarithms, from the medium that the scene has; index of refraction, g and surface are known. The standard deviation
    of a pixel is measured by how pixels differ from their neighbours, and differences beyond three of them count less (Huber).

    Parameters
    ----------
    scene : mi.Scene
        With one translucent medium, its true shape and light, and one camera for each photo.
    photos : sequence of (h, w, 3) float, or of files
        Linear radiance.
    masks : sequence of (h, w) float, or of files, optional
        What of each photo counts, besides being of the body; rims are left out.
    parameters : str
        ``coefficients``: ``sigma_a`` and ``sigma_s_prime``; ``reflectance``: that and the diffuse mean free path ``dmfp``, of which photos
        tell more; ``texture``: the bitmap of the reflectance, with the ``dmfp`` of the scene.
    exposure : str
        ``known``: photos have the radiance of the scene; ``free``: each is multiplied by an unknown number; ``shared``: all by the same.
    linearise : bool
        Take the curve of sRGB off files of 8 bits, which are refused otherwise.
    spp, settings
        Of the pictures: samples a pixel, and the parameters of ``pellucid_two_pass``.
    max_evaluations : int
        Most media that are tried.

    Raises
    ------
    PellucidError
        For photos that do not go with the cameras of the scene, for several media, and for what cannot be fitted.
    """
    for name, value, known in (("exposure", exposure, EXPOSURES), ("parameters", parameters, PARAMETERS)):
        if value not in known:
            raise PellucidError(f"{name} is one of {', '.join(known)}; found '{value}'.")
    if parameters == TEXTURE and exposure != "known":
        raise PellucidError(
            f"A texture is fitted with a known exposure, since a brighter texture looks as a longer one does; found '{exposure}'."
        )
    views = Views(scene, photos, masks, linearise, spp, settings)
    if parameters == TEXTURE:
        return fit_texture(views, max_evaluations)
    return fit_medium(views, OF_PARAMETERS[parameters], exposure, max_evaluations)
