"""The same medium as a volume for Mitsuba's volumetric path tracer: what the methods are compared with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pellucid.model.medium import Medium

RR_DEPTH = 2000
"""Roulette begins late: before, it would end one path in twenty at every scattering and make the others heavy."""


def homogeneous(medium: Medium) -> dict[str, Any]:
    """Describe a medium by its reduced coefficients and isotropic scattering: what diffusion says it is equivalent to."""
    sigma_t = medium.sigma_t_prime
    scale = float(np.max(sigma_t))  # colours of Mitsuba's scene dictionaries end at 1
    return {
        "type": "homogeneous",
        "scale": scale,
        "sigma_t": {"type": "rgb", "value": (sigma_t / scale).tolist()},
        "albedo": {"type": "rgb", "value": medium.albedo_prime.tolist()},
        "phase": {"type": "isotropic"},
    }


def rough_dielectric(medium: Medium, alpha: float) -> dict[str, Any]:
    """Describe the surface of a medium: rough, so that light that leaves can be connected to lamps."""
    return {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha, "int_ior": medium.eta, "ext_ior": 1.0}


def as_volume(spec: dict[str, Any], key: str, medium: Medium, folder: Path, alpha: float = 0.1) -> dict[str, Any]:
    """Copy a scene dictionary, with one of its shapes filled with a scattering volume.

    Parameters
    ----------
    spec : dict
        A scene; its shape ``key`` is a closed mesh or the dictionary of a shape.
    medium : Medium
        Per scene unit.
    folder : Path
        Where a mesh of memory is written, for Mitsuba to read it back with a medium inside.
    alpha : float
        Roughness of the surface.
    """
    shape = spec[key]
    if not isinstance(shape, dict):
        path = folder / f"{key}.ply"
        shape.write_ply(str(path))
        shape = {"type": "ply", "filename": str(path)}
    filled = {**shape, "bsdf": rough_dielectric(medium, alpha), "interior": homogeneous(medium)}
    return {**spec, key: filled}


def volume_path_tracer() -> Any:
    """Make Mitsuba's ``volpathmis`` without a bound on the number of scatterings."""
    import mitsuba as mi

    return mi.load_dict({"type": "volpathmis", "max_depth": -1, "rr_depth": RR_DEPTH})
