"""A principled BSDF with subsurface scattering, as Blender describes it, as a translucent material."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, warn
from ..model.conventions import principled_dmfp

WEIGHT = "subsurface_weight"
DEFAULTS: dict[str, Any] = {
    "base_color": 0.5,
    "roughness": 0.5,
    "specular": 0.5,
    WEIGHT: 0.0,
    "subsurface_radius": np.array([1.0, 0.2, 0.1]),
    "subsurface_scale": 0.05,
    "subsurface_anisotropy": 0.0,
    "subsurface_method": "random_walk",
}
"""Of Mitsuba, and what Blender has in addition."""
OTHERS = ("metallic", "anisotropic", "spec_trans", "spec_tint", "sheen", "clearcoat", "flatness")
"""What makes something else of the surface where it is not 0."""
SILENT = (
    "subsurface_ior",
    "sheen_tint",
    "clearcoat_gloss",
    "main_specular_sampling_rate",
    "clearcoat_sampling_rate",
    "diffuse_reflectance_sampling_rate",
)
"""What means nothing without the others, or is about speed."""
KEPT = ("scale", "body")
BLENDERS = (*(name for name in DEFAULTS if name.startswith("subsurface")), "subsurface_ior")
"""What Mitsuba does not know."""
BRIGHTEST = 0.999


def translucent(given: dict[str, Any]) -> dict[str, Any]:
    """Write the parameters of a ``principled`` as those of a ``pellucid_translucent``.

    Parameters
    ----------
    given : dict
        Numbers, colours ``(3,) float``, and textures as any other object. Lengths are in scene units, of ``scale`` millimetres.

    Returns
    -------
    dict
        The base colour is the reflectance; a texture stays what it was.

    Raises
    ------
    SceneError
        For a texture of anything but base colour, roughness and subsurface radius, and for parameters that neither Mitsuba nor Blender
        has.
    """
    unknown = set(given) - {*DEFAULTS, *OTHERS, *SILENT, *KEPT, "eta"}
    if unknown:
        raise SceneError(f"principled: there is no parameter '{min(unknown)}': remove it.")
    values = DEFAULTS | given
    _tell(values)
    colour, g = values["base_color"], _number(values, "subsurface_anisotropy")
    scale = float(values.get("scale", 1.0)) * _number(values, "subsurface_scale")
    lengths = values["subsurface_radius"]
    radius = scale * (np.ones(3) if _is_texture(lengths) else _triple(values, "subsurface_radius"))
    if not (radius > 0).all():
        raise SceneError("principled: subsurface_radius and subsurface_scale must be positive: give a small length.")
    shade = DEFAULTS["base_color"] if _is_texture(colour) else colour
    roughness = DEFAULTS["roughness"] if _is_texture(values["roughness"]) else _number(values, "roughness")
    dmfp = principled_dmfp(shade, radius, g, str(values["subsurface_method"]))
    return {
        "reflectance": colour if _is_texture(colour) else np.clip(_triple(values, "base_color"), 0, BRIGHTEST),
        **({"dmfp": lengths, "dmfp_scale": dmfp} if _is_texture(lengths) else {"dmfp": dmfp}),
        "eta": _eta(values),
        "g": g,
        "alpha": roughness**2,
        **{name: values[name] for name in KEPT if name in values},
    }


def _tell(values: dict[str, Any]) -> None:
    """Say in one line what of a material is not shown."""
    lost = [name for name in OTHERS if name in values and (_is_texture(values[name]) or np.any(values[name]))]
    if _is_texture(values["roughness"]):
        lost.append(f"the texture of its roughness, which is taken for {DEFAULTS['roughness']:g}")
    if (weight := _number(values, WEIGHT)) < 1:
        lost.append(f"{WEIGHT} {weight:g}, which is taken for 1")
    if _is_texture(values["base_color"]) and values["subsurface_method"] != "random_walk_skin":
        lost.append(f"free paths that follow its texture: they are those of a colour of {DEFAULTS['base_color']:g}")
    if lost:
        warn(f"Of a principled material are not shown: {', '.join(lost)}.")


def _eta(values: dict[str, Any]) -> float:
    """Read the index, or find it from the reflectance at normal incidence, .08 specular, as Mitsuba does."""
    if "eta" in values:
        return _number(values, "eta")
    return float(2 / (1 - np.sqrt(0.08 * _number(values, "specular"))) - 1)


def _is_texture(value: Any) -> bool:
    """Tell whether a value is an object instead of numbers."""
    return not isinstance(value, (int, float, np.ndarray))


def _number(values: dict[str, Any], name: str) -> float:
    """Read a number that cannot be a texture."""
    numbers = np.unique(_triple(values, name))
    if len(numbers) != 1:
        raise SceneError(f"principled: {name} must be one number; found {numbers.tolist()}.")
    return float(numbers[0])


def _triple(values: dict[str, Any], name: str) -> NDArray[np.float64]:
    """Read a colour that cannot be a texture."""
    if _is_texture(values[name]):
        raise SceneError(f"principled: {name} must be numbers, not a texture.")
    return np.broadcast_to(np.asarray(values[name], float), 3)
