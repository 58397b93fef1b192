"""A frame source that costs nothing: a lit ball, shaded in NumPy, on top of a real scene."""

import dataclasses
import time

import mitsuba as mi
import numpy as np

from pellucid import load_scene
from pellucid.errors import SceneError
from pellucid.model.medium import Medium
from pellucid.realtime.source import BodyState, Camera, Frame, Light, Settings

RADIUS = 20.0


def ball_scene():
    look = mi.ScalarTransform4f().look_at(origin=[0, -120, 30], target=[0, 0, RADIUS], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 32, "height": 24, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "integrator": {"type": "pellucid_two_pass", "sampling": "uniform", "sample_count": 400, "max_depth": 2},
        "sensor": {"type": "perspective", "fov": 32, "to_world": look, "film": film},
        "ball": {
            "type": "sphere",
            "center": [0, 0, RADIUS],
            "radius": RADIUS,
            "bsdf": {"type": "pellucid_translucent", "material": "skin1"},
        },
        "lamp": {"type": "point", "position": [60.0, -90.0, 80.0], "intensity": {"type": "rgb", "value": 9e3}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
    }


class FakeSource:
    """Implements FrameSource: what it shows depends on everything that can be changed."""

    def __init__(self, seconds: float = 0.0):
        self.scene = load_scene(ball_scene())
        self.settings = Settings()
        self.seconds = seconds
        self.calls: list[tuple] = []
        lamp, sky = np.array([60.0, -90.0, 80.0]), np.ones(3)
        self._lights = [
            Light("lamp", "point", lamp, None, sky.copy(), 9e3),
            Light("sky", "environment", None, None, sky.copy(), 1.0),
        ]
        self._bodies = [BodyState("ball", Medium.from_preset("skin1"), 2 * RADIUS)]

    @property
    def lights(self):
        return [dataclasses.replace(light) for light in self._lights]

    @property
    def bodies(self):
        return [dataclasses.replace(body) for body in self._bodies]

    def set_light(self, index, **changes):
        if "position" in changes and self._lights[index].position is None:
            raise SceneError("light 'sky' has no position: change its brightness.")
        self._lights[index] = dataclasses.replace(self._lights[index], **changes)

    def set_medium(self, index, medium):
        self._bodies[index].medium = medium

    def set_size(self, millimetres):
        self._bodies[0].size_mm = millimetres

    def linear(self, camera: Camera, resolution):
        width, height = resolution
        origin, target, up = (np.asarray(v, float) for v in (camera.origin, camera.target, camera.up))
        ahead = (target - origin) / np.linalg.norm(target - origin)
        right = np.cross(ahead, up) / np.linalg.norm(np.cross(ahead, up))
        above = np.cross(right, ahead)
        slope = np.tan(np.deg2rad(camera.fov) / 2)
        y, x = np.mgrid[0:height, 0:width] + 0.5
        x, y = (2 * x - width) / height * slope, (1 - 2 * y / height) * slope
        d = ahead + x[..., None] * right + y[..., None] * above
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        centre = np.array([0, 0, RADIUS])
        b = d @ (origin - centre)
        disc = b * b - (origin - centre) @ (origin - centre) + RADIUS**2
        n = (origin + d * (-b - np.sqrt(np.maximum(disc, 0)))[..., None] - centre) / RADIUS
        lamp, sky = self._lights
        to_lamp = lamp.position - centre
        cosine = np.maximum(n @ to_lamp / np.linalg.norm(to_lamp), 0)[..., None]
        light = cosine * lamp.colour * lamp.intensity / (to_lamp @ to_lamp) + 0.2 * sky.intensity * sky.colour
        albedo = self._bodies[0].medium.total_diffuse_reflectance * (2 * RADIUS / self._bodies[0].size_mm) ** 0.2
        picture = np.where((disc > 0)[..., None], albedo * light, 0.02)
        return picture.astype(np.float32)

    def half(self):
        return 2.0**-self.settings.exposure

    def frame(self, camera, resolution, moving):
        self.calls.append((resolution, moving))
        time.sleep(self.seconds)
        lifted = self.linear(camera, resolution) * 2**self.settings.exposure
        if self.settings.method == "hybrid":
            lifted = lifted[..., ::-1]
        pixels = (255 * (lifted / (1 + lifted)) ** (1 / 2.2)).astype(np.uint8)
        turn = np.random.default_rng(0).normal(size=(self.settings.samples, 3))
        samples = RADIUS * turn / np.linalg.norm(turn, axis=1, keepdims=True) + [0, 0, RADIUS]
        return Frame(pixels, {"integration": 0.01, "whole": 0.02}, samples.astype(np.float32), not moving)
