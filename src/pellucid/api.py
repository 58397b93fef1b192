"""Use a method from any program: prepare a scene once, then ask for the exitance at any points."""

from __future__ import annotations

from functools import cached_property

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import PellucidError, SceneError, did_you_mean, first_cause, warn
from .kernels.memory import columns, rows, upload
from .methods import method_class
from .methods.contract import Points, key_of_positions
from .methods.layers import Layers
from .methods.preparation import follows_curve
from .progress import chunks, steps
from .scene.nearest import NearestSurface

POINTS_AT_ONCE = 1 << 22
LOOKED_AT = 1000
"""So many of the points that are asked for are checked to lie on a surface."""


class Prepared:
    """A scene that a method has prepared, ready to be asked for its exitance. Made by `prepare`.

    Attributes
    ----------
    scene : mi.Scene
    integrator : mi.Integrator
        Renders pictures from the same state.
    """

    def __init__(self, scene: mi.Scene, integrator: mi.Integrator, sensor: int = 0):
        self.scene = scene
        self.integrator = integrator
        self.integrator.prepared = integrator.prepare_scene(scene, sensor)

    def __repr__(self) -> str:
        return f"<pellucid.Prepared: {self.integrator.method.name}, bodies {', '.join(self.bodies)}>"

    @property
    def bodies(self) -> list[str]:
        """Names of the translucent bodies, in the order of their numbers."""
        return [lit.body.name for lit in self.integrator.prepared.bodies]

    @cached_property
    def _nearest(self) -> NearestSurface:
        return NearestSurface(self.scene, [lit.body for lit in self.integrator.prepared.bodies])

    def exitance(
        self, points: ArrayLike, *, normals: ArrayLike | None = None, body: int | str | None = None
    ) -> NDArray[np.float32]:
        """Evaluate the radiant exitance at points of the bodies, for any renderer, a scanline one included.

        The exitance at a point depends on that point alone, bit for bit: not on the others, their order or their number.

        Parameters
        ----------
        points : (n, 3) float
            Where light leaves, in world coordinates [scene units].
        normals : (n, 3) float, optional
            Of the surface there, out of a closed body; of one whose faces are wound inwards, either way. If they are left out, a method
            that needs them takes those of the nearest surface. They tell which side of an open surface is asked, else its front.
        body : int or str, optional
            Number or name of the body that all points belong to. If it is left out, each belongs to that of the nearest surface.

        Returns
        -------
        (n, 3) float32
            Exitance B [W/m^2 if radiances are in W/(m^2 sr)]. The radiance towards ``omega_out`` is
            ``F_t(omega_out) B / (pi T_d)``.

        Raises
        ------
        SceneError
            For a body that the scene does not have, for arrays of another shape, and when the scene has changed since it was
            prepared.

        Source
        ------
        JB02 section 3, eq. 13.
        """
        at = _vectors("points", points)
        number = None if body is None else self._number(body)
        changed = self.integrator.prepared.record.changed(self.scene)
        if changed:
            raise SceneError(f"The scene has changed since it was prepared ({changed}): call pellucid.prepare again.")
        self._warn_of_distant(at)
        result = np.empty_like(at)
        n = None if normals is None else _vectors("normals", normals, len(at))
        for first, size in steps("exitance", chunks(len(at), POINTS_AT_ONCE), "points"):
            here = slice(first, first + size)
            asked = self._points(at[here], None if n is None else n[here], number)
            method, state = self.integrator.method, self.integrator.prepared
            result[here] = rows(method.exitance(self.scene, state, asked))
        return result

    def _warn_of_distant(self, p: NDArray[np.float32]) -> None:
        """Warn of points that lie on no surface: what is evaluated there is no exitance."""
        if not len(p):
            return
        some = p[:: -(-len(p) // LOOKED_AT)]
        worst, distance = self._nearest.most_distant(some)
        if worst >= 0:
            warn(
                f"The point {some[worst].tolist()} is {distance:.3g} away from the nearest translucent surface: light leaves at "
                "surfaces, and the exitance elsewhere means nothing."
            )

    def _points(self, p: NDArray[np.float32], n: NDArray[np.float32] | None, body: int | None) -> Points:
        """Describe points as a method asks for them, with bodies and normals of the nearest surface where they are not given."""
        if body is None and len(self.bodies) == 1:
            body = 0
        numbers = np.full(len(p), body or 0)
        state = self.integrator.prepared
        reads_normals = self.integrator.method.needs_normals or follows_curve(state)
        stretch = None
        # Methods expect normals on the side of those of the faces.
        turns = n is not None and reads_normals and bool(self._nearest.wound_inwards.any())
        if body is None or (n is None and reads_normals) or turns or state.stretch is not None:
            numbers, nearest, si = self._nearest.find(p, body, n)
            if n is None:
                n = nearest
            elif turns:
                against = self._nearest.wound_inwards[numbers] & (np.sum(n * nearest, axis=1) < 0)
                n = np.where(against[:, None], -n, n)
            if state.stretch is not None:
                stretch = state.stretch.at(si, upload(numbers.astype(np.uint32) + 1))
        n = np.full_like(p, np.nan) if n is None else n  # no method that reads them gets here
        at = mi.Point3f(*columns(p))
        return Points(
            at,
            mi.Normal3f(*columns(n)),
            upload(numbers.astype(np.uint32) + 1),
            upload(np.ones(len(p), np.float32)),
            key_of_positions(at, self.integrator.method.seed),
            stretch,
        )

    def _number(self, body: int | str) -> int:
        """Find a body by number or name."""
        names = self.bodies
        number = names.index(body) if body in names else body
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or not 0 <= number < len(names):
            raise SceneError(
                f"There is no body {body!r}{did_you_mean(str(body), names)}: the scene has {', '.join(names)}."
            )
        return int(number)


def _vectors(name: str, values: ArrayLike, count: int | None = None) -> NDArray[np.float32]:
    """Check an array of vectors."""
    array = np.atleast_2d(np.asarray(values, np.float32))
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all() or count not in (None, len(array)):
        wanted = f"({'n' if count is None else count}, 3)"
        raise SceneError(f"{name} must be an array of finite numbers of the shape {wanted}; found {np.shape(values)}.")
    return array


def prepare(scene: mi.Scene, method: str = "two_pass", *, sensor: int = 0, **settings: object) -> Prepared:
    """Prepare a scene by a method.

    Parameters
    ----------
    scene : mi.Scene
        Any scene with translucent shapes; from a file, load it with `load_scene`.
    method : str
        ``two_pass``, ``texture_space``, ``single_pass``, ``exact`` or ``sampled``.
    sensor : int
        The camera for whose view ``single_pass`` prepares; other methods prepare for all views alike.
    settings
        The parameters of the plug-in ``pellucid_<method>``.

    Raises
    ------
    PellucidError
        For a method or a setting that there is not, and for a scene without translucent shapes.
    """
    method_class(method)
    try:
        integrator = mi.load_dict({"type": f"pellucid_{method}", **settings})
    except RuntimeError as error:
        raise PellucidError(first_cause(str(error))) from error
    return Prepared(scene, integrator, sensor)


def render_layers(
    scene: mi.Scene,
    sensor: int | mi.Sensor = 0,
    *,
    seed: int = 0,
    spp: int = 0,
    integrator: mi.Integrator | None = None,
) -> Layers:
    """Render a picture with what a denoiser needs to know of each pixel.

    Parameters
    ----------
    scene : mi.Scene
    sensor : int or Sensor
    seed, spp : int
        As for ``mi.render``; 0 samples a pixel are those of the camera.
    integrator : mi.Integrator, optional
        One of this package, as that of a `Prepared` scene. If it is left out, that of the scene.

    Returns
    -------
    Layers
        ``denoised`` is the picture without its noise; ``colour``, ``albedo``, ``normal``, ``depth`` and ``exitance`` are the layers.

    Raises
    ------
    PellucidError
        For an integrator that is none of this package.
    """
    chosen = scene.integrator() if integrator is None else integrator
    if not hasattr(chosen, "render_layers"):
        found = "none" if chosen is None else chosen.class_name()
        raise PellucidError(
            f"render_layers needs one of the integrators pellucid_..., found {found}: give it as integrator=."
        )
    layers: Layers = chosen.render_layers(scene, sensor, seed, spp)
    return layers
