"""Follow light paths through a scene whose translucent surfaces either emit their exitance or stand in as diffuse ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..scene.bodies import Lookup
from .opaque import DiffuseLobe, fit_lobe

VERTEX_SLOTS = 3
"""Translucent vertices of one path whose exitance is recorded: the end of its first segment in slot 0, and two later
ones. Between two of them the path is reflected off a dielectric, so what a third could add is of the order of the square
of its Fresnel reflectance: 0.2 %."""

WEAK = 0.05
"""Paths whose throughput has fallen below this play Russian roulette at any depth. A dielectric reflects 4 % at normal
incidence: without this, all that follows the reflection would cost as much as a path and show as a twentieth of one."""


@dataclass
class Vertices:
    """The vertices of all paths at which a method answers: ``VERTEX_SLOTS`` slots of ``width`` records each.

    ``weight`` is what the exitance at ``p`` is to be multiplied with, without the Fresnel factors of its body:
    path throughput times ``F_t(omega_out)``. ``shading_normals`` tells whether ``n`` has these, or those of the surface itself. On opaque
    surfaces ``weight`` has the reflectance of their diffuse lobe, ``n`` is the shading normal on the side of the path, and ``body`` is
    `Translucency.opaque` plus the coat of the lobe. ``stretch`` tells how many times wider the profile is there than that of the body; None
    where all bodies have one profile each.
    """

    width: int
    p: mi.Point3f
    n: mi.Normal3f
    weight: mi.Color3f
    body: mi.UInt32
    shading_normals: bool
    stretch: mi.Color3f | None = None

    @classmethod
    def empty(cls, width: int, shading_normals: bool = False, stretched: bool = False) -> Vertices:
        """Make room for the vertices of ``width`` paths."""
        size = width * VERTEX_SLOTS
        return cls(
            width,
            dr.empty(mi.Point3f, size),
            dr.empty(mi.Normal3f, size),
            dr.empty(mi.Color3f, size),
            dr.zeros(mi.UInt32, size),
            shading_normals,
            dr.empty(mi.Color3f, size) if stretched else None,
        )

    def record(self, slot, lane, p, n, weight, body, active, stretch=None) -> None:
        """Write one vertex of each active path."""
        index = lane + slot * dr.opaque(mi.UInt32, self.width)  # a literal would make a kernel for each number of paths
        values = (self.p, p), (self.n, n), (self.weight, weight), (self.body, body), (self.stretch, stretch)
        for where, value in values:
            if where is not None:
                dr.scatter(where, value, index, active)


class Translucency(Protocol):
    """What answers the translucent vertices of paths: the method of an integrator, with its finished state."""

    lookup: Lookup
    shading_normals: bool
    """Whether it asks for shading normals: where the profile follows the curve, facets would show."""
    eta_table: mi.Float
    stretch: Any
    """Where the profiles of bodies are wider (`methods.stretch.Stretch`); None where each has one."""
    opaque: mi.UInt32 | None
    """The number of a body that stands for opaque surfaces, where the method lights these too."""

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


def _scatter(scene, sampler, si, active, throughput, taken: Taken | None = None, differentiated: bool = False):
    """Light from one sampled emitter at a surface, and the sample of its BSDF with its weight; without the light that is ``taken``."""
    if differentiated:
        direct, sample, weight = _scatter_differentiated(scene, sampler, si, active)
        return throughput * direct, sample, weight
    bsdf = si.bsdf()
    lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
    if taken is not None:
        lit &= ~taken.everything
    ds, emitted = scene.sample_emitter_direction(si, sampler.next_2d(lit), True, lit)
    lit &= ds.pdf > 0  # an emitter that sends nothing may answer with NaN
    value, pdf, sample, weight = bsdf.eval_pdf_sample(
        mi.BSDFContext(), si, si.to_local(ds.d), sampler.next_1d(active), sampler.next_2d(active), active
    )
    value *= throughput
    if taken is not None:
        value -= taken.lobe.eval(si.wi, si.to_local(ds.d)) * (taken.answered + taken.sent)
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


@dataclass
class Taken:
    """What point lights take off a path at a surface: the light that falls on its diffuse lobe, in units of the throughput.

    Attributes
    ----------
    lobe : DiffuseLobe
    answered : Color3f
        What is recorded there, for the method to answer.
    sent : Color3f
        What virtual lights there send to the surface before: it is answered already.
    everything : Bool
        Whether nothing is left of the light that falls there.
    """

    lobe: DiffuseLobe
    answered: mi.Color3f
    sent: mi.Color3f
    everything: mi.Bool

    def along(self, wi: mi.Vector3f, sample: mi.BSDFSample3f, weight: mi.Color3f) -> tuple[mi.Color3f, mi.Color3f]:
        """Tell what a path that goes on by a sample of the material takes along of ``sent``, and of what is ``answered``."""
        by_lobe = self.lobe.weight(wi, sample, weight)
        return self.sent * by_lobe, self.answered * by_lobe


def _record(
    translucency: Any, vertices: Vertices, slot, lane, si, throughput, carried, shown, active
) -> tuple[DiffuseLobe | None, mi.Bool, mi.Bool]:
    """Record what a method answers at a vertex: a translucent surface, or the diffuse lobe of an opaque one that is shown.

    Returns
    -------
    lobe
        The diffuse lobes of opaque surfaces, if the method answers any.
    inside, answered : Bool
        Where there is a translucent surface, and where there is a lobe, that is recorded.
    """
    there = active & (slot < VERTEX_SLOTS)
    body = translucency.lookup.body_index(si, active)
    inside = there & (body != 0)
    weight = throughput * _leaving(translucency, si, body, inside)
    n = dr.mulsign(si.sh_frame.n, dr.dot(si.sh_frame.n, si.n)) if vertices.shading_normals else si.n
    if translucency.opaque is None:
        stretch = None if translucency.stretch is None else translucency.stretch.at(si, body, inside)
        vertices.record(slot, lane, si.p, n, weight, body, inside, stretch)
        return None, inside, mi.Bool(False)
    lobe = fit_lobe(si, active & (body == 0))
    answered = there & shown & lobe.there
    n = dr.select(answered, si.sh_frame.n * dr.sign(si.wi.z), n)
    weight = dr.select(answered, (throughput - carried) * lobe.reflectance, weight)
    body = dr.select(answered, translucency.opaque + lobe.index, body)
    vertices.record(slot, lane, si.p, n, weight, body, inside | answered)
    return lobe, inside, answered


def _leaving(translucency: Any, si, body, active) -> mi.Float:
    """Evaluate which part of the light from inside leaves a body along the path: by Fresnel, and where there are no holes."""
    lookup = translucency.lookup
    cosine, eta = lookup.leaving_cosine(si, active), dr.gather(mi.Float, translucency.eta_table, body, active)
    transmitted = 1 - mi.fresnel(cosine, eta)[0]
    return transmitted * opacity(si, active) if lookup.has_holes else transmitted


def _take(
    translucency: Any, si, lobe: Any, answered: mi.Bool, throughput, carried, active
) -> tuple[mi.Color3f, mi.Color3f, Taken]:
    """Divide the light at a surface between a path and point lights; give what is left of its throughput, and what they carry of that.

    Virtual lights stand for all that translucent surfaces and those without another lobe reflect.
    """
    gone = lobe.whole | (translucency.lookup.body_index(si, active) != 0)
    throughput, carried = dr.select(gone, throughput - carried, throughput), dr.select(gone, 0, carried)
    own = dr.select(answered, throughput - carried, 0)
    return throughput, carried, Taken(lobe, own, carried * lobe.sent(si.wi), lobe.whole & answered)


def _survival(throughput, is_long) -> mi.Float:
    """Choose the probability with which a path goes on: long ones by their throughput, others only if they are weak."""
    strongest = dr.detach(dr.max(dr.abs(throughput)))
    return dr.select(is_long, dr.minimum(strongest, 0.95), dr.minimum(strongest / WEAK, 1))


@dr.syntax
def trace(scene: mi.Scene, sampler: mi.Sampler, start: Start, limits: Limits, translucency: Any, active):
    """Trace paths with next-event estimation and return ``(L, seen, hit, vertices)``.

    With a ``translucency`` every translucent vertex is recorded instead of answered, and only the reflection of its surface is
    followed (the caller takes the diffuse lobe off the materials); without one, materials act as their BSDFs say.
    ``L`` is radiance without the exitance of translucent vertices, and without ``seen``, the emitters at the end of the first segment.

    Where the translucency answers opaque surfaces too, it answers the diffuse lobes that each path meets before it follows one. What point
    lights send there is left out of what is traced: ``carried`` is the part of the throughput for which emitters give nothing, nor do other
    surfaces as far as virtual lights stand for them.
    """
    width, records = dr.width(start.ray), translucency is not None
    opaque = records and translucency.opaque is not None
    stretched = records and translucency.stretch is not None
    vertices: Any = Vertices.empty(width, translucency.shading_normals, stretched) if records else None
    lane = dr.arange(mi.UInt32, width)

    ray, origin = mi.Ray3f(start.ray), mi.Interaction3f(start.origin)
    pdf_prev, delta_prev = mi.Float(start.pdf), mi.Bool(start.delta)
    depth = mi.UInt32(start.depth)
    slot, hit = mi.UInt32(1), mi.Bool(False)
    throughput, radiance, seen = mi.Color3f(1), mi.Color3f(0), mi.Color3f(0)
    carried, shown, active = mi.Color3f(0), mi.Bool(opaque), mi.Bool(active)

    while dr.hint(active, max_iterations=limits.max_depth, label="pellucid paths"):
        si = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)

        # ---------------------- Emitters hit by the ray ----------------------
        visible = mi.Bool(active)
        if dr.hint(limits.hide_emitters, mode="scalar"):
            visible &= depth > 0
        emitted, begins = _emitted(scene, si, origin, pdf_prev, delta_prev, visible), depth == start.depth
        emitted *= throughput - carried
        seen, radiance = dr.select(begins, emitted, seen), radiance + dr.select(begins, 0, emitted)
        hit |= begins & si.is_valid()
        active &= si.is_valid() & (depth + 1 < limits.max_depth)

        # ---------------------- Light from inside, and on opaque surfaces ----------------------
        taken: Any = None
        if dr.hint(records, mode="scalar"):
            here = dr.select(depth == start.depth, 0, slot)
            lobe, inside, answered = _record(translucency, vertices, here, lane, si, throughput, carried, shown, active)
            slot = dr.select((inside | answered) & (here > 0), slot + 1, slot)
            if dr.hint(opaque, mode="scalar"):
                throughput, carried, taken = _take(translucency, si, lobe, answered, throughput, carried, active)
                active &= dr.any(throughput != 0)

        # ---------------------- Emitter sampling ----------------------
        direct, sample, weight = _scatter(scene, sampler, si, active, throughput, taken, limits.differentiated)
        radiance += direct

        # ---------------------- The next direction ----------------------
        throughput *= weight
        if dr.hint(opaque, mode="scalar"):
            sent, carried = taken.along(si.wi, sample, weight)
            throughput -= sent
            shown &= ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.DiffuseReflection)
        ray = si.spawn_ray(si.to_world(sample.wo))
        origin = interaction(si)
        pdf_prev, delta_prev = sample.pdf, mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        depth += 1

        # ---------------------- Russian roulette ----------------------
        survival = _survival(throughput, depth > limits.rr_depth)
        active &= sampler.next_1d(active) < survival
        throughput *= dr.rcp(survival)
        if dr.hint(opaque, mode="scalar"):
            carried *= dr.rcp(survival)

    return radiance, seen, hit, vertices
