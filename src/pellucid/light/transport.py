"""Follow light paths through a scene whose translucent surfaces either emit their exitance or stand in as diffuse ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..scene.bodies import Lookup

VERTEX_SLOTS = 3
"""Translucent vertices of one path whose exitance is recorded: the end of its first segment in slot 0, and two later
ones. Between two of them the path is reflected off a dielectric, so what a third could add is of the order of the square
of its Fresnel reflectance: 0.2 %."""

WEAK = 0.05
"""Paths whose throughput has fallen below this play Russian roulette at any depth. A dielectric reflects 4 % at normal
incidence: without this, all that follows the reflection would cost as much as a path and show as a twentieth of one."""


@dataclass
class Vertices:
    """The translucent vertices of all paths: ``VERTEX_SLOTS`` slots of ``width`` records each.

    ``weight`` is what the exitance at ``p`` is to be multiplied with, without the Fresnel factors of its body:
    path throughput times ``F_t(omega_out)``. ``shading_normals`` tells whether ``n`` has these, or those of the surface itself.
    """

    width: int
    p: mi.Point3f
    n: mi.Normal3f
    weight: mi.Color3f
    body: mi.UInt32
    shading_normals: bool

    @classmethod
    def empty(cls, width: int, shading_normals: bool = False) -> Vertices:
        """Make room for the vertices of ``width`` paths."""
        size = width * VERTEX_SLOTS
        return cls(
            width,
            dr.empty(mi.Point3f, size),
            dr.empty(mi.Normal3f, size),
            dr.empty(mi.Color3f, size),
            dr.zeros(mi.UInt32, size),
            shading_normals,
        )

    def record(self, slot, lane, si, weight, body, active) -> None:
        """Write one vertex of each active path."""
        index = lane + slot * dr.opaque(mi.UInt32, self.width)  # a literal would make a kernel for each number of paths
        dr.scatter(self.p, si.p, index, active)
        dr.scatter(self.n, si.sh_frame.n if self.shading_normals else si.n, index, active)
        dr.scatter(self.weight, weight, index, active)
        dr.scatter(self.body, body, index, active)


class Translucency(Protocol):
    """What answers the translucent vertices of paths: the method of an integrator, with its finished state."""

    lookup: Lookup
    shading_normals: bool
    """Whether it asks for shading normals: where the profile follows the curve, facets would show."""
    eta_table: mi.Float

    def radiance(self, vertices: Vertices) -> mi.Color3f:
        """Sum the light that the vertices of each path send along it: ``(width,)`` colours."""


@dataclass
class Start:
    """Where paths begin: the ray of each, and what multiple importance sampling must know of the vertex before it.

    ``pdf`` is the density per solid angle with which the direction was sampled; ``delta`` marks directions that emitter
    sampling cannot find (camera rays). ``depth`` counts the vertices behind the ray.
    """

    ray: mi.Ray3f
    origin: mi.Interaction3f
    pdf: mi.Float
    delta: mi.Bool
    depth: int

    @classmethod
    def camera(cls, ray: mi.Ray3f) -> Start:
        """Begin at the eye."""
        return cls(ray, dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True), 0)

    @classmethod
    def surface(cls, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, pdf: mi.Float) -> Start:
        """Begin at a surface, in a direction of its local frame that was sampled with the density ``pdf``."""
        return cls(si.spawn_ray(si.to_world(wo)), interaction(si), pdf, mi.Bool(False), 1)


@dataclass
class Limits:
    """When paths end: ``max_depth`` and ``rr_depth`` as in Mitsuba's ``path``, and whether the eye sees emitters.

    Of ``differentiated`` paths, what they carry has gradients, and where they go has none. Dr.Jit differentiates only loops
    that it evaluates: its flag ``SymbolicLoops`` has to be off.
    """

    max_depth: int
    rr_depth: int
    hide_emitters: bool = False
    differentiated: bool = False


def interaction(si: mi.SurfaceInteraction3f) -> mi.Interaction3f:
    """Keep of a surface interaction only what emitter densities depend on: a quarter of the registers of a loop."""
    return mi.Interaction3f(si.t, si.time, si.wavelengths, si.p, si.n)


def mis_weight(pdf_a, pdf_b):
    """Weigh one of two sampling techniques by the power heuristic; a density that is no number counts as none."""
    a2 = dr.square(pdf_a)
    return dr.detach(dr.select(pdf_a > 0, dr.select(pdf_b > 0, a2 / dr.fma(pdf_b, pdf_b, a2), 1), 0))


def opacity(si: mi.SurfaceInteraction3f, active=True) -> mi.Color3f:
    """Evaluate how much of a surface is there, by the mask of its material: 1 less what passes it without being touched."""
    return 1 - mi.Color3f(si.bsdf().eval_null_transmission(si, active))


def _emitted(scene, si, origin, pdf, delta, active) -> mi.Color3f:
    """Evaluate the emitter that a ray has hit, weighed against finding it by emitter sampling."""
    ds = mi.DirectionSample3f(scene, si, origin)
    return mis_weight(pdf, scene.pdf_emitter_direction(origin, ds, ~delta)) * ds.emitter.eval(si, active)


def _scatter(scene, sampler, si, active, differentiated: bool = False):
    """Light from one sampled emitter at a surface, and the sample of its BSDF with its weight."""
    if differentiated:
        return _scatter_differentiated(scene, sampler, si, active)
    bsdf = si.bsdf()
    lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(lit), True, lit)
    lit &= ds.pdf > 0  # an emitter that sends nothing may answer with NaN
    value, pdf, sample, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, si.to_local(ds.d), sampler.next_1d(active), sampler.next_2d(active), active
    )
    direct = value * emitted * dr.select(ds.delta, 1, mis_weight(ds.pdf, pdf))
    return dr.select(lit, direct, 0), sample, weight


def _scatter_differentiated(scene, sampler, si, active):
    """Do what `_scatter` does, with gradients of what the samples carry; a mirror has none."""
    bsdf, ctx = si.bsdf(), mi.BSDFContext()
    lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    with dr.suspend_grad():
        ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(lit), True, lit)
        lit &= ds.pdf > 0
        wo = si.to_local(ds.d)
        _, pdf, sample, weight = bsdf.eval_pdf_sample(
            ctx, si, wo, sampler.next_1d(active), sampler.next_2d(active), active
        )
    emitted = dr.replace_grad(emitted, scene.eval_emitter_direction(si, ds, lit) / ds.pdf)
    direct = bsdf.eval(ctx, si, wo, lit) * emitted * dr.select(ds.delta, 1, mis_weight(ds.pdf, pdf))
    again = dr.select(sample.pdf > 0, bsdf.eval(ctx, si, sample.wo, active) / sample.pdf, 0)
    return dr.select(lit, direct, 0), sample, dr.replace_grad(weight, again)


def _survival(throughput, is_long) -> mi.Float:
    """Choose the probability with which a path goes on: long ones by their throughput, others only if they are weak."""
    strongest = dr.detach(dr.max(throughput))
    return dr.select(is_long, dr.minimum(strongest, 0.95), dr.minimum(strongest / WEAK, 1))


@dr.syntax
def trace(scene: mi.Scene, sampler: mi.Sampler, start: Start, limits: Limits, translucency: Any, active):
    """Trace paths with next-event estimation and return ``(L, seen, hit, vertices)``.

    With a ``translucency`` every translucent vertex is recorded instead of answered, and only the reflection of its surface is
    followed (the caller takes the diffuse lobe off the materials); without one, materials act as their BSDFs say.
    ``L`` is radiance without the exitance of translucent vertices, and without ``seen``, the emitters at the end of the first segment.
    """
    width = dr.width(start.ray)
    records = translucency is not None
    vertices: Any = None
    lookup: Any = None
    eta_table: Any = None
    if dr.hint(records, mode="scalar"):
        vertices = Vertices.empty(width, translucency.shading_normals)
        lookup, eta_table = translucency.lookup, translucency.eta_table
    lane = dr.arange(mi.UInt32, width)

    ray, origin = mi.Ray3f(start.ray), mi.Interaction3f(start.origin)
    pdf_prev, delta_prev = mi.Float(start.pdf), mi.Bool(start.delta)
    depth = mi.UInt32(start.depth)
    slot, hit = mi.UInt32(1), mi.Bool(False)
    throughput, radiance, seen = mi.Color3f(1), mi.Color3f(0), mi.Color3f(0)
    active = mi.Bool(active)

    while dr.hint(active, max_iterations=limits.max_depth, label="pellucid paths"):
        si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)

        # ---------------------- Emitters hit by the ray ----------------------
        visible = mi.Bool(active)
        if dr.hint(limits.hide_emitters, mode="scalar"):
            visible &= depth > 0
        emitted, begins = throughput * _emitted(scene, si, origin, pdf_prev, delta_prev, visible), depth == start.depth
        seen, radiance = dr.select(begins, emitted, seen), radiance + dr.select(begins, 0, emitted)
        hit |= begins & si.is_valid()
        active &= si.is_valid() & (depth + 1 < limits.max_depth)

        # ---------------------- Light from inside ----------------------
        if dr.hint(records, mode="scalar"):
            body = lookup.body_index(si, active)
            first = depth == start.depth
            inside = active & (body != 0) & (first | (slot < VERTEX_SLOTS))
            cosine, eta = lookup.leaving_cosine(si, inside), dr.gather(mi.Float, eta_table, body, inside)
            transmitted = 1 - mi.fresnel(cosine, eta)[0]
            if dr.hint(lookup.has_holes, mode="scalar"):
                transmitted *= opacity(si, inside)
            vertices.record(dr.select(first, 0, slot), lane, si, throughput * transmitted, body, inside)
            slot = dr.select(inside & ~first, slot + 1, slot)

        # ---------------------- Emitter sampling ----------------------
        direct, sample, weight = _scatter(scene, sampler, si, active, limits.differentiated)
        radiance += throughput * direct

        # ---------------------- The next direction ----------------------
        throughput *= weight
        ray = si.spawn_ray(si.to_world(sample.wo))
        origin = interaction(si)
        pdf_prev = sample.pdf
        delta_prev = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        depth += 1

        # ---------------------- Russian roulette ----------------------
        survival = _survival(throughput, depth > limits.rr_depth)
        active &= sampler.next_1d(active) < survival
        throughput *= dr.rcp(survival)

    return radiance, seen, hit, vertices
