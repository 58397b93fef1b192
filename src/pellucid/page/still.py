"""The picture in the file, for browsers in which the page cannot run."""

from __future__ import annotations

import io
import warnings

import mitsuba as mi

from ..errors import PellucidWarning
from ..realtime.engine import Engine
from ..realtime.source import Camera
from .surface import RESOLUTION

SIZE = (400, 300)
QUALITY = 75


def still_picture(scene: mi.Scene, camera: Camera) -> bytes:
    """Render a scene by the real-time engine: a JPEG."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The real-time engine follows the curve", PellucidWarning)  # as the page does
        engine = Engine(scene, RESOLUTION)
    engine.settings.method = "hybrid"
    engine.settings.interpolated = engine.settings.gi = False
    engine.settings.exposure = 1.0
    frame = engine.frame(camera, SIZE, moving=True)
    file = io.BytesIO()
    Image.fromarray(frame.pixels).save(file, "JPEG", quality=QUALITY)
    return file.getvalue()
