"""The real-time engine: irradiance image, importance samples, exitance where the eye looks; three stages a frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from numbers import Real
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import PellucidError, warn
from ..kernels.sequences import r2
from ..methods.denoising import can_denoise, denoise
from ..methods.preparation import warn_of_open_surfaces
from ..methods.reflectance import settle_reflectances
from ..methods.stretch import refuse_stretched
from ..methods.texture_space.pyramid import check_resolution
from ..model.medium import Medium
from ..scene.bodies import Role, acting_as, build_lookup, find_bodies
from ..scene.finite import check_values
from .checks import check_medium, check_settings, check_view
from .gbuffer import Eye, camera_key
from .image_space import SeenLight
from .interpolation import every_pixel, every_tile
from .lights import Lamp
from .live_body import LiveBody
from .near_lamps import NearLampWarnings
from .pace import Clock, Stillness
from .shading import highlights, leave_table, surroundings, translucent
from .source import METHODS, BodyState, Camera, Frame, Light, Settings
from .tone import average_radiance, to_bytes, tone_map

PICTURE_PASSES = 16
"""Pictures, each through another place in the pixels and with other samples, that a settled frame is the mean of."""

SMALLEST_ATLAS = 128
WARM_UP = (64, 64)
LOWEST_BOUND = 1e-9


class Engine:
    """Makes frames of a Mitsuba scene with translucent bodies (`source.FrameSource`).

    Parameters
    ----------
    scene : mi.Scene
        Loaded with `pellucid.load_scene`. Edits go into it: any integrator renders the same picture.
    resolution : int
        Texels along each side of the irradiance image, a power of two; several bodies share as many among them.

    Raises
    ------
    SceneError
        When the scene has no translucent body, or one that cannot be laid out, and for another resolution.

    Warns
    -----
    PellucidWarning
        When the scene has no light, for open surfaces that may be lit or seen from both sides, and for lamps inside of bodies or too near.

    Source: CLHHC08 section 3.
    """

    def __init__(self, scene: mi.Scene, resolution: int = 1024):
        self.scene, self.settings = scene, Settings(denoised=can_denoise())
        bodies = find_bodies(scene)
        check_values(scene)
        settle_reflectances(bodies)
        refuse_stretched(bodies, "the real-time engine")
        if not scene.emitters():
            warn("The scene has no light: frames will be black. Add an emitter.")
        check_resolution(resolution)
        warn_of_open_surfaces(scene, bodies)
        share = max(resolution >> ((len(bodies) - 1).bit_length() + 1) // 2, min(resolution, SMALLEST_ATLAS))
        self._lookup = build_lookup(scene, bodies)
        self._bodies = [LiveBody(body, k, self._lookup, share) for k, body in enumerate(bodies)]
        self._seen = [
            SeenLight(b.body, k, self._lookup, b.near.centre, b.near.radius) for k, b in enumerate(self._bodies)
        ]
        self._lamps = [Lamp(scene, emitter) for emitter in scene.emitters()]
        self._near_lamps = NearLampWarnings(scene, self._bodies, self._lookup)
        self._area = sum(body.area for body in self._bodies)
        self._leave = leave_table(self._bodies)
        opaque = len(scene.shapes()) > len({id(part.in_scene) for body in bodies for part in body.parts})
        self._eye = Eye(scene, self._lookup, keep_hits=opaque)
        self._sampler = mi.load_dict({"type": "independent"})
        self._still = Stillness()
        self._edits, self._is_warm = 0, False
        self._lit_by: object = None
        self._drawn: object = None
        self._accepted = replace(self.settings)
        """The settings of the last frame that was made."""

    def __repr__(self) -> str:
        bodies = [
            f"{body.name} ({body.medium.name or 'a medium without a name'}, {body.size_mm:.3g} mm)"
            for body in self.bodies
        ]
        lights = [f"{light.name or 'unnamed'} ({light.kind}, intensity {light.intensity:.3g})" for light in self.lights]
        resolution = self._bodies[0].image.texels.resolution
        return (
            f"<Engine: {resolution} x {resolution} texels a body\n  bodies: {', '.join(bodies)}\n"
            f"  lights: {', '.join(lights) or 'none'}\n  {self.settings}>"
        )

    # ------------------------------------------------------------------ what can be changed

    @property
    def lights(self) -> list[Light]:
        """List the emitters of the scene as they are now."""
        return [lamp.describe() for lamp in self._lamps]

    @property
    def bodies(self) -> list[BodyState]:
        """List the translucent bodies of the scene as they are now."""
        return [BodyState(b.body.name, b.medium, b.extent * b.body.bsdf.scale) for b in self._bodies]

    @property
    def notes(self) -> list[str]:
        """Say how the surface of each body was laid out."""
        return [f"{body.body.name}: {note}" for body in self._bodies for note in body.notes]

    def set_light(self, index: int, **changes: Any) -> None:
        """Change ``position``, ``direction``, ``colour`` or ``intensity`` of a light; the rest stays.

        Raises
        ------
        PellucidError
            For a light that is not there, and for what its kind does not have.
        """
        shapes_moved = _pick(self._lamps, index, "light").change(**changes)
        if shapes_moved:
            self._eye.forget()
        for body in self._bodies:
            if shapes_moved:
                body.image.forget()
            elif "position" in changes or "direction" in changes:
                body.image.forget(index)
            body.image.indirect.forget()
            body.near.forget(None if shapes_moved else index)
        if "position" in changes:
            self._near_lamps.give()
        self._edits += 1

    def set_medium(self, index: int, medium: Medium) -> None:
        """Give a body, and all that share its material, another medium [1/mm]; its size stays.

        Raises
        ------
        PellucidError
            For a body that is not there, and for a medium that no frame can be made with; all stays as it was.
        """
        body = _pick(self._bodies, index, "body")
        self._set_media([(body, medium, body.body.bsdf.scale)])
        for each in self._bodies:
            each.image.indirect.forget()

    def set_size(self, millimetres: float) -> None:
        """Let the largest extent of all bodies be so many millimetres: changes ``scale``, no geometry.

        Raises
        ------
        PellucidError
            For a size that no frame can be made with; all stays as it was.
        """
        if not isinstance(millimetres, Real) or not (np.isfinite(millimetres) and millimetres > 0):
            raise PellucidError(f"The size of an object is a positive number of millimetres; found {millimetres!r}.")
        scale = millimetres / max(body.extent for body in self._bodies)
        self._set_media([(body, body.medium, scale) for body in self._bodies])

    def _set_media(self, media: list[tuple[LiveBody, Medium, float]]) -> None:
        """Give bodies media [1/mm] and sizes of a scene unit [mm]; where that fails, those that they had."""
        before = [(body, body.medium, body.body.bsdf.scale) for body in self._bodies]
        for body, medium, scale in media:
            check_medium(medium, body.extent * scale)
        try:
            for body, medium, scale in media:
                body.set_medium(medium, scale)
            self._refresh()
        except (ArithmeticError, LookupError, ValueError, RuntimeError, MemoryError) as error:
            for body, medium, scale in before:
                body.set_medium(medium, scale)
            self._refresh()
            raise PellucidError(
                f"No frame can be made with that medium at that size, which stay as they were: {error}"
            ) from error

    def _refresh(self) -> None:
        """Take over the media of the scene."""
        for body in self._bodies:
            body.refresh()
        self._leave = leave_table(self._bodies)
        self._edits += 1

    # ------------------------------------------------------------------ frames

    def frame(self, camera: Camera, resolution: tuple[int, int], moving: bool) -> Frame:
        """Make one frame, ``resolution`` = (width, height); ``moving`` promises that another one follows at once.

        At rest frames settle one by one: first the light, until lamps with an extent and indirect light are the mean of
        enough samples; then the picture, as the mean of passes through other places in the pixels, with other samples.

        Where a frame fails, the settings are those of the last one again, and the next one is prepared anew.

        Raises
        ------
        PellucidError
            For settings, a camera or a size that no frame can be made with.
        """
        with self._or_as_before(camera, resolution):
            return self._frame(camera, resolution, moving)

    @contextmanager
    def _or_as_before(self, camera: Camera, resolution: tuple[int, int]) -> Iterator[None]:
        """Check what a picture is to be made with; if it fails, take the settings back and forget all that was computed."""
        check_view(camera, resolution)
        try:
            check_settings(self.settings)
            yield
        except Exception:
            vars(self.settings).update(vars(self._accepted))
            self._forget()
            raise
        self._accepted = replace(self.settings)

    def _forget(self) -> None:
        """Mark all that frames keep for the next one as out of date."""
        self._eye.forget()
        self._still = Stillness()
        self._lit_by = self._drawn = None
        for body in self._bodies:
            body.image.forget()
            body.near.forget()

    def _frame(self, camera: Camera, resolution: tuple[int, int], moving: bool) -> Frame:
        """Make one frame with settings that are known to be fine."""
        if not self._is_warm:
            self._warm_up(camera)
            self._is_warm = True
        clock = Clock(self.settings.timed)
        key = (camera_key(camera), resolution, replace(self.settings), self._edits)
        if moving or key != self._still.key:
            self._still.restart(None if moving else key)
        elif self._still.frame is not None and self._still.frame.still:
            return self._still.frame
        if moving:
            # First, so that the processor does not wait for Python later: nothing stops it then from light to picture.
            self._look(clock, camera, resolution, 0)
        settled = self._light(clock, refine=not moving)
        still = self._still if settled and not moving else None
        colour = self._picture(clock, camera, resolution, still, interpolated=moving and self.settings.interpolated)
        with clock.stage("shading"):
            pixels = self._eye.to_host(to_bytes(colour))
        samples = np.concatenate([np.stack([x.numpy() for x in body.p], axis=1) for body in self._bodies])
        self._still.frame = Frame(pixels, clock.stop(), samples, self._still.passes >= PICTURE_PASSES)
        return self._still.frame

    def linear(self, camera: Camera, resolution: tuple[int, int]) -> NDArray[np.float32]:
        """Make the settled picture before tone mapping and without highlight, for comparisons: ``(h, w, 3) float32``.

        Through the middle of each pixel, with N samples once. What it raises is what `frame` does.
        """
        with self._or_as_before(camera, resolution):
            clock = Clock(False)
            while not self._light(clock, refine=True):
                pass
            radiance = self._radiance(clock, camera, resolution, 0, interpolated=False)
            return self._eye.to_host(list(radiance))

    def half(self) -> float:
        """Find the radiance that tone mapping shows as one half, in the light of the last picture."""
        return float(self._average()[0]) / 2.0**self.settings.exposure

    def _average(self) -> mi.Float:
        """Estimate the average radiance, to which tone mapping adapts."""
        flux = sum((body.flux for body in self._bodies), mi.Float(0))
        return average_radiance(flux, dr.opaque(mi.Float, self._area))

    def _warm_up(self, camera: Camera) -> None:
        """Go through all that frames may do, small: what is compiled now need not be compiled later."""
        clock, settings = Clock(False), self.settings
        try:
            for method in METHODS:
                # With any other bound a medium may have no local part now, and one later.
                self.settings = replace(settings, method=method, gi=True, importance_bound=LOWEST_BOUND)
                for refine in (False, True):
                    self._light(clock, refine)
                    for interpolated in (False, True):
                        still = Stillness()
                        for passes in (None, still, still):
                            self._eye.to_host(to_bytes(self._picture(clock, camera, WARM_UP, passes, interpolated)))
        finally:
            self.settings = settings
        for body in self._bodies:
            body.image.forget()

    # ------------------------------------------------------------------ the stages

    def _light(self, clock: Clock, refine: bool) -> bool:
        """Bring the irradiance images up to date, with ``refine`` also by indirect light; tell whether they are settled."""
        gi, images = self.settings.gi, [body.image for body in self._bodies]
        with clock.stage("irradiance"):
            for body in self._bodies:
                body.image.update(self.scene, self._lamps, body.eta)
                if self.settings.method == "hybrid":
                    body.near.divide(self.settings.importance_bound, self.settings.rings, self.settings.per_ring)
                    body.near.update(self.scene, fine=refine)
                    body.image.divide(self.scene, self._lamps, body.eta, body.near.mapped)
            if refine and gi:
                with acting_as(Role.DIFFUSE, [body.body for body in self._bodies]):
                    for body in self._bodies:
                        body.image.measure_indirect(self.scene, body.eta, self._sampler)
        key = (self._edits, gi, *(image.version for image in images))
        if key != self._lit_by:
            with clock.stage("pyramid"):
                for body in self._bodies:
                    body.update_light(self._lamps, gi)
            self._lit_by = key
        return all(image.is_settled(self._lamps, gi) for image in images)

    def _look(self, clock: Clock, camera: Camera, resolution: tuple[int, int], turn: int) -> None:
        """Find what the pixels see, each turn at another place in them."""
        with clock.stage("gbuffer"):
            x, y = ((0.5 + step) % 1 for step in r2(turn))
            self._eye.look(camera, resolution, (x, y))

    def _picture(
        self, clock: Clock, camera: Camera, resolution: tuple[int, int], still: Stillness | None, interpolated: bool
    ) -> mi.Color3f:
        """Make a picture as the screen shows it: the mean of all until now, if it is ``still``."""
        radiance = self._radiance(clock, camera, resolution, still.passes if still else 0, interpolated)
        with clock.stage("shading"):
            average = self._average()
            exposure, specular, shininess = (
                dr.opaque(mi.Float, v)
                for v in (self.settings.exposure, self.settings.specular, self.settings.shininess)
            )
            phong = highlights(self.scene, self._eye.gbuffer, self._lamps, specular, shininess, average, exposure)
            if still:
                radiance, phong = still.add(radiance, phong)
                if still.passes >= PICTURE_PASSES and self.settings.denoised:
                    radiance = self._eye.to_lanes(denoise(self._eye.to_host(list(radiance))))
            return tone_map(radiance, average, exposure) + phong

    def _radiance(
        self, clock: Clock, camera: Camera, resolution: tuple[int, int], turn: int, interpolated: bool
    ) -> mi.Color3f:
        """Look, sum, and shade: radiance, one a lane of the screen."""
        with clock.stage("samples"):
            settings, hybrid = self.settings, self.settings.method == "hybrid"
            bound = settings.importance_bound if hybrid else None
            key = (self._lit_by, settings.samples, settings.point_samples, turn, bound)
            if key != self._drawn:
                for body in self._bodies:
                    body.draw(self._lamps, settings, turn)
                self._drawn = key
        if self.settings.method == "image_space":
            with clock.stage("irradiance"):
                for seen in self._seen:
                    seen.update(self.scene, camera.origin, self.settings.samples)
        self._look(clock, camera, resolution, turn)
        eye = self._eye
        with clock.stage("integration"):
            if interpolated:
                exitance = every_tile(eye.screen, eye.device_camera, eye.gbuffer, len(self._bodies), self._exitance)
            else:
                exitance = every_pixel(eye.gbuffer, len(self._bodies), self._exitance)
            dr.make_opaque(exitance)  # also where no body is seen, and all of it is zero: one kernel reads it
        with clock.stage("shading"):
            return translucent(eye.gbuffer, exitance, self._leave) + surroundings(self.scene, eye.gbuffer, turn)

    def _exitance(self, k: int, p: mi.Point3f, n: mi.Normal3f) -> mi.Color3f:
        return (self._seen if self.settings.method == "image_space" else self._bodies)[k].exitance(p, n)


def _pick(items: list[Any], index: int, what: str) -> Any:
    """Take one of the lights or bodies."""
    if not 0 <= index < len(items):
        raise PellucidError(f"There is no {what} number {index}: the scene has {len(items)}, counted from 0.")
    return items[index]
