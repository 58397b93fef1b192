"""Surface samples: the points where light is measured before it is spread through the material."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import SampleCountError, SceneError, did_you_mean
from ...kernels.memory import rows, upload
from ...kernels.sequences import fibonacci_lattice
from ...model.units import FACTOR
from ..meshes.buffers import affine, mesh_interaction, smooth_positions
from ..shading import turned_normal
from .areas import sample_areas
from .draw import AnalyticPiece, MeshPiece, Parts, Sites, Surface, to_world_frame
from .spreading import spread_poisson, spread_relaxed, spread_repulsion

METHODS = ("relaxed", "repulsion", "poisson", "uniform")

PLACES, DIRECTIONS = ("p", "p_smooth"), ("n", "sh_n", "dp_du", "dp_dv")
"""What of samples moves with a surface, and what turns with it."""

CLOSED = 0.5
"""Of what is closed but for a hole or two, the vector area is less than this share of the area."""

FEWEST_SAMPLES = 5000
"""Samples of a small body, of which one in every disc of a mean free path would be few."""


@dataclass
class SurfaceSamples:
    """Points spread over the surface of one body, n of them, in the space of the scene.

    Attributes
    ----------
    p : (n, 3) float32
        Positions [scene units].
    n : (n, 3) float32
        Geometric unit normals.
    sh_n : (n, 3) float32
        Interpolated unit normals, for shading.
    p_smooth : (n, 3) float32
        Positions lifted to the smooth surface that the vertex normals of a mesh describe: where shadow rays start.
    uv : (n, 2) float32
        Texture coordinates.
    dp_du, dp_dv : (n, 3) float32
        Derivatives of the position with respect to the texture coordinates [scene units].
    area : (n,) float32
        The piece of surface each sample stands for [scene units squared]; summed in float64, the whole surface.
    shape_index : (n,) int32
        Which of the shapes of the body.
    prim_index, prim_uv : (n,) uint32, (n, 2) float32
        Triangle, and barycentric coordinates of its second and third vertex, on a mesh.
    outside : int
        On which side of the normals light arrives: +1 where those of the body point outwards, -1 inwards; of an open surface, its side.
    is_open : bool
        Whether the surface is that of an open body, of which each side is one of its own.
    is_part : bool
        Whether the body has more of them, elsewhere.
    violations : int
        How many samples have another one nearer than the distance that ``poisson`` was to keep, on their side.
    candidates : float
        How many places were tried for a sample, on average.
    """

    p: np.ndarray
    n: np.ndarray
    sh_n: np.ndarray
    p_smooth: np.ndarray
    uv: np.ndarray
    dp_du: np.ndarray
    dp_dv: np.ndarray
    area: np.ndarray
    shape_index: np.ndarray
    prim_index: np.ndarray
    prim_uv: np.ndarray
    outside: int = 1
    is_open: bool = False
    is_part: bool = False
    violations: int = 0
    candidates: float = 1.0

    def __len__(self) -> int:
        return len(self.p)

    @property
    def mean_radius(self) -> float:
        """Radius of a disc that has the mean area of the samples [scene units]."""
        return float(np.sqrt(np.mean(self.area, dtype=float) / np.pi))

    @property
    def spacing(self) -> float:
        """Side of a square that has the mean area of the samples [scene units]."""
        return float(np.sqrt(np.mean(self.area, dtype=float)))

    def take(self, index: np.ndarray) -> SurfaceSamples:
        """Reorder the samples."""
        return replace(self, **{k: v[index] for k, v in vars(self).items() if isinstance(v, np.ndarray)})

    def moved(self, to_world: np.ndarray) -> SurfaceSamples:
        """Move the samples with their surface, by a rigid transform ``(4, 4)``."""
        if np.array_equal(to_world, np.eye(4)):
            return self
        turned = {name: getattr(self, name) @ to_world[:3, :3].T for name in DIRECTIONS + PLACES}
        moved = {name: v + to_world[:3, 3] if name in PLACES else v for name, v in turned.items()}
        return replace(self, **{name: v.astype(np.float32) for name, v in moved.items()})

    def ray_start(self) -> np.ndarray:
        """Tell where shadow rays start, ``(n, 3) float32``.

        Seen from the smooth surface that the facets stand for, no facet shadows its neighbour at the terminator. On a surface without
        thickness rays start so far on their side that they meet it on their way to the other one.
        """
        if not self.is_open:
            return self.p_smooth
        off = 2 * mi.math.RayEpsilon * (1 + np.abs(self.p).max(axis=1, keepdims=True))
        return (self.p_smooth + self.outside * off * self.n).astype(np.float32)


def default_sample_count(area: float, mfp: float) -> int:
    """Give the number of samples that leaves one in every disc of one mean free path: A / (pi mfp^2), rounded up.

    Parameters
    ----------
    area
        Surface of the body [scene units squared].
    mfp
        Shortest mean free path over the channels [scene units].

    Source
    ------
    JB02 section 3.
    """
    return max(1, math.ceil(area / (math.pi * mfp**2)))


def check_sample_count(
    count: int, max_samples: int, *, name: str, extent: float, mfp: float, scale: float = 1.0
) -> None:
    """Refuse a body that needs more samples than are allowed, and say which unit mistake explains it.

    Parameters
    ----------
    name
        The body, for the message.
    extent
        Its longest side [scene units].
    mfp
        Its shortest mean free path [scene units].
    scale
        Millimetres per scene unit.

    Raises
    ------
    SampleCountError
        When ``count`` exceeds ``max_samples``.
    """
    if count <= max_samples:
        return
    # The number of samples grows with the square of a length: so many times is one of the lengths off, at least.
    excess = math.sqrt(count / max_samples)
    unit = "cm (divide them by 10)" if excess <= 10 else "m (divide them by 1000)"
    raise SampleCountError(
        f"body '{name}' needs {_number(count)} surface samples, more than max_samples = {_number(max_samples)}: "
        f"it is {extent * scale:.3g} mm across and its shortest mean free path is {mfp * scale:.3g} mm. "
        f"If it is smaller in truth, lower scale, now {scale:g} mm a scene unit ({scale / FACTOR:g} where a factor of {FACTOR} is "
        f"too much; at most {scale / excess:.2g} fits; of a bare mesh: --size {extent * scale / excess:.2g}); "
        f"if its coefficients are per {unit}, give them per mm; else raise max_samples or set sample_count yourself."
    )


def sample_surface(
    shapes: Parts | Surface, count: int, method: str = "relaxed", seed: int = 0, distance: float | None = None
) -> SurfaceSamples:
    """Spread samples over the whole surface of a body, each with the area of the surface it stands for.

    Parameters
    ----------
    shapes
        The shapes of the body, each with the (4, 4) matrix of its instance or None; or a `Surface` made of them.
    count
        Number of samples.
    method
        ``relaxed``: as for ``poisson``, then pushed apart a little (the most even); ``repulsion``: pushed apart until at rest;
        ``poisson``: none nearer to another than a fixed distance; ``uniform``: evenly by area alone (the fastest).
    seed
        The same seed gives the same samples.
    distance
        For ``poisson``: the least distance of two samples [scene units], the mean free path in AWB08. Where so many
        samples do not fit at this distance, the result says how many violate it.

    Raises
    ------
    SceneError
        For an unknown method, a count below one, or shapes without a surface that can be sampled.
    """
    if method not in METHODS:
        raise SceneError(
            f"unknown sampling method '{method}'{did_you_mean(method, METHODS)}; known: {', '.join(METHODS)}."
        )
    if count < 1:
        raise SceneError(f"{count} surface samples were asked for: give a sample_count of at least 1.")
    surface = shapes if isinstance(shapes, Surface) else Surface(shapes)
    # Where samples lie is decided once; nothing is differentiated through it.
    with dr.suspend_grad():
        sites, violations, candidates = _spread(surface, int(count), method, int(seed), distance)
        # Any other seed than that of the samples: the points that measure the areas must not coincide with them.
        area = sample_areas(surface, sites, int(seed) + 0x5EED).astype(np.float32)
        return make_samples(surface, sites, area, violations, candidates)


def _spread(surface: Surface, count: int, method: str, seed: int, distance: float | None) -> tuple[Sites, int, float]:
    """Decide where samples lie; also count violations of ``distance``, and candidates a sample."""
    if method == "poisson":
        return spread_poisson(surface, count, seed, distance)
    if method == "relaxed":
        return spread_relaxed(surface, count, seed), 0, 1.0
    if method == "repulsion":
        return spread_repulsion(surface, count, seed), 0, 1.0
    return surface.draw(count, seed, fibonacci_lattice), 0, 1.0


def make_samples(
    surface: Surface, sites: Sites, area: np.ndarray, violations: int = 0, candidates: float = 1.0
) -> SurfaceSamples:
    """Describe sites, each of which stands for an area ``(n,) float32``, as samples of a surface."""
    sites = surface.alike(sites)
    if surface.side:
        outside = surface.side
    elif surface.whole is not None:
        outside = _outside_of_whole(surface.whole)
    else:
        outside = outside_of(rows(sites.p), rows(sites.n), area)
    described = describe(surface, sites, outside)
    return SurfaceSamples(
        area=area,
        outside=outside,
        is_open=surface.side != 0,
        is_part=surface.whole is not None,
        violations=violations,
        candidates=candidates,
        **described,
    )


def _outside_of_whole(surface: Surface) -> int:
    """Tell on which side of a surface the outside is, from a few points of it."""
    sites = surface.alike(surface.draw(FEWEST_SAMPLES, 0, fibonacci_lattice))
    return outside_of(rows(sites.p), rows(sites.n), np.full(len(sites), surface.area / len(sites)))


def outside_of(p: np.ndarray, n: np.ndarray, area: np.ndarray) -> int:
    """Tell on which side of a closed surface the outside is: +1 where normals point outwards, -1 inwards; +1 for an open one.

    The vector area of a closed surface vanishes, and the flux of the position through it is three times its volume.
    """
    weighted = n.astype(float) * area[:, None]
    if np.linalg.norm(weighted.sum(axis=0)) > CLOSED * np.sum(area, dtype=float):
        return 1
    flux = np.sum((p - p.mean(axis=0, dtype=float)) * weighted)
    return 1 if flux > 0 else -1


def describe(surface: Surface, sites: Sites, side: int = 1) -> dict[str, np.ndarray]:
    """Ask each shape for everything about the points on it: fields of `SurfaceSamples`.

    ``side`` of the normals, 1 or -1, is where the smooth surface lies that facets stand for.
    """
    count = len(sites)
    fields = {name: np.empty((count, 3), np.float32) for name in ("p", "n", "sh_n", "p_smooth", "dp_du", "dp_dv")}
    fields["uv"] = np.empty((count, 2), np.float32)
    shape_index = np.array(sites.shape_index, dtype=np.int32)
    for k, piece in enumerate(surface.pieces):
        index = np.flatnonzero(shape_index == k)
        if len(index) == 0:
            continue
        here = sites.take(upload(index.astype(np.uint32)))
        described = _on_mesh(piece, here, side) if isinstance(piece, MeshPiece) else _on_analytic(piece, here)
        dr.eval(described)
        for name, value in described.items():
            fields[name][index] = rows(value + dr.zeros(type(value), len(index)))
    prim_index = np.array(sites.prim_index + dr.zeros(mi.UInt32, count), np.uint32)
    prim_uv = rows(sites.prim_uv + dr.zeros(mi.Point2f, count))
    return {"shape_index": shape_index, "prim_index": prim_index, "prim_uv": prim_uv, **fields}


def _on_mesh(piece: MeshPiece, sites: Sites, side: int) -> dict:
    """Describe sites on a mesh from their triangles and barycentric coordinates."""
    si = mesh_interaction(piece.mesh, sites.prim_index, sites.prim_uv)
    p_smooth = smooth_positions(piece.mesh, sites.prim_index, sites.prim_uv, piece.to_world, side * sites.n)
    described = {"p": sites.p, "n": sites.n, "p_smooth": p_smooth, **_shading(si, piece.mesh, piece.to_world)}
    # Faces may be wound against their vertex normals, as those of a mirrored mesh are.
    described["sh_n"] = dr.mulsign(described["sh_n"], dr.dot(described["sh_n"], sites.n))
    return described


def _on_analytic(piece: AnalyticPiece, sites: Sites) -> dict:
    """Describe sites on any other shape by a short ray that meets it there."""
    back = None if piece.to_world is None else np.linalg.inv(piece.to_world)
    p, n = to_world_frame(sites.p, sites.n, back)
    box = piece.shape.bbox()
    lift = dr.opaque(mi.Float, 1e-3 * float(dr.norm(box.max - box.min)))
    ray = mi.Ray3f(p + lift * n, -n)
    ray.maxt = 2 * lift
    # In two steps: `Shape.ray_intersect` of Mitsuba 3.9.1 fails as long as any shape group is alive.
    hit = piece.shape.ray_intersect_preliminary(ray)
    si = piece.shape.compute_surface_interaction(ray, hit, mi.RayFlags.All)
    # A ray may slip past the very rim of a disk.
    si.sh_frame.n = dr.select(hit.is_valid(), si.sh_frame.n, mi.Normal3f(n))
    return {"p": sites.p, "n": sites.n, "p_smooth": sites.p, **_shading(si, piece.shape, piece.to_world)}


def _shading(si: mi.SurfaceInteraction3f, shape: mi.Shape, to_world: np.ndarray | None) -> dict:
    """Carry what a shape says about its texture coordinates and shading normal to the space of the body.

    There its material turns the normal: a bump has the height that rays see in the scene.
    """
    transform = affine(to_world)
    si.n, si.sh_frame.n = (dr.normalize(transform @ mi.Normal3f(n)) for n in (si.n, si.sh_frame.n))
    si.dp_du, si.dp_dv = transform @ si.dp_du, transform @ si.dp_dv
    if hasattr(shape.bsdf(), "medium"):
        sh_n = si.sh_frame.n
    else:
        si.initialize_sh_frame()
        sh_n = turned_normal(shape.bsdf(), si)
    return {"sh_n": sh_n, "uv": si.uv, "dp_du": si.dp_du, "dp_dv": si.dp_dv}


def _number(value: float) -> str:
    """Write a count so that both 40,000 and 3.1e+09 can be read."""
    return f"{value:,}" if value < 1e6 else f"{value:.2g}"
