"""The files that a mesh file names beside itself: found, and read only if they are ordinary files."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ...errors import SceneError


class Beside:
    """Finds what a mesh file names relative to its folder; also hands out what is in memory already.

    It has the methods of trimesh's resolvers without being one: only who reads a mesh file waits for trimesh to be imported.

    Attributes
    ----------
    memory : dict
        Contents by name, which need no file.
    missing : list of str
        Names that were asked for in vain.
    """

    def __init__(self, path: Path):
        self.path = path
        self.memory: dict[str, bytes] = {}
        self.missing: list[str] = []

    def get(self, key: str) -> bytes:
        """Read a file by the name that the mesh file gives it.

        Raises
        ------
        SceneError
            When there is no such file, or when it is a pipe or a folder.
        """
        name = key.strip()
        if name in self.memory:
            return self.memory[name]
        slashed = name.replace("\\", "/")
        for candidate in (slashed, unquote(slashed), Path(slashed).name):
            found = self.path.parent / candidate
            if found.is_file():
                return found.read_bytes()
        self.missing.append(name)
        what = "is no ordinary file" if (self.path.parent / slashed).exists() else "is not there"
        raise SceneError(f"'{self.path}' needs '{name}', which {what}: put it beside the mesh file.")

    def __getitem__(self, key: str) -> bytes:
        """Read a file, as `get` does."""
        return self.get(key)

    def __contains__(self, key: str) -> bool:
        """Tell whether something is in memory."""
        return key in self.memory

    def keys(self) -> Any:
        """List what is in memory."""
        return self.memory.keys()

    def write(self, name: str, data: Any) -> None:
        """Write nothing."""
        raise SceneError(f"'{name}' is only read.")

    def namespaced(self, namespace: str) -> Beside:
        """Look into a folder below."""
        return Beside(self.path.parent / namespace / self.path.name)
