"""What the benchmarks of the texture-space method share: models before a camera, references, errors, and times of frames."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pellucid.api import prepare
from pellucid.model.fresnel import external_diffuse_transmittance, fresnel_dielectric
from pellucid.model.medium import Medium
from pellucid.scenes.builtin import build
from support.scenes import load

if TYPE_CHECKING:
    import mitsuba as mi

    from pellucid.realtime.source import Camera, FrameSource

Array = NDArray[np.float64]
Resolution = tuple[int, int]

LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
STEP = 1.5
"""By which lamp and camera go on from frame to frame [degrees]."""

FIRST_FRAMES = 3
"""Frames before those that are timed: kernels are compiled, and caches filled."""

BRIGHTER = 3.0
"""Factor on what is shown in documents; errors are measured without it."""

DIRECT_LIGHT = 2
"""Depth of light paths that come straight from a lamp: all that the paper has."""


# ------------------------------------------------------------------ scenes and cameras


def model_scene(
    name: str,
    material: str | Medium = "marble",
    size: float = 10.0,
    light_angle: float = 60.0,
    side: int = 512,
    profile: str = "tabulated",
) -> mi.Scene:
    """Load a built-in model of some material, with a smooth surface, that mirrors no lamp that is a point."""
    bsdf: dict[str, Any] = {"type": "pellucid_translucent", "alpha": 0.0, "profile": profile}
    if isinstance(material, str):
        bsdf["material"] = material
    else:
        bsdf |= {"eta": material.eta, "sigma_a": _rgb(material.sigma_a), "sigma_s_prime": _rgb(material.sigma_s_prime)}
    return load(build(name, bsdf=bsdf, size=size, light_angle=light_angle, resolution=(side, side)))


def _rgb(value: Array) -> dict[str, Any]:
    """A colour for ``mi.load_dict``."""
    return {"type": "rgb", "value": [float(v) for v in value]}


def camera_of(scene: mi.Scene) -> Camera:
    """Take the camera of a built-in model as the real-time pipeline wants it; its picture is square."""
    import mitsuba as mi

    from pellucid.realtime.source import Camera

    sensor = scene.sensors()[0]
    matrix = np.array(sensor.world_transform().matrix, float).reshape(4, 4)
    origin = matrix[:3, 3]
    target = origin + matrix[:3, 2] * float(np.linalg.norm(origin))
    return Camera(origin, target, (0.0, 0.0, 1.0), float(mi.traverse(sensor)["x_fov"][0]))


def turned(vector: Any, degrees: float) -> Array:
    """Turn a vector around the vertical, counter-clockwise seen from above."""
    x, y, z = np.asarray(vector, float)
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([c * x - s * y, s * x + c * y, z])


# ------------------------------------------------------------------ pictures and their errors


@dataclass
class Seen:
    """What is seen through the middle of each pixel: the points of the body ``(k, 3)``, what part of the exitance leaves
    towards the eye as radiance ``(k,)``, and which pixels they belong to ``(h, w) bool``."""

    points: NDArray[np.float32]
    leave: Array
    mask: NDArray[np.bool_]

    def picture(self, exitance: NDArray[np.floating]) -> Array:
        """Turn exitance at the points into a linear picture ``(h, w, 3)`` on black."""
        result = np.zeros((*self.mask.shape, 3))
        result[self.mask] = np.asarray(exitance, float) * self.leave[:, None]
        return result


def see_pixels(scene: mi.Scene, camera: Camera, resolution: Resolution, eta: float) -> Seen:
    """Trace a ray through the middle of each pixel of a scene that shows one body and nothing else."""
    import drjit as dr
    import mitsuba as mi

    from pellucid.realtime.gbuffer import DeviceCamera

    width, height = resolution
    y, x = (np.mgrid[:height, :width] + 0.5).reshape(2, -1).astype(np.float32)
    ray = DeviceCamera.make(camera, width, height).rays(mi.Float(x), mi.Float(y))
    si = scene.ray_intersect(ray)
    hit = si.is_valid().numpy()
    cosine = np.abs(dr.dot(si.sh_frame.n, ray.d).numpy())[hit]
    transmitted = 1 - np.array(fresnel_dielectric(mi.Float(cosine.astype(np.float32)), eta).numpy())
    leave = transmitted / (np.pi * external_diffuse_transmittance(eta))
    return Seen(si.p.numpy().T[hit].astype(np.float32), leave, hit.reshape(height, width))


@dataclass
class Reference:
    """A picture to compare with: linear ``(h, w, 3)``, the radiance that tone mapping takes for one half, how long it took."""

    picture: Array
    average: float
    seconds: float


def reference(scene: mi.Scene, seen: Seen, method: str, **settings: Any) -> Reference:
    """Render a body under direct light by one of our integrators at exactly the points that a frame shows.

    The average is that of the real-time pipeline, the light that enters over ``pi A`` (CLHHC08 section 3).
    """
    from pellucid.methods.preparation import entering_power

    begin = time.perf_counter()
    prepared = prepare(scene, method, irradiance_depth=DIRECT_LIGHT, **settings)
    picture = seen.picture(prepared.exitance(seen.points))
    seconds = time.perf_counter() - begin
    (lit,) = prepared.integrator.prepared.bodies
    flux = float(entering_power(lit).sum(axis=0) @ LUMINANCE)
    return Reference(picture, flux / (np.pi * float(np.sum(lit.samples.area, dtype=float))), seconds)


def toned(picture: NDArray[np.floating], average: float) -> Array:
    """Compress a linear picture into [0, 1) for the screen."""
    from pellucid.realtime.tone import tone_map

    return np.asarray(tone_map(np.asarray(picture, float), average))


def tone_errors(picture: NDArray[np.floating], truth: Reference, mask: NDArray[np.bool_]) -> dict[str, float]:
    """Take the RMSE of tone-mapped pictures: of the whole picture, as in CLHHC08, and of the pixels that show the body."""
    square = (toned(picture, truth.average) - toned(truth.picture, truth.average)) ** 2
    return {"image": float(np.sqrt(square.mean())), "covered": float(np.sqrt(square[mask].mean()))}


def frame_errors(source: FrameSource, camera: Camera, truth: Reference, mask: NDArray[np.bool_]) -> dict[str, float]:
    """Take the RMSE of a frame in motion as it goes to the screen, in bytes and tone-mapped, as `tone_errors` does."""
    source.frame(camera, mask.shape[::-1], moving=True)
    pixels = source.frame(camera, mask.shape[::-1], moving=True).pixels / 255
    square = (pixels - toned(truth.picture, truth.average)) ** 2
    return {"image": float(np.sqrt(square.mean())), "covered": float(np.sqrt(square[mask].mean()))}


def on_screen(picture: NDArray[np.floating], average: float) -> NDArray[np.floating]:
    """Tone-map a picture for `images.save_row`, which applies the curve of the screen to what is linear; `BRIGHTER`."""
    shown = toned(picture, average / BRIGHTER)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def halved(picture: NDArray[np.floating]) -> NDArray[np.floating]:
    """Take the means of 2 x 2 pixels."""
    height, width = (side // 2 * 2 for side in picture.shape[:2])
    return picture[:height, :width].reshape(height // 2, 2, width // 2, 2, -1).mean((1, 3))


# ------------------------------------------------------------------ times


def frame_times(
    source: FrameSource, camera: Camera, resolution: Resolution, frames: int, light: bool = True
) -> dict[str, float]:
    """Let the camera go around, and the first lamp if ``light``: median time of a frame and of its stages [s]."""
    from dataclasses import replace

    position = source.lights[0].position
    rows: list[dict[str, float]] = []
    for k in range(FIRST_FRAMES + frames):
        moved = replace(camera, origin=turned(camera.origin, -STEP * k))
        begin = time.perf_counter()
        if light:
            source.set_light(0, position=turned(position, STEP * k))
        frame = source.frame(moved, resolution, moving=True)
        rows.append({**frame.seconds, "whole": time.perf_counter() - begin})
    if light:
        source.set_light(0, position=position)
    rows = rows[FIRST_FRAMES:]
    return {stage: median(row.get(stage, 0.0) for row in rows) for stage in rows[-1]}


def slope(counts: Iterable[float], errors: Iterable[float]) -> float:
    """Fit the power of the number of samples that an error falls with."""
    return float(np.polyfit(np.log(list(counts)), np.log(list(errors)), 1)[0])


def settled(source: FrameSource, **settings: Any) -> FrameSource:
    """Choose settings of a source for comparisons: direct light alone, no highlight."""
    for name, value in {"gi": False, "specular": 0.0, **settings}.items():
        setattr(source.settings, name, value)
    return source


def say(text: str, begin: float = time.perf_counter()) -> None:
    """Print what is done, and when."""
    print(f"{time.perf_counter() - begin:7.1f} s  {text}", flush=True)
