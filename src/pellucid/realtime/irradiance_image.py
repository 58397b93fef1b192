"""The irradiance image E' of one body: the light that enters through each texel of its atlas, kept apart by light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import columns, opaque, upload
from ..kernels.sequences import r2_points
from ..light.direct import irradiance_from, receivers
from ..light.entering import entering_as_mapped
from ..light.irradiance import path_radiance
from ..light.transport import Limits, Start
from ..methods.texture_space.drawing import CoveredTexels
from ..model.fresnel import transmitted
from ..scene.atlas.texels import Texels
from .lights import Lamp

BLOCK = 4
"""Texels along each side of a block; indirect light, which changes slowly, is measured at one texel of each block a pass."""

LIGHT_PASSES = 16
"""Samples of each texel for a light with an extent, and of each block for indirect light, when nothing moves any more."""

FLAT = 1e-3
"""Facets whose shading normals differ by less from their own stand for nothing else."""

INDIRECT_LIMITS = Limits(max_depth=6, rr_depth=2)


@dataclass
class Layer:
    """What one light brings in through each texel.

    Attributes
    ----------
    flux : Float or Color3f of n lanes
        Per unit of the spectrum of the light; a Float where one colour serves for all directions.
    passes : int
        Samples a texel that the flux is the mean of; 0 where it is out of date.
    mapped : Float or Color3f of n lanes, or None
        The part of the flux that a translucent shadow map finds; None until it is asked for. It is all where facets stand for nothing else.
    """

    flux: Any
    passes: int = 0
    mapped: Any = None


class IrradianceImage:
    """The light on the texels of one body, by light; everything stays on the device. ``version`` counts measurements.

    Parameters
    ----------
    texels : Texels
        The n covered texels.
    texture : (n, 3) float or None
        Reflectance, where a texture says it: entering light is multiplied by it and divided by that of the medium.
    """

    def __init__(self, texels: Texels, texture: np.ndarray | None):
        samples = texels.samples
        self.count, self.texels = len(samples), CoveredTexels(texels)
        self.start = mi.Point3f(*columns(samples.ray_start()))
        self.n = mi.Normal3f(*columns(samples.outside * samples.sh_n))
        self.facet = mi.Normal3f(*columns(samples.outside * samples.n))
        self.is_smooth = bool(np.abs(samples.sh_n - samples.n).max() > FLAT)
        """Whether the surface is another one than its facets."""
        self.texture = None if texture is None else mi.Color3f(*columns(texture))
        self.reflectance = mi.Color3f(1)
        self.layers: list[Layer] = []
        self.indirect = _Blocks(*np.divmod(texels.texel, np.uint32(texels.resolution)))
        self.version = 0

    def set_reflectance(self, reflectance: np.ndarray) -> None:
        """Say what the medium reflects, ``(3,) float``: with a texture, its mean."""
        self.reflectance = opaque(mi.Color3f, reflectance)

    def forget(self, lamp: int | None = None) -> None:
        """Mark the light of one lamp as out of date, or of all; indirect light comes from all of them."""
        for k, layer in enumerate(self.layers):
            if lamp is None or k == lamp:
                layer.passes, layer.mapped = 0, None
        self.indirect.forget()

    def update(self, scene: mi.Scene, lamps: list[Lamp], eta: Any) -> None:
        """Measure the light that is out of date; of every light with an extent take one more sample, until it has enough."""
        while len(self.layers) < len(lamps):
            kind = mi.Float if lamps[len(self.layers)].uniform else mi.Color3f
            self.layers.append(Layer(dr.opaque(kind, 0, self.count)))
        for layer, lamp in zip(self.layers, lamps, strict=True):
            if lamp.is_on and layer.passes < (1 if lamp.is_delta else LIGHT_PASSES):
                fresh = self._measure(scene, lamp, eta, layer.passes)
                share = dr.opaque(mi.Float, 1 / (layer.passes + 1))
                layer.flux = fresh if lamp.is_delta else dr.fma(fresh - layer.flux, share, layer.flux)
                layer.passes += 1
                self.version += 1
                dr.eval(layer.flux)

    def divide(self, scene: mi.Scene, lamps: list[Lamp], eta: Any, mapped: list[bool]) -> None:
        """Measure how much of the light of lamps that have a shadow map these find, where that is out of date."""
        for layer, lamp, has_map in zip(self.layers, lamps, mapped, strict=True):
            if has_map and lamp.is_on and layer.mapped is None:
                layer.mapped = layer.flux
                if self.is_smooth:
                    si = receivers(self.texels.p, self.facet, self.n)
                    layer.mapped = self._flux(lamp, entering_as_mapped(scene, lamp.emitter, si, eta))
                dr.eval(layer.mapped)

    def is_settled(self, lamps: list[Lamp], gi: bool) -> bool:
        """Tell whether more passes would change nothing."""
        lights = zip(self.layers, lamps, strict=True)
        direct = all(not lamp.is_on or layer.passes >= (1 if lamp.is_delta else LIGHT_PASSES) for layer, lamp in lights)
        return direct and (not gi or self.indirect.passes >= LIGHT_PASSES)

    def _measure(self, scene: mi.Scene, lamp: Lamp, eta: Any, number: int) -> Any:
        """Sample one light once at each texel: flux that enters per unit of its spectrum."""
        si = receivers(self.start, self.n)
        entering = irradiance_from(scene, lamp.emitter, si, eta, r2_points(self.texels.texel, number))[1]
        return self._flux(lamp, entering)

    def _flux(self, lamp: Lamp, entering: mi.Color3f) -> Any:
        """Turn entering irradiance into flux per unit of the spectrum of a lamp."""
        entering = entering * self.texels.area
        if lamp.uniform:
            return dr.dot(entering, lamp.spectrum) / dr.squared_norm(lamp.spectrum)
        return entering / dr.max(lamp.spectrum)

    def measure_indirect(self, scene: mi.Scene, eta: Any, sampler: mi.Sampler) -> None:
        """Trace one path from each block: light that arrives by way of other surfaces."""
        if self.indirect.passes < LIGHT_PASSES:
            self.indirect.measure(scene, self, eta, sampler)
            self.version += 1

    def power(self, lamps: list[Lamp], gi: bool, rows: Any = None, mapped: list[bool] | None = None) -> mi.Color3f:
        """Sum the light that enters through texels [W], all or those numbered ``rows``; without what the shadow maps of lamps find, if
        it is said which have been ``mapped``."""

        def take(values: Any) -> Any:
            return values if rows is None else dr.gather(type(values), values, rows)

        total = mi.Color3f(0)
        for layer, lamp in zip(self.layers, lamps, strict=True):
            total += lamp.spectrum * take(layer.flux)
        if mapped is not None:
            total -= self._mapped_power(lamps, take, mapped)
        if gi and self.indirect.passes > 0:
            total += self.indirect.look_up(take(self.indirect.block)) * take(self.texels.area)
        return total if self.texture is None else total * take(self.texture) / self.reflectance

    def mapped_power(self, lamps: list[Lamp], rows: Any, mapped: list[bool]) -> mi.Color3f:
        """Sum the light that the shadow maps of lamps find, through texels numbered ``rows`` [W]."""
        total = self._mapped_power(lamps, lambda values: dr.gather(type(values), values, rows), mapped)
        return total if self.texture is None else total * dr.gather(mi.Color3f, self.texture, rows) / self.reflectance

    def _mapped_power(self, lamps: list[Lamp], take: Callable[[Any], Any], mapped: list[bool]) -> mi.Color3f:
        """Sum the same without the texture."""
        total = mi.Color3f(0)
        for layer, lamp, has_map in zip(self.layers, lamps, mapped, strict=True):
            found = layer.flux if layer.mapped is None else layer.mapped
            share = dr.opaque(mi.Float, float(has_map))  # one kernel for any choice
            total += lamp.spectrum * (take(found) * share)
        return total


class _Blocks:
    """Indirect light, one number a block of texels."""

    def __init__(self, row: np.ndarray, column: np.ndarray):
        key = (row // BLOCK).astype(np.int64) << 32 | column // BLOCK
        _, block, counts = np.unique(key, return_inverse=True, return_counts=True)
        self.count = len(counts)
        self.block = upload(block.astype(np.uint32))
        self.members = upload(np.argsort(block, kind="stable").astype(np.uint32))
        self.first = upload((np.cumsum(counts) - counts).astype(np.uint32))
        self.size = upload(counts.astype(np.uint32))
        self.total = dr.opaque(mi.Color3f, 0, self.count)
        self.passes = 0

    def forget(self) -> None:
        """Start again."""
        if self.passes:
            self.total, self.passes = dr.opaque(mi.Color3f, 0, self.count), 0

    def measure(self, scene: mi.Scene, image: IrradianceImage, eta: Any, sampler: mi.Sampler) -> None:
        """Add one path from a texel of each block, another one in each pass; emitters that it hits at once are left out."""
        sampler.seed(dr.opaque(mi.UInt32, self.passes), self.count)
        pick = mi.UInt32(sampler.next_1d() * mi.Float(self.size))
        member = dr.gather(mi.UInt32, self.members, self.first + dr.minimum(pick, self.size - 1))
        si = receivers(dr.gather(mi.Point3f, image.start, member), dr.gather(mi.Normal3f, image.n, member))
        wo = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        # A path of density zero finds no emitter: those that it could find are sampled by themselves.
        start = Start.surface(si, wo, dr.zeros(mi.Float, self.count))
        radiance = path_radiance(scene, sampler, start, INDIRECT_LIMITS, None)
        self.total += radiance * transmitted(wo.z, eta) * np.pi
        self.passes += 1
        dr.eval(self.total)

    def look_up(self, block: mi.UInt32) -> mi.Color3f:
        """Evaluate the irradiance that enters in blocks."""
        return dr.gather(mi.Color3f, self.total, block) * dr.opaque(mi.Float, 1 / max(self.passes, 1))
