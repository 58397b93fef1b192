"""The files that a scene is made of, as they travel to workers."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

NAMING = (".xml", ".obj", ".mtl", ".gltf")
"""Files that name other files."""

LONGEST = 250
"""A name of a file is shorter; data that are written into a file are not."""

QUOTED = (re.compile(r'"([^"\n]+)"'), re.compile(r"'([^'\n]+)'"))


@dataclass(frozen=True)
class Bundle:
    """The contents of files by their names, relative to one folder."""

    files: dict[str, bytes]

    @classmethod
    def of(cls, sources: Mapping[str, Path]) -> Bundle:
        """Collect files into folders of the bundle, each with all that it names beside or below itself.

        What a file names elsewhere has to be there on every machine.
        """
        files: dict[str, bytes] = {}
        for folder, source in sources.items():
            for path in _with_named(source, set()):
                name = _name(path, source.parent)
                if name is not None:
                    files[f"{folder}/{name}"] = path.read_bytes()
        return cls(files)

    @property
    def key(self) -> str:
        """What tells it from others: equal for equal names and contents."""
        digest = hashlib.sha256()
        for name, contents in sorted(self.files.items()):
            digest.update(f"{name}\0{len(contents)}\0".encode(errors="surrogateescape"))
            digest.update(contents)
        return digest.hexdigest()[:16]

    def unpack(self, folder: Path) -> None:
        """Write the files."""
        for name, contents in self.files.items():
            relative = PurePosixPath(name)
            if relative.is_absolute() or ".." in relative.parts:
                raise ValueError(f"'{name}' does not lie below the folder of the scene.")
            path = folder / relative
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(contents)


def _with_named(path: Path, seen: set[Path]) -> Iterator[Path]:
    """List a file and the files that it names, and those that they name."""
    path = Path(os.path.abspath(path))  # links are not followed: they have the names that count
    if path in seen or not path.is_file():
        return
    seen.add(path)
    yield path
    if path.suffix.lower() in NAMING:
        text = path.read_text(errors="replace")
        for name in {*text.split(), *(name for quoted in QUOTED for name in quoted.findall(text))}:
            if "." in name and len(name) < LONGEST and not name.startswith("/"):
                yield from _with_named(path.parent / name, seen)


def _name(path: Path, folder: Path) -> str | None:
    """Name a file relative to a folder; None where it does not lie below it."""
    below = os.path.abspath(folder)
    return path.relative_to(below).as_posix() if path.is_relative_to(below) else None
