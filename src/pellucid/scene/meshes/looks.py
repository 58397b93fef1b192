"""What colour the parts of a mesh file have: of a material, of a picture, of their vertices. All in linear RGB."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .gltf import COLOR
from .gltf_scatter import Inside, inside_of

Array = NDArray[np.float64]

WHITE = 0.9995
"""A material that is white all over says nothing about a colour: it is what exporters write by default."""


@dataclass(eq=False)
class Look:
    """What is seen of a material.

    Attributes
    ----------
    name : str
        As the file calls it; empty where it has none.
    color : (3,) float or None
        Of the whole material.
    texture : (h, w, 3) float16 or None
        A picture that lies on it, from the upper edge down; ``color`` is in it.
    by_vertex : bool
        The vertices have colours of their own; ``color`` is in them.
    ignored : tuple of str
        What else the file says about the material, and is not shown.
    inside : Inside or None
        The medium that the file describes.
    """

    name: str = ""
    color: Array | None = None
    texture: NDArray[np.float16] | None = None
    by_vertex: bool = False
    ignored: tuple[str, ...] = ()
    inside: Inside | None = None

    @property
    def is_coloured(self) -> bool:
        """Tell whether the file says anything about the colour."""
        return self.by_vertex or self.texture is not None or self.color is not None

    @property
    def described(self) -> str:
        """Name the source of the colour, with a verb."""
        if self.by_vertex:
            return "the colours of its vertices are"
        return "its texture is" if self.texture is not None else "its colour is"


def linear(value: Any) -> Any:
    """Decode sRGB in [0, 1] to linear values."""
    value = np.asarray(value)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


class Looks:
    """Collects the looks of a file: parts of one material share one.

    Parameters
    ----------
    materials : list of dict, optional
        Of a glTF file.
    is_linear : bool
        The colours of the vertices are linear, else sRGB; those of glTF are linear always.
    """

    def __init__(self, materials: list[dict[str, Any]] | None = None, is_linear: bool = False):
        self.materials, self.is_linear = materials, is_linear
        self.found: dict[tuple[object, ...], Look] = {}

    def of(self, mesh: Any) -> tuple[Look, Array | None]:
        """Find the look of a mesh that trimesh has read, and the colours of its vertices, ``(n, 3)``."""
        colors = _vertex_colors(mesh, self.is_linear)
        material = getattr(mesh.visual, "material", None)
        key = (getattr(material, "name", None), material is not None, colors is not None)
        if key not in self.found:
            color, image, name, ignored = self._material(material)
            plain = color is None or (image is None and color.min() >= WHITE)
            if image is not None and colors is not None and colors.min() < WHITE:
                ignored = (*ignored, "the colours of its vertices under the texture")
            texture = None if image is None else _decoded(image, color)
            shown = None if plain or image is not None else color
            inside = (
                None if material is None or self.materials is None else inside_of(self.materials[int(material.name)])
            )
            ignored += () if inside is None else inside.ignored
            self.found[key] = Look(name, shown, texture, image is None and colors is not None, ignored, inside)
        look = self.found[key]
        if colors is None or not look.by_vertex:
            return look, None
        return look, colors if look.color is None else colors * look.color

    def _material(self, material: Any) -> tuple[Array | None, Any, str, tuple[str, ...]]:
        """Read colour, picture, name, and what is not shown, of a material."""
        if material is None:
            return None, None, "", ()
        if self.materials is None:
            color = material.kwargs.get("kd") if hasattr(material, "kwargs") else None
            color = np.resize(np.asarray(color, float), 3) if color is not None and np.size(color) in (1, 3) else None
            # In practice a picture replaces the colour, which many exporters leave at black or grey.
            image = getattr(material, "image", None)
            if image is not None and _is_made_up(image):
                return color, None, "", ()
            return None if image is not None else color, image, str(material.name or ""), ()
        described = self.materials[int(material.name)]
        base = described["pbrMetallicRoughness"]
        color = np.asarray(base.get("baseColorFactor", (1, 1, 1, 1)), float)[:3]
        ignored = () if described.get("alphaMode", "OPAQUE") == "OPAQUE" else ("its opacity",)
        image = material.baseColorTexture
        if image is None and "baseColorTexture" in base:
            ignored = (*ignored, "a texture that cannot be read")
        return color, image, described.get("name", ""), ignored

    def uv_transform(self, mesh: Any) -> Array | None:
        """Find the matrix, (2, 3), by which a glTF file moves the texture coordinates (KHR_texture_transform)."""
        material = getattr(mesh.visual, "material", None)
        if self.materials is None or material is None:
            return None
        base = self.materials[int(material.name)]["pbrMetallicRoughness"]
        moved = base.get("baseColorTexture", {}).get("extensions", {}).get("KHR_texture_transform")
        if moved is None:
            return None
        angle, scale = moved.get("rotation", 0.0), np.asarray(moved.get("scale", (1, 1)), float)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return np.column_stack([turn * scale, moved.get("offset", (0, 0))])


def _is_made_up(image: Any) -> bool:
    """Tell whether a picture is the one, grey all over, that trimesh makes for texture coordinates without a material."""
    from trimesh.visual.material import color_image

    return np.array_equal(np.asarray(image), np.asarray(color_image()))


def _vertex_colors(mesh: Any, is_linear: bool) -> Array | None:
    """Read the colours of the vertices, linear RGB: ``(n, 3)``."""
    if COLOR in mesh.vertex_attributes:
        return np.clip(np.asarray(mesh.vertex_attributes[COLOR], float)[:, :3], 0, 1)
    visual = mesh.visual
    if visual.kind in ("vertex", "face") and visual.defined:
        colors = np.asarray(visual.vertex_colors, float)[:, :3] / 255
    elif "color" in getattr(visual, "vertex_attributes", {}):
        colors = np.asarray(visual.vertex_attributes["color"], float)[:, :3]
        colors = colors / 255 if colors.max() > 1 else colors
    else:
        return None
    return colors if is_linear else linear(colors)


def _decoded(image: Any, factor: Array | None) -> NDArray[np.float16]:
    """Decode a picture to linear values, times a colour."""
    table = linear(np.arange(256) / 255)
    values = table[np.asarray(image.convert("RGB"))]
    return (values if factor is None else values * factor).astype(np.float16)
