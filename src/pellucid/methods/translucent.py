"""The material plug-in ``pellucid_translucent``: what a scene says about a translucent surface."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import MediumError, warn
from ..kernels.memory import opaque
from ..model.dipole import Dipole
from ..model.fresnel import external_diffuse_transmittance
from ..model.medium import Medium
from ..model.single_scattering import brdf as single_scattering_brdf
from ..scene.bodies import Role
from ..scene.shading import asks_for_normal, projections
from .differentiated_medium import DifferentiatedMedium, differentiate
from .material import COEFFICIENTS, REFLECTANCE, Description, ShownValues, mean_values, read_description, texture_mean


class TranslucentBSDF(mi.BSDF):
    r"""
    .. _bsdf-pellucid_translucent:

    Translucent material (:monosp:`pellucid_translucent`)
    -----------------------------------------------------

    .. pluginparameters::

     * - material
       - |string|
       - One of the measured materials, which :monosp:`pellucid materials` lists. (Default: marble)
     * - sigma_s_prime, sigma_a
       - |float| or |rgb|
       - Reduced scattering and absorption coefficients [1/mm], instead of a material.
     * - reflectance, dmfp
       - |rgb| or |texture|
       - Total diffuse reflectance and diffuse mean free path [mm], instead of a material.
     * - dmfp_scale
       - |float| or |rgb|
       - Factor on the texture of :monosp:`dmfp`. (Default: 1)
     * - eta, g
       - |float|
       - Relative index of refraction and mean cosine of the phase function. (Default: those of the material, or 1.3 and 0)
     * - scale
       - |float|
       - Millimetres to one scene unit: 10 for a scene in centimetres, 1000 in metres. (Default: 1)
     * - alpha
       - |float|
       - GGX roughness of the surface; 0 is a mirror-smooth one. (Default: 0.1)
     * - specular_reflectance
       - |float|
       - Factor on the reflection of the surface; 0 removes it. (Default: 1)
     * - profile
       - |string|
       - How light spreads from where it enters: ``tabulated`` as that of photons in a flat body, ``curved`` with what curve and
         thickness change, or by the papers' ``dipole``. (Default: tabulated)
     * - single_scattering
       - |bool|
       - Add the single-scattering lobe of Hanrahan and Krueger to the dipole, which already carries the energy of all orders,
         so this brightens the material. The tabulated profiles contain that light, and the lobe is left out. (Default: no)
     * - body
       - |string|
       - Shapes with the same name form one solid. (Default: every shape is a solid of its own)

    Light that enters a surface of this material leaves it elsewhere. Only an integrator whose name begins with
    :monosp:`pellucid_` can follow it there; to every other integrator the material is a dielectric surface over a diffuse
    base of the same total reflectance. Both sides of the surface behave alike.

    All parameters but the last three, :monosp:`g` and :monosp:`material` can be changed after
    :code:`params = mi.traverse(scene)`. However the scene describes the medium, it can be changed by its coefficients or by
    its reflectance and diffuse mean free path: the other two follow, and :monosp:`eta` leaves those alone that were given
    last. Where one of these is a texture, the coefficients follow it and cannot be changed.
    """

    def __init__(self, props):
        super().__init__(props)
        self.body = str(props.get("body", ""))
        self.single_scattering = bool(props.get("single_scattering", False))
        self.role = Role.STAND_IN
        self._shown = ShownValues()
        description, self.textures = read_description(props)
        self.texture = self.textures.reflectance
        self.widest = 1.0  # of `stretch` on all bodies
        if self.single_scattering and description.profile != Dipole.name:
            warn(
                "single_scattering is left out: tabulated profiles have that light already; it can be added to profile = 'dipole'."
            )
            self.single_scattering = False
        self._describe(description, description.medium(), float(props.get("scale", 1.0)))
        self._set_surface(float(props.get("alpha", 0.1)), float(props.get("specular_reflectance", 1.0)))

    def set_medium(self, medium: Medium, scale: float) -> None:
        """Change the medium [1/mm] and the millimetres to one scene unit, also of a scene that is being rendered.

        Textures stay. What the integrators have prepared for the medium before is out of date.
        """
        names = REFLECTANCE if self.textures.named() else COEFFICIENTS
        self._describe(Description.from_medium(medium, names), medium, scale)

    @contextmanager
    def differentiated(self) -> Iterator[DifferentiatedMedium]:
        """Act with the gradients of the parameters that are shown, for a while; give what light depends on.

        Raises
        ------
        MediumError
            For gradients that the medium does not have.
        """
        if self.textures.dmfp is not None:
            raise MediumError("No gradients flow through a body whose dmfp is a texture: give one dmfp.")
        shown = dict(self._shown.variables)
        if self.texture is not None:
            attached = any(dr.grad_enabled(value) for _, value in mi.traverse(self.texture).items())
            shown["reflectance"] = texture_mean(self.texture) if attached else mi.Color3f(0)
        medium = differentiate(self._description, self.scale, shown)
        if self.single_scattering and medium.theta():
            raise MediumError(
                "No gradients flow through single_scattering: leave it out, the tabulated profile has that light."
            )
        acting = {"_eta": medium.eta, "_t_d": medium.t_d, "_reflectance": medium.reflectance}
        acting |= {"specular": shown["specular_reflectance"]}
        before = {name: getattr(self, name) for name in acting}
        for name, value in acting.items():
            setattr(self, name, value)
        try:
            yield medium
        finally:
            for name, value in before.items():
                setattr(self, name, value)

    def _set_surface(self, alpha: float, specular: float) -> None:
        """Set the roughness of the surface, and the factor on its reflection."""
        if not 0 <= alpha <= 1:
            raise MediumError(f"alpha, the roughness of the surface, lies between 0 and 1; found {alpha:g}.")
        self.alpha, self.specular = alpha, specular
        self._distribution = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.opaque(mi.Float, max(alpha, 1e-3)))
        self._shown.show(alpha=alpha, specular_reflectance=specular)
        self.act_as(self.role)

    def _describe(self, description: Description, medium: Medium, scale: float) -> None:
        """Set the medium and its description [1/mm]."""
        self.medium = medium.scaled(scale)
        self.scale = scale
        self._description, self._medium = description, medium
        self._shown.show(**description.values(medium), scale=scale)
        reflectance = self.medium.total_diffuse_reflectance
        self._eta = dr.opaque(mi.Float, self.medium.eta)
        self._t_d = dr.opaque(mi.Float, external_diffuse_transmittance(self.medium.eta))
        self._reflectance = opaque(mi.Color3f, reflectance)
        self._mean_reflectance = dr.opaque(mi.Float, float(np.mean(reflectance)))
        if self.textures.dmfp is not None:
            self._per_dmfp = opaque(mi.Color3f, self.textures.dmfp_scale / medium.dmfp)

    def act_as(self, role: Role) -> None:
        """Choose which lobes the material has from now on."""
        self.role = role
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        reflection = mi.BSDFFlags.GlossyReflection if self.alpha > 0 else mi.BSDFFlags.DeltaReflection
        has_base = role is not Role.SURFACE or self.single_scattering
        base = mi.BSDFFlags.DiffuseReflection if has_base else mi.BSDFFlags.Empty
        if role is Role.DIFFUSE:
            reflection = mi.BSDFFlags.DiffuseReflection
        self.m_components = [reflection | sides, base | sides]
        self.m_flags = reflection | base | sides

    # ------------------------------------------------------------------ the lobes

    def _base(self, si, wi, wo):
        """Evaluate what comes from inside, without its cosine: the diffuse stand-in, and single scattering."""
        value = mi.Color3f(0)
        if self.role is Role.DIFFUSE:
            return (self.eval_diffuse_reflectance(si) * self._t_d + self.specular * (1 - self._t_d)) * dr.inv_pi
        if self.role is Role.STAND_IN:
            enter = 1 - mi.fresnel(wo.z, self._eta)[0]
            leave = 1 - mi.fresnel(wi.z, self._eta)[0]
            value += self.eval_diffuse_reflectance(si) * (enter * leave / (dr.pi * self._t_d))
        if self.single_scattering:
            value += mi.Color3f(single_scattering_brdf(self.medium, wi, wo))
        return value

    def _reflect(self, wi, wo):
        """Evaluate the rough reflection and its density: microfacets (GGX, Smith) with the exact Fresnel reflectance."""
        m = dr.normalize(wi + wo)
        fresnel = mi.fresnel(dr.dot(wi, m), self._eta)[0]
        value = (
            self.specular * fresnel * self._distribution.eval(m) * self._distribution.G(wi, wo, m) / (4 * wi.z * wo.z)
        )
        return value, self._distribution.pdf(wi, m) / (4 * dr.dot(wo, m))

    def _choice(self, wi):
        """Weigh the reflection against the base: the probability with which the reflection is sampled."""
        if self.role is Role.DIFFUSE:
            return mi.Float(0)
        fresnel = self.specular * mi.fresnel(wi.z, self._eta)[0]
        if self.role is Role.SURFACE and not self.single_scattering:
            return mi.Float(1)
        base = mi.Float(0.1 if self.single_scattering else 0)
        if self.role is Role.STAND_IN:
            base += self._mean_reflectance
        return dr.select(fresnel + base > 0, fresnel / (fresnel + base * (1 - fresnel)), 0)

    # ------------------------------------------------------------------ the interface of Mitsuba

    def eval_pdf(self, ctx, si, wo, active=True):
        """Evaluate all smooth lobes times the cosine, and the density of ``sample``."""
        wi, wo, same_side = _upright(si.wi, wo)
        active &= same_side
        choice = self._choice(wi)
        value = self._base(si, wi, wo)
        pdf = (1 - choice) * mi.warp.square_to_cosine_hemisphere_pdf(wo)
        if self.alpha > 0 and self.role is not Role.DIFFUSE:
            reflected, reflected_pdf = self._reflect(wi, wo)
            value += reflected
            pdf += choice * reflected_pdf
        return dr.select(active, value * wo.z, 0), dr.select(active, pdf, 0)

    def eval(self, ctx, si, wo, active=True):
        """Evaluate all smooth lobes times the cosine; of no lobe what leads to the shading normal (`shading.turned_normal`)."""
        if asks_for_normal(ctx):
            return projections(si.wi, wo)
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        """Evaluate the density of ``sample`` per solid angle."""
        return self.eval_pdf(ctx, si, wo, active)[1]

    def sample(self, ctx, si, sample1, sample2, active=True):
        """Choose the reflection or the base, and a direction from it."""
        side = dr.sign(si.wi.z)
        wi = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        choice = self._choice(wi)
        reflect = active & (sample1 < choice)

        bs = dr.zeros(mi.BSDFSample3f)
        bs.eta = 1.0
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        if self.alpha > 0:
            m, _ = self._distribution.sample(wi, sample2)
            bs.wo = dr.select(reflect, mi.reflect(wi, m), bs.wo)
            reflection = mi.BSDFFlags.GlossyReflection
        else:
            bs.wo = dr.select(reflect, mi.reflect(wi), bs.wo)
            reflection = mi.BSDFFlags.DeltaReflection
        bs.sampled_type = dr.select(reflect, mi.UInt32(+reflection), mi.UInt32(+mi.BSDFFlags.DiffuseReflection))
        bs.sampled_component = dr.select(reflect, mi.UInt32(0), mi.UInt32(1))
        bs.wo.z *= side

        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
        weight = value / bs.pdf
        if self.alpha == 0:
            bs.pdf = dr.select(reflect, choice, bs.pdf)
            weight = dr.select(reflect, self.specular * mi.fresnel(wi.z, self._eta)[0] / choice, weight)
        active &= bs.pdf > 0
        return bs, dr.select(active, weight, 0)

    def eval_diffuse_reflectance(self, si, active=True):
        """Evaluate the total diffuse reflectance (JB02 eq. 15, or its texture) at a point."""
        return mi.Color3f(self.texture.eval(si, active)) if self.texture is not None else mi.Color3f(self._reflectance)

    def stretch(self, si, active=True):
        """Evaluate how many times wider the profile is at a point than that of the medium, whose dmfp is the shortest on its bodies."""
        return dr.maximum(mi.Color3f(self.textures.dmfp.eval(si, active)) * self._per_dmfp, 1)

    def traverse(self, callback):
        """Show what can be changed: where there are textures, these instead of the coefficients."""
        shown = dict(self._shown.variables) | self.textures.named()
        for name in COEFFICIENTS if self.textures.named() else ():
            del shown[name]
        for name, value in shown.items():
            smooth = name != "alpha" and value is not self.textures.dmfp
            callback.put(name, value, mi.ParamFlags.Differentiable if smooth else mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys=()):
        """Take over what was changed; the rest stays as precise as it was given.

        Raises
        ------
        MediumError
            For what no material can have, and for a medium that was changed by coefficients and by reflectance at once.
        """
        new = self._shown.changed()
        if self.texture is not None and "reflectance" in (keys or ("reflectance",)):
            new["reflectance"] = mean_values(self.texture)
        description = self._description.changed(new)
        medium = self._medium if description is self._description else description.medium()
        self._describe(description, medium, new.get("scale", self.scale))
        self._set_surface(new.get("alpha", self.alpha), new.get("specular_reflectance", self.specular))

    def to_string(self):
        """Describe the material in Mitsuba's form."""
        medium = self._medium
        values = {
            "material": medium.name or "",
            "sigma_a": medium.sigma_a.tolist(),
            "sigma_s_prime": medium.sigma_s_prime.tolist(),
            "eta": medium.eta,
            "profile": medium.profile,
            "scale": self.scale,
            "alpha": self.alpha,
            "specular_reflectance": self.specular,
            "body": self.body,
        }
        lines = ",\n".join(f"  {name} = {value}" for name, value in values.items() if value != "")
        return f"TranslucentBSDF[\n{lines}\n]"


def _upright(wi, wo):
    """Mirror both directions to the upper side of the surface, and tell where they lie on the same side."""
    same_side = (wi.z * wo.z) > 0
    return mi.Vector3f(wi.x, wi.y, dr.abs(wi.z)), mi.Vector3f(wo.x, wo.y, dr.abs(wo.z)), same_side
