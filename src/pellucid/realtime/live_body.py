"""One translucent body from frame to frame: its light, the samples drawn from it, and the exitance that they cause."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..methods.preparation import LitBody, textured
from ..methods.texture_space.drawing import BodySum, SampleSum, draw_samples
from ..methods.texture_space.hybrid import NearLight
from ..methods.thin import warn_of_thin_parts
from ..model.decomposition import Decomposition
from ..model.fresnel import external_diffuse_transmittance, fresnel_dielectric
from ..model.medium import Medium
from ..scene.atlas.layout import build_atlas
from ..scene.atlas.texels import rasterise
from ..scene.bodies import Body, Lookup, translucent_bsdf
from .irradiance_image import IrradianceImage
from .lights import Lamp
from .source import Settings

LEAVE_STEPS = 256
"""Steps of the table of ``F_t(omega_out) / (pi T_d)`` over the cosine; between them it is a straight line."""


class LiveBody:
    """A body of the scene with its irradiance image and its samples.

    Attributes
    ----------
    area, extent : float
        Surface [scene units squared] and longest side [scene units].
    spacing : float
        Side of a texel of the mean area [scene units].
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
        self.spacing = texels.samples.spacing
        lit: LitBody[None] = LitBody(body, texels.samples)
        colour = textured(lit)
        if colour is not None:
            colour = colour * body.medium.total_diffuse_reflectance
        self.image = IrradianceImage(texels, colour)
        self.p, self.flux = mi.Point3f(), mi.Float(0)
        self.near = NearLight(body, number, lookup, texels.samples.p)
        self.bright: Any = None
        self.summed: BodySum
        self.all: SampleSum
        self.far: SampleSum
        self.far_split: tuple[Medium, Decomposition] | None = None
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
        warn_of_thin_parts(self.body, "The real-time engine")
        self.eta = dr.opaque(mi.Float, medium.eta)
        self.image.set_reflectance(medium.total_diffuse_reflectance)
        self.all = SampleSum.of(medium, self.extent)

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

    def update_light(self, lamps: list[Lamp], gi: bool) -> None:
        """Sum up the light of all lamps level by level. Source: CLHHC08 section 3, figure 2b."""
        self.bright = None  # its memory serves the next
        self.bright = self.image.texels.sum_up(mi.luminance(self.image.power(lamps, gi)))
        self.flux = self.bright.total

    def draw(self, lamps: list[Lamp], settings: Settings, turn: int) -> None:
        """Draw surface samples for the light of now; ``turn`` counts the passes of a picture at rest.

        In the hybrid method the light of lamps that their translucent shadow maps find is kept apart, for it goes by R_g alone.

        Source: CLHHC08 eqs. 9 and 10, section 4.
        """
        gi, image = settings.gi, self.image
        drawn = draw_samples(image.texels, self.bright, settings.samples, turn, point_samples=settings.point_samples)
        self.p = drawn.p
        mapped = self.near.mapped if settings.method == "hybrid" else [False] * len(lamps)
        self.summed = BodySum(None)
        if not all(mapped) or (gi and image.indirect.passes > 0) or image.is_smooth:
            power = image.power(lamps, gi, drawn.index, mapped) * drawn.share
            self.all = self.all.hold(drawn, power)
            self.summed.rest = self.all
        if any(mapped):
            self._tabulate_far()
            self.far = self.far.hold(drawn, image.mapped_power(lamps, drawn.index, mapped) * drawn.share)
            self.summed.far, self.summed.near = self.far, self.near

    def _tabulate_far(self) -> None:
        """Tabulate R_g of the medium as it is divided now, unless it is the same as before."""
        medium, split = self.body.medium, self.near.split
        if (medium, split) != self.far_split:
            self.far = SampleSum.of_far_part(medium, self.extent, split.global_weight)
            self.far_split = medium, split

    def exitance(self, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        """Sum the exitance at points over the samples, in the hybrid method together with the local part; normals point outside."""
        return self.summed.exitance(p, n)
