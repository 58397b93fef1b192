"""What the single-pass method prepares of a scene: prototypes with their samples, lights, and what a mode makes of both."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...effort import count, timed
from ...kernels.memory import lanes_where, rows, upload
from ...kernels.morton import morton_order
from ...light.lamps import CloseLamps
from ...light.points.discretise import discretise
from ...light.points.records import LightSamples
from ...progress import steps
from ...scene.bodies import Role, acting_as
from ...scene.prototypes import Prototype
from ..close_lamps import add_close_light
from ..contract import Points
from ..preparation import LitScene
from ..surface_samples import SpreadParameters
from .adaptive.algorithm import Covering
from .modes import Exact, Mode
from .reflected import without_light_from_inside
from .samples import EyePoints, SampledPrototype, sample_prototype
from .surfaces import SurfaceLight, light_surfaces
from .trees.light_tree import LightTree, build_light_tree

RECEIVERS = 4096
"""Points on bodies, for which virtual point lights are chosen."""

EVERYWHERE = 1 << 20
"""Without a view: clusters of all bodies together whose irradiance is measured."""

OUTSIDE_LEVEL, OUTSIDE_TOLERANCE = 10, 64.0
"""With a view: level of the tree of each copy down to which irradiance is measured that no eye point needs (1024 clusters), and how many
times larger its error may be."""


@dataclass
class LightParameters:
    """How the light of the scene is turned into points: numbers of points on emitters and of virtual ones, depth of light paths, seed;
    and the lamps that are too near for samples."""

    direct: int
    indirect: int
    depth: int
    seed: int
    close: CloseLamps | None = None


@dataclass
class SinglePassScene(LitScene):
    """The bodies of a scene by prototype, and what is prepared for one view.

    Attributes
    ----------
    places : (b, 2) int
        The prototype and the copy of each body.
    spread, light : SpreadParameters, LightParameters
        How samples and lights are made.
    sampled : dict
        Prototypes that have samples, by number. They depend on no view.
    mode : Mode
        How sums are prepared and evaluated.
    prepared : dict
        What the mode has made of the prototypes in view; and of others, when they are first asked for. The latter depends on the prototype
        and the lights alone, and not on what was asked before.
    weight : (b,) float
        How much of the view shows each body.
    covering : Covering
        What is measured where no eye point is.
    view_points : Points, optional
        The points of the view.
    surfaces : SurfaceLight, optional
        How opaque surfaces are lit.
    """

    prototypes: list[Prototype] = field(default_factory=list)
    places: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    spread: SpreadParameters = field(default_factory=SpreadParameters)
    light: LightParameters = field(default_factory=lambda: LightParameters(0, 0, 0, 0))
    sampled: dict[int, SampledPrototype] = field(default_factory=dict)
    mode: Mode[Any] = field(default_factory=Exact)
    prepared: dict[int, Any] = field(default_factory=dict)
    weight: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    covering: Covering = field(default_factory=lambda: Covering(OUTSIDE_LEVEL, OUTSIDE_TOLERANCE))
    view_points: Points | None = None
    surfaces: SurfaceLight | None = None
    _lights: LightTree | None = None
    _samples: LightSamples = field(default_factory=LightSamples.none)

    def see(self, scene: mi.Scene, view: Points | None) -> None:
        """Prepare all prototypes that a view shows for its points; without a view, all that there are."""
        self.view_points = view
        if view is None:
            self.weight = np.array([self.prototypes[k].surface.area for k in self.places[:, 0]])
            self.covering = Covering((EVERYWHERE // len(self.places)).bit_length() - 1, 1.0)
            shown: dict[int, NDArray[np.uint32]] = {k: np.zeros(0, np.uint32) for k in range(len(self.prototypes))}
        else:
            seen = np.bincount(view.body.numpy().astype(np.int64) - 1, minlength=len(self.places))
            self.weight = seen[: len(self.places)].astype(float)
            count("view points", int(self.weight.sum()))
            shown = self.by_prototype(view)
        for number, _ in steps("samples", [1] * len(shown), "prototypes"):
            self.samples_of(list(shown)[number])
        for k, here in shown.items():
            lights = self.lights(scene)
            with timed("exitance"):
                eyes = EyePoints.none() if view is None else self.eye_points(view, k, here)[0]
                self.prepared[k] = self.mode.prepare(scene, lights, self.sampled[k], eyes, self.covering)
        if view is not None and dr.width(self._opaque(view)):
            self.surface_light(scene)

    def exitance(self, scene: mi.Scene, points: Points) -> mi.Color3f:
        """Evaluate the exitance at points, prototype by prototype."""
        exitance = dr.zeros(mi.Color3f, dr.width(points.p))
        for k, here in self.by_prototype(points).items():
            count("eye points", len(here))
            eyes, index = self.eye_points(points, k, here)
            dr.scatter(exitance, self.of_prototype(scene, k, eyes), index)
            dr.eval(exitance)
        for number, lit in enumerate(self.bodies):
            if lit.close is not None:
                outside = self.samples_of(int(self.places[number, 0])).outside
                add_close_light(exitance, points, number + 1, lit, outside)
        index = self._opaque(points)
        if dr.width(index):
            light = self.surface_light(scene)
            with timed("surfaces"):
                some = points.take(index)
                coat = some.body - dr.opaque(mi.UInt32, len(self.places) + 1)
                dr.scatter(exitance, light.entering(scene, some, coat), index)
                dr.eval(exitance)
        return exitance

    def surface_light(self, scene: mi.Scene) -> SurfaceLight:
        """Prepare the light of opaque surfaces for what the view shows of them, unless that is done."""
        if self.surfaces is None:
            self.lights(scene)
            with timed("lights"), acting_as(Role.DIFFUSE, [lit.body for lit in self.bodies]):
                lights = build_light_tree(without_light_from_inside(scene, self, self._samples.without_rays()))
            with timed("surfaces"):
                self.surfaces = light_surfaces(scene, lights, *self._on_opaque())
        return self.surfaces

    def of_prototype(self, scene: mi.Scene, number: int, eyes: EyePoints) -> mi.Color3f:
        """Evaluate the exitance at points on the copies of one prototype, which is prepared now if the view does not show it."""
        body, lights = self.samples_of(number), self.lights(scene)
        with timed("exitance"):
            if number not in self.prepared:
                self.prepared[number] = self.mode.prepare(scene, lights, body, EyePoints.none(), self.covering)
            exitance = self.mode.exitance(scene, lights, body, self.prepared[number], eyes)
            dr.eval(exitance)
        return exitance

    def samples_of(self, number: int) -> SampledPrototype:
        """Spread samples on a prototype, unless it has some."""
        if number not in self.sampled:
            with timed("samples"):
                self.sampled[number] = sample_prototype(self.prototypes[number], self.spread, self.light.seed)
        return self.sampled[number]

    def lights(self, scene: mi.Scene) -> LightTree:
        """Turn the light of the scene into points, chosen for what the view shows, unless that is done."""
        if self._lights is not None:
            return self._lights
        receivers = self._receivers(np.random.default_rng(self.light.seed))
        asked = self.light
        with timed("lights"), acting_as(Role.DIFFUSE, [lit.body for lit in self.bodies]):
            for _ in steps("lights", [1], "trees"):
                self._samples = discretise(
                    scene, asked.direct, asked.indirect, asked.seed, asked.depth, receivers, asked.close
                )
                self._lights = tree = self.mode.cluster(self._samples)
        count("light samples", len(self._samples))
        return tree

    def _receivers(self, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
        """Draw points on the bodies, the more the more is seen of them, and as many on opaque surfaces: positions, normals ``(n, 3)``."""
        p, n = self._on_opaque()
        some = rng.integers(0, len(p), RECEIVERS) if len(p) else np.zeros(0, np.int64)
        points, normals = [p[some]], [n[some]]
        weight = self.weight if self.weight.any() or len(p) else np.ones(len(self.places))
        chosen = self.places[:0]
        if weight.any():
            chosen = self.places[rng.choice(len(self.places), RECEIVERS, p=weight / weight.sum())]
        for k in np.unique(chosen[:, 0]):
            body = self.samples_of(int(k))
            copy = chosen[chosen[:, 0] == k, 1].astype(np.uint32)
            leaf = rng.integers(0, body.samples.count, len(copy)).astype(np.uint32)
            si = body.samples.receiver(mi.UInt32(leaf), body.placement, mi.UInt32(copy))
            points.append(rows(si.p))
            normals.append(rows(si.sh_frame.n))
        return np.concatenate(points), np.concatenate(normals)

    def _on_opaque(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Give the points of the view on opaque surfaces: positions and normals ``(k, 3)``."""
        seen = self.view_points
        if seen is None or not dr.width(index := self._opaque(seen)):
            return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
        seen = seen.take(index)
        return rows(seen.p), rows(seen.n)

    def _opaque(self, points: Points) -> mi.UInt32:
        """Find the points on opaque surfaces, whose body numbers are those after the last body (`transport.Vertices`)."""
        if not dr.width(points.body):
            return mi.UInt32([])
        return lanes_where(points.body > dr.opaque(mi.UInt32, len(self.places)))

    def by_prototype(self, points: Points) -> dict[int, NDArray[np.uint32]]:
        """Sort points by their prototypes: the numbers of those of each, leaving out lanes that are no points."""
        body = points.body.numpy().astype(np.int64)
        body[body > len(self.places)] = 0
        prototype = np.where(body > 0, self.places[body - 1, 0], -1)
        return {int(k): np.flatnonzero(prototype == k).astype(np.uint32) for k in np.unique(prototype) if k >= 0}

    def eye_points(self, points: Points, number: int, here: NDArray) -> tuple[EyePoints, mi.UInt32]:
        """Take points of one prototype to its own space: copy by copy, what is seen directly first, and neighbours beside each other.

        Returns
        -------
        EyePoints, UInt32
            They, and the number of each among all.
        """
        body = self.samples_of(number)
        copy = self.places[points.body.numpy()[here].astype(np.int64) - 1, 1].astype(np.uint32)
        index, of_copy = upload(here), upload(copy)
        local = body.placement.to_local(of_copy, dr.gather(mi.Point3f, points.p, index))
        normal = body.placement.turn_to_local(of_copy, dr.gather(mi.Normal3f, points.n, index))
        normal *= dr.opaque(mi.Float, body.outside)
        tolerance = dr.gather(mi.Float, points.tolerance, index)
        dr.eval(local, normal, tolerance)
        order = morton_order(rows(local))
        order = order[np.lexsort((tolerance.numpy()[order] > 1, copy[order]))].astype(np.uint32)
        place = upload(order)
        eyes = EyePoints(
            dr.gather(mi.Point3f, local, place),
            dr.gather(mi.Normal3f, normal, place),
            upload(copy[order]),
            dr.gather(mi.Float, tolerance, place),
        )
        dr.eval(eyes)
        return eyes, upload(here[order])
