"""A converged picture to measure errors against, and what errors are made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import pellucid
from pellucid.metrics import relative_rmse
from support.pixels import covered_pixels

CONVERGED_PATHS = 256


@dataclass
class Reference:
    """The converged exitance of a few thousand pixels, and one point in each of them."""

    rows: np.ndarray
    columns: np.ndarray
    exitance: np.ndarray
    points: np.ndarray

    def error(self, picture: np.ndarray) -> float:
        """RMSE of a picture's exitance over its mean."""
        return relative_rmse(picture[self.rows, self.columns, 3:6], self.exitance)


def converge(scene: Any, prepared: Any, pixels: int, **settings: Any) -> Reference:
    """Sum over all of many more samples, elsewhere and better lit, at a grid of points in every pixel."""
    rows, columns, points = covered_pixels(scene, scene.sensors()[0], prepared.lookup, pixels)
    exact = pellucid.prepare(scene, "exact", **settings)
    exitance = exact.exitance(points.reshape(-1, 3)).reshape(points.shape)
    return Reference(rows, columns, exitance.mean(axis=1), points[:, 0])


def parts_of_error(
    scene: Any, prepared: Any, points: np.ndarray, paths: int = CONVERGED_PATHS, **settings: Any
) -> dict[str, float]:
    """Tell which error at points is due to clusters, and which to clusters and to the noise of the light on the samples.

    Neither knows of the error that the samples themselves make: both references sum over the same ones.
    """
    import mitsuba as mi

    (lit,) = prepared.bodies
    p = mi.Point3f(np.ascontiguousarray(points.T))

    def ask(name: str, lit_body: Any) -> np.ndarray:
        method = mi.load_dict({"type": f"pellucid_{name}"}).method
        stated = replace(lit_body, state=None)
        stated.state = method.build(stated)
        return method.sum_up(stated, p, mi.Normal3f(0), False).numpy().T

    well_lit = pellucid.prepare(scene, "exact", **settings, irradiance_paths=paths).integrator.prepared.bodies[0]
    ours = ask("two_pass", lit)
    return {
        "clusters": relative_rmse(ours, ask("exact", lit)),
        "same_samples": relative_rmse(ours, ask("exact", well_lit)),
    }
