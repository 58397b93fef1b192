"""``pellucid_texture_space``: irradiance in a texture, and a sum over samples drawn from it by importance (CLHHC08)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.memory import columns
from ...light.entering import entering_as_mapped
from ...light.irradiance import sample_receivers
from ...progress import steps
from ...scene.atlas.layout import build_atlas
from ...scene.atlas.texels import rasterise
from ...scene.bodies import Body
from ...scene.samples.surface import default_sample_count
from ..parameters import parameter
from ..preparation import NOT_YET, PATHS, LitBody, LitScene, effective_area, entering_power, shortest_mfp
from ..surface_samples import LitSamplesMethod
from .drawing import ORDERS, BodySum, CoveredTexels, Drawn, DrawnDerivatives, SampleSum, draw_samples
from .hybrid import NearLight
from .pyramid import check_resolution

TEXELS_PER_MFP, COARSEST, FINEST = 4, 256, 1024
"""Texels along the mean free path of a body, and the least and most along a side of its texture: light that enters is blurred over more
than that, so finer ones cost time and change nothing."""

MOST_SAMPLES = 40_000
"""At most so many samples does a body get, of those that two passes would spread over it."""

COARSE = 4
"""What is seen only by way of another surface is summed over so many times fewer samples."""

FEWEST_PATHS = 2
"""A sample that is drawn stands for hundreds of texels, whose noise is averaged: few paths each are enough."""


class Fineness(NamedTuple):
    """The least number of samples of a body, the most light paths of a texel, and the largest chart as a share of the surface (0: any)."""

    samples: int
    paths: int
    chart: float


GIVEN, FITTED = Fineness(2500, PATHS, 0.0), Fineness(4000, 16, 0.01)
"""Where a resolution is given, and where it follows from the mean free path. Small charts are unwrapped in a third of the time; samples are
less even across their seams, for which a larger number of samples makes up at little cost."""


@dataclass
class TextureState:
    """The texels of a body, the samples drawn, and what is summed: for the eye, and for what another surface shows (``coarse``)."""

    texels: CoveredTexels
    extent: float
    drawn: Drawn = NOT_YET
    drawn_coarse: Drawn = NOT_YET
    power: mi.Color3f = NOT_YET
    seen: BodySum = NOT_YET
    coarse: SampleSum = NOT_YET


@final
@dataclass
class TextureSpace(LitSamplesMethod[TextureState]):
    r"""
    .. _integrator-pellucid_texture_space:

    Texture-space importance sampling (:monosp:`pellucid_texture_space`)
    --------------------------------------------------------------------

    .. pluginparameters::

     * - sample_count
       - |int|
       - Samples drawn from the irradiance texture of each body, in proportion to its light. 0: one to every :math:`\pi` squared
         mean free paths of the surface, but at least 4000 (2500 where a resolution is given) and at most 40,000. (Default: 0)
     * - resolution
       - |int|
       - Texels along each side of that texture, a power of two. 0: so many that four span the mean free path, but at least 256 and at
         most 1024. (Default: 0)
     * - order
       - |string|
       - How samples are drawn: by even points of the plane that are warped to the light (``plane``), or by even numbers along the
         light of all texels, summed in the paper's ``mipmap`` order or in ``rows``. (Default: plane)
     * - hybrid
       - |bool|
       - Sum what stays near the point where it enters over translucent shadow maps of point, spot and directional lights, and
         only what goes far over the samples. (Default: no)
     * - point_samples
       - |bool|
       - Let the light of a sample enter at a point, as in the paper, instead of over a disc around it. (Default: no)
     * - irradiance_paths, irradiance_depth
       - |int|
       - Light paths a texel, 0 to share 2.4 million among all texels of the scene, at least 2 each, and at most 16 where no
         resolution is given; and their depth as in ``max_depth``. (Default: 0, and ``max_depth``)
     * - translucent_passes, max_depth, rr_depth, hide_emitters, aovs, seed
       -
       - As for :ref:`pellucid_two_pass <integrator-pellucid_two_pass>`.

    The time of a picture is the product of its points and the samples, whatever the material and the size of the body; so
    is that of the preparation, which is the atlas and the light paths. Noise is a pattern on the surface that stays where
    it is while the camera moves.
    """

    name = "texture_space"
    neighbours = 1  # texels lie so dense that the profile averages over more than it is worth to average before
    sample_count: int = parameter(0, at_least=0)
    resolution: int = parameter(0, at_least=0)
    order: str = parameter("plane", choices=ORDERS)
    hybrid: bool = parameter(False)
    point_samples: bool = parameter(False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.resolution:
            check_resolution(self.resolution)

    def spread_all(self, opened: LitScene) -> None:
        """Make every texel that the surface of a body covers a sample of the irradiance."""
        for k, _ in steps("samples", [1] * len(opened.bodies), "bodies"):
            lit = opened.bodies[k]
            resolution = self.resolution or fitting_resolution(lit.body)
            # Large bodies have more samples than the least anyway, and nothing would make up for seams.
            largest = self.fineness.chart if resolution < FINEST else 0.0
            atlas = build_atlas(lit.body, resolution, largest_chart=largest)
            for note in atlas.notes:
                mi.Log(mi.LogLevel.Info, f"pellucid: body '{lit.body.name}': {note}")
            texels = rasterise(atlas)
            lit.state = TextureState(CoveredTexels(texels), atlas.surface.extent)
            lit.samples = texels.samples

    def default_paths(self, sample_count: int) -> int:
        """Share the light paths among all texels."""
        return min(max(FEWEST_PATHS, PATHS // sample_count), self.fineness.paths)

    @property
    def fineness(self) -> Fineness:
        """How fine the texture and the samples are where nothing is said of them."""
        return GIVEN if self.resolution else FITTED

    def build(self, lit: LitBody) -> TextureState:
        """Draw samples from the power that enters through each texel, for the eye and for other surfaces."""
        texels, medium = lit.state.texels, lit.body.medium
        entering = mi.Color3f(*columns(entering_power(lit)))
        bright = texels.sum_up(mi.luminance(entering))
        tables = SampleSum.of(medium, lit.state.extent)

        def draw(count: int) -> tuple[Drawn, mi.Color3f]:
            drawn = draw_samples(texels, bright, count, self.seed, self.order, self.point_samples)
            return drawn, dr.gather(mi.Color3f, entering, drawn.index) * drawn.share

        wanted = default_sample_count(float(np.sum(lit.samples.area)), float(np.min(medium.mfp)))
        count = self.sample_count or min(max(wanted, self.fineness.samples), MOST_SAMPLES)
        drawn, power = draw(count)
        drawn_coarse, power_coarse = draw(-(-count // COARSE))
        seen, coarse = BodySum(tables.hold(drawn, power)), tables.hold(drawn_coarse, power_coarse)
        return replace(lit.state, drawn=drawn, drawn_coarse=drawn_coarse, power=power, seen=seen, coarse=coarse)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Draw the samples; in the hybrid method also look at every body from the lights."""
        lit_scene = super().prepare(scene, opened)
        for number, lit in enumerate(lit_scene.bodies if self.hybrid else ()):
            near = NearLight(lit.body, number, lit_scene.lookup, lit.samples.p)
            near.update(scene, fine=True)
            close = lit_scene.close_lamps(number)
            for k in close.numbers if close is not None else ():
                near.maps[k] = None  # rays carry what samples would miss of its light
            if any(near.mapped):
                _divide(scene, lit, near)
        return lit_scene

    def sum_up(
        self, lit: LitBody[TextureState], p: mi.Point3f, n: mi.Normal3f, indirectly: bool, stretch: Any = None
    ) -> mi.Color3f:
        """Sum CLHHC08 eq. 10 over the samples drawn, and in the hybrid method what stays near over shadow maps."""
        return (lit.state.coarse if indirectly else lit.state.seen).exitance(p, n)

    @property
    def has_gradients(self) -> bool:
        """Whether there are derivatives: not of what shadow maps see."""
        return not self.hybrid and super().has_gradients

    def derivatives(self, lit: LitBody[TextureState], names: list[str], indirectly: bool) -> DrawnDerivatives:
        """Differentiate the sum over the same samples, drawn with the same probabilities."""
        state = lit.state
        total, drawn = (state.coarse, state.drawn_coarse) if indirectly else (state.seen.rest, state.drawn)
        assert total is not None
        slopes = [total.discs.log_slopes(lit.body.medium, name) for name in names]
        return DrawnDerivatives(total, drawn, len(lit.samples), slopes)

    def summed(self, lit: LitBody[TextureState]) -> np.ndarray:
        """Number the texels that samples are drawn from."""
        return np.unique(np.concatenate([lit.state.drawn.index.numpy(), lit.state.drawn_coarse.index.numpy()]))


def fitting_resolution(body: Body) -> int:
    """Choose how many texels along each side the texture of a body has: about `TEXELS_PER_MFP` along its mean free path."""
    texels = TEXELS_PER_MFP * np.sqrt(body.surface().area) / shortest_mfp(body)
    return 1 << int(np.ceil(np.log2(np.clip(texels, COARSEST, FINEST))))


def _divide(scene: mi.Scene, lit: LitBody, near: NearLight) -> None:
    """Give the samples of a body the light of mapped emitters by R_g, as far as the maps see it, and the rest by R_d as before.

    Source: CLHHC08 section 4.
    """
    state, medium = lit.state, lit.body.medium
    drawn = state.drawn
    entering = dr.zeros(mi.Color3f, dr.width(drawn.index))
    eta = dr.opaque(mi.Float, medium.eta)
    si = sample_receivers(lit.samples, drawn.index)
    si.p = dr.gather(mi.Point3f, state.texels.p, drawn.index)  # on the facet
    for emitter, mapped in zip(scene.emitters(), near.mapped, strict=True):
        if mapped:
            entering += entering_as_mapped(scene, emitter, si, eta)
    scale = mi.Color3f(*columns(effective_area(lit)))
    power = entering * dr.gather(mi.Color3f, scale, drawn.index) * drawn.share
    rest = state.seen.rest.hold(drawn, state.power - power)
    far = SampleSum.of_far_part(medium, state.extent, near.split.global_weight).hold(drawn, power)
    lit.state = replace(state, seen=BodySum(rest, far, near))
