"""What a worker is sent once: what was asked for, and the files of the scene."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..jobs.job import Request
from .bundle import Bundle

SCENE = "scene"
"""The folder of the scene in a bundle."""


@dataclass(frozen=True)
class Work:
    """A request and the files that it needs.

    Attributes
    ----------
    request : Request
        Its paths are those of the machine that asks.
    bundle : Bundle
    moved : dict
        For each option whose value is a file: the name of that file in the bundle.
    versions : dict
        What every worker has to have (`versions.versions`).
    """

    request: Request
    bundle: Bundle
    moved: dict[str, str]
    versions: dict[str, str]

    @classmethod
    def of(cls, request: Request, versions: dict[str, str]) -> Work:
        """Collect the files of a request."""
        sources = {f"option-{name}": Path(value) for name, value in _files(request).items()}
        moved = {name: f"option-{name}/{Path(value).name}" for name, value in _files(request).items()}
        scene = Path(request.source)
        if scene.is_file():
            sources[SCENE], moved["source"] = scene, f"{SCENE}/{scene.name}"
        return cls(request, Bundle.of(sources), moved, versions)

    @property
    def key(self) -> str:
        """What tells it from other work."""
        return hashlib.sha256(f"{self.request}{self.bundle.key}".encode(errors="surrogateescape")).hexdigest()[:16]

    def request_in(self, folder: Path) -> Request:
        """Unpack the files in a folder, and give the request for them there."""
        self.bundle.unpack(folder)
        here: dict[str, Any] = {name: folder / path for name, path in self.moved.items()}
        request = self.request
        return replace(
            request,
            source=str(here.get("source", request.source)),
            bsdf={name: here.get(name, value) for name, value in request.bsdf.items()},
            built={name: here.get(name, value) for name, value in request.built.items()},
            definitions={name: str(here.get(name, value)) for name, value in request.definitions.items()},
        )


def _files(request: Request) -> dict[str, Any]:
    """List the options whose values are files."""
    options = request.bsdf | request.built | request.definitions
    return {name: value for name, value in options.items() if isinstance(value, str | Path) and Path(value).is_file()}
