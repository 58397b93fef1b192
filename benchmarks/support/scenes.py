"""The built-in scenes as the benchmarks want them."""

from __future__ import annotations

from typing import Any

from pellucid.model.medium import Medium
from pellucid.scenes.builtin import build

Resolution = tuple[int, int]


def teapot_spec(
    resolution: Resolution, material: str = "marble", box_filter: bool = True, **options: Any
) -> dict[str, Any]:
    """Describe the built-in teapot, by default on a film whose pixels are the means of their own samples alone."""
    options.setdefault("bsdf", {"type": "pellucid_translucent", "material": material})
    spec = build("teapot", resolution=resolution, **options)
    if box_filter:
        spec["sensor"]["film"]["rfilter"] = {"type": "box"}
    return independent(spec)


def independent(spec: dict[str, Any]) -> dict[str, Any]:
    """Let the camera draw independent numbers: stratified ones round the samples a pixel up, which distorts rates."""
    spec["sensor"]["sampler"]["type"] = "independent"
    return spec


def published(name: str, **options: Any) -> dict[str, Any]:
    """Describe a built-in scene with the profile of the papers."""
    return with_dipoles(build(name, **options))


def with_dipoles(content: dict[str, Any]) -> dict[str, Any]:
    """Give all translucent materials in the description of a scene the dipole, those of meshes in memory too."""
    for value in content.values():
        bsdf = None if isinstance(value, (dict, list, str, int, float)) else getattr(value, "bsdf", lambda: None)()
        if hasattr(bsdf, "medium"):
            bsdf.set_medium(_with_dipole(bsdf.medium.scaled(1 / bsdf.scale), bsdf.texture is not None), bsdf.scale)
    nested = {key: with_dipoles(value) if isinstance(value, dict) else value for key, value in content.items()}
    return nested | ({"profile": "dipole"} if content.get("type") == "pellucid_translucent" else {})


def _with_dipole(medium: Medium, by_colour: bool) -> Medium:
    """Give a medium the dipole, with the coefficients that it has, or with its reflectance and diffuse mean free path."""
    if by_colour:
        given = medium.total_diffuse_reflectance, medium.dmfp, medium.eta, medium.g
        return Medium.from_reflectance(*given, profile="dipole")
    return Medium(medium.sigma_s_prime, medium.sigma_a, medium.g, medium.eta, medium.name, "dipole")


def load(spec: dict[str, Any]) -> Any:
    """Load a scene dictionary with its shapes kept apart."""
    from pellucid.scenes.loading import load_scene

    return load_scene(spec)
