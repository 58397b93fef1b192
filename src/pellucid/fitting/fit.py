"""The medium whose pictures are the photographs: least squares over the logarithms of its coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import PellucidError, warn
from ..methods.material import COEFFICIENTS
from ..methods.preparation import number_of_samples
from ..model.medium import Medium
from ..scene.bodies import Body, find_bodies
from .photos import Picture, erode, read_mask, read_photo, seen_by
from .result import Fit

EXPOSURES = ("known", "free", "shared")
MORE_SAMPLES = 4
"""Times the default number of surface samples: with that alone the scattering of small pictures is a tenth off."""

RELATIVE_NOISE, FLOOR = 0.01, 0.002
"""Standard deviation of a pixel, of its own value and of the mean of the photo."""

HUBER = 3.0
"""Standard deviations beyond which a difference counts linearly: highlights that the mask has left in."""

MODEL_ERROR = 0.03
"""By which the model itself may be too bright or too dark in a channel."""

BADLY_CONDITIONED = 1e3
NAMES = tuple(f"{name}.{channel}" for name in COEFFICIENTS for channel in "rgb")

Array = NDArray[np.float64]


def fit(
    scene: mi.Scene,
    photos: Sequence[Any],
    masks: Sequence[Any] | None = None,
    exposure: str = "known",
    linearise: bool = False,
    spp: int = 16,
    max_evaluations: int = 25,
    **settings: Any,
) -> Fit:
    """Find the coefficients of the translucent medium of a scene from photographs of it.

    Least squares over the logarithms of ``sigma_a`` and ``sigma_s_prime``, from those that the scene has; index of refraction, g and
    surface are known. Differences beyond three standard deviations count less (Huber).

    Parameters
    ----------
    scene : mi.Scene
        With one translucent medium, its true shape and light, and one camera for each photo.
    photos : sequence of (h, w, 3) float, or of files
        Linear radiance.
    masks : sequence of (h, w) float, or of files, optional
        What of each photo counts, besides being of the body; rims are left out.
    exposure : str
        ``known``: photos have the radiance of the scene; ``free``: each is multiplied by an unknown number; ``shared``: all by the same.
    linearise : bool
        Take the curve of sRGB off files of 8 bits, which are refused otherwise.
    spp, settings
        Of the pictures: samples a pixel, and the parameters of ``pellucid_two_pass``.
    max_evaluations : int
        Most media that are tried.

    Raises
    ------
    PellucidError
        For photos that do not go with the cameras of the scene, for several media, and for what cannot be fitted.
    """
    if exposure not in EXPOSURES:
        raise PellucidError(f"exposure is one of {', '.join(EXPOSURES)}; found '{exposure}'.")
    problem = Problem(scene, photos, masks, exposure, linearise, spp, settings)
    found = least_squares(
        problem.residuals, problem.start(), problem.jacobian, loss="huber", f_scale=HUBER, xtol=1e-3, ftol=1e-5,
        max_nfev=max_evaluations,
    )  # fmt: skip
    if found.status == 0:
        warn(
            f"The fit has not settled after {max_evaluations} media: its result is the best of them; allow more, or start nearer."
        )
    return problem.result(found)


class Problem:
    """Differences between pictures of a medium and photos, as functions of its logarithms."""

    def __init__(
        self, scene: mi.Scene, photos: Sequence[Any], masks: Sequence[Any] | None, exposure: str, linearise: bool, spp: int,
        settings: dict[str, Any],
    ):  # fmt: skip
        self.scene, self.exposure, self.spp = scene, exposure, spp
        self.body = _only_body(scene)
        self.photos = [read_photo(photo, linearise) for photo in photos]
        self._check(masks)
        seen = [seen_by(scene, sensor, self.body) for sensor in scene.sensors()[: len(photos)]]
        self.pixel = max(size for _, size in seen) * self.body.bsdf.scale
        self.masks = [mask & self._given(masks, k) for k, (mask, _) in enumerate(seen)]
        if not any(mask.any() for mask in self.masks):
            raise PellucidError(
                "No pixel of the photos is left to fit: the body is not seen, or the masks leave out all of it."
            )
        self.weights = [
            1 / np.hypot(RELATIVE_NOISE * p, FLOOR * p[m].mean()) for p, m in zip(self.photos, self.masks, strict=True)
        ]
        count = MORE_SAMPLES * number_of_samples(self.body, self.body.surface(), 0, 1_000_000)
        self.integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": count, **settings})
        self.parameters = mi.traverse(self.body.bsdf)
        self._pictures: tuple[Array, list[Picture]] | None = None
        self.evaluations = 0

    def start(self) -> Array:
        """Begin at the medium of the scene, and at exposures of 1."""
        medium = self.body.bsdf.medium.scaled(1 / self.body.bsdf.scale)
        theta = np.log(np.maximum([*medium.sigma_a, *medium.sigma_s_prime], 1e-6))
        return np.append(theta, np.zeros(self._exposures()))

    def residuals(self, theta: Array) -> Array:
        """Weigh the differences between pictures and photos in the masks."""
        k = self._factors(theta)
        differences = [(e * p - photo) for e, p, photo in zip(k, self.pictures(theta), self.photos, strict=True)]
        return self._masked(differences)

    def jacobian(self, theta: Array) -> Array:
        """Differentiate the residuals: every channel depends on its own coefficients."""
        pictures, k = self.pictures(theta), self._factors(theta)
        columns = []
        for name in COEFFICIENTS:
            changes = [e * change for e, change in zip(k, self._changes(name), strict=True)]
            for channel in range(3):
                columns.append(self._masked([change * (np.arange(3) == channel) for change in changes]))
        for j in range(self._exposures()):
            own = [
                e * p * float(self.exposure == "shared" or n == j)
                for n, (e, p) in enumerate(zip(k, pictures, strict=True))
            ]
            columns.append(self._masked(own))
        return np.stack(columns, axis=1)

    def pictures(self, theta: Array) -> list[Picture]:
        """Render the medium for every camera; the last one is kept."""
        if self._pictures is None or not np.array_equal(self._pictures[0], theta):
            for name, values in zip(COEFFICIENTS, np.exp(theta[:6]).reshape(2, 3), strict=True):
                self.parameters[name] = mi.Color3f(values.tolist())
            self.parameters.update()
            self.integrator.prepared = self.integrator.prepare_scene(self.scene)
            views = range(len(self.photos))
            images = [self.integrator.render(self.scene, sensor=k, seed=k, spp=self.spp) for k in views]
            self._pictures = theta.copy(), [np.array(image, float)[:, :, :3] for image in images]
            self.evaluations += 1
        return self._pictures[1]

    def _changes(self, name: str) -> list[Picture]:
        """Find how the pictures change with the logarithm of a coefficient, all three channels at once."""
        value = self.parameters[name]
        dr.enable_grad(value)
        changes = []
        for k in range(len(self.photos)):
            dr.set_grad(value, dr.detach(value))
            image = self.integrator.render_forward(self.scene, self.parameters, sensor=k, seed=k, spp=self.spp)
            changes.append(np.array(image, float)[:, :, :3])
        dr.disable_grad(value)
        return changes

    def result(self, found: Any) -> Fit:
        """Describe what was found, and warn of what the photos cannot tell."""
        theta, residuals, jacobian = found.x, self.residuals(found.x), self.jacobian(found.x)
        information = jacobian.T @ jacobian
        condition = float(np.linalg.cond(information))
        inverse = np.linalg.pinv(information)
        scale = max(float(np.mean(np.minimum(residuals**2, HUBER**2))), 1e-12)
        covariance = inverse * scale
        brightness = self._masked(
            [e * p for e, p in zip(self._factors(theta), self.pictures(theta), strict=True)]
        ).reshape(-1, 3)
        for channel in range(3):  # the model may be off by a factor in every channel
            off = (brightness * (np.arange(3) == channel)).ravel()
            shift = MODEL_ERROR * (inverse @ (jacobian.T @ off))
            covariance = covariance + np.outer(shift, shift)
        sigma_a, sigma_s_prime = np.exp(theta[:6]).reshape(2, 3)
        old = self.body.bsdf.medium
        medium = Medium(sigma_s_prime, sigma_a, old.g, old.eta, profile=old.profile)
        self._warn(medium, condition)
        k = self._factors(theta)
        differences = [
            (e * p - photo) * mask[:, :, None]
            for e, p, photo, mask in zip(k, self.pictures(theta), self.photos, self.masks, strict=True)
        ]
        names = NAMES + tuple(f"exposure.{j}" for j in range(self._exposures()))
        return Fit(
            medium,
            names,
            np.asarray(covariance, np.float64),
            k,
            float(np.sqrt(scale)),
            condition,
            differences,
            self.evaluations,
        )

    def _warn(self, medium: Medium, condition: float) -> None:
        """Warn of what the photos cannot tell."""
        if condition > BADLY_CONDITIONED:
            why = (
                "; with the exposure unknown, a dark photo and an absorbing medium look alike"
                if self._exposures()
                else ""
            )
            warn(
                f"The photos do not tell the parameters apart (condition number {condition:.0e}){why}: add views and lights."
            )
        dmfp = medium.dmfp
        extent = self.body.surface().extent * self.body.bsdf.scale
        if (dmfp < self.pixel).any():
            warn(
                f"The diffuse mean free path, {dmfp.min():.2g} mm, is less than a pixel, {self.pixel:.2g} mm: take nearer photos."
            )
        if (dmfp > extent).any():
            warn(
                f"The diffuse mean free path, {dmfp.max():.2g} mm, is longer than the body, {extent:.2g} mm: measure a larger piece."
            )

    def _exposures(self) -> int:
        return {"known": 0, "free": len(self.photos), "shared": 1}[self.exposure]

    def _factors(self, theta: Array) -> Array:
        """Read the exposure of every photo."""
        return np.broadcast_to(np.exp(theta[6:]) if self._exposures() else 1.0, len(self.photos))

    def _masked(self, pictures: list[Picture]) -> Array:
        """Put the weighed pixels of all masks in one row."""
        parts = zip(pictures, self.weights, self.masks, strict=True)
        return np.concatenate([(picture * weight)[mask].ravel() for picture, weight, mask in parts])

    def _given(self, masks: Sequence[Any] | None, k: int) -> Any:
        return True if masks is None else erode(read_mask(masks[k]))

    def _check(self, masks: Sequence[Any] | None) -> None:
        """Refuse photos and masks that do not go with the cameras."""
        sensors = self.scene.sensors()
        if not 0 < len(self.photos) <= len(sensors):
            raise PellucidError(
                f"There are {len(self.photos)} photos and {len(sensors)} cameras in the scene: give one photo a camera."
            )
        if masks is not None and len(masks) != len(self.photos):
            raise PellucidError(f"There are {len(masks)} masks for {len(self.photos)} photos: give one mask a photo.")
        for k, (photo, sensor) in enumerate(zip(self.photos, sensors, strict=False)):
            size = tuple(int(n) for n in sensor.film().crop_size())
            if photo.shape[1::-1] != size:
                found = f"{photo.shape[1]}x{photo.shape[0]}"
                raise PellucidError(
                    f"Photo {k} has {found} pixels and its camera {size[0]}x{size[1]}: make them alike."
                )
            if not np.isfinite(photo).all():
                raise PellucidError(f"Photo {k} has values that are not finite.")


def _only_body(scene: mi.Scene) -> Body:
    """Find the translucent body of a scene, with a medium of its own."""
    bodies = find_bodies(scene)
    if len({id(body.bsdf) for body in bodies}) != 1:
        raise PellucidError(f"The scene has {len(bodies)} translucent bodies of several media: leave one to fit.")
    if bodies[0].bsdf.texture is not None:
        raise PellucidError(
            "The reflectance is a texture: describe the medium by sigma_a and sigma_s_prime to fit them."
        )
    return bodies[0]
