"""``pellucid_single_pass``: irradiance and its spread through the material, refined together for what is seen (AWB08)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, final

import mitsuba as mi
import numpy as np

from ...errors import PellucidError
from ...light.points.discretise import DEFAULT_DIRECT, DEFAULT_INDIRECT
from ...light.points.emitters import builder_of
from ...scene.bodies import Body
from ...scene.prototypes import find_prototypes
from ...scene.samples.surface import FEWEST_SAMPLES, default_sample_count
from ..close_lamps import close_light
from ..contract import Method, Points
from ..parameters import parameter
from ..preparation import LitScene, shortest_mfp
from ..surface_samples import SpreadParameters
from .adaptive.algorithm import AdaptiveSettings
from .modes import MODES, Adaptive, Exact, Mode, TripleCuts, TwoPass, reflectance
from .paper.cache import DEFAULT_ENTRIES, LinkCache, check_entries
from .paper.triple_cut import CutParameters
from .state import LightParameters, SinglePassScene

DARK = 0.03
"""Share of the brightest medium's reflectance below which errors are no longer relative to a body's own light."""


@final
@dataclass
class SinglePass(SpreadParameters, Method[SinglePassScene]):
    r"""
    .. _integrator-pellucid_single_pass:

    Single-pass method for large scenes (:monosp:`pellucid_single_pass`)
    --------------------------------------------------------------------

    .. pluginparameters::

     * - light_opaque
       - |bool|
       - Light diffuse opaque surfaces by the same point lights, where they are seen directly, in mirrors or through glass; if not, paths
         do. (Default: yes)
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
       - Cut: the paper's m, alpha and beta, and the radiance shown as white. (Default: 1, 10, 1, 1)
     * - pairs
       - |int|
       - Cut: from so many pairs of a sample and a light a triple is estimated, a power of two; one of them is traced. (Default: 16)
     * - clamp
       - |float|
       - Cut: how many times farther away virtual lights stop growing brighter than where they send the radiosity of their surface;
         larger values make smaller cuts, and take light away where surfaces touch. (Default: 1)
     * - max_cut, cache_entries
       - |int|, |int|
       - Cut: most triples of an eye point, and links that are remembered. (Default: 16384, a million)
     * - sampling, sample_count, max_samples, point_samples, max_depth, rr_depth, hide_emitters, aovs, seed
       -
       - As for :ref:`pellucid_two_pass <integrator-pellucid_two_pass>`; the aov ``irradiance`` is not available.

    Lights, clusters and rays are decided for a view: for the translucent points that four paths through each pixel of the camera meet.
    After that the exitance at a point depends on that point alone. One eye point a pixel and body is evaluated, however many samples
    the pixel has. Bodies of which the view shows no copy get samples when they are first asked for.

    In the mode ``adaptive``, what the view does not show is known more coarsely: its light is measured in a thousand clusters to each
    body. Half of such points are off by less than 4 %, 95 of 100 by less than 20 % (the teapot on its table with 8,000 samples: 1.2 and
    16 %; a Mezquita of 24 bodies with 60,000: 3.6 and 20 %). Without any camera light is measured everywhere, in a million clusters for
    all bodies: 95 of 100 points are off by less than about 2 %.
    """

    name = "single_pass"
    uses_view = True
    one_point_a_pixel = True
    view_paths = 4
    paths_at_once = 1 << 23

    mode: str = parameter("adaptive", choices=MODES)
    max_error: float = parameter(0.02, "a relative error", above=0)
    direct: int = parameter(DEFAULT_DIRECT, at_least=1)
    indirect: int = parameter(DEFAULT_INDIRECT, at_least=0)
    first_rays: int = parameter(AdaptiveSettings.first_rays, at_least=1)
    most_rays: int = parameter(AdaptiveSettings.most_rays, at_least=1)
    max_cut: int = parameter(CutParameters.max_cut, at_least=2)
    alternation: int = parameter(CutParameters.alternation, at_least=1)
    alpha: float = parameter(CutParameters.alpha, above=0)
    beta: float = parameter(CutParameters.beta, above=0)
    white: float = parameter(CutParameters.white, above=0)
    pairs: int = parameter(CutParameters.pairs, at_least=1)
    clamp: float = parameter(1.0, above=0)
    light_opaque: bool = parameter(True)
    cache_entries: int = parameter(DEFAULT_ENTRIES, at_least=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        if "irradiance" in self.channels:
            raise PellucidError(
                "aovs: single_pass measures no irradiance of its own at eye points; use two_pass for that."
            )
        self.cut = CutParameters(**_of(CutParameters, self))  # checks them
        check_entries(self.cache_entries)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> SinglePassScene:
        """Find the prototypes. All else depends on what is seen."""
        prototypes, places = find_prototypes([lit.body for lit in opened.bodies])
        areas = [prototypes[number].surface.area for number, _ in places]
        spacing = {
            k: self._spacing(lit.body, area) for k, (lit, area) in enumerate(zip(opened.bodies, areas, strict=True))
        }
        close = opened.lamps.close_to(spacing)
        for number, lit in enumerate(opened.bodies):
            lit.close = close_light(scene, opened, number, close)
        light = LightParameters(self.direct, self.indirect, self.light_limits.max_depth, self.seed, close)
        opened.lights_opaque = self.light_opaque and all(map(builder_of, scene.emitters()))
        return SinglePassScene(**vars(opened), prototypes=prototypes, places=places, spread=self, light=light)

    def prepare_view(self, scene: mi.Scene, state: SinglePassScene, view: Points | None) -> SinglePassScene:
        """Choose lights for what is seen, and prepare the mode for the eye points. Samples are kept from one view to the next."""
        seeing = replace(state, mode=self._mode(state), prepared={}, _lights=None, surfaces=None)
        seeing.see(scene, view)
        return seeing

    def exitance(self, scene: mi.Scene, state: SinglePassScene, points: Points) -> mi.Color3f:
        """Evaluate the exitance at points of any bodies."""
        return state.exitance(scene, points)

    def _spacing(self, body: Body, area: float) -> float:
        """Tell how far apart the samples of a body will be [scene units]."""
        count = self.sample_count or max(default_sample_count(area, shortest_mfp(body)), FEWEST_SAMPLES)
        return float(np.sqrt(area / count))

    def _mode(self, state: SinglePassScene) -> Mode[Any]:
        """Make the mode that is asked for."""
        if self.mode == "adaptive":
            brightest = max(reflectance(prototype.bodies[0].medium) for prototype in state.prototypes)
            return Adaptive(AdaptiveSettings(**_of(AdaptiveSettings, self)), DARK * brightest)
        if self.mode == "cut":
            return TripleCuts(self.cut, self.clamp, self.seed, LinkCache(self.cache_entries))
        return TwoPass(self.max_error, self.seed) if self.mode == "two_pass" else Exact()


def _of(cls: type, parameters: SinglePass) -> dict[str, Any]:
    """Take the parameters that a class has fields for."""
    return {f.name: getattr(parameters, f.name) for f in fields(cls)}
