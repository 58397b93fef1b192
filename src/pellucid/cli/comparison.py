"""Several methods on one scene: run, measured and laid side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..jobs.job import Job
from ..jobs.output import film_array
from ..metrics import relative_rmse, rmse
from .reporter import StageClock
from .tables import print_table


@dataclass
class Result:
    """What one method made of the scene: its picture, ``(h, w, 3) float``, and its times [s]."""

    method: str
    picture: np.ndarray
    preparation: float
    drawing: float
    compiling: float


def run(job: Job, method: str, clock: StageClock) -> Result:
    """Render by one method."""
    before = clock.compiling()
    integrator = job.integrator(method)
    with clock.lap() as preparation:
        job.prepare(integrator)
    with clock.lap() as drawing:
        job.render(integrator)
    picture = film_array(job.sensor.film())
    return Result(method, picture, preparation.seconds, drawing.seconds, clock.compiling() - before)


def gain(picture: np.ndarray, truth: np.ndarray) -> float:
    """Choose a round factor that lifts the largest differences (99.5 %) to about white."""
    largest = float(np.quantile(np.abs(picture - truth), 0.995))
    if largest <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(1 / largest))
    return float(max(1.0, power * max(step for step in (1, 2, 5) if power * step <= 1 / largest)))


def composition(results: list[Result], truth: np.ndarray, gains: list[float]) -> np.ndarray:
    """Put the pictures side by side above their amplified differences: ``(2 h, k w, 3) float``."""
    pictures = [result.picture for result in results]
    differences = [factor * np.abs(picture - truth) for picture, factor in zip(pictures, gains, strict=True)]
    return np.concatenate([np.concatenate(pictures, axis=1), np.concatenate(differences, axis=1)], axis=0)


def show(results: list[Result], truth: np.ndarray, gains: list[float], reference: str) -> None:
    """Print the table."""
    rows = [
        (
            result.method,
            f"{result.preparation:.2f}",
            f"{result.drawing:.2f}",
            f"{result.compiling:.2f}",
            "reference" if result.method == reference else f"{rmse(result.picture, truth):.3g}",
            "" if result.method == reference else f"{100 * relative_rmse(result.picture, truth):.3g} %",
            "" if result.method == reference else f"x {factor:g}",
        )
        for result, factor in zip(results, gains, strict=True)
    ]
    header = ("method", "preparation [s]", "picture [s]", "compiling [s]", "RMSE", "RMSE/mean", "shown")
    print_table(header, rows)
