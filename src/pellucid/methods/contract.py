"""The path tracer that all methods share: surfaces reflect by their BSDFs, translucent ones also emit their exitance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
from mitsuba.python.ad.integrators.common import ADIntegrator

from ..errors import PellucidError
from ..light.irradiance import LANES
from ..light.transport import SLOTS, Limits, Start, Vertices, trace
from ..progress import steps
from ..scene.bodies import Role, acting_as
from . import aovs as aov_channels
from .preparation import LitBody, LitScene, SampleSettings, default_paths, light_samples, open_scene, spread_samples

LIGHT_RR_DEPTH = 2
"""Paths that measure irradiance play Russian roulette early: the profile averages over so many of them that its noise does
not show, and the time saved buys more paths."""

SAMPLINGS = ("auto", "repulsion", "poisson", "uniform")


class Answer:
    """Answers the translucent vertices of paths with the exitance of one method (``light.transport.Translucency``).

    What the eye sees at once (``from_eye``, the first vertices) is asked for exactly; what it sees by way of another
    surface may be coarser. ``per_pixel`` consecutive paths belong to one pixel.
    """

    def __init__(
        self,
        method: TranslucentIntegrator,
        scene: mi.Scene,
        lit: LitScene,
        seed: int,
        from_eye: bool,
        per_pixel: int = 1,
    ):
        self.method, self.scene, self.lit, self.seed, self.from_eye = method, scene, lit, seed, from_eye
        self.per_pixel = per_pixel
        self.lookup, self.eta_table, self.needs_normals = lit.lookup, lit.eta_table, method.needs_normals
        self.first_exitance = mi.Color3f(0)
        self.first_body = mi.UInt32(0)

    def radiance(self, vertices: Vertices) -> mi.Color3f:
        """Sum weight times ``B / (pi T_d)`` over the vertices of each path (JB02 eq. 14)."""
        dr.eval(vertices)
        total = dr.zeros(mi.Color3f, vertices.width)
        for slot, (body, exitance) in enumerate(self.method.exitances(self, vertices)):
            lane = dr.arange(mi.UInt32, vertices.width) + slot * vertices.width
            leave = dr.gather(mi.Float, self.lit.leave_table, body)
            weight = dr.gather(mi.Color3f, vertices.weight, lane, body != 0)
            total += dr.select(body != 0, weight * exitance * leave, 0)
            if slot == 0:
                self.first_exitance, self.first_body = exitance, body
        return total

    def is_coarse(self, slot: int) -> bool:
        """Tell whether the vertices of a slot are seen only by way of another surface."""
        return slot > 0 or not self.from_eye


class TranslucentIntegrator(ADIntegrator):
    """Base of all methods. A subclass says how the exitance is prepared (``build``) and summed (``exitance``)."""

    uses_samples = True
    needs_normals = False
    lit_by_paths = True
    paths_at_once = LANES

    def __init__(self, props):
        super().__init__(props)
        self.hide_emitters = bool(props.get("hide_emitters", False))
        self.translucent_passes = _at_least(props, "translucent_passes", 0, 0) if self.lit_by_paths else 0
        self.limits = Limits(self.max_depth, self.rr_depth, self.hide_emitters)
        light_depth = _at_least(props, "irradiance_depth", max(self.max_depth, 2), 2, endless=-1)
        self.light_limits = Limits(light_depth, LIGHT_RR_DEPTH)
        sampling = str(props.get("sampling", "auto"))
        if sampling not in SAMPLINGS:
            raise PellucidError(f"sampling is one of {', '.join(SAMPLINGS)}; found '{sampling}'.")
        self.settings = SampleSettings(
            sampling,
            _at_least(props, "sample_count", 0, 0),
            _at_least(props, "max_samples", 20_000_000, 1),
            _at_least(props, "irradiance_paths", 0, 0) if self.lit_by_paths else 0,
            _at_least(props, "seed", 0, 0),
        )
        self.point_samples = bool(props.get("point_samples", False))
        self.aovs = aov_channels.parse(str(props.get("aovs", "")))
        self.prepared: LitScene | None = None

    # ------------------------------------------------------------------ what a method defines

    def spread(self, lit: LitBody) -> None:
        """Spread the samples of one body."""
        spread_samples(lit, self.settings)

    def default_paths(self, sample_count: int) -> int:
        """Choose how many light paths each of all samples gets."""
        return default_paths(sample_count)

    def build(self, lit: LitBody) -> Any:
        """Build the state of one body from its samples and their light."""
        raise NotImplementedError

    def exitance(
        self, scene: mi.Scene, lit: LitBody, p: mi.Point3f, n: mi.Normal3f | None, seed: int, coarse: bool
    ) -> mi.Color3f:
        """Evaluate the radiant exitance at points of one body; ``coarse`` where it is seen only by way of another surface."""
        raise NotImplementedError

    def exitances(self, answer: Answer, vertices: Vertices) -> Iterator[tuple[mi.UInt32, mi.Color3f]]:
        """Evaluate the exitance at all vertices: body numbers and exitance, slot by slot."""
        for slot in range(SLOTS):
            lane = dr.arange(mi.UInt32, vertices.width) + slot * vertices.width
            body = dr.gather(mi.UInt32, vertices.body, lane)
            exitance = dr.zeros(mi.Color3f, vertices.width)
            for k, lit in enumerate(answer.lit.bodies):
                index = dr.compress(body == k + 1)
                if dr.width(index) == 0:
                    continue
                place = dr.gather(mi.UInt32, lane, index)
                p = dr.gather(mi.Point3f, vertices.p, place)
                n = dr.gather(mi.Normal3f, vertices.n, place) if vertices.n is not None else None
                answer.seed += 1  # of the methods that draw numbers
                value = self.exitance(answer.scene, lit, p, n, answer.seed, answer.is_coarse(slot))
                dr.scatter(exitance, value, index)
            yield body, exitance

    # ------------------------------------------------------------------ the two passes

    def prepare_scene(self, scene: mi.Scene) -> LitScene:
        """Spread samples, light them, and build what the second pass reads: once for static light and geometry.

        Assign the result to ``prepared`` and every later ``render`` starts from it (a turntable); else each prepares anew.
        """
        lit_scene = open_scene(scene)
        if self.uses_samples:
            for k, _ in steps("samples", [1] * len(lit_scene.bodies), "bodies"):
                self.spread(lit_scene.bodies[k])
            self._light(scene, lit_scene, Role.DIFFUSE, None)
        self._build_all(lit_scene)
        for _ in range(self.translucent_passes if self.uses_samples else 0):
            answer = Answer(self, scene, lit_scene, self.settings.seed, from_eye=False)
            self._light(scene, lit_scene, Role.SURFACE, answer)
            self._build_all(lit_scene)
        return lit_scene

    def _light(self, scene: mi.Scene, lit_scene: LitScene, role: Role, answer: Answer | None) -> None:
        """Light the samples of all bodies, while translucent surfaces act in a role."""
        paths = self.settings.irradiance_paths or self.default_paths(sum(len(lit.samples) for lit in lit_scene.bodies))
        with acting_as(role, [lit.body for lit in lit_scene.bodies]):
            for lit in lit_scene.bodies:
                light_samples(scene, lit, self.light_limits, paths, self.settings.seed, answer)

    def _build_all(self, lit_scene: LitScene) -> None:
        """Build the state of every body."""
        for k, _ in steps("tree", [1] * len(lit_scene.bodies), "bodies"):
            lit_scene.bodies[k].state = self.build(lit_scene.bodies[k])

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render as Mitsuba's integrators do, in as many passes over the picture as memory asks for."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        with dr.suspend_grad():
            lit_scene = self.prepared or self.prepare_scene(scene)
            film = sensor.film()
            sampler, spp = self.prepare(sensor, seed, spp, self.aov_names())
            size = film.crop_size() + (2 * film.rfilter().border_size() if film.sample_border() else 0)
            pixels = int(dr.prod(size))
            per_pass = max(
                d for d in range(1, spp + 1) if spp % d == 0 and (d == 1 or d * pixels <= self.paths_at_once)
            )
            with acting_as(Role.SURFACE, [lit.body for lit in lit_scene.bodies]):
                for first, paths in steps("picture", [pixels * per_pass] * (spp // per_pass), "paths"):
                    pass_seed = (seed + first) % 2**32
                    if per_pass < spp:
                        sampler.set_sample_count(per_pass)  # some samplers round it up to what they can stratify
                        sampler.set_samples_per_wavefront(sampler.sample_count())
                        sampler.seed(pass_seed, paths // per_pass * sampler.sample_count())
                    answer = Answer(self, scene, lit_scene, pass_seed, True, sampler.sample_count())
                    self._render_pass(scene, sensor, sampler, film, answer)
            return film.develop() if develop else None

    def _render_pass(self, scene, sensor, sampler, film, answer: Answer) -> None:
        """Trace a few samples of every pixel and add them to the film."""
        ray, weight, pos = self.sample_rays(scene, sensor, sampler)
        radiance, hit, vertices = trace(scene, sampler, Start.camera(ray), self.limits, answer, mi.Bool(True))
        dr.eval(radiance, hit, weight, pos, vertices)
        radiance += answer.radiance(vertices)
        first = aov_channels.FirstPoints(answer.first_body, answer.first_exitance)
        channels = aov_channels.evaluate(self.aovs, scene, sampler, ray, answer.lit, first, self.limits, answer)
        block = film.create_block()
        block.set_coalesce(block.coalesce() and sampler.sample_count() >= 4)
        alpha = dr.select(hit, mi.Float(1), mi.Float(0))
        ADIntegrator._splat_to_block(block, film, pos, radiance * weight, 1.0, alpha, channels, ray.wavelengths)
        film.put_block(block)
        film.schedule_storage()
        dr.eval()

    def aov_names(self):
        """Name the extra channels."""
        return [f"{name}.{c}" for name in self.aovs for c in "RGB"]

    def to_string(self):
        """Describe the integrator in Mitsuba's form."""
        return f"{type(self).__name__}[max_depth = {self.max_depth}, {self.settings}]"


ENDLESS = 0xFFFFFFFF


def _at_least(props, name: str, default: int, lowest: int, endless: int | None = None) -> int:
    """Read a whole number and check its range; the value ``endless`` stands for no bound at all."""
    value = props.get(name, default)
    if value == endless:
        return ENDLESS
    if int(value) != value or value < lowest:
        raise PellucidError(f"{name} is a whole number of at least {lowest}; found {value}.")
    return int(value)
