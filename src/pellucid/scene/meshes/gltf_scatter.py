"""What a glTF material says about the inside of a body: KHR_materials_volume with either of the two drafts on scattering."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import MediumError, SceneError
from ...model.conventions import colour_to_albedo, medium_of_colour
from ...model.medium import Medium

Array = NDArray[np.float64]

VOLUME, IOR = "KHR_materials_volume", "KHR_materials_ior"
SCATTER, VOLUME_SCATTER = "KHR_materials_scatter", "KHR_materials_volume_scatter"
TRANSMISSION, DIFFUSE = "KHR_materials_transmission", "KHR_materials_diffuse_transmission"
TEXTURES = ("multiscatterColorTexture", "scatterStrengthTexture", "diffuseTransmissionColorTexture")


class Inside(NamedTuple):
    """The inside of a body, and its surface.

    Attributes
    ----------
    medium : Medium
        Per metre.
    tint : (3,) float or None
        By which light is multiplied wherever it passes the surface; None for the base colour of the material.
    alpha : float
        Roughness of the surface.
    ignored : tuple of str
        What else is said about the inside, and is not shown.
    """

    medium: Medium
    tint: Array | None
    alpha: float
    ignored: tuple[str, ...]


def inside_of(material: dict[str, Any]) -> Inside | None:
    """Read the inside of a material; None where light does not enter it, or is not scattered.

    The extinction is ``-ln(attenuationColor) / attenuationDistance``, absorption and scattering together. The albedo follows from
    the multi-scatter colour by van de Hulst's formula: with g in it in KHR_materials_scatter, without in its predecessor.

    Raises
    ------
    SceneError
        For a channel that is not attenuated at all, or entirely.
    """
    extensions = material.get("extensions", {})
    volume, scatter = extensions.get(VOLUME), extensions.get(SCATTER, extensions.get(VOLUME_SCATTER))
    entering = _entering(extensions)
    if volume is None or scatter is None or entering == 0:
        return None
    colour, g = _colour(extensions), float(scatter.get("scatterAnisotropy", 0.0))
    if colour is None:
        return None
    name = f"the material '{material.get('name', '')}'"
    mean_free_path = 1 / _extinction(volume, name)
    eta = float(extensions.get(IOR, {}).get("ior", 1.5))
    try:
        medium = medium_of_colour(colour, mean_free_path, eta, g)
        if SCATTER not in extensions:
            albedo = colour_to_albedo(colour)
            medium = Medium((1 - g) * albedo / mean_free_path, (1 - albedo) / mean_free_path, g, eta)
    except MediumError as error:
        raise SceneError(f"{name}: {error}") from None
    diffuse = extensions.get(DIFFUSE) if SCATTER not in extensions else None
    tint = None if diffuse is None else np.array(diffuse.get("diffuseTransmissionColorFactor", (1, 1, 1)), float)
    roughness = float(material.get("pbrMetallicRoughness", {}).get("roughnessFactor", 1.0))
    ignored = [f"its {key}" for key in TEXTURES if key in scatter or key in (diffuse or {})]
    if entering < 1:
        ignored.append(f"the {1 - entering:.0%} of the light that do not enter")
    return Inside(medium, tint, roughness**2, tuple(ignored))


def _entering(extensions: dict[str, Any]) -> float:
    """Find the part of the light at the surface that enters instead of being reflected diffusely."""
    specular = extensions.get(TRANSMISSION, {}).get("transmissionFactor", 0.0)
    diffuse = 0.0 if SCATTER in extensions else extensions.get(DIFFUSE, {}).get("diffuseTransmissionFactor", 0.0)
    return float(max(specular, diffuse))


def _colour(extensions: dict[str, Any]) -> Array | None:
    """Read the multi-scatter colour, which a strength may dim; None where it is black."""
    if SCATTER in extensions:
        scatter = extensions[SCATTER]
        strength = float(scatter.get("scatterStrengthFactor", 0.0))
        colour = strength * np.array(scatter.get("multiscatterColorFactor", (1, 1, 1)), float)
    else:
        scatter = extensions[VOLUME_SCATTER]
        colour = np.array(scatter.get("multiscatterColor", scatter.get("multiscatterColorFactor", (0, 0, 0))), float)
    return colour if colour.any() else None


def _extinction(volume: dict[str, Any], name: str) -> Array:
    """Read the extinction coefficient [1/m]: ``(3,) float``."""
    colour = np.array(volume.get("attenuationColor", (1, 1, 1)), float)
    distance = float(volume.get("attenuationDistance", np.inf))
    if not (0 < distance < np.inf and (colour > 0).all() and (colour < 1).all()):
        raise SceneError(
            f"{name}: attenuationColor {colour.tolist()} at attenuationDistance {distance:g} m: every channel must be above 0 and "
            "below 1 at a positive distance, or light is never, or at once, scattered in it."
        )
    return -np.log(colour) / distance
