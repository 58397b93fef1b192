"""Bodies whose diffuse mean free path is a texture: the profile is that of the point where light leaves.

Such a body has the medium of the shortest dmfp on it. Where that is longer by a factor, the stretch, the profile is the same but wider:
``R(r / stretch) / stretch^2``. The absorption, and with it the reflectance, is that of the medium everywhere.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import MediumError, SceneError
from ..model.medium import Medium
from ..model.profiles import ProfileTable
from ..scene.bodies import Body
from ..scene.samples.surface import SurfaceSamples
from .reflectance import filtered_texture, over_surface


class Stretch:
    """By how much the profile is wider at points than that of their body.

    Parameters
    ----------
    bodies : list of Body
        All of a scene; at least one `Body.is_stretched`.
    """

    def __init__(self, bodies: list[Body]):
        self._bsdfs = list({id(body.bsdf): body.bsdf for body in bodies if body.is_stretched}.values())
        number = {id(bsdf): k for k, bsdf in enumerate(self._bsdfs, 1)}
        self._number = mi.UInt32([0, *(number.get(id(body.bsdf), 0) for body in bodies)])

    def at(self, si: mi.SurfaceInteraction3f, body: mi.UInt32, active: Any = True) -> mi.Color3f:
        """Evaluate the stretch at points of bodies, whose numbers begin at 1; 1 on those with one profile."""
        number = dr.gather(mi.UInt32, self._number, body, active)
        result = mi.Color3f(1)
        for k, bsdf in enumerate(self._bsdfs, 1):
            here = active & (number == k)
            result = dr.select(here, bsdf.stretch(si, here), result)
        return result


def settle_lengths(bodies: list[Body]) -> Stretch | None:
    """Give materials whose dmfp is a texture the medium of its least value on all their bodies; None where there are none.

    Raises
    ------
    MediumError
        Where a texture is not positive.
    """
    stretched = [body for body in bodies if body.is_stretched]
    for bsdf in {id(body.bsdf): body.bsdf for body in stretched}.values():
        texture, scale = bsdf.textures.dmfp, bsdf.textures.dmfp_scale
        own = [body for body in stretched if body.bsdf is bsdf]
        lengths = scale * np.concatenate([over_surface(texture, body)[0] for body in own])
        shortest = lengths.min(axis=0)
        if not shortest.min() > 0:
            raise MediumError(
                f"The texture of the dmfp is {shortest.min():g} mm somewhere on the body '{own[0].name}': a mean free path is positive, "
                "raise the darkest values."
            )
        now = bsdf.medium.scaled(1 / bsdf.scale)
        medium = Medium.from_reflectance(now.total_diffuse_reflectance, shortest, now.eta, now.g, now.profile)
        bsdf.set_medium(medium, bsdf.scale)
        bsdf.widest = float((lengths / shortest).max())
    return Stretch(bodies) if stretched else None


def refuse_stretched(bodies: list[Body], who: str) -> None:
    """Refuse bodies whose dmfp is a texture, for who has one profile a body.

    Raises
    ------
    SceneError
    """
    for body in bodies:
        if body.is_stretched:
            raise SceneError(
                f"The dmfp of the body '{body.name}' is a texture, and {who} has one mean free path a body: give a number, or render it by "
                "pellucid_two_pass."
            )


def table_of_samples(body: Body, medium: Medium, samples: SurfaceSamples) -> ProfileTable:
    """Tabulate the profile of a medium for light that enters a body over soft discs around samples, as wide as its `overlap` says."""
    return ProfileTable.for_stretch(medium, medium.flat_profile.overlap * samples.mean_radius, body.bsdf.widest)


def stretch_of_samples(body: Body, samples: SurfaceSamples) -> mi.Color3f | None:
    """Average the stretch over the disc of each sample; None on a body that has one profile."""
    if not body.is_stretched:
        return None
    medium, textures = body.medium.scaled(1 / body.bsdf.scale), body.bsdf.textures
    lengths = filtered_texture(textures.dmfp, body, samples) * textures.dmfp_scale
    return mi.Color3f(*np.maximum(lengths / medium.dmfp, 1).T.astype(np.float32))
