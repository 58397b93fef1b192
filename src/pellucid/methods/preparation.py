"""What every method prepares once for a scene: bodies, surface samples, and the power that enters at each of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import mitsuba as mi
import numpy as np

from ..errors import EnvironmentProblem, SampleCountError, warn
from ..kernels.free_memory import free_memory
from ..light.irradiance import Irradiance, PathLight, measure_light
from ..light.lamps import CloseLamps, NearLamps, both_sides_matter, find_near_lamps, lamp_positions, lamps_inside
from ..light.transport import Limits, Translucency
from ..model.fresnel import external_diffuse_transmittance
from ..model.profiles import ProfileTable
from ..model.units import unit_mistake
from ..model.validity import check_reflectance, validity
from ..scene.bodies import Body, Lookup, build_lookup, find_bodies
from ..scene.changes import SceneRecord
from ..scene.finite import check_values
from ..scene.mesh_faults import check_meshes
from ..scene.samples.areas import POINTS_AT_ONCE, POINTS_PER_SAMPLE
from ..scene.samples.draw import Surface
from ..scene.samples.surface import (
    FEWEST_SAMPLES,
    SurfaceSamples,
    check_sample_count,
    default_sample_count,
    sample_surface,
)
from .reflectance import filtered_texture, opacity_at, settle_reflectances
from .stretch import Stretch, settle_lengths, table_of_samples
from .thin import thin_factor

PATHS, FEWEST_PATHS, MOST_PATHS = 2_400_000, 16, 256
SPARE_PATHS = 64
"""Paths to a sample that are enough where there are several times as many samples as are needed."""

FEW = 20
"""Samples below which the sum over them is no exitance any more."""

MANY, SECONDS_PER_SAMPLE = 3_000_000, 1.5e-5
"""Samples of a body that take more than a minute, and about how long one takes to spread, light and sort."""

BYTES_A_SAMPLE, BYTES_A_POINT = 650, 50
"""What a sample takes with its light and its place in a tree (560 to 660 measured), and one of the points that measure its area."""

BodyState = TypeVar("BodyState")
NOT_YET: Any = None
"""Stands for what is prepared later."""


@dataclass
class LitBody(Generic[BodyState]):
    """A body with its samples, the light on them, and the state that a method has built from both.

    ``spare`` tells how many samples there are for each that is needed: more than one on small bodies.
    """

    body: Body
    samples: SurfaceSamples = NOT_YET
    irradiance: Irradiance = NOT_YET
    state: BodyState = NOT_YET
    spare: float = 1.0
    close: Any = None
    """What rays from lamps carry that are too near for the samples (`close_lamps.CloseLight`)."""


@dataclass
class LitScene:
    """What every method prepares of a scene: its bodies and the tables by which kernels tell them apart.

    ``lamps`` tells how near lamps are to them, ``record`` whether the scene has changed since, and ``view`` what the last view was that
    was prepared for. ``lights_opaque`` tells whether the method answers opaque surfaces too: as bodies behind the last one, see
    `transport.Vertices`.
    """

    bodies: list[LitBody]
    lookup: Lookup
    eta_table: mi.Float
    leave_table: mi.Float
    """``1 / (pi T_d)`` by body: turns exitance times ``F_t(omega_out)`` into radiance (JB02 eq. 14, with T_d for F_dr)."""
    lamps: NearLamps
    record: SceneRecord = NOT_YET
    view: dict[str, str] | None = None
    lights_opaque: bool = False
    stretch: Stretch | None = None
    """Where the profiles of bodies are wider, if some are."""
    elsewhere: Any = None
    """What stands for the samples of all bodies where they lie on other machines (`elsewhere.Asked`, `elsewhere.Known`)."""

    def close_lamps(self, number: int) -> CloseLamps | None:
        """Choose the lamps that are too near for the samples of one body."""
        return self.lamps.close_to({number: self.bodies[number].samples.spacing})


def follows_curve(state: LitScene) -> bool:
    """Tell whether the profile of any body knows of the curve, and the exitance depends on normals."""
    return any(lit.body.medium.flat_profile.is_curved for lit in state.bodies)


def open_scene(scene: mi.Scene) -> LitScene:
    """Find the bodies of a scene, and warn of what will not look right.

    Raises
    ------
    SceneError
        When the scene has no translucent shape, and for pictures with values that are not finite.
    """
    bodies = find_bodies(scene)
    check_values(scene)
    settle_reflectances(bodies)
    stretch = settle_lengths(bodies)
    if not scene.emitters():
        warn("The scene has no light: the picture will be black. Add an emitter.")
    for text in dict.fromkeys(text for body in bodies for text in validity(body.medium)):
        warn(text)
    etas = [body.medium.eta for body in bodies]
    leave = [1 / (np.pi * external_diffuse_transmittance(eta)) for eta in etas]
    lookup = build_lookup(scene, bodies)
    for lamp, inside in lamps_inside(scene, bodies, lookup):
        warn(
            f"The lamp '{lamp}' is inside the body '{inside}': none of its light gets out, since light enters from outside only; "
            "put it outside or into a cavity, or use Mitsuba's 'volpath'."
        )
    check_meshes(bodies)
    warn_of_open_surfaces(scene, bodies)
    tables = mi.Float([1.0, *etas]), mi.Float([0.0, *leave])
    lamps = find_near_lamps(scene, bodies, lookup)
    return LitScene([LitBody(body) for body in bodies], lookup, *tables, lamps, stretch=stretch)


def warn_of_open_surfaces(scene: mi.Scene, bodies: list[Body]) -> None:
    """Warn of open surfaces whose two sides both matter."""
    lamps = lamp_positions(scene)
    for body in bodies:
        if body.side == 1 and both_sides_matter(scene, lamps, body):
            warn(
                f"The body '{body.name}' is open or has no thickness: each of its sides returns what enters there, as a half space does, "
                "and what would pass from one side to the other is left out. Give it thickness, or close it."
            )


def warn_of_units(opened: LitScene) -> None:
    """Warn of bodies whose size does not go with their mean free path: where one is much too large, samples are refused before."""
    for text in dict.fromkeys(text for lit in opened.bodies if (text := _unit_mistake(lit.body))):
        warn(text)


def _unit_mistake(body: Body) -> str | None:
    """Compare the size of a body with its mean free path."""
    scale = body.bsdf.scale
    return unit_mistake(body.name, max(body.bbox().extents()) * scale, float(np.min(body.medium.mfp)) * scale, scale)


def count_samples(lit: LitBody, surface: Surface, asked: int, most: int) -> int:
    """Choose the number of samples of a body, and note how many of them can be spared."""
    count = number_of_samples(lit.body, surface, asked, most)
    if not asked:
        lit.spare = count / default_sample_count(surface.area, shortest_mfp(lit.body))
    return count


def check_samples_fit(count: int) -> None:
    """Check that there is memory for so many samples.

    Raises
    ------
    EnvironmentProblem
        When there is not, with what is needed and what there is.
    """
    free = free_memory() if mi.variant().startswith("llvm") else None
    needed = count * BYTES_A_SAMPLE + min(count * POINTS_PER_SAMPLE[1], POINTS_AT_ONCE) * BYTES_A_POINT
    if free is not None and needed > free:
        raise EnvironmentProblem(
            f"{count:,} surface samples need about {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free: ask for fewer with "
            "--samples (sample_count), keep them on several machines (--cluster with --sample-parts), or take the method 'texture_space', "
            "which needs no more of them for larger bodies."
        )


def spread_samples(body: Body, surface: Surface, count: int, sampling: str, seed: int) -> SurfaceSamples:
    """Spread so many samples on the surface of a body."""
    if count > MANY:
        warn(
            f"The body '{body.name}' gets {count:.2g} surface samples, one to every disc of a mean free path; on two cores that "
            f"takes about {count * SECONDS_PER_SAMPLE / 60:.0f} minutes. 'single_pass' lights only what is seen, the time of "
            "'texture_space' does not grow with the body, and sample_count asks for fewer."
        )
    method = "relaxed" if sampling == "auto" else sampling
    return sample_surface(surface, count, method, seed, shortest_mfp(body))


def shortest_mfp(body: Body) -> float:
    """Give the shortest mean free path over the channels [scene units]."""
    return float(np.min(body.medium.mfp))


def number_of_samples(body: Body, surface: Surface, asked: int, most: int) -> int:
    """Choose the number of samples of a body: what was asked for, or else one in every disc of a mean free path, but not too few.

    Raises
    ------
    SampleCountError
        For more than ``most``, with what is probably wrong: the reflectance or the units.
    """
    mfp = shortest_mfp(body)
    count = asked or max(default_sample_count(surface.area, mfp), min(FEWEST_SAMPLES, most))
    if count > most and not asked and body.is_stretched:
        raise SampleCountError(
            f"body '{body.name}' needs {count:.2g} surface samples: the texture of its dmfp goes down to "
            f"{body.medium.dmfp.min() * body.bsdf.scale:.2g} mm. Raise the darkest values, or give sample_count."
        )
    if count > most and not asked:
        check_reflectance(body.name, body.medium, float(np.sqrt(surface.area / (np.pi * most))), count)
    check_sample_count(count, most, name=body.name, extent=surface.extent, mfp=mfp, scale=body.bsdf.scale)
    if count < FEW:
        warn(
            f"The body '{body.name}' gets {count} surface samples: with fewer than {FEW} it may be too dark by a tenth or more."
        )
    return count


def sample_profile(lit: LitBody, point_samples: bool) -> ProfileTable:
    """Tabulate the profile of light that enters around a sample: over a soft disc that reaches beyond its neighbours, or at a point.

    A point's light has a peak as wide as the mean free path, which is the distance of its neighbours, or a narrower one: their sum is a
    bumpy surface. Soft discs that overlap add up to an even one (`stretch.table_of_samples`).
    """
    if point_samples:
        return ProfileTable.from_medium(lit.body.medium, 0.0)
    return table_of_samples(lit.body, lit.body.medium, lit.samples)


def default_paths(sample_count: int) -> int:
    """Divide a fixed number of light paths among the samples of a scene, so that few of them are lit the better."""
    return int(np.clip(PATHS // sample_count, FEWEST_PATHS, MOST_PATHS))


def paths_of(lit: LitBody, paths: int) -> int:
    """Give each sample of a body fewer paths where there are more samples than are needed: every point sums over many of them."""
    return max(min(paths, SPARE_PATHS), round(paths / lit.spare))


def light_samples(
    scene: mi.Scene,
    state: LitScene,
    number: int,
    limits: Limits,
    paths: int,
    seed: int,
    translucency: Translucency | None,
    part: range | None = None,
) -> PathLight:
    """Path-trace the light at the samples of one body, or at some of them (`irradiance.measure_light`)."""
    lit, close = state.bodies[number], state.close_lamps(number)
    return measure_light(scene, lit.samples, lit.body.medium.eta, limits, paths, seed, translucency, part, close)


def entering_power(lit: LitBody) -> np.ndarray:
    """Multiply the entering light with the area of each sample, and with the texture where there is one: ``(n, 3) float``.

    A reflectance texture scales the profile of the mean medium at the point where light enters, so that under even light the
    exitance is the texture, blurred by the profile.
    """
    return lit.irradiance.entering.astype(float) * effective_area(lit)


def effective_area(lit: LitBody) -> np.ndarray:
    """Evaluate what turns light that enters at each sample into power: its area times `entering_factor`, ``(n, 3) float``."""
    factor = entering_factor(lit)
    return lit.samples.area[:, None] * (np.ones(3) if factor is None else factor)


def entering_factor(lit: LitBody) -> np.ndarray | None:
    """Evaluate what multiplies the light that enters at each sample: `textured` times `thin_factor`; None where it is 1 everywhere."""
    colour, thin = textured(lit), thin_factor(lit.body, lit.samples)
    return colour if thin is None else thin if colour is None else colour * thin


def textured(lit: LitBody) -> np.ndarray | None:
    """Evaluate what multiplies the light that enters at each sample, ``(n, 3) float``; None where it is 1 everywhere.

    That is the reflectance texture over its mean, times the opacity.
    """
    colour, there = None, opacity_at(lit.body, lit.samples)
    if lit.body.bsdf.texture is not None:
        colour = filtered_texture(lit.body.bsdf.texture, lit.body, lit.samples)
        colour /= lit.body.medium.total_diffuse_reflectance
    return colour if there is None else there if colour is None else colour * there
