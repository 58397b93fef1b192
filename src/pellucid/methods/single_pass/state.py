"""What the single-pass method keeps of a scene: prototypes with their samples, made when they are first seen, and lights."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.memory import memory_at_hand
from ...light.points.discretise import discretise
from ...light.points.records import LightSamples
from ...model.profiles import ProfileTable
from ...progress import steps
from ...scene.bodies import Role, acting_as
from ...scene.prototypes import Prototype
from ...scene.samples.surface import check_sample_count, default_sample_count, sample_surface
from ..preparation import LitBody, LitScene, outside, sample_profile, textured
from .trees.light_tree import build_light_tree
from .trees.sample_tree import Placement, SampleTree, build_placement, build_sample_tree

DARK, MOST_LENIENT = 0.1, 8.0
"""Share of the brightest medium's reflectance below which errors stop to be relative; and the largest factor by which."""

RECEIVERS = 4096
"""Points on bodies that are seen, for which virtual point lights are chosen."""


@dataclass
class Effort:
    """What a picture took, in the terms of AWB08 figures 5 and 7; ``seconds`` by stage.

    ``links`` counts the terms of all sums at eye points: triples of the cut, or clusters; ``receivers`` the irradiance
    samples or clusters whose light was measured; ``samples`` those that were spread, copies included.
    """

    shadow_rays: int = 0
    eye_points: int = 0
    links: int = 0
    receivers: int = 0
    cache_hits: int = 0
    full_cuts: int = 0
    samples: int = 0
    violations: int = 0
    light_samples: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the time of what is inside to a stage."""
        begin = time.perf_counter()
        yield
        dr.sync_thread()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin


@dataclass
class LitPrototype:
    """A prototype whose copies are seen: its samples, their tree, the profile, and what a mode adds (``state``)."""

    prototype: Prototype
    samples: SampleTree
    placement: Placement
    table: ProfileTable
    state: dict[str, Any] = field(default_factory=dict)

    @property
    def eta(self) -> float:
        """Relative index of refraction."""
        return float(self.prototype.bodies[0].medium.eta)


@dataclass
class SinglePassScene(LitScene):
    """Bodies by prototype: ``places (b, 2)`` has the prototype and the copy of each; and the lights, once there are eye points.

    ``shared`` holds what a mode shares among prototypes.
    """

    prototypes: list[Prototype] = field(default_factory=list)
    places: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    lit: dict[int, LitPrototype] = field(default_factory=dict)
    lights: Any = None
    """`LightTree`, once there are eye points."""
    effort: Effort = field(default_factory=Effort)
    shared: dict[str, Any] = field(default_factory=dict)

    def see(self, bodies: np.ndarray, settings: Any, point_samples: bool) -> None:
        """Spread samples on the prototypes of bodies that are seen for the first time."""
        new = [int(k) for k in np.unique(self.places[bodies, 0]) if k not in self.lit]
        if not new:
            return
        with self.effort.timed("samples"), memory_at_hand():
            for number, _ in steps("samples", [1] * len(new), "prototypes"):
                prototype = self.prototypes[new[number]]
                self.lit[new[number]] = lit = light_prototype(prototype, settings, point_samples, self.effort)
                self.effort.samples += lit.samples.count * len(prototype.bodies)

    def discretise(
        self, scene: mi.Scene, bodies: np.ndarray, direct: int, indirect: int, depth: int, seed: int
    ) -> None:
        """Turn the light of the scene into points, chosen for what is seen: ``bodies`` has one entry an eye point."""
        if self.lights is not None:
            return
        diffuse = acting_as(Role.DIFFUSE, [lit.body for lit in self.bodies])
        with self.effort.timed("lights"), memory_at_hand(), diffuse:
            receivers = self._receivers(bodies, np.random.default_rng(seed))
            for _ in steps("lights", [1], "trees"):
                samples: LightSamples = discretise(scene, direct, indirect, seed, depth, receivers)
                self.lights = build_light_tree(samples)
            self.effort.light_samples = len(samples)

    def leniency(self, lit: LitPrototype) -> float:
        """Say how much less exact a dark body may be: it is judged by a tenth of what the brightest medium would reflect."""
        bright = [
            float(np.mean(each.prototype.bodies[0].medium.total_diffuse_reflectance)) for each in self.lit.values()
        ]
        own = float(np.mean(lit.prototype.bodies[0].medium.total_diffuse_reflectance))
        return float(np.clip(DARK * max(bright) / max(own, 1e-6), 1, MOST_LENIENT))

    def _receivers(self, bodies: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw points on the bodies that are seen, the more the more is seen of them; with normals."""
        chosen = self.places[rng.choice(bodies, RECEIVERS)]
        points, normals = [], []
        for k in np.unique(chosen[:, 0]):
            lit = self.lit[int(k)]
            copy = chosen[chosen[:, 0] == k, 1]
            leaf = rng.integers(0, lit.samples.count, len(copy))
            si = lit.samples.receiver(
                mi.UInt32(leaf.astype(np.uint32)), lit.placement, mi.UInt32(copy.astype(np.uint32))
            )
            points.append(si.p.numpy().T)
            normals.append(si.sh_frame.n.numpy().T)
        return np.concatenate(points), np.concatenate(normals)


def light_prototype(prototype: Prototype, settings: Any, point_samples: bool, effort: Effort) -> LitPrototype:
    """Spread the samples of a prototype and cluster them (AWB08 section 5.3)."""
    body, surface = prototype.bodies[0], prototype.surface
    mfp = float(np.min(body.medium.mfp))
    count = settings.sample_count or default_sample_count(surface.area, mfp)
    check_sample_count(
        count, settings.max_samples, name=body.name, extent=surface.extent, mfp=mfp, scale=body.bsdf.scale
    )
    method = "poisson" if settings.sampling == "auto" else settings.sampling
    samples = sample_surface(surface, count, method, settings.seed, mfp)
    effort.violations += samples.violations
    lit: LitBody[None] = LitBody(body, samples, outside(samples))
    tree = build_sample_tree(samples, lit.outside, textured(lit))
    placement = build_placement(np.stack(prototype.to_world))
    return LitPrototype(prototype, tree, placement, sample_profile(lit, point_samples))
