"""Two scenes with the teapot: marble in lamp light, and glossy under the sky (both in figure 3 of JB02)."""

from __future__ import annotations

from pathlib import Path

from ...scene.meshes.buffers import mesh_from_arrays
from ..stage import PictureSettings, Spec, diffuse, environment_light, material, start, studio
from .mesh import DEFAULT_SIZE, teapot_mesh


def teapot(settings: PictureSettings, bsdf: Spec | None = None, size: float = DEFAULT_SIZE, detail: int = 18) -> Spec:
    """A marble teapot, lit warmly from behind and the side, with a dim cool fill: the setting of figure 3 of JB02."""
    unit = size / DEFAULT_SIZE
    target = (8.0 * unit, 0.0, 42.0 * unit)
    scene = start(settings, (-95.0 * unit, -430.0 * unit, 170.0 * unit), target, 27.7, "x")
    vertices, normals, faces = teapot_mesh(size, detail)
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "marble"})
    scene["teapot"] = mesh_from_arrays("teapot", vertices, faces, normals, bsdf=bsdf)
    return scene | studio(target, size)


def teapot_env(
    settings: PictureSettings,
    bsdf: Spec | None = None,
    size: float = DEFAULT_SIZE,
    detail: int = 18,
    environment: str | Path | None = None,
) -> Spec:
    """A glossy teapot of marble under an environment map, or by default under Mitsuba's sun and sky.

    Parameters
    ----------
    environment : str or Path, optional
        A latitude-longitude picture, ``.exr`` or ``.hdr``, whose up is y as is usual for them.
    """
    import mitsuba as mi

    unit = size / DEFAULT_SIZE
    target = (8.0 * unit, 0.0, 46.0 * unit)
    scene = start(settings, (-95.0 * unit, -430.0 * unit, 92.0 * unit), target, 27.7, "x")
    vertices, normals, faces = teapot_mesh(size, detail)
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "marble", "alpha": 0.03})
    scene["teapot"] = mesh_from_arrays("teapot", vertices, faces, normals, bsdf=bsdf)
    scene["sky"] = _sky() if environment is None else environment_light(environment)
    # Under the sky the ground reaches the horizon; a picture of an environment shows its own ground around a table.
    reach = unit * (170.0 if environment else 4e5)
    scene["ground"] = {
        "type": "disk",
        "to_world": mi.ScalarTransform4f().scale([reach, reach, 1]),
        "bsdf": diffuse(0.15, 0.135, 0.12),
    }
    return scene


def _sky() -> Spec:
    """A clear evening: the sun low behind the teapot, to the left."""
    return {
        "type": "sunsky",
        "sun_direction": [-0.75, 0.5, 0.33],
        "sun_scale": 3.2,
        "sky_scale": 2.6,
        "turbidity": 4.0,
    }
