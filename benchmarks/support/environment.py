"""Environments that were photographed: those that come with viser (Poly Haven, CC0), which the viewer needs anyway.

They are JPEGs of usual brightness with a second one inside: the logarithm of what each pixel is multiplied with (ISO 21496-1).
"""

from __future__ import annotations

import io
import re
from importlib.util import find_spec
from pathlib import Path

import mitsuba as mi
import numpy as np

BEGIN = b"\xff\xd8\xff"
"""Of a JPEG."""


def environment(name: str, folder: Path) -> Path:
    """Write one of them as a latitude-longitude EXR of linear radiance.

    Parameters
    ----------
    name : str
        As viser names its files, such as ``st_fagans_interior_1k``.
    folder : Path
        Where it is written.
    """
    spec = find_spec("viser")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("The environment is one of viser's: pip install '.[viewer]'.")
    raw = (Path(spec.origin).parent / "_assets" / "hdri" / f"{name}.jpg").read_bytes()
    shown, gain = _picture(raw), _picture(raw[_second(raw) :])
    number = {key: float(value) for key, value in re.findall(r'hdrgm:(\w+)="([\d.-]+)"', raw.decode("latin-1"))}
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    stops = number["GainMapMin"] + (number["GainMapMax"] - number["GainMapMin"]) * gain ** (1 / number["Gamma"])
    radiance = (linear + number["OffsetSDR"]) * 2**stops - number["OffsetHDR"]
    path = folder / f"{name}.exr"
    mi.Bitmap(radiance.astype(np.float32)).write(str(path))
    return path


def _second(raw: bytes) -> int:
    """Find where the last picture begins: the second, since there are no thumbnails."""
    return raw.rindex(BEGIN)


def _picture(raw: bytes) -> np.ndarray:
    """Decode a JPEG: ``(h, w, 3)`` in [0, 1]."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(raw)).convert("RGB"), float) / 255
