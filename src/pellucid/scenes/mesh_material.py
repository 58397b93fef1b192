"""The material of a bare mesh: the medium that its file describes, or its colours as reflectance and a mean free path from elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MediumError, SceneError, warn
from ..model.medium import DEFAULT_PROFILE, Medium
from ..scene.meshes.gltf_scatter import Inside
from ..scene.meshes.looks import Look
from .stage import Spec, rgb

DEFAULT_DMFP = 1.0
"""Diffuse mean free path of a mesh whose file says its colour and nobody says its material [mm]."""
BRIGHTEST = 0.999
OWN_COLOUR = {"reflectance", "sigma_a", "sigma_s_prime"}
OWN_MEDIUM = OWN_COLOUR | {"material", "dmfp"}


def coloured(file: str, look: Look, bsdf: Spec, metre: float = 1000.0) -> Spec:
    """Combine the colour, or the medium, that a file gives to a part with the material that was asked for.

    Parameters
    ----------
    file : str
        Its name, for what is said.
    look : Look
        From the file.
    bsdf : dict
        What was asked for.
    metre : float
        Millimetres to what is a metre in the file: a mesh that is scaled keeps its look.

    Returns
    -------
    dict
        For ``mi.load_dict``.

    Raises
    ------
    MediumError
        For a measured material without a finite diffuse mean free path.
    """
    if bsdf["type"] != "pellucid_translucent":
        return bsdf
    name = f"'{file}'" + (f", material '{look.name}'" if look.name else "")
    if look.inside is not None and not OWN_MEDIUM & set(bsdf):
        return _of_file(name, look, look.inside, metre) | bsdf
    if look.inside is not None:
        warn(f"{name}: the medium that the file describes is not shown, as another one was given.")
    if not look.is_coloured:
        return bsdf
    if OWN_COLOUR & set(bsdf):
        warn(f"{name}: {look.described} not shown, as the reflectance or the coefficients were given.")
        return bsdf
    kept = {key: value for key, value in bsdf.items() if key != "material"}
    if "material" in bsdf:
        medium = Medium.from_preset(bsdf["material"], profile=bsdf.get("profile", DEFAULT_PROFILE))
        if not np.isfinite(medium.dmfp).all():
            raise MediumError(
                f"'{medium.name}' absorbs nothing, so that it has no diffuse mean free path for the colours of {name}: "
                "give dmfp [mm] in its place."
            )
        kept = {"dmfp": rgb(*medium.dmfp), "eta": medium.eta, "g": medium.g} | kept
        source = f"the diffuse mean free path is that of {medium.name}"
    elif "dmfp" in bsdf:
        source = "the diffuse mean free path is as given"
    else:
        kept["dmfp"] = DEFAULT_DMFP
        source = f"the diffuse mean free path is {DEFAULT_DMFP:g} mm (give --dmfp or --material for another)"
    warn(f"{name}: {look.described} taken for the reflectance, {source}.")
    return kept | {"reflectance": _reflectance(look)}


def _of_file(name: str, look: Look, inside: Inside, metre: float) -> Spec:
    """Describe the medium of a file: by its coefficients, or by what comes back where light is tinted as it passes the surface.

    Light passes twice, in and out; it is not tinted when it is reflected from within.
    """
    medium = inside.medium.scaled(1 / metre)
    surface = {"eta": medium.eta, "g": medium.g, "alpha": inside.alpha}
    tint = inside.tint if inside.tint is not None else look.texture if look.texture is not None else look.color
    if tint is None or np.min(tint) == 1:
        return {"sigma_s_prime": rgb(*medium.sigma_s_prime), "sigma_a": rgb(*medium.sigma_a)} | surface
    if not np.isfinite(medium.dmfp).all():
        raise MediumError(
            f"{name}: light is tinted at the surface and not absorbed inside: give a scatter colour below 1."
        )
    returned = np.square(tint, dtype=float) * medium.total_diffuse_reflectance
    return {"reflectance": _colour(returned), "dmfp": rgb(*medium.dmfp)} | surface


def picture_needs_uv(file: str, bsdf: Spec, has_uv: bool) -> None:
    """Refuse a picture as reflectance or dmfp of a mesh on which it cannot lie.

    Raises
    ------
    SceneError
        Without texture coordinates.
    """
    for name in ("reflectance", "dmfp"):
        value = bsdf.get(name)
        if isinstance(value, dict) and value["type"] == "bitmap" and not has_uv:
            raise SceneError(
                f"'{file}' has no texture coordinates, by which the picture '{value.get('filename')}' could lie on it: "
                f"unwrap the mesh (UV), or give numbers as {name}."
            )


def _reflectance(look: Look) -> Spec:
    """Describe the colours of a look as a reflectance, a colour or a texture."""
    if look.by_vertex:
        return {"type": "mesh_attribute", "name": "vertex_color"}
    colour = look.color if look.texture is None else look.texture
    assert colour is not None
    return _colour(colour)


def _colour(values: NDArray[Any]) -> Spec:
    """Describe one colour ``(3,)``, or a picture ``(h, w, 3)``."""
    import mitsuba as mi

    if values.ndim == 1:
        return rgb(*np.clip(values, 0, BRIGHTEST))
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(values, np.float16)), "raw": True}
