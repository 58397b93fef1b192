"""The folder of the frames of a turntable, which knows of what settings they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import OutputError
from ..version import __version__
from .job import Request
from .output import check_folder, write

SETTINGS = "turntable.json"


class FrameFolder:
    """Frames in a folder, and beside them the settings they were rendered with: no two turntables are mixed in it."""

    def __init__(self, folder: Path, request: Request, frames: int):
        self.folder = check_folder(folder, create=True)
        self.paths = [folder / f"frame_{frame:05d}.png" for frame in range(frames)]
        self._settings = folder / SETTINGS
        wanted = json.loads(json.dumps(_settings(request, frames)))
        if self._settings.is_file():
            self._compare(wanted)
        elif any(folder.glob("frame_*.png")):
            self._refuse("it has no turntable.json that says of which")
        write(self._settings, lambda beside: beside.write_text(json.dumps(wanted, indent=1)))

    def missing(self) -> list[int]:
        """List the frames that are not there yet."""
        return [frame for frame, path in enumerate(self.paths) if not path.is_file()]

    def remove(self) -> None:
        """Remove the frames and their settings, and the folder if nothing else is in it."""
        for path in (*self.paths, self._settings):
            path.unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _compare(self, wanted: dict[str, Any]) -> None:
        """Check that the settings are those of the frames that are there."""
        try:
            found = json.loads(self._settings.read_text())
        except ValueError:
            found = None
        if not isinstance(found, dict):
            self._refuse(f"{SETTINGS} in it cannot be read")
            return
        for name in sorted({*found, *wanted}):
            if found.get(name) != wanted.get(name):
                self._refuse(f"{name} was {found.get(name)}, and is {wanted.get(name)}")

    def _refuse(self, reason: str) -> None:
        raise OutputError(
            f"'{self.folder}' holds frames of another turntable ({reason}): name another folder, or remove this one."
        )


def _settings(request: Request, frames: int) -> dict[str, Any]:
    """Write down what frames depend on; a file by its size and its time of change."""
    source = Path(request.source)
    changed = [source.stat().st_size, source.stat().st_mtime_ns] if source.is_file() else None
    return {
        **{"pellucid": __version__, "frames": frames, "scene": request.source, "its size and time": changed},
        **{"sensor": request.sensor, "resolution": request.resolution, "spp": request.spp, "method": request.method},
        **{
            **request.bsdf,
            **{k: str(v) for k, v in request.built.items()},
            **request.definitions,
            **request.parameters,
        },
    }
