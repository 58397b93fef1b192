"""Scene files of Mitsuba, of this version and of older ones, parsed and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import mitsuba as mi

from ..errors import SceneError, warn
from .foreign import convert_nodes
from .numbers import check_description
from .older import Older, is_older, rewritten
from .pictures import check_files, check_pictures, check_whole, may_load_in_parallel, picture_files


class Parsed(NamedTuple):
    """A scene file as Mitsuba's parser understands it; ``older`` if it had to be rewritten."""

    config: Any
    state: Any
    older: Older | None


def parse_scene_file(path: Path, parameters: Mapping[str, str]) -> Parsed:
    """Parse a scene file, an older one by way of its translation.

    Raises
    ------
    SceneError
        For a file that is not there, and for numbers that are not finite.
    """
    if not path.is_file():
        raise SceneError(f"There is no scene file '{path}': check the path.")
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    older = None
    if is_older(path, parameters):
        older = rewritten(path, parameters)
        config.unused_properties = mi.LogLevel.Debug  # they are told in one line
    # Whoever looks at a parameter marks it as read, and Mitsuba tells of those that nobody reads: look at a copy.
    check_description(_parse(config, path, parameters, older))
    state = _parse(config, path, parameters, older)
    with looking_into(path.resolve().parent):
        convert_nodes(state)
    return Parsed(config, state, older)


def _parse(config: Any, path: Path, parameters: Mapping[str, str], older: Older | None) -> Any:
    """Let Mitsuba parse a file, or what it was rewritten to."""
    if older is not None:
        return mi.parser.parse_string(config, older.text)
    return mi.parser.parse_file(config, str(path), **parameters)


def load_scene_file(path: Path, parameters: Mapping[str, str]) -> mi.Scene:
    """Load a scene file with every shape kept apart.

    Raises
    ------
    SceneError
        For a file that is not there, and for numbers that are not finite, in it or in its pictures.
    """
    parsed = parse_scene_file(path, parameters)
    with looking_into(path.resolve().parent):
        mi.parser.transform_all(parsed.config, parsed.state)
        files = list(picture_files(parsed.state))
        check_whole(files)
        parsed.config.parallel = may_load_in_parallel(files)
        try:
            scene = mi.parser.instantiate(parsed.config, parsed.state)
        except RuntimeError:
            check_files(files)  # a material may have stumbled over a picture without naming it
            raise
        check_pictures(scene, files)
    if parsed.older is not None:
        _tell(path.name, parsed.older, parsed.state)
    return scene


@contextmanager
def looking_into(folder: Path) -> Iterator[None]:
    """Let Mitsuba look for files in a folder first."""
    resolver = mi.file_resolver()
    before = [resolver[k] for k in range(len(resolver))]
    resolver.prepend(str(folder))
    try:
        yield
    finally:
        resolver.clear()
        for place in before:
            resolver.append(place)


def _tell(file: str, older: Older, state: Any) -> None:
    """Say in one line what became of an older scene."""
    unread = [f"{name} of {node.props.plugin_name()}" for node in state.nodes for name in node.props.unqueried()]
    lost = ", ".join(dict.fromkeys(older.lost + unread))
    text = f"'{file}' is a scene of Mitsuba 0.x: {'; '.join(dict.fromkeys(older.converted))}"
    warn(text + (f". Without a counterpart: {lost}." if lost else "."))
