"""The time of a gradient at equal noise: sums over samples beside path replay through a volume."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import pellucid
from pellucid.model.medium import Medium
from support.block import block_spec

SPP = 16
NAMES = ("sigma_a", "sigma_s_prime")
Gradients = dict[str, float]


def gradient_speed(size: int, sample_count: int, runs: int) -> dict[str, Any]:
    """Measure the gradient of a picture's mean by both coefficients, from many seeds: its time and its relative standard deviation.

    The medium is grey: path replay is biased where it is not (Mitsuba's issue 1846).
    """
    medium = Medium.from_reflectance(0.5, 1.0, eta=1.3)
    works = {"pellucid": _sums(medium, size, sample_count), "prbvolpath": _replay(medium, size)}
    found: dict[str, tuple[list[Gradients], list[float]]] = {name: ([], []) for name in works}
    for seed in range(-1, runs):  # in turns; the first run compiles
        for name, work in works.items():
            since = time.perf_counter()
            gradient = work(seed + 1)
            if seed >= 0:
                found[name][0].append(gradient)
                found[name][1].append(time.perf_counter() - since)
    results: dict[str, Any] = {}
    for parameter in NAMES:
        both = {}
        for name, (gradients, times) in found.items():
            values = np.array([g[parameter] for g in gradients])
            both[name] = {
                "seconds": float(np.median(times)),
                "mean": float(values.mean()),
                "noise": float(values.std(ddof=1) / abs(values.mean())),
            }
        ours, theirs = both["pellucid"], both["prbvolpath"]
        ratio = theirs["seconds"] * theirs["noise"] ** 2 / (ours["seconds"] * ours["noise"] ** 2)
        results[parameter] = {**both, "ratio": ratio}
    return results


def _sums(medium: Medium, size: int, sample_count: int) -> Callable[[int], Gradients]:
    """Make the gradient by pellucid, preparation and all, by the logarithms of the coefficients."""
    colours = {name: {"type": "rgb", "value": getattr(medium, name).tolist()} for name in NAMES}
    bsdf = {"type": "pellucid_translucent", **colours, "eta": medium.eta, "alpha": 0.0}
    scene = pellucid.load_scene(block_spec({"bsdf": bsdf}, size))
    params = mi.traverse(scene)
    keys = {name: f"block.bsdf.{name}" for name in NAMES}

    def work(seed: int) -> Gradients:
        for key in keys.values():
            dr.enable_grad(params[key])
            dr.set_grad(params[key], 0)
        params.update()
        integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": sample_count, "seed": seed})
        _backward(scene, params, integrator, seed)
        return {name: _along(params[key]) for name, key in keys.items()}

    return work


def _replay(medium: Medium, size: int) -> Callable[[int], Gradients]:
    """Make the gradient by Mitsuba's path replay, by the logarithms of the coefficients."""
    sigma_t, albedo = float(medium.sigma_t[0]), float(medium.albedo[0])
    interior = {
        "type": "homogeneous",
        "sigma_t": {"type": "rgb", "value": [1.0] * 3},
        "scale": sigma_t,
        "albedo": {"type": "rgb", "value": [albedo] * 3},
    }
    smooth = {"type": "dielectric", "int_ior": medium.eta, "ext_ior": 1.0}
    scene = pellucid.load_scene(block_spec({"bsdf": smooth, "interior": interior}, size))
    params = mi.traverse(scene)
    (of_extinction,) = (key for key, _ in params if key.endswith("sigma_t.value.value"))
    (of_albedo,) = (key for key, _ in params if key.endswith("albedo.value.value"))
    integrator = mi.load_dict({"type": "prbvolpath", "max_depth": 2000, "rr_depth": 2000})

    def work(seed: int) -> Gradients:
        for key in (of_extinction, of_albedo):
            dr.enable_grad(params[key])
            dr.set_grad(params[key], 0)
        params.update()
        _backward(scene, params, integrator, seed)
        extinction, scattering = _along(params[of_extinction]), _along(params[of_albedo])
        return {  # sigma_t = sigma_a + sigma_s, albedo = sigma_s / sigma_t
            "sigma_a": (1 - albedo) * (extinction - scattering),
            "sigma_s_prime": albedo * extinction + (1 - albedo) * scattering,
        }

    return work


def _backward(scene: mi.Scene, params: Any, integrator: Any, seed: int) -> None:
    """Send the gradient of a picture's mean back; the picture itself is not needed for that."""
    size = scene.sensors()[2].film().crop_size()
    shape = (int(size[1]), int(size[0]), 3)
    gradient = dr.full(mi.TensorXf, 1 / float(np.prod(shape)), shape)
    integrator.render_backward(scene, params, gradient, sensor=2, seed=seed, spp=SPP)


def _along(value: Any) -> float:
    """Read the gradient by the logarithm of a parameter, all channels together."""
    return float((dr.grad(value).numpy() * dr.detach(value).numpy()).sum())
