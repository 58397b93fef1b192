"""The built-in scenes as the benchmarks want them."""

from __future__ import annotations

from typing import Any

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


def load(spec: dict[str, Any]) -> Any:
    """Load a scene dictionary with its shapes kept apart."""
    from pellucid.scenes.loading import load_scene

    return load_scene(spec)
