"""What the gradient of a sum over samples costs beside the sum: by the coefficients, and by the power of all samples as well.

Times are those of processors, which other work on the machine changes little.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import pellucid
from pellucid.methods.material import COEFFICIENTS
from support.block import block_spec

METHODS = {"two_pass": {"sample_count": 20_000}, "texture_space": {"sample_count": 5000, "resolution": 256}}
"""A sum over a tree, and one over all samples."""

PROFILES = ("dipole", "tabulated", "curved")
POINTS = 200
"""Along a side: the top of the block, in the order of a picture."""


def gradient_cost(fewer: int, rounds: int) -> dict[str, Any]:
    """Measure the shortest of some rounds of each, with so many times fewer samples [processor s]."""
    return {
        f"`{method}`, {profile}": _of_sum(
            {"type": f"pellucid_{method}", **settings, "sample_count": settings["sample_count"] // fewer},
            profile,
            rounds,
        )
        for method, settings in METHODS.items()
        for profile in PROFILES
    }


def _of_sum(spec: dict[str, Any], profile: str, rounds: int) -> dict[str, float]:
    """Measure one method and profile."""
    bsdf = {"type": "pellucid_translucent", "profile": profile, "reflectance": 0.5, "dmfp": 1.0}
    scene = pellucid.load_scene(block_spec({"bsdf": bsdf}, 8))
    integrator: Any = mi.load_dict(spec | {"irradiance_paths": 16})
    method, lit = integrator.method, integrator.prepare_scene(scene).bodies[0]
    p, n = _top(lit.body)
    weights = mi.Point3f(np.random.default_rng(0).uniform(-0.3, 0.7, (3, dr.width(p))).astype(np.float32))
    dr.eval(p, n, weights)
    derivatives = method.derivatives(lit, list(COEFFICIENTS), False)
    works: dict[str, Callable[[], Any]] = {
        "sum": lambda: method.sum_up(lit, p, n, False),
        "coefficients": lambda: derivatives.gradient(p, weights, of_power=False, n=n),
        "powers": lambda: derivatives.gradient(p, weights, of_power=True, n=n),
        "tables": lambda: method.derivatives(lit, list(COEFFICIENTS), False),
    }
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds + 1):  # in turns; the first round compiles
        for name, work in works.items():
            times[name].append(_seconds(work))
    return {name: min(all_of_it[1:]) for name, all_of_it in times.items()}


def _top(body: Any) -> tuple[mi.Point3f, mi.Normal3f]:
    """Spread points over the top of a body that is a block, row by row."""
    box = body.bbox()
    x, y = dr.meshgrid(*[dr.linspace(mi.Float, box.min[k] * 0.99, box.max[k] * 0.99, POINTS) for k in range(2)])
    return mi.Point3f(x, y, box.max[2]), mi.Normal3f(0, 0, 1) + dr.zeros(mi.Normal3f, dr.width(x))


def _seconds(work: Callable[[], Any]) -> float:
    since = time.process_time()
    dr.eval(work())
    dr.sync_thread()
    return time.process_time() - since
