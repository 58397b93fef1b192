"""The pictures of a scene beside the photographs of it: which pixels count, how sure each is, and how pictures are made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..errors import PellucidError
from ..methods.preparation import number_of_samples
from ..scene.bodies import Body, find_bodies
from .photos import Picture, deviation, erode, read_mask, read_photo, seen_by

MORE_SAMPLES = 4
"""Times the default number of surface samples: with that alone the scattering of small pictures is a tenth off."""

HUBER = 3.0
"""Standard deviations beyond which a difference counts linearly: highlights that the mask has left in."""


class Views:
    """The cameras of a scene with one translucent medium, and a photo for each.

    Attributes
    ----------
    photos, masks, weights : list
        ``(h, w, 3) float`` each; ``(h, w) bool``, what counts; ``(h, w, 3)``, one over the standard deviation of a pixel.
    pixel, extent : float
        How wide a pixel is on the body, and the body [mm].
    parameters : mi.SceneParameters
        What ``mi.traverse`` shows of the medium.

    Raises
    ------
    PellucidError
        For photos and masks that do not go with the cameras, and for several media.
    """

    def __init__(
        self, scene: mi.Scene, photos: Sequence[Any], masks: Sequence[Any] | None, linearise: bool, spp: int,
        settings: dict[str, Any],
    ):  # fmt: skip
        self.scene, self.spp, self.body = scene, spp, _only_body(scene)
        self.photos = [read_photo(photo, linearise) for photo in photos]
        given = None if masks is None else [read_mask(mask) for mask in masks]
        self._check(given)
        seen = [seen_by(scene, sensor, self.body) for sensor in scene.sensors()[: len(photos)]]
        self.pixel = max(size for _, size in seen) * self.body.bsdf.scale
        self.extent = self.body.surface().extent * self.body.bsdf.scale
        self.masks: list[NDArray[np.bool_]] = [mask for mask, _ in seen]
        if given is not None:
            self.masks = [mask & erode(own) for mask, own in zip(self.masks, given, strict=True)]
        if not any(mask.any() for mask in self.masks):
            raise PellucidError(
                "No pixel of the photos is left to fit: the body is not seen, or the masks leave out all of it."
            )
        for k, (photo, mask) in enumerate(zip(self.photos, self.masks, strict=True)):
            if mask.any() and (photo[mask].mean(axis=0) <= 0).any():
                raise PellucidError(
                    f"Photo {k} is black, or below zero, in a channel where the body is seen: give linear radiance, or leave it out."
                )
        self.weights = [1 / deviation(*pair) for pair in zip(self.photos, self.masks, strict=True)]
        count = MORE_SAMPLES * number_of_samples(self.body, self.body.surface(), 0, 1_000_000)
        self.integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": count, **settings})
        self.parameters = mi.traverse(self.body.bsdf)
        self.evaluations = 0

    def render(self) -> list[Picture]:
        """Render the medium as it is now for every camera."""
        self.integrator.prepared = self.integrator.prepare_scene(self.scene)
        views = range(len(self.photos))
        images = [self.integrator.render(self.scene, sensor=k, seed=k, spp=self.spp) for k in views]
        self.evaluations += 1
        return [as_array(image) for image in images]

    def masked(self, pictures: Sequence[Picture]) -> NDArray[np.float64]:
        """Put the pixels of all masks in one row, in their standard deviations."""
        parts = zip(pictures, self.weights, self.masks, strict=True)
        return np.concatenate([(picture * weight)[mask].ravel() for picture, weight, mask in parts])

    def differences(self, pictures: Sequence[Picture]) -> list[Picture]:
        """Subtract the photos from pictures, in the masks."""
        parts = zip(pictures, self.photos, self.masks, strict=True)
        return [(picture - photo) * mask[:, :, None] for picture, photo, mask in parts]

    def _check(self, masks: list[NDArray[np.bool_]] | None) -> None:
        """Refuse photos and masks that do not go with the cameras."""
        if not self.scene.emitters():
            raise PellucidError("The scene has no light: give it that of the photos.")
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
        for k, (photo, mask) in enumerate(zip(self.photos, masks or [], strict=False)):
            if mask.shape != photo.shape[:2]:
                found, wanted = (f"{shape[1]}x{shape[0]}" for shape in (mask.shape, photo.shape))
                raise PellucidError(f"Mask {k} has {found} pixels and its photo {wanted}: make them alike.")


def as_array(image: mi.TensorXf) -> Picture:
    """Bring the colours of a picture to the host: ``(h, w, 3) float``."""
    return np.array(image, float)[:, :, :3]


def _only_body(scene: mi.Scene) -> Body:
    """Find the translucent body of a scene, with a medium of its own."""
    bodies = find_bodies(scene)
    if len({id(body.bsdf) for body in bodies}) != 1:
        raise PellucidError(f"The scene has {len(bodies)} translucent bodies of several media: leave one to fit.")
    return bodies[0]
