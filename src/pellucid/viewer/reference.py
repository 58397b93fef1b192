"""The two-pass picture of a saved scene, in a process of its own: ``python -m pellucid.viewer.reference`` for the viewer.

Writes one line for every step, ``stage done total``, and the picture as an ``.npz``: ``picture`` (h, w, 3) and ``body``
(h, w), which tells where translucent bodies are seen. Every pixel is seen through its middle and without highlight, as
in the frames that it is compared with.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np

from ..progress import reporting_to


class Lines:
    """A reporter that writes a line for every step."""

    def __init__(self) -> None:
        self._stages: list[tuple[str, float, int]] = []

    def start(self, stage: str, total: int, unit: str) -> None:
        """Begin a stage."""
        self._stages.append((stage, 0, total))
        self._say()

    def advance(self, done: float) -> None:
        """Count."""
        stage, before, total = self._stages[-1]
        self._stages[-1] = (stage, before + done, total)
        self._say()

    def finish(self) -> None:
        """End a stage."""
        self._stages.pop()

    def _say(self) -> None:
        stage, done, total = self._stages[-1]
        print(stage.replace(" ", "_"), done, total, flush=True)


def render(path: str, width: int, height: int, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Render a scene through the middles of the pixels of its first camera; tell also where bodies are seen."""
    import mitsuba as mi

    from ..scene.bodies import build_lookup, find_bodies
    from ..scenes.loading import load_scene

    scene = load_scene(path)
    bodies = find_bodies(scene)
    for body in bodies:
        body.bsdf.specular = 0.0
    integrator = mi.load_dict({"type": "pellucid_two_pass", "irradiance_depth": depth})
    sensor = _through_middles(scene.sensors()[0], width, height)
    picture = np.array(integrator.render(scene, sensor, seed=0, spp=1))[..., :3]
    index = mi.Float(np.arange(width * height, dtype=np.float32))
    row = mi.Float(mi.UInt32(index) // width)
    at = mi.Point2f((index - row * width + 0.5) / width, (row + 0.5) / height)
    ray, _ = sensor.sample_ray(0, 0.5, at, mi.Point2f(0.5))
    body = build_lookup(scene, bodies).body_index(scene.ray_intersect(ray))
    return picture, np.array(body).reshape(height, width) > 0


def _through_middles(sensor: Any, width: int, height: int) -> Any:
    """Make a camera like another one, whose samples are the middles of its pixels."""
    import mitsuba as mi

    parameters = mi.traverse(sensor)
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    across = float(np.array(parameters["x_fov"]).ravel()[0])
    return mi.load_dict(
        {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f(np.array(parameters["to_world"].matrix, float).reshape(4, 4).tolist()),
            "fov": across,
            "fov_axis": "x",
            "near_clip": sensor.near_clip(),
            "far_clip": sensor.far_clip(),
            "film": film,
            "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
        }
    )


def main(arguments: list[str]) -> None:
    """Render ``scene.xml width height depth picture.npz variant``, without pushing more urgent work aside."""
    path, width, height, depth, output, variant = arguments
    os.nice(10)
    from ..kernels.backend import choose_variant

    choose_variant(variant)
    with reporting_to(Lines()):
        picture, body = render(path, int(width), int(height), int(depth))
        np.savez(output, picture=picture, body=body)


if __name__ == "__main__":
    main(sys.argv[1:])
