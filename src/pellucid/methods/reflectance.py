"""The texture of a body's reflectance: what it is on average over the body, and over the disc of each sample."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import columns, upload
from ..kernels.sequences import fibonacci_disc, fibonacci_lattice
from ..light.transport import opacity
from ..model.medium import Medium
from ..scene.bodies import Body, children
from ..scene.meshes.buffers import mesh_interaction
from ..scene.samples.surface import SurfaceSamples, make_samples
from .material import BLACKEST, WHITEST

TEXTURE_TAPS = 16
MEAN_POINTS = 4096


def settle_reflectances(bodies: list[Body]) -> None:
    """Give materials whose texture belongs to the shape the medium of its mean over the surface of all their bodies.

    A material alone knows the mean of a picture over its unit square. An attribute of a mesh, such as colours of its
    vertices, has no colour without the mesh.
    """
    for bsdf in {id(body.bsdf): body.bsdf for body in bodies if _is_attribute(body.bsdf.texture)}.values():
        found = [over_surface(bsdf.texture, body) for body in bodies if body.bsdf is bsdf]
        mean = sum(area * colours.mean(axis=0) for colours, area in found) / sum(area for _, area in found)
        now = bsdf.medium.scaled(1 / bsdf.scale)
        medium = Medium.from_reflectance(np.clip(mean, BLACKEST, WHITEST), now.dmfp, now.eta, now.g, now.profile)
        bsdf.set_medium(medium, bsdf.scale)


def filtered_texture(texture: mi.Texture, body: Body, samples: SurfaceSamples) -> np.ndarray:
    """Average a texture over the disc that each sample stands for: ``(n, 3) float`` (JB02 section 5)."""
    total = np.zeros((len(samples.p), 3))
    for rows, colour in _taps(texture, body, samples):
        total[rows] += _rows(colour, len(rows))
    return total / TEXTURE_TAPS


def differentiated_texture(texture: mi.Texture, body: Body, samples: SurfaceSamples) -> mi.Color3f:
    """Do what `filtered_texture` does, with gradients to the texture."""
    total = dr.zeros(mi.Color3f, len(samples.p))
    for rows, colour in _taps(texture, body, samples):
        dr.scatter_add(total, colour / TEXTURE_TAPS, upload(rows.astype(np.uint32)))
    return total


def _taps(texture: mi.Texture, body: Body, samples: SurfaceSamples) -> Iterator[tuple[np.ndarray, mi.Color3f]]:
    """Evaluate a texture at points of the disc of each sample; give the rows of the samples with each."""
    reach = np.sqrt(samples.area / np.pi)
    # The step in (u, v) that moves by one unit along the two tangent directions: the inverse of [dp_du dp_dv].
    tangent = _unit(samples.dp_du)
    bitangent = np.cross(samples.n, tangent)
    a, b = np.sum(samples.dp_du * tangent, -1), np.sum(samples.dp_dv * tangent, -1)
    c, d = np.sum(samples.dp_du * bitangent, -1), np.sum(samples.dp_dv * bitangent, -1)
    determinant = a * d - b * c
    inverse = np.divide(1, determinant, out=np.zeros_like(determinant), where=np.abs(determinant) > 1e-20)
    for rows, si in _interactions(body, samples):
        for r, phi in zip(*fibonacci_disc(TEXTURE_TAPS), strict=True):
            s, t = r * reach * np.cos(phi), r * reach * np.sin(phi)
            du, dv = (d * s - b * t) * inverse, (a * t - c * s) * inverse
            uv = samples.uv + np.stack([du, dv], -1)
            si.uv = mi.Point2f(*columns(uv[rows]))
            yield rows, mi.Color3f(texture.eval(si))


def opacity_at(body: Body, samples: SurfaceSamples) -> np.ndarray | None:
    """Evaluate how much of the surface is there at each sample, ``(n, 3) float``; None where no material has a mask."""
    if not any(part.has_holes for part in body.parts):
        return None
    there = np.ones((len(samples), 3))
    for rows, si in _interactions(body, samples):
        there[rows] = _rows(opacity(si), len(rows))
    return there


def _is_attribute(texture: mi.Texture | None) -> bool:
    """Tell whether a texture, or one inside it, reads an attribute of the shape."""
    if texture is None:
        return False
    return "MeshAttribute" in texture.class_name() or any(
        _is_attribute(child) for _, child in children(texture) if isinstance(child, mi.Texture)
    )


def over_surface(texture: mi.Texture, body: Body) -> tuple[np.ndarray, float]:
    """Evaluate a texture at points spread evenly over a body, ``(n, 3) float``; also return its area."""
    surface = body.surface()
    sites = surface.draw(MEAN_POINTS, 0, fibonacci_lattice)
    points = make_samples(surface, sites, np.full(len(sites), surface.area / len(sites), np.float32))
    colours = np.zeros((len(points), 3))
    for rows, si in _interactions(body, points):
        colours[rows] = _colour(texture, si)
    return colours, surface.area


def _interactions(body: Body, samples: SurfaceSamples) -> Iterator[tuple[np.ndarray, mi.SurfaceInteraction3f]]:
    """Describe the samples on each shape of a body as a texture wants to see them; give their rows with each."""
    for k, part in enumerate(body.parts):
        rows = np.flatnonzero(samples.shape_index == k)
        if len(rows) == 0:
            continue
        if part.shape.is_mesh():
            corner = mi.Point2f(*columns(samples.prim_uv[rows]))
            si: Any = mesh_interaction(part.shape, upload(samples.prim_index[rows]), corner)
        else:
            si = dr.zeros(mi.SurfaceInteraction3f, len(rows))
            si.shape = mi.ShapePtr(part.shape)
        si.uv = mi.Point2f(*columns(samples.uv[rows]))
        yield rows, si


def _colour(texture: mi.Texture, si: mi.SurfaceInteraction3f) -> np.ndarray:
    """Evaluate a texture: ``(n, 3) float``."""
    return _rows(texture.eval(si), dr.width(si.uv))


def _rows(colour: Any, count: int) -> np.ndarray:
    """Bring colours to the host: ``(n, 3) float``."""
    return np.asarray((mi.Color3f(colour) + dr.zeros(mi.Color3f, count)).numpy()).T


def _unit(v: np.ndarray) -> np.ndarray:
    """Normalise vectors, leaving zero ones alone."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)
