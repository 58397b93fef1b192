"""One translucent body from frame to frame: its light, the samples drawn from it, and the exitance that they cause."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.gather import gather_samples
from ..gather.source import Source, device_source, with_samples
from ..kernels.sequences import hammersley_set
from ..methods.preparation import LitBody, outside, textured
from ..methods.texture_space.discs import DiscTables, disc_radius
from ..methods.texture_space.hybrid import NearLight
from ..methods.texture_space.pyramid import build_pyramid, warp_points
from ..model.decomposition import Decomposition
from ..model.fresnel import external_diffuse_transmittance, fresnel_dielectric
from ..model.medium import Medium
from ..model.profiles import ProfileTable
from ..scene.atlas.layout import build_atlas
from ..scene.atlas.texels import rasterise
from ..scene.bodies import Body, Lookup, translucent_bsdf
from .irradiance_image import IrradianceImage
from .lights import Lamp
from .source import Settings

LARGEST_DISC = 0.25
"""Radius of the largest disc over which the light of a sample enters, as a share of the extent of the body."""

LEAVE_STEPS = 256
"""Steps of the table of ``F_t(omega_out) / (pi T_d)`` over the cosine; between them it is a straight line."""


class LiveBody:
    """A body of the scene with its irradiance image and its samples.

    Attributes
    ----------
    area, extent : float
        Surface [scene units squared] and longest side [scene units].
    image : IrradianceImage
    p : Point3f
        Where the samples drawn are.
    near : NearLight
        The local part, for the hybrid method.
    flux : Float
        E'avg: the luminance of all light that enters [W].
    """

    def __init__(self, body: Body, number: int, lookup: Lookup, resolution: int):
        self.body = body
        atlas = build_atlas(body, resolution)
        texels = rasterise(atlas)
        self.notes = atlas.notes
        self.area, self.extent = atlas.surface.area, atlas.surface.extent
        lit: LitBody[None] = LitBody(body, texels.samples)
        colour = textured(lit)
        if colour is not None:
            colour = colour * body.medium.total_diffuse_reflectance
        self.image = IrradianceImage(texels, outside(texels.samples), colour)
        self.p, self.flux = mi.Point3f(), mi.Float(0)
        self.near = NearLight(body, number, lookup, texels.samples.p)
        self.pyramid: Any = None
        self.surface = build_pyramid(self.image.over_square(self.image.area), self.image.resolution)
        self.source: Source
        self.discs: DiscTables
        self.far: Source
        self.far_split: tuple[Medium, Decomposition] | None = None
        self.divided, self.has_rest = False, True
        self.tabulated: Medium | None = None
        self.refresh()

    # ------------------------------------------------------------------ the medium

    def set_medium(self, medium: Medium, scale: float) -> None:
        """Change the medium [1/mm] and the size of a scene unit [mm] in the scene; `refresh` is to follow."""
        for part in self.body.parts:
            bsdf: Any = translucent_bsdf(part.shape)
            bsdf.set_medium(medium, scale)

    def refresh(self) -> None:
        """Tabulate the medium of the body as it is now in the scene, unless it is the same as before; `draw` is to follow."""
        medium = self.body.medium
        if medium == self.tabulated:
            return
        if self.tabulated is not None and medium.eta != self.tabulated.eta:
            self.image.forget()
        self.tabulated = medium
        self.eta = dr.opaque(mi.Float, medium.eta)
        self.image.set_reflectance(medium.total_diffuse_reflectance)
        self.discs = DiscTables.from_medium(medium, LARGEST_DISC * self.extent)
        self.source = device_source(mi.Point3f(), mi.Color3f(), self.discs.table)

    @property
    def medium(self) -> Medium:
        """The medium per millimetre."""
        return self.body.medium.scaled(1 / self.body.bsdf.scale)

    def leave_table(self) -> np.ndarray:
        """Tabulate ``F_t / (pi T_d)`` over the cosine between the normal and the eye: ``(LEAVE_STEPS + 1,) float32``.

        Source: CLHHC08 section 3 (the table) and eq. 11, with T_d as in JB02 eq. 14.
        """
        eta = self.body.medium.eta
        cosine = dr.linspace(mi.Float, 1e-6, 1, LEAVE_STEPS + 1)
        transmittance = 1 - np.asarray(fresnel_dielectric(cosine, dr.opaque(mi.Float, eta)).numpy())
        return (transmittance / (np.pi * external_diffuse_transmittance(eta))).astype(np.float32)

    # ------------------------------------------------------------------ light, samples, exitance

    def pour(self, lamps: list[Lamp], gi: bool) -> None:
        """Sum up the light of all lamps level by level. Source: CLHHC08 section 3, figure 2b."""
        self.pyramid = None
        self.pyramid = build_pyramid(self.image.image(lamps, gi), self.image.resolution)
        self.flux = self.pyramid.total

    def draw(self, lamps: list[Lamp], settings: Settings, turn: int) -> None:
        """Draw surface samples in proportion to the light that enters; each stands for ``E'avg / N`` of it.

        Of its own colour: drawn by luminance, its power is its texel's times total over N times luminance. In the hybrid
        method the light of lamps that have a translucent shadow map is kept apart, for it goes by R_g alone. What goes by
        R_d enters over discs, unless points are asked for. ``turn`` counts the passes of a picture at rest.

        Source: CLHHC08 eqs. 9 and 10, section 4.
        """
        count, gi = settings.samples, settings.gi
        texel, value = warp_points(self.pyramid, *hammersley_set(mi.Float, count, turn))
        row = dr.gather(mi.UInt32, self.image.row, texel)
        share = dr.select(value > 0, self.flux / (dr.maximum(value, 1e-30) * dr.opaque(mi.Float, count)), 0)
        self.p = dr.gather(mi.Point3f, self.image.p, row)
        dr.eval(self.p, row, share)
        mapped = self.near.mapped if settings.method == "hybrid" else [False] * len(lamps)
        self.divided = any(mapped)
        self.has_rest = not all(mapped) or (gi and self.image.indirect.passes > 0)
        if self.divided:
            self._draw_far(self.image.power(lamps, False, row, mapped) * share)
        if self.has_rest:
            power = self.image.power(lamps, gi, row, [not near for near in mapped]) * share
            dr.eval(power)
            radius = mi.Float(disc_radius(self.pyramid, self.surface, texel, count))
            radius *= dr.opaque(mi.Float, 0.0 if settings.point_samples else 1.0)
            self.source = with_samples(self.source, self.p, power, self.discs.first(radius))

    def _draw_far(self, power: mi.Color3f) -> None:
        """Give the samples drawn the power that goes by R_g."""
        medium, split = self.body.medium, self.near.split
        dr.eval(power)
        if (medium, split) == self.far_split:
            self.far = with_samples(self.far, self.p, power)
        else:
            self.far = device_source(self.p, power, ProfileTable.from_medium(medium, weight=split.global_weight))
            self.far_split = medium, split

    def exitance(self, p: mi.Point3f) -> mi.Color3f:
        """Sum the exitance at points over the samples, in the hybrid method together with the local part.

        Source: CLHHC08 eq. 10, section 4.
        """
        if not self.divided:
            return mi.Color3f(gather_samples(self.source, p))
        # In memory after each sum: whatever reads it is the same kernel, with or without the rest.
        total = self.near.exitance(p) + mi.Color3f(gather_samples(self.far, p))
        dr.eval(total)
        if self.has_rest:
            total += mi.Color3f(gather_samples(self.source, p))
            dr.eval(total)
        return total
