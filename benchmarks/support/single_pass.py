"""What the benchmarks of the single-pass method share: the eye points of a picture, and what its reference costs there.

The reference (AWB08 section 4.2.3) lights every irradiance sample of every body in view by Lightcuts. On large scenes
that takes hours, so it is run on a random part of the samples, in blocks of neighbours as the whole would be, and scaled up.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from pellucid.effort import Effort, observing
from pellucid.gather.gather import gather
from pellucid.gather.octree import build_octree
from pellucid.light.transport import Start, trace
from pellucid.methods.answer import Answer
from pellucid.methods.contract import Points
from pellucid.methods.single_pass.modes import CUT_ERROR
from pellucid.methods.single_pass.paper.light_cut import DEFAULT_MAX_CUT, light_cuts
from pellucid.methods.single_pass.samples import EyePoints, SampledPrototype
from pellucid.methods.single_pass.state import SinglePassScene
from pellucid.progress import chunks, steps
from pellucid.scene.bodies import Role, acting_as
from support.scenes import load
from support.timing import run

PUBLISHED = {"type": "pellucid_single_pass", "sampling": "poisson"}
"""The integrator, with samples as AWB08 has them."""

RECEIVERS_AT_ONCE = 1 << 16
BLOCK = 64
"""Samples, or eye points, that are chosen together: they share most of a cut, and lanes of a launch are as coherent as usual."""


class Cuts(NamedTuple):
    """Where Lightcuts end: the largest error bound of a cluster, as a part of the total, and the most clusters."""

    max_error: float
    max_cut: int = DEFAULT_MAX_CUT


@dataclass
class Seen:
    """Eye points on the copies of one prototype, in a coherent order, and the exitance that was found there."""

    number: int
    body: SampledPrototype
    eyes: EyePoints
    exitance: Any = None

    def __len__(self) -> int:
        return dr.width(self.eyes.p)

    def take(self, index: np.ndarray) -> Seen:
        """Select some of the eye points."""
        chosen = mi.UInt32(index.astype(np.uint32))
        eyes = dr.gather(EyePoints, self.eyes, chosen)
        dr.eval(eyes)
        exitance = None if self.exitance is None else dr.gather(mi.Color3f, self.exitance, chosen)
        return Seen(self.number, self.body, eyes, exitance)

    def copies(self) -> np.ndarray:
        """Tell which copies are in view."""
        return np.unique(self.eyes.copy.numpy())


@dataclass
class Cost:
    """Time and shadow rays of ``done`` items of work, scaled to ``total`` of them; and the standard error of the rays."""

    seconds: float
    shadow_rays: float
    done: int
    total: int
    standard_error: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        return Cost(
            self.seconds + other.seconds,
            self.shadow_rays + other.shadow_rays,
            self.done + other.done,
            self.total + other.total,
            float(np.hypot(self.standard_error, other.standard_error)),
        )


@dataclass
class Picture:
    """A picture, how long it took [s], what was spent, and its eye points with their exitance.

    ``points`` are all of them in the order in which they are asked for, ``pixel`` is where each is shown, and ``place`` has for each of
    ``seen`` the numbers of its eye points among them.
    """

    scene: Any
    integrator: Any
    image: np.ndarray
    seconds: float
    effort: Effort
    points: Points
    pixel: np.ndarray
    seen: list[Seen]
    place: list[np.ndarray]

    @property
    def state(self) -> SinglePassScene:
        """Samples, lights, and what the mode has prepared."""
        return self.integrator.prepared

    @property
    def stages(self) -> dict[str, float]:
        """Time [s] of samples, lights, exitance, and of the surface: all the rest."""
        stages = dict(self.effort.seconds)
        return stages | {"surface": self.seconds - sum(stages.values())}

    def prepared_with(self, **parameters: Any) -> tuple[SinglePassScene, Effort]:
        """Prepare the same view, lights and samples for other parameters; and tell what that takes."""
        method = self.integrator.method.with_parameters(**parameters)
        with observing() as effort:
            state = method.prepare_view(self.scene, self.state, self.state.view_points)
        return state, effort


def take_picture(spec: dict[str, Any], spp: int, warm: bool = True) -> Picture:
    """Render a scene whose integrator is `pellucid_single_pass`, by kernels that a small picture has compiled before."""
    scene = load(spec)
    if warm:
        few = {**spec["integrator"], "sample_count": 2000, "direct": 64, "indirect": 512}
        film = {**spec["sensor"]["film"], "width": 64, "height": 48}
        mi.load_dict(few).render(scene, mi.load_dict({**spec["sensor"], "film": film}), spp=spp)
        dr.sync_thread()
    integrator = mi.load_dict(spec["integrator"])

    def picture() -> Any:
        integrator.prepared = integrator.prepare_scene(scene)
        return integrator.render(scene, spp=spp)

    with observing() as effort:
        seconds, image = run(picture)
    state = integrator.prepared
    points, pixel = asked_points(scene, integrator, spp)
    parts = [(k, *state.eye_points(points, k, here)) for k, here in state.by_prototype(points).items()]
    seen = [Seen(k, state.samples_of(k), eyes, state.of_prototype(scene, k, eyes)) for k, eyes, _ in parts]
    place = [index.numpy() for _, _, index in parts]
    return Picture(scene, integrator, np.array(image), seconds, effort, points, pixel, seen, place)


def asked_points(scene: Any, integrator: Any, spp: int) -> tuple[Points, np.ndarray]:
    """Find the points that a picture asks for, in their order, and the pixel of each."""
    sensor, method = scene.sensors()[0], integrator.method
    sampler, _ = integrator.prepare(sensor, 0, spp, integrator.aov_names())
    ray, _, _ = integrator.sample_rays(scene, sensor, sampler)
    answer = Answer(method, scene, integrator.prepared, 0, True, sampler.sample_count())
    with acting_as(Role.SURFACE, [lit.body for lit in integrator.prepared.bodies]):
        *_, vertices = trace(scene, sampler, Start.camera(ray), method.limits, answer, mi.Bool(True))
        points, asked, _ = answer.points(vertices)
    dr.eval(points)
    return points, asked.numpy().astype(np.int64) % vertices.width // sampler.sample_count()


def polygons(spec: dict[str, Any]) -> int:
    """Count the polygons of a built-in scene, those of every instance included."""

    def of(entry: Any) -> int:
        if not isinstance(entry, dict):
            return entry.face_count() if hasattr(entry, "face_count") else 0
        if entry.get("type") == "instance":
            return of(spec[entry["group"]["id"]] | {"type": "copies"})
        if entry.get("type") == "copies":
            return sum(of(part) for part in entry.values())
        return int(entry.get("type") == "rectangle")

    return sum(of(entry) for entry in spec.values())


# ------------------------------------------------------------------ eye points


def only_by_others(seen: list[Seen]) -> list[Seen]:
    """Leave out eye points on bodies that primary rays meet: those on bodies that are seen only by way of another surface are left."""
    rest = []
    for s in seen:
        direct = np.unique(s.eyes.copy.numpy()[s.eyes.tolerance.numpy() <= 1])
        rest.append(s.take(np.flatnonzero(~np.isin(s.eyes.copy.numpy(), direct))))
    return [s for s in rest if len(s)]


def at_once(seen: list[Seen]) -> list[Seen]:
    """Leave out eye points that are seen only by way of another surface, of which less accuracy is asked."""
    direct = [(s, np.flatnonzero(s.eyes.tolerance.numpy() <= 1)) for s in seen]
    return [s.take(index) for s, index in direct if len(index)]


def in_blocks(count: int, wanted: int, rng: np.random.Generator, block: int = BLOCK) -> np.ndarray:
    """Choose about ``wanted`` of the numbers below ``count``, in random blocks of neighbours; all where that is not fewer."""
    if wanted >= count:
        return np.arange(count)
    first = np.sort(rng.permutation(-(-count // block))[: max(round(wanted / block), 1)]) * block
    index = (first[:, None] + np.arange(block)).ravel()
    return index[index < count]


def some(seen: list[Seen], wanted: int, rng: np.random.Generator, block: int = BLOCK) -> list[Seen]:
    """Choose about ``wanted`` of all eye points, in random blocks of neighbours."""
    ends = np.cumsum([len(s) for s in seen])
    index = in_blocks(int(ends[-1]), wanted, rng, block)
    owner = np.searchsorted(ends, index, side="right")
    return [s.take(index[owner == k] - (ends[k] - len(s))) for k, s in enumerate(seen) if np.any(owner == k)]


def values(seen: list[Seen]) -> np.ndarray:
    """Lay out the exitance of all eye points: ``(n, 3) float``."""
    return np.concatenate([s.exitance.numpy().T for s in seen])


def evaluate(scene: mi.Scene, state: SinglePassScene, seen: list[Seen]) -> tuple[list[Seen], Effort, float]:
    """Evaluate what is prepared at eye points: they with their exitance, what was spent, and the time [s]."""
    start = time.perf_counter()
    with observing() as effort:
        found = [Seen(s.number, s.body, s.eyes, state.of_prototype(scene, s.number, s.eyes)) for s in seen]
        dr.sync_thread()
    return found, effort, time.perf_counter() - start


# ------------------------------------------------------------------ the reference


def samples_in_view(seen: list[Seen]) -> int:
    """Count the irradiance samples of all bodies in view: those that the reference lights."""
    return sum(s.body.samples.count * len(s.copies()) for s in seen)


def light_reference(
    scene: mi.Scene, state: SinglePassScene, seen: list[Seen], cuts: Cuts, wanted: int, seed: int = 0
) -> Cost:
    """Light some of the samples of all bodies in view by Lightcuts, and scale time and rays up to all of them.

    The standard error is that of the rays: blocks of neighbours, drawn at random from each prototype, differ by so much.
    """
    rng, total = np.random.default_rng(seed), samples_in_view(seen)
    spent, rays, done, variance = 0.0, 0.0, 0, 0.0
    for s in seen:
        copies, count = s.copies(), s.body.samples.count
        here = len(copies) * count
        index = in_blocks(here, max(round(wanted * here / total), 1), rng)
        light_some(scene, state, s.body, index[:BLOCK] % count, copies[index[:BLOCK] // count], cuts)  # compiles
        start = time.perf_counter()
        traced = light_some(scene, state, s.body, index % count, copies[index // count], cuts)[1]
        spent += (time.perf_counter() - start) * here / len(index)
        rays += float(traced.sum()) * here / len(index)
        done += len(index)
        if len(index) < here:
            means = np.add.reduceat(traced, np.arange(0, len(traced), BLOCK)) / BLOCK
            variance += here**2 * float(means.var()) / len(means) * (1 - len(index) / here)
    return Cost(spent, rays, done, total, float(np.sqrt(variance)))


def light_some(
    scene, state: SinglePassScene, body: SampledPrototype, leaf: np.ndarray, copy: np.ndarray, cuts: Cuts, seed=0
) -> tuple[np.ndarray, np.ndarray]:
    """Find the light that enters at samples by Lightcuts: ``(n, 3)``, and the shadow rays of each: ``(n,)``."""
    found, rays, lights = [], [], state.lights(scene)
    for first, size in steps("reference", chunks(len(leaf), RECEIVERS_AT_ONCE), "samples"):
        here = slice(first, first + size)
        numbers = [mi.UInt32(a[here].astype(np.uint32)) for a in (leaf, copy)]
        si = body.samples.receiver(numbers[0], body.placement, numbers[1])
        dr.eval(si)
        lit = light_cuts(scene, si, body.eta, lights, cuts.max_error, cuts.max_cut, seed)
        found.append(lit.entering.numpy().T)
        rays.append(lit.shadow_rays.numpy().astype(float))
    return np.concatenate(found), np.concatenate(rays)


def gather_reference(seen: list[Seen], bodies: int, seed: int = 0) -> tuple[float, Cost]:
    """Time the second pass of the reference: building octrees [s], and summing at the eye points of some bodies, scaled up.

    Where nothing is lit the sums take as long: samples carry their area for light.
    """
    start = time.perf_counter()
    octrees = [build_octree(s.body.samples.p, s.body.samples.area, np.zeros_like(s.body.samples.p)) for s in seen]
    build = time.perf_counter() - start
    every = [(k, copy) for k, s in enumerate(seen) for copy in s.copies()]
    chosen = np.random.default_rng(seed).permutation(len(every))[:bodies]
    filling, summing, samples, points = 0.0, 0.0, 0, 0
    for number, place in enumerate([chosen[0], *chosen]):
        k, copy = every[place]
        body = seen[k].body
        here = seen[k].take(np.flatnonzero(seen[k].eyes.copy.numpy() == copy))
        start = time.perf_counter()
        octree = octrees[k].with_power(np.repeat(body.samples.area[:, None], 3, axis=1))
        middle = time.perf_counter()
        dr.eval(gather(octree, body.table, here.eyes.p, CUT_ERROR))
        dr.sync_thread()
        if number == 0:  # compiles
            continue
        filling, summing = filling + middle - start, summing + time.perf_counter() - middle
        samples, points = samples + body.samples.count, points + len(here)
    all_points = sum(len(s) for s in seen)
    seconds = filling * samples_in_view(seen) / samples + summing * all_points / points
    return build, Cost(seconds, 0, points, all_points)
