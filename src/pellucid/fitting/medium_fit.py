"""The medium whose pictures are the photographs: least squares over the logarithms of two of its parameters."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import PellucidError, warn
from ..methods.material import COEFFICIENTS, REFLECTANCE, WHITEST
from ..model.medium import Medium
from .photos import Picture
from .result import Fit
from .views import HUBER, Views, as_array

MODEL_ERROR = 0.03
"""By which the model itself may be too bright or too dark in a channel."""

BADLY_CONDITIONED = 1e3

Array = NDArray[np.float64]


def fit_medium(views: Views, names: tuple[str, str], exposure: str, max_evaluations: int) -> Fit:
    """Find the medium; parameters as of `fit.fit`."""
    if views.body.bsdf.texture is not None:
        raise PellucidError(
            "The reflectance is a texture: fit the texture, or describe the medium without one to fit its parameters."
        )
    problem = Problem(views, names, exposure)
    found = least_squares(
        problem.residuals, problem.start(), problem.jacobian, loss="huber", f_scale=HUBER, xtol=1e-3, ftol=1e-5,
        max_nfev=max_evaluations, bounds=(-np.inf, problem.most()),
    )  # fmt: skip
    if found.status == 0:
        warn(
            f"The fit has not settled after {max_evaluations} media: its result is the best of them; allow more, or start nearer."
        )
    return problem.result(found.x)


class Problem:
    """Differences between pictures of a medium and photos, as functions of logarithms: of two parameters, and of exposures."""

    def __init__(self, views: Views, names: tuple[str, str], exposure: str):
        self.views, self.names, self.exposure = views, names, exposure
        self.exposures = {"known": 0, "free": len(views.photos), "shared": 1}[exposure]
        self._pictures: tuple[Array, list[Picture]] | None = None

    def start(self) -> Array:
        """Begin at the medium of the scene, and at exposures of 1."""
        values = [np.ravel(self.views.parameters[name].numpy()).astype(float) for name in self.names]
        theta = np.log(np.clip(values, 1e-6, None)).ravel()
        return np.minimum(np.append(theta, np.zeros(self.exposures)), self.most() - 1e-9)

    def most(self) -> Array:
        """Bound the logarithms: no reflectance is more than `WHITEST`."""
        return np.array(
            [np.log(WHITEST) if name == "reflectance" else np.inf for name in self.names for _ in range(3)]
            + [np.inf] * self.exposures
        )

    def residuals(self, theta: Array) -> Array:
        """Weigh the differences between pictures and photos in the masks."""
        return self.views.masked(self.views.differences(self._exposed(theta)))

    def jacobian(self, theta: Array) -> Array:
        """Differentiate the residuals: every channel depends on its own parameters."""
        exposed, k = self._exposed(theta), self._factors(theta)
        columns = []
        for name in self.names:
            changes = [e * change for e, change in zip(k, self._changes(name), strict=True)]
            for channel in range(3):
                columns.append(self.views.masked([change * (np.arange(3) == channel) for change in changes]))
        for j in range(self.exposures):
            own = [p * float(self.exposure == "shared" or n == j) for n, p in enumerate(exposed)]
            columns.append(self.views.masked(own))
        return np.stack(columns, axis=1)

    def pictures(self, theta: Array) -> list[Picture]:
        """Render the medium for every camera; the last one is kept."""
        if self._pictures is None or not np.array_equal(self._pictures[0], theta):
            for name, values in zip(self.names, np.exp(theta[:6]).reshape(2, 3), strict=True):
                self.views.parameters[name] = mi.Color3f(values.tolist())
            self.views.parameters.update()
            self._pictures = theta.copy(), self.views.render()
        return self._pictures[1]

    def result(self, theta: Array) -> Fit:
        """Describe what was found, and warn of what the photos cannot tell."""
        residuals, jacobian, exposed = self.residuals(theta), self.jacobian(theta), self._exposed(theta)
        information = jacobian.T @ jacobian
        inverse = np.linalg.pinv(information)
        scale = max(float(np.mean(np.minimum(residuals**2, HUBER**2))), 1e-12)
        covariance = inverse * scale
        brightness = self.views.masked(exposed).reshape(-1, 3)
        for channel in range(3):  # the model may be off by a factor in every channel
            off = (brightness * (np.arange(3) == channel)).ravel()
            shift = MODEL_ERROR * (inverse @ (jacobian.T @ off))
            covariance = covariance + np.outer(shift, shift)
        bsdf = self.views.body.bsdf
        found = Fit(
            medium=bsdf.medium.scaled(1 / bsdf.scale),
            names=tuple(f"{name}.{channel}" for name in self.names for channel in "rgb")
            + tuple(f"exposure.{j}" for j in range(self.exposures)),
            values=np.exp(theta),
            covariance=np.asarray(covariance, np.float64),
            exposure=self._factors(theta),
            residual=float(np.sqrt(scale)),
            condition_number=float(np.linalg.cond(information)),
            differences=self.views.differences(exposed),
            evaluations=self.views.evaluations,
        )
        self._warn(found)
        return found

    def _warn(self, found: Fit) -> None:
        """Warn of what the photos cannot tell."""
        if found.condition_number > BADLY_CONDITIONED:
            why = (
                "; with the exposure unknown, a dark photo and an absorbing medium look alike" if self.exposures else ""
            )
            warn(
                f"The photos do not tell the parameters apart (condition number {found.condition_number:.0e}){why}: "
                "add views and lights."
            )
        warn_of_untold(found.medium, self.views)

    def _changes(self, name: str) -> list[Picture]:
        """Find how the pictures change with the logarithm of a parameter, all three channels at once."""
        value, views = self.views.parameters[name], range(len(self.views.photos))
        dr.enable_grad(value)
        dr.set_grad(value, dr.detach(value))
        images = self.views.integrator.render_forward_views(self.views.scene, views, views, self.views.spp)
        dr.disable_grad(value)
        return [as_array(image) for image in images]

    def _exposed(self, theta: Array) -> list[Picture]:
        """Multiply the pictures by their exposures."""
        return [e * picture for e, picture in zip(self._factors(theta), self.pictures(theta), strict=True)]

    def _factors(self, theta: Array) -> Array:
        """Read the exposure of every photo."""
        return np.broadcast_to(np.exp(theta[6:]) if self.exposures else 1.0, len(self.views.photos))


def warn_of_untold(medium: Medium, views: Views) -> None:
    """Warn of diffuse mean free paths [mm] that photos of a body cannot tell, and of reflectances below that of the surface."""
    dmfp, reflectance = medium.dmfp, medium.total_diffuse_reflectance
    surface = views.body.bsdf.specular * ((medium.eta - 1) / (medium.eta + 1)) ** 2
    if (reflectance < surface).any():
        warn(
            f"The reflectance, {reflectance.min():.2g}, is less than the {surface:.2g} of the surface above: its error may be more than it "
            "says; take photos through crossed polarisers, and set specular_reflectance to 0."
        )
    if (dmfp < views.pixel).any():
        warn(
            f"The diffuse mean free path, {dmfp.min():.2g} mm, is less than a pixel, {views.pixel:.2g} mm: take nearer photos."
        )
    if (dmfp > views.extent).any():
        warn(
            f"The diffuse mean free path, {dmfp.max():.2g} mm, is longer than the body, {views.extent:.2g} mm: measure a larger piece."
        )


OF_PARAMETERS = {"coefficients": COEFFICIENTS, "reflectance": REFLECTANCE}
