"""What the methods share that light samples of the surface by path tracing, once a scene, and sum over them at every point."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import drjit as dr
import mitsuba as mi

from ..kernels.memory import lanes_where
from ..progress import steps
from ..scene.bodies import Role, acting_as
from .answer import Answer
from .contract import Method, Points
from .parameters import parameter
from .preparation import LitBody, LitScene, default_paths, light_samples, paths_of, spread_samples, warn_of_lamps

SAMPLINGS = ("auto", "relaxed", "repulsion", "poisson", "uniform")

BodyState = TypeVar("BodyState")


@dataclass
class SpreadParameters:
    """How samples are spread over surfaces."""

    sampling: str = parameter("auto", choices=SAMPLINGS)
    sample_count: int = parameter(0, at_least=0)
    max_samples: int = parameter(20_000_000, at_least=1)
    point_samples: bool = parameter(False)


@dataclass
class LightParameters:
    """How many paths measure the irradiance at samples."""

    irradiance_paths: int = parameter(0, at_least=0)
    translucent_passes: int = parameter(0, at_least=0)


@dataclass
class LitSamplesMethod(LightParameters, Method[LitScene], Generic[BodyState]):
    """A method whose bodies have lit samples each. A subclass says how they are spread, and what is built from their light."""

    @abstractmethod
    def spread(self, lit: LitBody[BodyState]) -> None:
        """Spread the samples of one body."""

    @abstractmethod
    def build(self, lit: LitBody[BodyState]) -> BodyState:
        """Build the state of one body from its samples and their light; where there is one, from its state under other light."""

    @abstractmethod
    def sum_up(self, lit: LitBody[BodyState], p: mi.Point3f, indirectly: bool) -> mi.Color3f:
        """Sum the exitance at points of one body, all seen directly or all ``indirectly``, by way of another surface."""

    def default_paths(self, sample_count: int) -> int:
        """Choose how many light paths each of all samples gets."""
        return default_paths(sample_count)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Spread samples, light them, and build what is summed; then light them again by what other bodies send."""
        for k, _ in steps("samples", [1] * len(opened.bodies), "bodies"):
            self.spread(opened.bodies[k])
        warn_of_lamps(scene, opened)
        self._light(scene, opened, Role.DIFFUSE, None)
        for _ in range(self.translucent_passes):
            self._light(scene, opened, Role.SURFACE, Answer(self, scene, opened, self.seed, from_eye=False))
        return opened

    def _light(self, scene: mi.Scene, state: LitScene, role: Role, answer: Answer | None) -> None:
        """Light the samples of all bodies, while translucent surfaces act in a role, and build their states."""
        paths = self.irradiance_paths or self.default_paths(sum(len(lit.samples) for lit in state.bodies))
        with acting_as(role, [lit.body for lit in state.bodies]):
            for lit in state.bodies:
                own = paths if self.irradiance_paths else paths_of(lit, paths)
                light_samples(scene, lit, self.light_limits, own, self.seed, answer)
        for k, _ in steps("tree", [1] * len(state.bodies), "bodies"):
            state.bodies[k].state = self.build(state.bodies[k])

    def exitance(self, scene: mi.Scene, state: LitScene, points: Points) -> mi.Color3f:
        """Sum body by body, what is seen directly and what is not apart."""
        result = dr.zeros(mi.Color3f, dr.width(points.p))
        for number, lit in enumerate(state.bodies, 1):
            for indirectly in (False, True):
                index = lanes_where((points.body == number) & ((points.tolerance > 1) == indirectly))
                if dr.width(index):
                    value = self.sum_up(lit, dr.gather(mi.Point3f, points.p, index), indirectly)
                    dr.scatter(result, value, index)
        return result


@dataclass
class SpreadSamplesMethod(SpreadParameters, LitSamplesMethod[BodyState]):
    """A method whose samples are spread evenly over the surface."""

    def spread(self, lit: LitBody[BodyState]) -> None:
        """Spread the samples of one body."""
        spread_samples(lit, self.sampling, self.sample_count, self.max_samples, self.seed)
