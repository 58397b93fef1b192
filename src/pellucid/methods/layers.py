"""What belongs to a picture beside its radiance: layers, as means over the area of each pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from . import aovs
from .denoising import Image, can_denoise, denoise
from .tiles import Region

NAMES = ("albedo", "normal", "depth", "exitance")
"""The channels of `aovs` that are kept for every pixel."""


@dataclass
class Layers:
    """Means over the samples of each pixel: no filter of a film has mixed neighbours.

    Attributes
    ----------
    colour : (h, w, 3) float32
        Radiance.
    albedo, normal : (h, w, 3) float32
        Diffuse reflectance and shading normal of what is seen first.
    depth : (h, w, 1) float32
        Distance from the camera [scene units]; what has none counts as 0.
    exitance : (h, w, 3) float32
        Exitance of translucent bodies.
    """

    colour: Image
    albedo: Image
    normal: Image
    depth: Image
    exitance: Image

    @cached_property
    def denoised(self) -> Image:
        """Take the noise out of the radiance: ``(h, w, 3) float32``. Where there is no denoiser, a warning says so."""
        return self.colour if not can_denoise() else denoise(self.colour, self.albedo, self.normal)

    def channels(self) -> dict[str, Image]:
        """List the numbers of the denoised picture and of all layers but the radiance: ``denoised.R`` and so on, ``(h, w)`` each."""
        names = aovs.channel_names(NAMES)
        images = [self.denoised, *(getattr(self, name) for name in NAMES)]
        return dict(
            zip(
                [f"denoised.{c}" for c in "RGB"] + names,
                np.concatenate(images, axis=-1).transpose(2, 0, 1),
                strict=True,
            )
        )


class LayerSums:
    """Adds up layers over the passes of a picture."""

    def __init__(self, film: mi.Film, region: Region):
        """Make room for the pixels of a region, of which those of a film are kept."""
        self._size, self._region = [int(n) for n in film.crop_size()], region
        self._names = ["colour.R", "colour.G", "colour.B", *aovs.channel_names(NAMES)]
        self._total: NDArray[np.float64] = np.zeros((region.pixels, len(self._names)))
        self._samples = 0

    def add(self, radiance: mi.Color3f, channels: list[mi.Float], per_pixel: int) -> None:
        """Add samples: so many consecutive ones to each pixel, row by row."""
        dr.eval(radiance, channels)  # together: each sum by itself would look again
        sums: list[Any] = [dr.block_sum(value, per_pixel) for value in (*radiance, *channels)]
        dr.eval(sums)
        self._total += np.stack([value.numpy() for value in sums], axis=1)
        self._samples += per_pixel

    def means(self) -> Layers:
        """Divide by the number of samples, and leave out the pixels around the film."""
        (width, height), (x, y) = self._size, self._region.inner
        means = (self._total / max(self._samples, 1)).astype(np.float32)
        image = means.reshape(self._region.height, self._region.width, -1)[y : y + height, x : x + width]
        fields = [name.partition(".")[0] for name in self._names]
        return Layers(**{name: image[..., [f == name for f in fields]] for name in dict.fromkeys(fields)})
