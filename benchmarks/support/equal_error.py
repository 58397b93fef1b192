"""What the reference of the single pass costs at any error: its cuts are made smaller, and its own error at eye points measured.

Lightcuts choose the representatives of clusters at random, so two seeds give two pictures of the reference that differ by their
errors. Each is a sum over millions of samples; both are estimated from two independent draws of a few of these, in which a sample
that both draws have is lit once, and the mean product of the two differences is their squared difference without the noise of
drawing.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pellucid.light.points.discretise import irradiance_of_all
from support.single_pass import Cuts, Picture, Seen
from support.single_pass_errors import draw_samples, light_keys

FINEST = Cuts(0.02)
"""Those of AWB08."""

COARSER = (
    *(Cuts(bound) for bound in (0.05, 0.1, 0.2, 0.5)),
    *(Cuts(FINEST.max_error, most) for most in (300, 100, 30)),
)
"""With looser bounds, or cut off earlier: where virtual lights are near most cuts are full, and bounds change little."""

DRAWS = 512
FINE, OTHER, COARSE = 11, 12, 13
"""Seeds of representatives: of two references with the finest cuts, and of all coarser ones."""


@dataclass
class Errors:
    """What the reference finds at eye points with different cuts, as differences from its finest: each by two draws ``(n, 3)``."""

    mean: float
    """Of the exitance."""
    cuts: tuple[Cuts, ...]
    """The finest first."""
    differences: list[tuple[NDArray, NDArray]]

    def curve(self) -> list[dict[str, float]]:
        """List the RMSE of the exitance over its mean for all cuts, and its standard error.

        The difference of two references that are equally good is twice the squared error of one; that of a coarser one from a fine one
        is the sum of both.
        """
        rows, fine = [], 0.0
        for number, (cuts, (one, two)) in enumerate(zip(self.cuts, self.differences, strict=True)):
            each = (one * two).mean(axis=1)
            square = each.mean() / 2 if number == 0 else each.mean() - fine
            fine = square if number == 0 else fine
            rms = float(np.sqrt(max(square, 0.0)))
            spread = float(each.std()) / np.sqrt(len(each)) / (2 if number == 0 else 1)
            errors = {"rmse": rms / self.mean, "rmse_error": float(spread / (2 * max(rms, 1e-30)) / self.mean)}
            rows.append(cuts._asdict() | errors)
        return rows


def reference_errors(picture: Picture, seen: list[Seen], coarser: tuple[Cuts, ...] = COARSER) -> Errors:
    """Measure how much the reference errs at some eye points."""
    every = (FINEST, *coarser)
    parts = [_of_prototype(picture, s, every) for s in seen if len(s)]
    differences = [
        (np.concatenate([p[1][k][0] for p in parts]), np.concatenate([p[1][k][1] for p in parts]))
        for k in range(len(every))
    ]
    return Errors(float(np.concatenate([p[0] for p in parts]).mean()), every, differences)


def _of_prototype(picture: Picture, seen: Seen, every: tuple[Cuts, ...]) -> tuple[NDArray, list[tuple]]:
    """Give the exitance of the finest reference at eye points, and for all cuts the two differences."""
    pair = [draw_samples(seen, seed, DRAWS) for seed in (1, 2)]
    keys, place = np.unique(np.concatenate([draws.key for draws in pair]), return_inverse=True)
    backs = np.split(place, [len(pair[0].key)])

    def both(light: NDArray) -> list[NDArray]:
        return [draws.sums(light[back]) for draws, back in zip(pair, backs, strict=True)]

    fine = light_keys(picture, seen, keys, FINEST, FINE)
    differences = []
    for cuts in every:
        light = light_keys(picture, seen, keys, cuts, OTHER if cuts == FINEST else COARSE)
        differences.append(tuple(both(light - fine)))
    return both(fine)[0], differences


def against_all_lights(picture: Picture, seen: list[Seen], wanted: int) -> dict[str, float]:
    """Compare Lightcuts at some samples with the sum over all lights: RMSE and bias of the light that enters, over its mean.

    Samples are drawn in proportion to what eye points have of them.
    """
    found, exact, rng = [], [], np.random.default_rng(0)
    for s in seen:
        draws = draw_samples(s, 3, DRAWS)
        chosen = np.sort(draws.key[rng.permutation(len(draws.key))[: max(round(wanted * len(s) / _all(seen)), 1)]])
        found.append(light_keys(picture, s, chosen, FINEST, FINE))
        exact.append(_all_lights(picture, s, chosen))
    a, b = np.concatenate(found), np.concatenate(exact)
    error = (a - b).mean(axis=1)
    return {
        "samples": len(a),
        "rmse": float(np.sqrt(np.mean((a - b) ** 2)) / b.mean()),
        "bias": float(error.mean() / b.mean()),
        "bias_error": float(error.std() / np.sqrt(len(a)) / b.mean()),
    }


def _all(seen: list[Seen]) -> int:
    return sum(len(s) for s in seen)


def _all_lights(picture: Picture, seen: Seen, keys: NDArray) -> NDArray[np.float64]:
    """Sum the light of all lights that enters at samples: ``(n, 3)``."""
    leaves, lights = seen.body.samples.leaves, picture.state.lights(picture.scene)
    numbers = [mi.UInt32(part.astype(np.uint32)) for part in (keys % leaves, keys // leaves)]
    si = seen.body.samples.receiver(numbers[0], seen.body.placement, numbers[1])
    dr.eval(si)
    return irradiance_of_all(picture.scene, lights.lights, lights.leaves, si, seen.body.eta)[1].numpy().T


def at_error(curve: list[dict[str, float]], rmse: float) -> tuple[dict[str, float], str]:
    """Find the fewest rays with which the reference has an RMSE: by looser bounds, or by cuts that end earlier.

    Between neighbours it is interpolated along a power law. Where the curve ends before the RMSE it is said: ``<`` where the coarsest
    cuts err less than that still, so that fewer rays may do; ``>`` where the finest do not reach it.
    """
    fine = curve[0]
    families = ([row for row in curve if row[key] == fine[key]] for key in ("max_cut", "max_error"))
    return min((_along(family, rmse) for family in families), key=lambda found: found[0]["shadow_rays"])


def _along(rows: list[dict[str, float]], rmse: float) -> tuple[dict[str, float], str]:
    """Interpolate along cuts that differ in one way."""
    rows = sorted((row for row in rows if row["rmse"] > 0), key=lambda row: row["rmse"])
    x = np.log([row["rmse"] for row in rows])
    found = {
        key: float(np.exp(np.interp(np.log(rmse), x, np.log([row[key] for row in rows]))))
        for key in ("shadow_rays", "irradiance", "max_error", "max_cut")
    }
    return found, "<" if rmse > rows[-1]["rmse"] else ">" if rmse < rows[0]["rmse"] else ""
