"""Use the two passes from any program: prepare a scene once, then ask for the exitance at any point."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from .errors import SceneError
from .progress import chunks, steps

POINTS_AT_ONCE = 1 << 22


class Prepared:
    """A scene whose surface samples are spread and lit, ready to be asked for its exitance.

    Made by `prepare`. ``integrator`` renders pictures from the same state; ``bodies`` names the translucent solids.
    """

    def __init__(self, scene: mi.Scene, integrator: Any):
        self.scene = scene
        self.integrator = integrator
        self.integrator.prepared = integrator.prepare_scene(scene)

    @property
    def bodies(self) -> list[str]:
        """Names of the translucent bodies, in the order of their numbers."""
        return [lit.body.name for lit in self.integrator.prepared.bodies]

    def exitance(self, points: np.ndarray, normals: np.ndarray | None = None, body: int | str = 0) -> np.ndarray:
        """Evaluate the radiant exitance at points of a body, for any renderer, a scanline one included.

        Parameters
        ----------
        points : (n, 3) float
            Where light leaves, in world coordinates.
        normals : (n, 3) float, optional
            Of the surface there. Only the method ``sampled`` needs them: the profile is a function of distance.
        body : int or str
            Number or name of the body the points belong to.

        Returns
        -------
        (n, 3) float32
            Exitance B [W/m^2 if radiances are in W/(m^2 sr)]. The radiance towards ``omega_out`` is
            ``F_t(omega_out) B / (pi T_d)``.

        Raises
        ------
        SceneError
            For a body that the scene does not have, and for points of another shape.

        Source
        ------
        JB02 section 3, eq. 13.
        """
        points = np.atleast_2d(np.asarray(points, np.float32))
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise SceneError(f"points must be an (n, 3) array of finite numbers; found shape {points.shape}.")
        given = [0, 0, 1] if normals is None else normals
        normals = np.broadcast_to(np.asarray(given, np.float32), points.shape)
        lit = self._body(body)
        result = np.empty_like(points)
        for first, size in steps("exitance", chunks(len(points), POINTS_AT_ONCE), "points"):
            here = slice(first, first + size)
            p = mi.Point3f(np.ascontiguousarray(points[here].T))
            n = mi.Normal3f(np.ascontiguousarray(normals[here].T))
            result[here] = self.integrator.exitance(self.scene, lit, p, n, first, False).numpy().T
        return result

    def _body(self, body: int | str) -> Any:
        """Find a body by number or name."""
        number = self.bodies.index(body) if body in self.bodies else body
        if not isinstance(number, int) or not 0 <= number < len(self.bodies):
            raise SceneError(f"There is no body {body!r}: the scene has {', '.join(self.bodies)}.")
        return self.integrator.prepared.bodies[number]


def prepare(scene: mi.Scene, method: str = "two_pass", **settings: Any) -> Prepared:
    """Spread and light the surface samples of a scene.

    Parameters
    ----------
    scene : mi.Scene
        Any scene with translucent shapes; from a file, load it with `load_scene`.
    method : str
        ``two_pass``, ``texture_space``, ``single_pass``, ``exact`` or ``sampled``.
    settings
        The parameters of the plug-in ``pellucid_<method>``.
    """
    return Prepared(scene, mi.load_dict({"type": f"pellucid_{method}", **settings}))
