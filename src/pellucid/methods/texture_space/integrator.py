"""``pellucid_texture_space``: irradiance in a texture, and a sum over samples drawn from it by importance (CLHHC08)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import drjit as dr
import mitsuba as mi
import numpy as np

from ...gather.gather import gather_samples
from ...gather.source import Source, device_source, with_samples
from ...kernels.memory import columns, upload
from ...kernels.sequences import even_numbers, hammersley_set
from ...light.direct import irradiance_from
from ...light.irradiance import sample_receivers
from ...scene.atlas.layout import build_atlas
from ...scene.atlas.texels import Texels, rasterise
from ...scene.samples.surface import default_sample_count, sides
from ..parameters import parameter
from ..preparation import NOT_YET, PATHS, LitBody, LitScene, entering_power, outside, textured
from ..surface_samples import LitSamplesMethod
from .discs import DiscTables, disc_radius
from .hybrid import NearLight
from .pyramid import (
    Pyramid,
    Rows,
    build_pyramid,
    build_rows,
    check_resolution,
    sample_pyramid,
    sample_rows,
    warp_points,
)

DEFAULT_RESOLUTION = 1024

FEWEST_SAMPLES, MOST_SAMPLES = 2500, 40_000
"""Between these a body gets as many samples as two passes would spread over it."""

ORDERS = ("plane", "mipmap", "rows")

COARSE = 4
"""What is seen only by way of another surface is summed over so many times fewer samples."""

FEWEST_PATHS = 2
"""A sample that is drawn stands for hundreds of texels, whose noise is averaged: few paths each are enough."""


@dataclass
class Drawn:
    """Samples drawn from a texture: their texels, ``E'_avg / (N E')``, positions, power, and radii of their discs."""

    index: mi.UInt32
    share: mi.Float
    p: mi.Point3f
    power: mi.Color3f
    radius: mi.Float


@dataclass
class TextureState:
    """The texels of a body, the samples drawn, and what is summed.

    Summed for the eye: ``fine``, and in the hybrid method ``far`` by R_g and ``near`` by R_l, of the same light. For what
    is seen by way of another surface: ``coarse``.
    """

    texels: Texels
    drawn: Drawn = NOT_YET
    discs: DiscTables = NOT_YET
    fine: Source = NOT_YET
    coarse: Source = NOT_YET
    near: NearLight | None = None
    far: Source = NOT_YET


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
         mean free paths of the surface, but at least 2500 and at most 40,000. (Default: 0)
     * - resolution
       - |int|
       - Texels along each side of that texture, a power of two. (Default: 1024)
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
       - Light paths a texel, 0 to share 2.4 million among all texels of the scene, at least 2 each; and their depth as in
         ``max_depth``. (Default: 0, and ``max_depth``)
     * - translucent_passes, max_depth, rr_depth, hide_emitters, aovs, seed
       -
       - As for :ref:`pellucid_two_pass <integrator-pellucid_two_pass>`.

    The time of a picture is the product of its points and the samples, whatever the material and the size of the body; so
    is that of the preparation, which is the atlas and the light paths. Noise is a pattern on the surface that stays where
    it is while the camera moves.
    """

    name = "texture_space"
    sample_count: int = parameter(0, at_least=0)
    resolution: int = parameter(DEFAULT_RESOLUTION, at_least=1)
    order: str = parameter("plane", choices=ORDERS)
    hybrid: bool = parameter(False)
    point_samples: bool = parameter(False)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_resolution(self.resolution)

    def spread(self, lit: LitBody) -> None:
        """Make every texel that the surface of a body covers a sample of the irradiance."""
        atlas = build_atlas(lit.body, self.resolution)
        for note in atlas.notes:
            mi.Log(mi.LogLevel.Info, f"pellucid: body '{lit.body.name}': {note}")
        lit.state = TextureState(rasterise(atlas))
        lit.samples = lit.state.texels.samples
        lit.outside = outside(lit.samples)

    def default_paths(self, sample_count: int) -> int:
        """Share the light paths among all texels."""
        return max(FEWEST_PATHS, PATHS // sample_count)

    def build(self, lit: LitBody) -> TextureState:
        """Draw samples from the power that enters through each texel, for the eye and for other surfaces."""
        texels, power = lit.state.texels, entering_power(lit)
        colour = mi.Color3f(*columns(power))
        texel = upload(texels.texel)
        light, area = (dr.zeros(mi.Float, self.resolution**2) for _ in range(2))
        number = dr.zeros(mi.UInt32, self.resolution**2)
        dr.scatter(light, mi.luminance(colour), texel)
        dr.scatter(area, upload(texels.samples.area), texel)
        dr.scatter(number, dr.arange(mi.UInt32, len(texels.texel)), texel)
        bright, surface = (build_pyramid(values, self.resolution) for values in (light, area))
        rows = build_rows(light, self.resolution) if self.order == "rows" else None
        position = mi.Point3f(*columns(texels.samples.p))

        def draw(count: int) -> Drawn:
            place, value = self._draw(bright, rows, count)
            index = dr.gather(mi.UInt32, number, place)
            # CLHHC08 eq. 10: E'_avg / N, here in the colour of the light of the texel.
            share = dr.select(value > 0, mi.Float(bright.total) / (value * dr.opaque(mi.Float, count)), 0)
            radius = dr.zeros(mi.Float, count)
            if not self.point_samples:
                radius += mi.Float(disc_radius(bright, surface, place, count))
            power = dr.gather(mi.Color3f, colour, index) * share
            return Drawn(index, share, dr.gather(mi.Point3f, position, index), power, radius)

        wanted = default_sample_count(float(np.sum(texels.samples.area)), float(np.min(lit.body.medium.mfp)))
        count = self.sample_count or min(max(wanted, FEWEST_SAMPLES), MOST_SAMPLES)
        drawn, few = draw(count), draw(-(-count // COARSE))
        largest = max(_largest(drawn), _largest(few))
        discs = DiscTables.from_medium(lit.body.medium, largest)
        fine, coarse = (device_source(d.p, d.power, discs.table, discs.first(d.radius)) for d in (drawn, few))
        return TextureState(texels, drawn, discs, fine, coarse)

    def _draw(self, bright: Pyramid, rows: Rows | None, count: int) -> tuple[mi.UInt32, mi.Float]:
        """Draw texels in the order that was asked for. Source: CLHHC08 eq. 9."""
        if self.order == "plane":
            return warp_points(bright, *hammersley_set(mi.Float, count, self.seed))
        u = even_numbers(mi.Float, count, self.seed)
        return sample_pyramid(bright, u) if rows is None else sample_rows(rows, u)

    def prepare(self, scene: mi.Scene, opened: LitScene) -> LitScene:
        """Draw the samples; in the hybrid method also look at every body from the lights."""
        lit_scene = super().prepare(scene, opened)
        for number, lit in enumerate(lit_scene.bodies if self.hybrid else ()):
            near = NearLight(lit.body, number, lit_scene.lookup, lit.samples.p)
            near.update(scene, fine=True)
            if any(near.mapped):
                _divide(scene, lit, near)
        return lit_scene

    def sum_up(self, lit: LitBody[TextureState], p: mi.Point3f, indirectly: bool) -> mi.Color3f:
        """Sum CLHHC08 eq. 10 over the samples drawn, and in the hybrid method what stays near over shadow maps."""
        state = lit.state
        if indirectly:
            return mi.Color3f(gather_samples(state.coarse, p))
        total = mi.Color3f(gather_samples(state.fine, p))
        if state.near is not None:
            total += mi.Color3f(gather_samples(state.far, p)) + state.near.exitance(p)
        return total


def _divide(scene: mi.Scene, lit: LitBody, near: NearLight) -> None:
    """Give the samples of a body the light of mapped emitters by R_g, and the rest by R_d as before.

    Source: CLHHC08 section 4.
    """
    drawn, medium = lit.state.drawn, lit.body.medium
    entering = dr.zeros(mi.Color3f, dr.width(drawn.index))
    eta = dr.opaque(mi.Float, medium.eta)
    for side in sides(lit.outside):
        si = sample_receivers(lit.samples, lit.outside, drawn.index, mi.Float(side))
        for emitter, mapped in zip(scene.emitters(), near.mapped, strict=True):
            if mapped:
                entering += irradiance_from(scene, emitter, si, eta, mi.Point2f(0.5))[1]
    scale = lit.samples.area[:, None] * (1.0 if (colour := textured(lit)) is None else colour)
    scale = mi.Color3f(*columns(np.broadcast_to(scale, (len(lit.samples), 3))))
    power = entering * dr.gather(mi.Color3f, scale, drawn.index) * drawn.share
    rest = dr.maximum(drawn.power - power, 0)
    dr.eval(power, rest)
    discs = DiscTables.from_medium(medium, _largest(drawn), near.split.global_weight)
    far = device_source(drawn.p, power, discs.table, discs.first(drawn.radius))
    fine = with_samples(lit.state.fine, drawn.p, rest, lit.state.discs.first(drawn.radius))
    lit.state = replace(lit.state, fine=fine, far=far, near=near)


def _largest(drawn: Drawn) -> float:
    """Read the largest radius of a disc [scene units]."""
    return float(dr.max(drawn.radius)[0])
