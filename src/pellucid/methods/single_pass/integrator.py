"""``pellucid_single_pass``: irradiance and its spread through the material, refined together for what is seen (AWB08)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import PellucidError, did_you_mean
from ...kernels.morton import morton_order
from ...light.points.discretise import DEFAULT_DIRECT, DEFAULT_INDIRECT
from ...light.transport import SLOTS, Vertices
from ...scene.prototypes import find_prototypes
from ..contract import Answer, LitBody, TranslucentIntegrator, _at_least
from ..preparation import open_scene
from .adaptive.algorithm import AdaptiveSettings
from .modes import MODES, EyePoints, ModeSettings
from .paper.cache import DEFAULT_ENTRIES
from .paper.light_cut import DEFAULT_MAX_CUT
from .paper.triple_cut import CutParameters
from .state import SinglePassScene

LEAST_TOLERANCE, MOST_TOLERANCE = 2.0, 256.0
"""What is seen only by way of another surface may be so many times less exact; and more, up to the other, as little of its pixel
shows it: a dielectric reflects a twentieth, and of several paths few may meet the same body."""

INDIRECT_TOLERANCE = 4.0
"""The same where nothing is known of the pixel."""

UNIT = 1 << 16
"""What a whole pixel is counted as: whole numbers, whose sum does not hang on the order."""


class SinglePassIntegrator(TranslucentIntegrator):
    r"""
    .. _integrator-pellucid_single_pass:

    Single-pass method for large scenes (:monosp:`pellucid_single_pass`)
    --------------------------------------------------------------------

    .. pluginparameters::

     * - mode
       - |string|
       - ``adaptive``: measures light only where it is seen. ``cut``: the triple cuts of the paper. ``two_pass``: its reference,
         Lightcuts at every irradiance sample. ``exact``: all triples. (Default: adaptive)
     * - max_error
       - |float|
       - Relative error of the exitance that rays may leave, 1.52 standard deviations; in the mode ``cut`` the largest error
         bound of a triple, and in the mode ``two_pass`` of a light cluster. (Default: 0.02)
     * - direct, indirect
       - |int|
       - Point lights shared by the emitters that have an extent, and virtual point lights for what they light. (Default: 3072, 50000)
     * - irradiance_depth
       - |int|
       - Depth of light paths as in ``max_depth``; 2 leaves out indirect light. (Default: ``max_depth``)
     * - first_rays, most_rays
       - |int|
       - Adaptive: shadow rays of every 16th cluster, from which the others learn what is seen; and at most, of any.
         (Default: 16, 8192)
     * - alternation, alpha, beta, white
       - |int|, |float|, |float|, |float|
       - Cut: the paper's m, alpha and beta, and the radiance shown as white. (Default: 8, 10, 1, 1)
     * - max_cut, cache_entries
       - |int|, |int|
       - Cut: most triples of an eye point, and link factors that are remembered. (Default: 8192, 4 million)
     * - sampling
       - |string|
       - As for :ref:`pellucid_two_pass <integrator-pellucid_two_pass>`; ``auto`` is ``poisson``, with the mean free path as the
         distance. (Default: auto)
     * - sample_count, max_samples, point_samples, max_depth, rr_depth, hide_emitters, aovs, seed
       -
       - As for :ref:`pellucid_two_pass <integrator-pellucid_two_pass>`; the aov ``irradiance`` is not to be had.

    One eye point a pixel and body is evaluated, however many samples the pixel has. Samples are spread on bodies when they are
    first seen: those that are not cost nothing.
    """

    needs_normals = False
    lit_by_paths = False
    paths_at_once = 1 << 23

    def __init__(self, props):
        super().__init__(props)
        self.mode = str(props.get("mode", "adaptive"))
        if self.mode not in MODES:
            raise PellucidError(
                f"mode is one of {', '.join(MODES)}{did_you_mean(self.mode, MODES)}; found '{self.mode}'."
            )
        if "irradiance" in self.aovs:
            raise PellucidError(
                "aovs: single_pass measures no irradiance of its own at eye points; use two_pass for that."
            )
        self.direct = _at_least(props, "direct", DEFAULT_DIRECT, 1)
        self.indirect = _at_least(props, "indirect", DEFAULT_INDIRECT, 0)
        cut = CutParameters(
            max_error=_positive(props, "max_error", 0.02),
            max_cut=_at_least(props, "max_cut", CutParameters.max_cut, 2),
            alternation=_at_least(props, "alternation", CutParameters.alternation, 1),
            alpha=_positive(props, "alpha", CutParameters.alpha),
            beta=_positive(props, "beta", CutParameters.beta),
            white=_positive(props, "white", CutParameters.white),
        )
        self.mode_settings = ModeSettings(
            max_error=cut.max_error,
            first_rays=_at_least(props, "first_rays", AdaptiveSettings.first_rays, 1),
            most_rays=_at_least(props, "most_rays", AdaptiveSettings.most_rays, 1),
            cut=cut,
            max_light_cut=DEFAULT_MAX_CUT,
            cache_entries=_at_least(props, "cache_entries", DEFAULT_ENTRIES, 1024),
            seed=self.settings.seed,
        )

    def prepare_scene(self, scene: mi.Scene) -> SinglePassScene:
        """Find the prototypes. Samples and lights are made once it is known what is seen."""
        opened = open_scene(scene)
        prototypes, places = find_prototypes([lit.body for lit in opened.bodies])
        return SinglePassScene(**vars(opened), prototypes=prototypes, places=places)

    def exitances(self, answer: Answer, vertices: Vertices) -> Iterator[tuple[mi.UInt32, mi.Color3f]]:
        """Evaluate one eye point a pixel and body, and let the other samples of the pixel share it."""
        bodies, owners, chosen = [], [], []
        shows = dr.opaque(mi.UInt32, 0, vertices.width * SLOTS)
        for slot in range(SLOTS):
            lane = dr.arange(mi.UInt32, vertices.width)
            body = dr.gather(mi.UInt32, vertices.body, lane + slot * vertices.width)
            owner = _first_of_pixel(body, answer.per_pixel)
            weight = dr.gather(mi.Color3f, vertices.weight, lane + slot * vertices.width, body != 0)
            part = mi.UInt32(UNIT / answer.per_pixel * dr.max(weight))
            dr.scatter_add(shows, part, owner + slot * vertices.width, body != 0, mode=dr.ReduceMode.Direct)
            bodies.append(body)
            owners.append(owner)
            chosen.append(dr.compress((owner == lane) & (body != 0)).numpy() + np.uint32(slot * vertices.width))
        index = mi.UInt32(np.concatenate(chosen))
        values = dr.zeros(mi.Color3f, vertices.width * SLOTS)
        if dr.width(index):
            p, body = dr.gather(mi.Point3f, vertices.p, index), dr.gather(mi.UInt32, vertices.body, index)
            coarse = (index >= vertices.width) | mi.Bool(answer.is_coarse(0))
            share = mi.Float(dr.gather(mi.UInt32, shows, index)) / UNIT
            tolerance = dr.select(coarse, dr.clip(dr.rcp(share), LEAST_TOLERANCE, MOST_TOLERANCE), 1)
            dr.scatter(values, self._of_points(answer.scene, answer.lit, p, body, tolerance), index)
        for slot, (body, owner) in enumerate(zip(bodies, owners, strict=True)):
            yield body, dr.gather(mi.Color3f, values, owner + slot * vertices.width, body != 0)

    def exitance(
        self, scene: mi.Scene, lit: LitBody, p: mi.Point3f, n: mi.Normal3f | None, seed: int, coarse: bool
    ) -> mi.Color3f:
        """Evaluate the exitance at points of one body."""
        state: Any = self.prepared
        number = [each.body for each in state.bodies].index(lit.body) + 1
        count = dr.width(p)
        tolerance = dr.full(mi.Float, INDIRECT_TOLERANCE if coarse else 1.0, count)
        return self._of_points(scene, state, p, dr.full(mi.UInt32, number, count), tolerance)

    def _of_points(self, scene, state: Any, p, body: mi.UInt32, tolerance: mi.Float) -> mi.Color3f:
        """Evaluate the exitance at eye points of any bodies (numbers from 1 on), prototype by prototype of a `SinglePassScene`."""
        numbers = body.numpy().astype(np.int64) - 1
        state.see(numbers, self.settings, self.point_samples)
        depth = self.light_limits.max_depth
        state.discretise(scene, numbers, self.direct, self.indirect, depth, self.settings.seed)
        state.effort.eye_points += len(numbers)
        place = state.places[numbers]
        exitance = dr.zeros(mi.Color3f, len(numbers))
        with state.effort.timed("exitance"):
            for k in np.unique(place[:, 0]).tolist():
                lit = state.lit[k]
                here = np.flatnonzero(place[:, 0] == k)
                copy = mi.UInt32(place[here, 1].astype(np.uint32))
                index = mi.UInt32(here.astype(np.uint32))
                local = lit.placement.to_local(copy, dr.gather(mi.Point3f, p, index))
                dr.eval(local)
                # Copy by copy, what is seen at once first, and neighbours beside each other.
                order = morton_order(local.numpy().T)
                coarse = dr.gather(mi.Float, tolerance, index).numpy() > 1
                order = mi.UInt32(order[np.lexsort((coarse[order], place[here[order], 1]))].astype(np.uint32))
                index = dr.gather(mi.UInt32, index, order)
                eyes = EyePoints(
                    dr.gather(mi.Point3f, local, order),
                    dr.gather(mi.UInt32, copy, order),
                    dr.gather(mi.Float, tolerance, index) * state.leniency(lit),
                )
                dr.eval(eyes)
                dr.scatter(exitance, MODES[self.mode](scene, state, lit, eyes, self.mode_settings), index)
            dr.eval(exitance)
        return exitance


@dr.syntax
def _first_of_pixel(body: mi.UInt32, per_pixel: int) -> mi.UInt32:
    """Find, for each path, the first path of its pixel that meets the same body: its own number if there is none."""
    count = dr.opaque(mi.UInt32, per_pixel)
    lane = dr.arange(mi.UInt32, dr.width(body))
    owner = lane // count * count
    while dr.hint(dr.gather(mi.UInt32, body, owner) != body, label="pellucid owner"):
        owner += 1
    dr.eval(owner)
    return owner


def _positive(props, name: str, default: float) -> float:
    """Read a number above zero."""
    value = float(props.get(name, default))
    if not 0 < value < float("inf"):
        raise PellucidError(f"{name} is a number above zero; found {value:g}.")
    return value
