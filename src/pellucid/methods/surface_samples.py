"""What the methods share that light samples of the surface by path tracing, once a scene, and sum over them at every point."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import PellucidError
from ..gather.derivatives import SumDerivatives
from ..kernels.memory import lanes_where
from ..light.irradiance import MOST_NEIGHBOURS, PathLight
from ..progress import steps
from ..scene.bodies import Role, acting_as
from ..scene.prototypes import Prototype, find_prototypes
from ..scene.samples.surface import SurfaceSamples
from .answer import Answer
from .close_lamps import add_close_light, close_light
from .contract import Method, Points
from .parameters import parameter
from .preparation import (
    LitBody,
    LitScene,
    check_samples_fit,
    count_samples,
    default_paths,
    light_samples,
    paths_of,
    spread_samples,
)

SEED_BITS = 20
"""The seeds of parts are so many bits apart."""

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

    neighbours: ClassVar[int] = MOST_NEIGHBOURS
    """Samples over which indirect light is averaged, at most."""

    @abstractmethod
    def spread_all(self, opened: LitScene) -> None:
        """Spread the samples of all bodies."""

    @abstractmethod
    def build(self, lit: LitBody[BodyState]) -> BodyState:
        """Build the state of one body from its samples and their light; where there is one, from its state under other light."""

    @abstractmethod
    def sum_up(
        self, lit: LitBody[BodyState], p: mi.Point3f, n: mi.Normal3f, indirectly: bool, stretch: Any = None
    ) -> mi.Color3f:
        """Sum the exitance at points of one body, all seen directly or all ``indirectly``, by way of another surface.

        Normals point outside; ``stretch`` is that of `Points`.
        """

    def derivatives(self, lit: LitBody[BodyState], names: list[str], indirectly: bool) -> SumDerivatives:
        """Give the derivatives of `sum_up` by the power of samples, and by the logarithms of what is named (`slopes.log_slopes`)."""
        raise NotImplementedError

    def summed(self, lit: LitBody[BodyState]) -> NDArray[np.uint32]:
        """Number the samples whose power `sum_up` depends on, once each."""
        return np.arange(len(lit.samples), dtype=np.uint32)

    @property
    def has_gradients(self) -> bool:
        """Whether there are `derivatives`; bodies that light each other by their exitance have none."""
        return type(self).derivatives is not LitSamplesMethod.derivatives and not self.translucent_passes

    def default_paths(self, sample_count: int) -> int:
        """Choose how many light paths each of all samples gets."""
        return default_paths(sample_count)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Spread samples, light them, and build what is summed; then light them again by what other bodies send."""
        self.spread_all(opened)
        self._light(scene, opened, Role.DIFFUSE, None)
        return self._go_on(scene, opened)

    def light_part(self, scene: mi.Scene, opened: LitScene, number: int, part: range, paths: int) -> PathLight:
        """Light some of the samples of one body, by so many paths each, as `prepare` does first."""
        with acting_as(Role.DIFFUSE, [lit.body for lit in opened.bodies]):
            return light_samples(scene, opened, number, self.light_limits, paths, self.seed, None, part)

    def paths_by_body(self, state: LitScene, counts: list[int]) -> list[int]:
        """Choose how many light paths each sample of each body gets, of which there are ``counts``."""
        paths = self.irradiance_paths or self.default_paths(sum(counts))
        return [paths if self.irradiance_paths else paths_of(lit, paths) for lit in state.bodies]

    def _go_on(self, scene: mi.Scene, state: LitScene) -> LitScene:
        """Build what is summed from lit samples; then light them again by what other bodies send."""
        for number, lit in enumerate(state.bodies):
            lit.close = close_light(scene, state, number, state.close_lamps(number))
        self._build(state)
        for _ in range(self.translucent_passes):
            self._light(scene, state, Role.SURFACE, Answer(self, scene, state, self.seed, from_eye=False))
            self._build(state)
        return state

    def _light(self, scene: mi.Scene, state: LitScene, role: Role, answer: Answer | None) -> None:
        """Light the samples of all bodies, while translucent surfaces act in a role."""
        paths = self.paths_by_body(state, [len(lit.samples) for lit in state.bodies])
        with acting_as(role, [lit.body for lit in state.bodies]):
            for number, (lit, own) in enumerate(zip(state.bodies, paths, strict=True)):
                light = light_samples(scene, state, number, self.light_limits, own, self.seed, answer)
                lit.irradiance = light.irradiance(lit.samples, self.neighbours)

    def _build(self, state: LitScene) -> None:
        """Build the states of all bodies."""
        for k, _ in steps("tree", [1] * len(state.bodies), "bodies"):
            state.bodies[k].state = self.build(state.bodies[k])

    def exitance(self, scene: mi.Scene, state: LitScene, points: Points) -> mi.Color3f:
        """Sum body by body, what is seen directly and what is not apart."""
        if state.elsewhere is not None:
            return state.elsewhere.exitance(points)
        result = dr.zeros(mi.Color3f, dr.width(points.p))
        for number, lit in enumerate(state.bodies, 1):
            if lit.state is None:  # its samples lie elsewhere
                continue
            for indirectly in (False, True):
                index = lanes_where((points.body == number) & ((points.tolerance > 1) == indirectly))
                if dr.width(index):
                    n = dr.gather(mi.Normal3f, points.n, index) * dr.opaque(mi.Float, lit.samples.outside)
                    p = dr.gather(mi.Point3f, points.p, index)
                    stretch = points.stretch_on(lit.body, index)
                    dr.scatter(result, self.sum_up(lit, p, n, indirectly, stretch), index)
            if lit.close is not None:
                add_close_light(result, points, number, lit, lit.samples.outside)
        return result


@dataclass
class SpreadSamplesMethod(SpreadParameters, LitSamplesMethod[BodyState]):
    """A method whose samples are spread evenly over the surface."""

    def count_samples(self, opened: LitScene, parts: int = 1) -> list[int]:
        """Choose how many samples each body gets, and check that there is memory for all, or for one of equal parts of them."""
        return self._count(opened, *find_prototypes([lit.body for lit in opened.bodies]), parts)

    def _count(
        self, opened: LitScene, prototypes: list[Prototype], places: NDArray[np.int64], parts: int = 1
    ) -> list[int]:
        """Count as `count_samples` does, where the prototypes of the bodies and ``places`` are known (`find_prototypes`)."""
        surfaces = [prototypes[number].surface for number in places[:, 0]]
        asked, most = self.sample_count, self.max_samples
        counts = [
            count_samples(lit, surface, asked, most) for lit, surface in zip(opened.bodies, surfaces, strict=True)
        ]
        check_samples_fit(-(-sum(counts) // parts))
        return counts

    def spread_all(self, opened: LitScene) -> None:
        """Spread samples on one of all bodies that are copies of each other, and move them to the others.

        There are ``A / (pi mfp^2)`` on each body, or a few thousand, unless a number is asked for (JB02 section 3).
        """
        prototypes, places = find_prototypes([lit.body for lit in opened.bodies])
        counts = self._count(opened, prototypes, places)
        for k, _ in steps("samples", [1] * len(prototypes), "bodies"):
            prototype, copies = prototypes[k], np.flatnonzero(places[:, 0] == k)
            number = counts[copies[0]]
            samples = spread_samples(prototype.bodies[0], prototype.surface, number, self.sampling, self.seed)
            for copy, to_world in zip(copies, prototype.to_world, strict=True):
                opened.bodies[copy].samples = samples.moved(to_world)

    def resume(
        self, scene: mi.Scene, opened: LitScene, samples: list[SurfaceSamples], light: list[PathLight]
    ) -> LitScene:
        """Prepare as `prepare` does, from samples that have been spread and lit elsewhere."""
        self.count_samples(opened)
        for lit, spread, measured in zip(opened.bodies, samples, light, strict=True):
            lit.samples, lit.irradiance = spread, measured.irradiance(spread, self.neighbours)
        return self._go_on(scene, opened)

    def check_parts(self) -> None:
        """Check that `prepare_part` knows of all that is asked for.

        Raises
        ------
        PellucidError
            With what needs all samples at once.
        """
        for asked, why in (
            (self.translucent_passes, "translucent_passes: bodies that light each other by their exitance need"),
            ("irradiance" in self.channels, "the channel 'irradiance' is that of the nearest of"),
        ):
            if asked:
                raise PellucidError(f"{why} all samples at once: leave it out, or --sample-parts (sample_parts).")

    def prepare_part(self, scene: mi.Scene, opened: LitScene, number: int, count: int) -> LitScene:
        """Prepare what lies on part ``number``, from 0 on, of ``count`` that have equally many samples.

        The samples of all bodies are divided in the order of bodies and of their triangles along a space-filling curve. A part is spread,
        lit and built as if its surface were all that there is of its bodies; a body that has none there has no state. The exitance is the
        sum of that of all parts. One part is what `prepare` makes.
        """
        prototypes, places = find_prototypes([lit.body for lit in opened.bodies])
        counts = self._count(opened, prototypes, places, count)
        paths = self.paths_by_body(opened, counts)
        seed = self.seed + (number << SEED_BITS)
        spread: dict[tuple[int, float, float], SurfaceSamples] = {}
        stretches = stretches_of_part(counts, number, count)
        for k, _ in steps("samples", [1] * len(stretches), "bodies"):
            body, first, last = stretches[k]
            lit, (which, copy) = opened.bodies[body], places[body]
            prototype = prototypes[which]
            if (which, first, last) not in spread:
                surface = prototype.surface.stretch(first, last)
                size = max(1, round(counts[body] * surface.area / prototype.surface.area))
                spread[which, first, last] = spread_samples(prototype.bodies[0], surface, size, self.sampling, seed)
            lit.samples = spread[which, first, last].moved(prototype.to_world[copy])
        with acting_as(Role.DIFFUSE, [lit.body for lit in opened.bodies]):
            for body, *_ in stretches:
                lit = opened.bodies[body]
                light = light_samples(scene, opened, body, self.light_limits, paths[body], seed, None)
                lit.irradiance = light.irradiance(lit.samples, self.neighbours)
        for k, _ in steps("tree", [1] * len(stretches), "bodies"):
            body, first, _ = stretches[k]
            lit = opened.bodies[body]
            if first == 0:  # once a body
                lit.close = close_light(scene, opened, body, opened.close_lamps(body))
            lit.state = self.build(lit)
        return opened


def stretches_of_part(counts: list[int], number: int, parts: int) -> list[tuple[int, float, float]]:
    """Divide the samples of all bodies into parts, and say which bodies one of them has, and between which shares, 0 to 1, of each."""
    ends = np.cumsum(counts)
    first, last = (ends[-1] * k / parts for k in (number, number + 1))
    stretches = []
    for body, (count, end) in enumerate(zip(counts, ends, strict=True)):
        begin, stop = (float(np.clip((edge - (end - count)) / count, 0, 1)) for edge in (first, last))
        if stop > begin:
            stretches.append((body, begin, stop))
    return stretches
