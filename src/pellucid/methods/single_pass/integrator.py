"""``pellucid_single_pass``: irradiance and its spread through the material, refined together for what is seen (AWB08)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ...errors import PellucidError
from ...kernels.morton import morton_order
from ...light.points.discretise import DEFAULT_DIRECT, DEFAULT_INDIRECT
from ...scene.prototypes import find_prototypes
from ..contract import Method, Points
from ..parameters import parameter
from ..preparation import LitScene
from ..surface_samples import SpreadParameters
from .adaptive.algorithm import AdaptiveSettings
from .modes import MODES, EyePoints, ModeSettings
from .paper.cache import DEFAULT_ENTRIES
from .paper.light_cut import DEFAULT_MAX_CUT
from .paper.triple_cut import CutParameters
from .state import SinglePassScene


@final
@dataclass
class SinglePass(SpreadParameters, Method[SinglePassScene]):
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

    name = "single_pass"
    uses_view = True
    one_point_a_pixel = True
    paths_at_once = 1 << 23

    mode: str = parameter("adaptive", choices=tuple(MODES))
    max_error: float = parameter(0.02, "a relative error", above=0)
    direct: int = parameter(DEFAULT_DIRECT, at_least=1)
    indirect: int = parameter(DEFAULT_INDIRECT, at_least=0)
    first_rays: int = parameter(AdaptiveSettings.first_rays, at_least=1)
    most_rays: int = parameter(AdaptiveSettings.most_rays, at_least=1)
    max_cut: int = parameter(CutParameters.max_cut, at_least=2)
    alternation: int = parameter(CutParameters.alternation, at_least=1)
    alpha: float = parameter(float(CutParameters.alpha), above=0)
    beta: float = parameter(float(CutParameters.beta), above=0)
    white: float = parameter(float(CutParameters.white), above=0)
    cache_entries: int = parameter(DEFAULT_ENTRIES, at_least=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        if "irradiance" in self.channels:
            raise PellucidError(
                "aovs: single_pass measures no irradiance of its own at eye points; use two_pass for that."
            )
        cut = CutParameters(
            max_error=self.max_error,
            max_cut=self.max_cut,
            alternation=self.alternation,
            alpha=self.alpha,
            beta=self.beta,
            white=self.white,
        )
        self.mode_settings = ModeSettings(
            max_error=self.max_error,
            first_rays=self.first_rays,
            most_rays=self.most_rays,
            cut=cut,
            max_light_cut=DEFAULT_MAX_CUT,
            cache_entries=self.cache_entries,
            seed=self.seed,
        )

    def prepare(self, scene: mi.Scene, opened: LitScene) -> SinglePassScene:
        """Find the prototypes. Samples and lights are made once it is known what is seen."""
        prototypes, places = find_prototypes([lit.body for lit in opened.bodies])
        return SinglePassScene(**vars(opened), prototypes=prototypes, places=places)

    def exitance(self, scene: mi.Scene, state: SinglePassScene, points: Points) -> mi.Color3f:
        """Evaluate the exitance at points of any bodies, prototype by prototype."""
        numbers = points.body.numpy().astype(np.int64) - 1
        state.see(numbers, self, self.point_samples)
        depth = self.light_limits.max_depth
        state.discretise(scene, numbers, self.direct, self.indirect, depth, self.seed)
        state.effort.eye_points += len(numbers)
        place = state.places[numbers]
        exitance = dr.zeros(mi.Color3f, len(numbers))
        with state.effort.timed("exitance"):
            for k in np.unique(place[:, 0]).tolist():
                lit = state.lit[k]
                here = np.flatnonzero(place[:, 0] == k)
                copy = mi.UInt32(place[here, 1].astype(np.uint32))
                index = mi.UInt32(here.astype(np.uint32))
                local = lit.placement.to_local(copy, dr.gather(mi.Point3f, points.p, index))
                dr.eval(local)
                # Copy by copy, what is seen at once first, and neighbours beside each other.
                order = morton_order(local.numpy().T)
                coarse = dr.gather(mi.Float, points.tolerance, index).numpy() > 1
                order = mi.UInt32(order[np.lexsort((coarse[order], place[here[order], 1]))].astype(np.uint32))
                index = dr.gather(mi.UInt32, index, order)
                eyes = EyePoints(
                    dr.gather(mi.Point3f, local, order),
                    dr.gather(mi.UInt32, copy, order),
                    dr.gather(mi.Float, points.tolerance, index) * state.leniency(lit),
                )
                dr.eval(eyes)
                dr.scatter(exitance, MODES[self.mode](scene, state, lit, eyes, self.mode_settings), index)
            dr.eval(exitance)
        return exitance
