"""The folder of the frames of a turntable, which knows of what settings they are."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import OutputError, PellucidError
from .output import check_folder, write

SETTINGS = "turntable.json"


class FrameFolder:
    """Frames in a folder, and beside them the settings they were rendered with: no two turntables are mixed in it."""

    def __init__(self, folder: Path, settings: dict[str, Any], frames: int):
        self.folder = check_folder(folder, create=True)
        self.paths = [folder / f"frame_{frame:05d}.png" for frame in range(frames)]
        self._file = folder / SETTINGS
        self.settings = json.loads(json.dumps({**settings, "frames": frames}))
        if self._file.is_file():
            self.compare(self.settings)
        elif any(folder.glob("frame_*.png")):
            self._refuse("it has no turntable.json that says of which")
        write(self._file, lambda beside: beside.write_text(json.dumps(self.settings, indent=1)))

    @classmethod
    def open(cls, folder: Path) -> FrameFolder:
        """Open a folder of frames by the settings that are in it.

        Raises
        ------
        OutputError
            When it is none.
        """
        try:
            settings = json.loads((folder / SETTINGS).read_text())
            frames = int(settings["frames"])
        except (OSError, ValueError, KeyError, TypeError):
            raise OutputError(f"'{folder}' is no folder of frames: 'pellucid turntable' makes them.") from None
        return cls(folder, settings, frames)

    def missing(self) -> list[int]:
        """List the frames that are not there yet."""
        return [frame for frame, path in enumerate(self.paths) if not path.is_file()]

    def left(self) -> str:
        """Say how many frames there are, and that they are not lost."""
        frames = len(self.paths)
        return f"{frames - len(self.missing())} of {frames} frames are in '{self.folder}': the same command goes on"

    @contextmanager
    def unless_it_fails(self) -> Iterator[None]:
        """Leave nothing behind of work that fails before its first frame."""
        try:
            yield
        except PellucidError:
            if len(self.missing()) == len(self.paths):
                self.remove()
            raise

    def keep(self, frame: int, png: bytes) -> None:
        """Write a frame."""
        write(self.paths[frame], lambda beside: beside.write_bytes(png))

    def remove(self) -> None:
        """Remove the frames and their settings, and the folder if nothing else is in it."""
        for path in (*self.paths, self._file):
            path.unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def compare(self, wanted: dict[str, Any]) -> None:
        """Check that the settings are those of the frames that are there."""
        try:
            found = json.loads(self._file.read_text())
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
            f"'{self.folder}' is the folder of another turntable ({reason}): name another folder, or remove this one."
        )
