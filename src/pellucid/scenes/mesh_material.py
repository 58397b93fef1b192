"""The material of a bare mesh: the colours of its file as reflectance, and a mean free path from elsewhere."""

from __future__ import annotations

import numpy as np

from ..errors import MediumError, SceneError, warn
from ..model.medium import Medium
from ..scene.meshes.looks import Look
from .stage import Spec, rgb

DEFAULT_DMFP = 1.0
"""Diffuse mean free path of a mesh whose file says its colour and nobody says its material [mm]."""
BRIGHTEST = 0.999
OWN_COLOUR = {"reflectance", "sigma_a", "sigma_s_prime"}


def coloured(file: str, look: Look, bsdf: Spec) -> Spec:
    """Combine the colour that a file gives to a part with the material that was asked for.

    Parameters
    ----------
    file : str
        Its name, for what is said.
    look : Look
        From the file.
    bsdf : dict
        What was asked for.

    Returns
    -------
    dict
        For ``mi.load_dict``.

    Raises
    ------
    MediumError
        For a measured material without a finite diffuse mean free path.
    """
    if not look.is_coloured or bsdf["type"] != "pellucid_translucent":
        return bsdf
    name = f"'{file}'" + (f", material '{look.name}'" if look.name else "")
    if OWN_COLOUR & set(bsdf):
        warn(f"{name}: {look.described} not shown, as the reflectance or the coefficients were given.")
        return bsdf
    kept = {key: value for key, value in bsdf.items() if key != "material"}
    if "material" in bsdf:
        medium = Medium.from_preset(bsdf["material"])
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


def picture_needs_uv(file: str, bsdf: Spec, has_uv: bool) -> None:
    """Refuse a picture as reflectance of a mesh on which it cannot lie.

    Raises
    ------
    SceneError
        Without texture coordinates.
    """
    reflectance = bsdf.get("reflectance")
    if isinstance(reflectance, dict) and reflectance["type"] == "bitmap" and not has_uv:
        raise SceneError(
            f"'{file}' has no texture coordinates, by which the picture '{reflectance.get('filename')}' could lie on it: "
            "unwrap the mesh (UV), or give a colour as reflectance."
        )


def _reflectance(look: Look) -> Spec:
    """Describe the colours of a look as a reflectance, a colour or a texture."""
    import mitsuba as mi

    if look.by_vertex:
        return {"type": "mesh_attribute", "name": "vertex_color"}
    if look.texture is not None:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(look.texture)), "raw": True}
    assert look.color is not None
    return rgb(*np.clip(look.color, 0, BRIGHTEST))
