"""Taking the noise out of a finished picture, by Open Image Denoise."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray

from ..errors import warn

Image = NDArray[np.float32]

MODULE = "mitsuba_oidn"


def can_denoise() -> bool:
    """Tell whether the denoiser is installed; where it is not, warn that the picture stays as it is."""
    if importlib.util.find_spec(MODULE) is not None:
        return True
    warn("The picture keeps its noise: there is no denoiser (mitsuba-oidn) for this platform, or it is not installed.")
    return False


def denoise(colour: Image, albedo: Image | None = None, normal: Image | None = None) -> Image:
    """Take the noise out of a linear picture.

    Parameters
    ----------
    colour : (h, w, 3) float32
        Radiance, each pixel the mean of samples of its own: noise that a wider filter has spread over neighbours passes for detail.
    albedo, normal : (h, w, 3) float32, optional
        Reflectance in [0, 1] and shading normals of what is seen: where they change, the picture may.

    Returns
    -------
    (h, w, 3) float32

    Source
    ------
    A. T. Afra, *Intel Open Image Denoise*, 2019-2025.
    """
    from mitsuba_oidn import Quality
    from mitsuba_oidn import denoise as filtered

    images = {"color": colour} if albedo is None else {"color": colour, "albedo": albedo, "normal": normal}
    images = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
    # Balanced leaves a twelfth more error than the best quality, in less than half the time.
    return np.array(filtered(**images, hdr=True, clean_aux=albedo is not None, quality=Quality.Balanced))
