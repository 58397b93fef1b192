"""Files of tiles, as they are rendered apart from each other, and the picture that is put together from them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OutputError
from .output import check_folder, write

if TYPE_CHECKING:
    import numpy as np

    from ..methods.layers import Layers

KEY, LAYER = "pellucid", "layer."
"""The attribute of a file of OpenEXR that says what the tile belongs to, and how the channels of its layers begin."""

OPENEXR = b"v/1\x01"
"""How files of OpenEXR begin."""


@dataclass(frozen=True)
class Picture:
    """What all tiles of a picture have in common.

    Attributes
    ----------
    settings : dict
        What was asked for, and by which version.
    film : dict
        The film of the whole, as `methods.tiles.describe_film` writes it down.
    extra : list of str
        The channels that the film has beside its colour.
    count : int
        Number of tiles.
    """

    settings: dict[str, Any]
    film: dict[str, Any]
    extra: list[str]
    count: int

    def plain(self) -> dict[str, Any]:
        """Write it down in JSON's own types, to compare with what was read."""
        return json.loads(json.dumps(asdict(self)))


@dataclass
class Tile:
    """One tile: its number, from 1 on, the crop offset of its film, the sums in it ``(h, w, channels)``, and its layers if it has any."""

    picture: Picture
    number: int
    offset: tuple[int, int]
    sums: np.ndarray
    layers: dict[str, np.ndarray] | None = None

    def write(self, path: Path) -> None:
        """Write a file of OpenEXR with 32-bit floats: nothing is divided, exposed or denoised yet."""
        import mitsuba as mi
        import numpy as np

        layers = self.layers or {}
        names = [f"sum.{k}" for k in range(self.sums.shape[-1])]
        names += [f"{LAYER}{name}.{k}" for name, image in layers.items() for k in range(image.shape[-1])]
        data = np.concatenate([self.sums, *layers.values()], axis=-1).astype(np.float32)
        bitmap = mi.Bitmap(np.ascontiguousarray(data), mi.Bitmap.PixelFormat.MultiChannel, names)
        about = {**self.picture.plain(), "number": self.number, "offset": self.offset, "names": names}
        bitmap.metadata()[KEY] = json.dumps(about)
        stream = mi.MemoryStream()
        bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
        write(path, lambda beside: beside.write_bytes(stream.raw_buffer()))

    @classmethod
    def read(cls, path: Path) -> Tile:
        """Read a tile.

        Raises
        ------
        OutputError
            When the file is not there, or no tile.
        """
        import mitsuba as mi
        import numpy as np

        try:
            content = path.read_bytes()
            if not content.startswith(OPENEXR):  # Mitsuba never finds the end of one of another kind that is cut off
                raise ValueError
            stream = mi.MemoryStream()
            stream.write(content)
            stream.seek(0)
            bitmap = mi.Bitmap(stream)
            about = json.loads(bitmap.metadata()[KEY])
        except OSError as error:
            raise OutputError(f"'{path}' cannot be read: {error.strerror or error}.") from None
        except (RuntimeError, KeyError, ValueError):
            raise OutputError(f"'{path}' is no tile: those are written by 'pellucid render ... --tile K/N'.") from None
        found = [field.name for field in bitmap.struct_()]
        data = np.atleast_3d(np.array(bitmap, np.float32))[..., [found.index(name) for name in about["names"]]]
        parts: dict[str, list[int]] = {}
        for k, name in enumerate(about["names"]):
            parts.setdefault(name.rpartition(".")[0], []).append(k)
        images = {name: np.ascontiguousarray(data[..., columns]) for name, columns in parts.items()}
        sums = images.pop("sum")
        layers = {name.removeprefix(LAYER): image for name, image in images.items()}
        picture = Picture(**{name: about[name] for name in Picture.__dataclass_fields__})
        return cls(picture, about["number"], tuple(about["offset"]), sums, layers or None)


def tile_path(picture: Path, number: int, count: int) -> Path:
    """Name the file of a tile after its picture."""
    return picture.with_name(f"{picture.stem}_tile_{number:05d}_of_{count:05d}.exr")


class TileFolder:
    """Tiles of one picture that are kept until it is complete, in a folder beside it."""

    def __init__(self, picture: Path):
        self.folder = check_folder(picture.with_name(f"{picture.stem}_tiles"), create=True)
        self.picture: Picture | None = None

    def there(self, picture: Picture) -> set[int]:
        """List the tiles of a picture that are there.

        Raises
        ------
        OutputError
            When there is a tile of another picture.
        """
        self.picture = picture
        tiles = self.read()
        for tile in tiles:
            try:
                _compare(picture, tile)
            except OutputError as error:
                raise OutputError(f"'{self.folder}' holds tiles of another picture: remove it. {error}") from None
        return {tile.number for tile in tiles}

    def keep(self, tile: Tile) -> None:
        """Write a tile."""
        tile.write(self.folder / f"tile_{tile.number:05d}.exr")

    def read(self) -> list[Tile]:
        """Read all tiles."""
        return [Tile.read(path) for path in sorted(self.folder.glob("tile_*.exr"))]

    def left(self) -> str:
        """Say how many tiles there are, and that they are not lost."""
        count = len(list(self.folder.glob("tile_*.exr")))
        if not count:
            return "no tile is finished"
        whole = f" of {self.picture.count}" if self.picture else ""
        return f"{count}{whole} tiles are in '{self.folder}': the same command goes on"

    def remove(self) -> None:
        """Remove the tiles, and the folder if nothing else is in it."""
        for path in self.folder.glob("tile_*.exr"):
            path.unlink()
        self.remove_if_empty()

    def remove_if_empty(self) -> None:
        """Remove the folder if nothing is in it."""
        if not any(self.folder.iterdir()):
            self.folder.rmdir()


def merge(tiles: Sequence[Tile]) -> tuple[Any, Layers | None]:
    """Put a picture together.

    Returns
    -------
    film, layers
        The film of the whole, as one run fills it; and the layers of the whole, if the tiles have them.

    Raises
    ------
    OutputError
        When a tile is missing, or belongs to another picture.
    """
    import mitsuba as mi

    from ..methods.tiles import put_sums

    picture = tiles[0].picture
    for tile in tiles:
        _compare(picture, tile)
    _complete(picture, (tile.number for tile in tiles))
    film = mi.load_dict(picture.film)
    film.prepare(picture.extra)
    by_number = {tile.number: tile for tile in tiles}
    for tile in by_number.values():
        put_sums(film, tile.sums, tile.offset)
    return film, _merge_layers(film, list(by_number.values()))


def _merge_layers(film: Any, tiles: Sequence[Tile]) -> Layers | None:
    """Put the layers of tiles beside each other."""
    import numpy as np

    from ..methods.layers import Layers

    if any(tile.layers is None for tile in tiles):
        return None
    (width, height), corner = (int(n) for n in film.crop_size()), film.crop_offset()
    whole = {name: np.zeros((height, width, image.shape[-1]), np.float32) for name, image in tiles[0].layers.items()}  # type: ignore[union-attr]
    for tile in tiles:
        x, y = (int(a - b) for a, b in zip(tile.offset, corner, strict=True))
        for name, image in (tile.layers or {}).items():
            whole[name][y : y + image.shape[0], x : x + image.shape[1]] = image
    return Layers(**whole)


def _compare(picture: Picture, tile: Tile) -> None:
    """Check that a tile belongs to a picture."""
    ours, other = picture.plain(), tile.picture.plain()
    for part in ("settings", "film"):
        for name in sorted({*ours[part], *other[part]}):
            if ours[part].get(name) != other[part].get(name):
                found = f"{name} is {other[part].get(name)} there, and {ours[part].get(name)} in the first one"
                raise OutputError(f"Tile {tile.number} belongs to another picture ({found}): render it again.")
    if ours != other:
        raise OutputError(f"Tile {tile.number} is one of {other['count']}, and the first one of {ours['count']}.")


def _complete(picture: Picture, numbers: Iterable[int]) -> None:
    """Check that no tile is missing."""
    missing = sorted({*range(1, picture.count + 1)} - {*numbers})
    if missing:
        shown = ", ".join(map(str, missing[:8])) + (", ..." if len(missing) > 8 else "")
        raise OutputError(
            f"{len(missing)} of {picture.count} tiles are missing ({shown}): render them, then merge again."
        )
