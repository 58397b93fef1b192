"""What the benchmarks of the single-pass method share: the eye points of a picture, and what its reference costs there.

The reference (AWB08 section 4.2.3) lights every irradiance sample of every body in view by Lightcuts. On large scenes
that takes hours, so it is run on a random part of the samples, in blocks of neighbours as the whole would be, and scaled up.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from pellucid.gather.gather import gather
from pellucid.gather.octree import build_octree
from pellucid.methods.single_pass.modes import CUT_ERROR, MODES, EyePoints, ModeSettings
from pellucid.methods.single_pass.paper.light_cut import light_cuts
from pellucid.methods.single_pass.state import LitPrototype, SinglePassScene
from pellucid.progress import chunks, steps
from support.scenes import load
from support.timing import run

RECEIVERS_AT_ONCE = 1 << 16
BLOCK = 64
"""Samples, or eye points, that are chosen together: they share most of a cut, and lanes of a launch are as coherent as usual."""


@dataclass
class Seen:
    """Eye points on the copies of one prototype, in a coherent order, and the exitance that a mode found there."""

    lit: LitPrototype
    eyes: EyePoints
    exitance: Any = None

    def __len__(self) -> int:
        return dr.width(self.eyes.p)

    def take(self, index: np.ndarray) -> Seen:
        """Select some of the eye points."""
        chosen = mi.UInt32(index.astype(np.uint32))
        eyes = EyePoints(
            dr.gather(mi.Point3f, self.eyes.p, chosen),
            dr.gather(mi.UInt32, self.eyes.copy, chosen),
            dr.gather(mi.Float, self.eyes.tolerance, chosen),
        )
        dr.eval(eyes)
        exitance = None if self.exitance is None else dr.gather(mi.Color3f, self.exitance, chosen)
        return Seen(self.lit, eyes, exitance)

    def copies(self) -> np.ndarray:
        """Tell which copies are in view."""
        return np.unique(self.eyes.copy.numpy())


@dataclass
class Cost:
    """Time and shadow rays of ``done`` items of work, scaled to ``total`` of them."""

    seconds: float
    shadow_rays: float
    done: int
    total: int


@dataclass
class Picture:
    """A picture, how long it took [s], and the state and the eye points that it leaves behind."""

    scene: Any
    integrator: Any
    image: np.ndarray
    seconds: float
    seen: list[Seen]

    @property
    def state(self) -> SinglePassScene:
        """Samples, lights, effort."""
        return self.integrator.prepared

    @property
    def stages(self) -> dict[str, float]:
        """Time [s] of samples, lights, exitance, and of the surface: all the rest."""
        stages = dict(self.state.effort.seconds)
        return stages | {"surface": self.seconds - sum(stages.values())}


def take_picture(spec: dict[str, Any], spp: int, warm: bool = True) -> Picture:
    """Render a scene whose integrator is `pellucid_single_pass`, by kernels that a small picture has compiled before."""
    scene = load(spec)
    if warm:
        few = {**spec["integrator"], "sample_count": 2000, "direct": 64, "indirect": 512}
        film = {**spec["sensor"]["film"], "width": 64, "height": 48}
        mi.load_dict(few).render(scene, mi.load_dict({**spec["sensor"], "film": film}), spp=spp)
        dr.sync_thread()
    integrator = mi.load_dict(spec["integrator"])
    integrator.prepared = integrator.prepare_scene(scene)
    with recording(integrator.mode) as seen:
        seconds, image = run(lambda: integrator.render(scene, spp=spp))
    return Picture(scene, integrator, np.array(image), seconds, seen)


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


@contextmanager
def recording(mode: str) -> Iterator[list[Seen]]:
    """Keep the eye points, and their exitance, of every call of a mode inside."""
    original, found = MODES[mode], []

    def recorder(scene, state, lit, eyes, settings):
        exitance = original(scene, state, lit, eyes, settings)
        found.append(Seen(lit, eyes, exitance))
        return exitance

    MODES[mode] = recorder
    try:
        yield found
    finally:
        MODES[mode] = original


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


def evaluate(
    scene: mi.Scene, state: SinglePassScene, mode: str, seen: list[Seen], settings: ModeSettings
) -> tuple[np.ndarray, float]:
    """Run a mode at eye points: exitance ``(n, 3)``, and the time [s]. It adds to ``state.effort``."""
    start = time.perf_counter()
    results = []
    for s in seen:
        result = MODES[mode](scene, state, s.lit, s.eyes, settings)
        dr.eval(result)
        results.append(result)
    dr.sync_thread()
    return np.concatenate([r.numpy().T for r in results]), time.perf_counter() - start


def evaluate_everywhere(
    scene: mi.Scene, state: SinglePassScene, seen: list[Seen], settings: ModeSettings
) -> tuple[list[Seen], float]:
    """Run the adaptive mode at all eye points of a picture, which share its rays: they with what was found, and the time [s]."""
    found, seconds = [], 0.0
    for s in seen:
        exitance, taken = evaluate(scene, state, "adaptive", [s], settings)
        found.append(Seen(s.lit, s.eyes, mi.Color3f(exitance.T)))
        seconds += taken
    return found, seconds


def forget_light(state: SinglePassScene) -> None:
    """Drop what two modes would share: the irradiance of samples, and factors in the cache."""
    state.shared.pop("cache", None)
    for lit in state.lit.values():
        lit.state.pop("powers", None)


# ------------------------------------------------------------------ the reference


def samples_in_view(seen: list[Seen]) -> int:
    """Count the irradiance samples of all bodies in view: those that the reference lights."""
    return sum(s.lit.samples.count * len(s.copies()) for s in seen)


def light_reference(
    scene: mi.Scene, state: SinglePassScene, seen: list[Seen], settings: ModeSettings, wanted: int, seed: int = 0
) -> Cost:
    """Light some of the samples of all bodies in view by Lightcuts, and scale time and rays up to all of them."""
    rng, total = np.random.default_rng(seed), samples_in_view(seen)
    spent, rays, done = 0.0, 0.0, 0
    for s in seen:
        copies, count = s.copies(), s.lit.samples.count
        here = len(copies) * count
        index = in_blocks(here, max(round(wanted * here / total), 1), rng)
        light_some(scene, state, s.lit, index[:BLOCK] % count, copies[index[:BLOCK] // count], settings)  # compiles
        start = time.perf_counter()
        traced = light_some(scene, state, s.lit, index % count, copies[index // count], settings)[1]
        spent += (time.perf_counter() - start) * here / len(index)
        rays += traced * here / len(index)
        done += len(index)
    return Cost(spent, rays, done, total)


def light_some(
    scene, state: SinglePassScene, lit: LitPrototype, leaf: np.ndarray, copy: np.ndarray, settings: ModeSettings
) -> tuple[np.ndarray, int]:
    """Find the light that enters at samples by Lightcuts: ``(n, 3)``, and the shadow rays."""
    found, rays = [], 0
    for first, size in steps("reference", chunks(len(leaf), RECEIVERS_AT_ONCE), "samples"):
        here = slice(first, first + size)
        numbers = [mi.UInt32(a[here].astype(np.uint32)) for a in (leaf, copy)]
        si = lit.samples.receiver(numbers[0], lit.placement, numbers[1])
        dr.eval(si)
        cuts = light_cuts(scene, si, lit.eta, state.lights, settings.max_error, settings.max_light_cut, settings.seed)
        found.append(cuts.entering.numpy().T)
        rays += int(cuts.shadow_rays.numpy().sum(dtype=np.int64))
    return np.concatenate(found), rays


def gather_reference(seen: list[Seen], bodies: int, seed: int = 0) -> tuple[float, Cost]:
    """Time the second pass of the reference: building octrees [s], and summing at the eye points of some bodies, scaled up.

    Where nothing is lit the sums take as long: samples carry their area for light.
    """
    start = time.perf_counter()
    octrees = [build_octree(s.lit.samples.p, s.lit.samples.area, np.zeros_like(s.lit.samples.p)) for s in seen]
    build = time.perf_counter() - start
    every = [(k, copy) for k, s in enumerate(seen) for copy in s.copies()]
    chosen = np.random.default_rng(seed).permutation(len(every))[:bodies]
    filling, summing, samples, points = 0.0, 0.0, 0, 0
    for number, place in enumerate([chosen[0], *chosen]):
        k, copy = every[place]
        lit = seen[k].lit
        here = seen[k].take(np.flatnonzero(seen[k].eyes.copy.numpy() == copy))
        start = time.perf_counter()
        octree = octrees[k].with_power(np.repeat(lit.samples.area[:, None], 3, axis=1))
        middle = time.perf_counter()
        dr.eval(gather(octree, lit.table, here.eyes.p, CUT_ERROR))
        dr.sync_thread()
        if number == 0:  # compiles
            continue
        filling, summing = filling + middle - start, summing + time.perf_counter() - middle
        samples, points = samples + lit.samples.count, points + len(here)
    all_points = sum(len(s) for s in seen)
    seconds = filling * samples_in_view(seen) / samples + summing * all_points / points
    return build, Cost(seconds, 0, points, all_points)
