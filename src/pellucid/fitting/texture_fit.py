"""The texture of a reflectance whose pictures are the photographs: reverse gradients, and neighbours that are alike."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..errors import PellucidError
from ..methods.material import BLACKEST, WHITEST
from .medium_fit import warn_of_untold
from .photos import Picture
from .result import TextureFit
from .views import HUBER, Views

DATA = "reflectance.data"
UNLIKE = 0.3
"""Standard deviation of the logarithm of a texel from that of its neighbour, as is thought before a photo is seen."""

TOLD = 0.1
"""A texel counts as told by the photos where they change by it at least so much of what they change by most texels."""

SETTLED = 1e-3
"""Relative change of the loss from one texture to the next below which the fit ends."""

Array = NDArray[np.float64]


def fit_texture(views: Views, max_evaluations: int) -> TextureFit:
    """Find the bitmap; parameters as of `fit.fit`.

    Raises
    ------
    PellucidError
        If the reflectance of the scene is no bitmap of three channels.
    """
    if DATA not in views.parameters or views.parameters[DATA].shape[-1] != 3:
        raise PellucidError(
            "A texture is fitted where the scene has one to begin from: give the BSDF a reflectance of type bitmap with three channels "
            "(raw, as many texels as are wanted), and a dmfp."
        )
    problem = TextureProblem(views)
    start = problem.start()
    scale = 1 / np.sqrt(problem.curvature(start))

    def loss(x: Array) -> tuple[float, Array]:
        value, gradient = problem.loss(x * scale)
        return value, gradient * scale

    found = minimize(
        loss,
        start / scale,
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([np.log(BLACKEST) / scale, np.log(WHITEST) / scale], axis=1),
        options={"maxfun": max_evaluations, "ftol": SETTLED},
    )
    return problem.result(found.x * scale)


class TextureProblem:
    """The improbability of the logarithms of all texels, of photos and of what is thought before, and its gradient."""

    def __init__(self, views: Views):
        self.views = views
        self.shape = tuple(int(n) for n in views.parameters[DATA].shape)

    def start(self) -> Array:
        """Begin at the texture of the scene."""
        return np.log(np.clip(self.views.parameters[DATA].numpy().astype(float), BLACKEST, WHITEST)).ravel()

    def loss(self, logarithms: Array) -> tuple[float, Array]:
        """Evaluate the loss of photos (Huber), and of neighbours that differ."""
        pictures = self._render(logarithms)
        loss, by_picture = 0.0, []
        for difference, weight in zip(self.views.differences(pictures), self.views.weights, strict=True):
            r = difference * weight
            loss += float(np.where(np.abs(r) < HUBER, r**2 / 2, HUBER * (np.abs(r) - HUBER / 2)).sum())
            by_picture.append(np.clip(r, -HUBER, HUBER) * weight)
        unlike, by_texel = _unlike(logarithms.reshape(self.shape))
        return loss + unlike, (self._backward(by_picture) + by_texel).ravel()

    def curvature(self, logarithms: Array) -> Array:
        """Bound the second derivatives of the loss, one for each texel: a step of the gradient over it goes about the right way.

        A picture is a sum of what texels add to it, and the convex sum over them bounds what a square has of products.
        """
        pictures = self._render(logarithms)
        parts = zip(pictures, self.views.weights, self.views.masks, strict=True)
        of_photos = self._backward([picture * (weight**2 * mask[:, :, None]) for picture, weight, mask in parts])
        return np.maximum(of_photos.ravel(), 0) + 8 / UNLIKE**2

    def result(self, logarithms: Array) -> TextureFit:
        """Describe what was found, and which texels the photos tell of."""
        pictures = self._render(logarithms)
        parts = zip(self.views.weights, self.views.masks, strict=True)
        tells = self._backward([weight * mask[:, :, None] for weight, mask in parts]).sum(axis=2)
        residuals = self.views.masked(self.views.differences(pictures))
        bsdf = self.views.body.bsdf
        medium = bsdf.medium.scaled(1 / bsdf.scale)
        warn_of_untold(medium, self.views)
        return TextureFit(
            texture=np.exp(logarithms).reshape(self.shape),
            told=tells > TOLD * np.quantile(tells, 0.9),
            medium=medium,
            residual=float(np.sqrt(np.mean(np.minimum(residuals**2, HUBER**2)))),
            differences=self.views.differences(pictures),
            evaluations=self.views.evaluations,
        )

    def _render(self, logarithms: Array) -> list[Picture]:
        """Render pictures with a texture."""
        texels = np.exp(logarithms).reshape(self.shape).astype(np.float32)
        self.views.parameters[DATA] = mi.TensorXf(texels)
        self.views.parameters.update()
        return self.views.render()

    def _backward(self, by_picture: list[Picture]) -> Array:
        """Send the gradients by pictures back to the logarithms of the texels."""
        views, texels = self.views, self.views.parameters[DATA]
        dr.enable_grad(texels)
        views.parameters.set_dirty(DATA)
        views.parameters.update()
        sent = [mi.TensorXf(np.ascontiguousarray(gradient, np.float32)) for gradient in by_picture]
        numbers = range(len(sent))
        views.integrator.render_backward_views(views.scene, sent, numbers, numbers, views.spp)
        found = np.asarray(dr.grad(texels).numpy() * dr.detach(texels).numpy(), float)
        dr.disable_grad(texels)
        return found


def _unlike(logarithms: Array) -> tuple[float, Array]:
    """Evaluate the loss of texels that differ from their neighbours, and its gradient."""
    loss, gradient = 0.0, np.zeros_like(logarithms)
    for axis in (0, 1):
        step = np.diff(logarithms, axis=axis) / UNLIKE**2
        loss += float((step**2).sum()) * UNLIKE**2 / 2
        widths = [(0, 0)] * 3
        widths[axis] = (1, 1)
        gradient -= np.diff(np.pad(step, widths), axis=axis)
    return loss, gradient
