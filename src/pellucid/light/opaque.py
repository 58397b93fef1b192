"""The diffuse lobes of opaque surfaces: what point lights may light in place of paths."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..model.fresnel import external_diffuse_transmittance, transmitted

INDICES = (1.0, 1.5)
"""What covers a diffuse base: nothing, so that it obeys Lambert's law; or a smooth coat of this index, which reflects grazing light. What
another coat would make of it is left to paths."""

OBLIQUE = 0.4
"""Cosine of the second direction in which a lobe is looked at."""

COATED, LAMBERTIAN = 0.96, 1e-3
"""A lobe that gives less than this share of its value along the normal is taken for a coated one; how exactly one obeys Lambert's law."""

MEAN_TRANSMITTED, LEAST_TRANSMITTED = external_diffuse_transmittance(INDICES[1]), 1e-3
"""What the coat transmits of diffuse light, and at least from one direction."""


@dataclass
class DiffuseLobe:
    """A diffuse lobe as far as point lights light it, one a lane: ``f = reflectance T(omega_in) / pi``, T the transmittance of the coat.

    Attributes
    ----------
    there : Bool
        Whether there is one.
    whole : Bool
        Whether the material has nothing else.
    reflectance : Color3f
    index : UInt32
        The coat, among `INDICES`.
    """

    there: mi.Bool
    whole: mi.Bool
    reflectance: mi.Color3f
    index: mi.UInt32

    def eval(self, wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Color3f:
        """Evaluate the lobe times the cosine."""
        cosine = dr.abs(wo.z)
        value = self.reflectance * (transmitted(cosine, _coat(self.index)) * cosine * dr.inv_pi)
        return dr.select(self.there & (wi.z * wo.z > 0), value, 0)

    def weight(self, wi: mi.Vector3f, sample: mi.BSDFSample3f, weight: mi.Color3f) -> mi.Color3f:
        """Tell what part of the weight of a sample of the material belongs to the lobe."""
        smooth = (sample.pdf > 0) & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        return dr.select(self.whole, weight, dr.select(smooth, self.eval(wi, sample.wo) / sample.pdf, 0))

    def sent(self, wi: mi.Vector3f) -> mi.Float:
        """Tell how many times the lobe virtual lights send towards ``wi``: as much as it into all directions, but evenly."""
        towards = dr.maximum(transmitted(dr.abs(wi.z), _coat(self.index)), LEAST_TRANSMITTED)
        return dr.select(self.index == 0, 1, MEAN_TRANSMITTED / towards)


def fit_lobe(si: mi.SurfaceInteraction3f, active: mi.Bool) -> DiffuseLobe:
    """Describe the diffuse lobes of materials by what they give along the normal and aslant.

    What a material gives besides, and what another lobe would, is for paths: they carry the difference.
    """
    bsdf, ctx, flags = si.bsdf(), mi.BSDFContext(), mi.BSDFFlags
    ctx.type_mask = flags.DiffuseReflection
    active = active & mi.has_flag(bsdf.flags(), flags.DiffuseReflection)
    side = dr.sign(si.wi.z)
    facing = bsdf.eval(ctx, si, mi.Vector3f(0, 0, side), active)
    sine = (1 - OBLIQUE**2) ** 0.5
    oblique = bsdf.eval(ctx, si, mi.Vector3f(sine, 0, side * OBLIQUE), active) / OBLIQUE
    index = dr.select(dr.sum(oblique) < COATED * dr.sum(facing), mi.UInt32(1), mi.UInt32(0))
    others = flags.Glossy | flags.Delta | flags.Delta1D | flags.DiffuseTransmission
    alone = (bsdf.flags() & mi.UInt32(int(others))) == 0
    there = active & (dr.max(facing) > 0)
    whole = there & alone & dr.all(dr.abs(oblique - facing) <= LAMBERTIAN * facing)
    return DiffuseLobe(there, whole, facing * (dr.pi / transmitted(1, _coat(index))), index)


def _coat(index: mi.UInt32) -> mi.Float:
    """Give the index of refraction of a coat."""
    return dr.select(index == 0, mi.Float(INDICES[0]), mi.Float(INDICES[1]))
