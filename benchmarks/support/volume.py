"""The same medium as a volume for Mitsuba's volumetric path tracer: what the methods are compared with.

The boundary is smooth. Mitsuba's rough dielectric models one bounce between its facets, and light that has scattered inside
meets the boundary again and again: a body that does not absorb would lose 6 to 7 % of the light at a roughness of .1, 1 % at
.03, and nothing behind a smooth boundary. Compare with a material of ``alpha`` 0, under lamps that have an extent: paths out of
a smooth boundary find them by chance alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pellucid.model.medium import Medium

RR_DEPTH = 2000
"""Roulette begins late: it ends one path in twenty at every scattering, and what longer paths carry is hardly ever found.

Of isotropic scattering; by similarity paths that scatter forwards are ``1 / (1 - g)`` times as long.
"""


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


def boundary(medium: Medium) -> dict[str, Any]:
    """Describe the surface of a medium: smooth, which keeps the energy."""
    return {"type": "dielectric", "int_ior": medium.eta, "ext_ior": 1.0}


def as_volume(spec: dict[str, Any], key: str, medium: Medium, folder: Path) -> dict[str, Any]:
    """Copy a scene dictionary, with one of its shapes filled with a scattering volume.

    Parameters
    ----------
    spec : dict
        A scene; its shape ``key`` is a closed mesh or the dictionary of a shape.
    medium : Medium
        Per scene unit.
    folder : Path
        Where a mesh of memory is written, for Mitsuba to read it back with a medium inside.
    """
    shape = spec[key]
    if not isinstance(shape, dict):
        path = folder / f"{key}.ply"
        shape.write_ply(str(path))
        shape = {"type": "ply", "filename": str(path)}
    filled = {**shape, "bsdf": boundary(medium), "interior": homogeneous(medium)}
    return {**spec, key: filled}


def volume_path_tracer(g: float = 0.0) -> Any:
    """Make Mitsuba's ``volpathmis`` without a bound on the number of scatterings, of that mean cosine."""
    import mitsuba as mi

    return mi.load_dict({"type": "volpathmis", "max_depth": -1, "rr_depth": round(RR_DEPTH / (1 - g))})
