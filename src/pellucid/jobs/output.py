"""Pictures become files: checked before the work begins, written beside their place and moved there when complete."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import OutputError, did_you_mean

if TYPE_CHECKING:
    import numpy as np

EIGHT_BIT = (".png", ".jpg", ".jpeg")
FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".exr": "OpenEXR", ".hdr": "RGBE"}
PICTURES = tuple(FORMATS)


def check_file(path: Path, known: Iterable[str] = PICTURES) -> Path:
    """Check that a file of a known kind can be written to a path.

    Raises
    ------
    OutputError
        For an unknown extension, a folder that is missing or cannot be written to, and a file that is protected.
    """
    known = sorted(known)
    suffix = path.suffix.lower()
    if suffix not in known:
        asked = f"'{suffix}' is no kind of file" if suffix else f"'{path}' has no extension: no kind of file"
        raise OutputError(
            f"{asked} that can be written here{did_you_mean(suffix, known)}; known are {' '.join(known)}."
        )
    try:
        path.lstat()
    except FileNotFoundError:
        pass
    except NotADirectoryError:
        check_folder(path.parent)
    except OSError as error:  # a name that is too long
        raise OutputError(f"'{path}' cannot be written: {error.strerror}.") from None
    else:
        if path.is_dir():
            raise OutputError(f"'{path}' is a folder: name a file in it.")
        if path.exists() and not path.is_file():
            raise OutputError(f"'{path}' is no ordinary file: choose another name.")
        if place_of(path).is_symlink():
            raise OutputError(f"'{path}' is a link that leads back to itself: remove it, or choose another name.")
        if path.exists() and not os.access(path, os.W_OK):
            raise OutputError(f"'{path}' is there and write-protected: choose another name.")
    check_folder(place_of(path).parent)
    return path


def check_files(paths: Iterable[Path]) -> None:
    """Check that files can be written to several paths, each to another.

    Raises
    ------
    OutputError
        As `check_file`, and when two paths lead to one file.
    """
    seen: dict[Path, Path] = {}
    for path in paths:
        place = place_of(check_file(path))
        if place in seen:
            raise OutputError(f"-o {seen[place]} and -o {path} are one file: name each picture once.")
        seen[place] = path


def place_of(path: Path) -> Path:
    """Find the file that a path stands for: a link is followed, and what it leads to is written."""
    return Path(os.path.realpath(path))


def check_folder(folder: Path, create: bool = False) -> Path:
    """Check that files can be written to a folder, by writing one.

    Raises
    ------
    OutputError
        When the folder is missing (and not to be created), is no folder, or refuses.
    """
    try:
        if create:
            folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".pellucid-"):
            pass
    except FileNotFoundError:
        raise OutputError(f"There is no folder '{folder}' to write to: create it first.") from None
    except (FileExistsError, NotADirectoryError):
        raise OutputError(f"'{folder}' is a file, not a folder: nothing can be written in it.") from None
    except OSError as error:
        raise OutputError(f"Nothing can be written in '{folder}': {error.strerror}.") from None
    return folder


def write(path: Path, writer: Callable[[Path], object]) -> None:
    """Let ``writer`` write a temporary file beside ``path``, then move it there: the file is complete or absent."""
    place = place_of(path)
    beside = place.with_name(f".pellucid-{secrets.token_hex(8)}{place.suffix}")  # other machines write here too
    try:
        writer(beside)
        os.replace(beside, place)
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"'{path}' could not be written: {error.strerror or error}.") from error
    finally:
        beside.unlink(missing_ok=True)


def shows_denoised(path: Path) -> bool:
    """Tell whether a file shows the denoised picture: those that are looked at do, and an EXR has room for it."""
    return path.suffix.lower() in (*EIGHT_BIT, ".exr")


def save_film(film: Any, paths: Iterable[Path], layers: Any = None) -> None:
    """Write what a film holds, extra channels included where the format has room for them.

    With ``layers`` (`methods.layers.Layers`), files of 8 bits show the denoised picture, and an EXR holds it beside the others.
    """
    bitmap = film.bitmap()
    for path in paths:
        suffix = path.suffix.lower()
        if layers is None or not shows_denoised(path):
            save_bitmap(bitmap, path)
        elif suffix == ".exr":
            save_bitmap(_with_layers(bitmap, layers), path)
        else:
            save_bitmap(_with_colour(_first_layer(bitmap), layers.denoised), path)


def _with_colour(bitmap: Any, colour: np.ndarray) -> Any:
    """Replace the colour of a picture, and keep its alpha if it has one."""
    import mitsuba as mi
    import numpy as np

    alpha = np.array(bitmap, np.float32)[..., 3:] if bitmap.has_alpha() else colour[..., :0]
    return mi.Bitmap(np.concatenate([colour, alpha], axis=-1))


def _with_layers(bitmap: Any, layers: Any) -> Any:
    """Add layers to the channels of a picture; those that it has of its own stay."""
    import mitsuba as mi
    import numpy as np

    names, data = [field.name for field in bitmap.struct_()], np.atleast_3d(np.array(bitmap))
    added = {name: value for name, value in layers.channels().items() if name not in names}
    data = np.concatenate([data, np.stack(list(added.values()), axis=-1).astype(data.dtype)], axis=-1)
    return mi.Bitmap(data, channel_names=[*names, *added])


def film_array(film: Any) -> np.ndarray:
    """Read the linear picture that a film holds, ``(h, w, 3) float``, without its extra channels."""
    import mitsuba as mi
    import numpy as np

    return np.array(_first_layer(film.bitmap()).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))


def save_array(picture: np.ndarray, path: Path) -> None:
    """Write a linear picture, ``(h, w, 3) float``."""
    import mitsuba as mi
    import numpy as np

    save_bitmap(mi.Bitmap(np.ascontiguousarray(picture, np.float32)), path)


def save_bitmap(bitmap: Any, path: Path) -> None:
    """Write a linear Mitsuba bitmap as the extension asks: 8 bits with the sRGB curve, or linear floats."""
    import mitsuba as mi

    form, suffix = mi.Bitmap.PixelFormat, path.suffix.lower()
    if suffix != ".exr":
        bitmap = _first_layer(bitmap)
        with_alpha = suffix == ".png" and bitmap.has_alpha()
        eight_bit = suffix in EIGHT_BIT
        component = mi.Struct.Type.UInt8 if eight_bit else mi.Struct.Type.Float32
        bitmap = bitmap.convert(form.RGBA if with_alpha else form.RGB, component, srgb_gamma=eight_bit)
    stream = (
        mi.MemoryStream()
    )  # Mitsuba opens no files whose names are not UTF-8, and tells of full disks in its own words
    bitmap.write(stream, getattr(mi.Bitmap.FileFormat, FORMATS[suffix]))
    write(path, lambda beside: beside.write_bytes(stream.raw_buffer()))


def _first_layer(bitmap: Any) -> Any:
    """Take the picture itself, which comes before its extra channels."""
    import mitsuba as mi

    return bitmap.split()[0][1] if bitmap.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel else bitmap
