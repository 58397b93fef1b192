"""The options that several commands share, and the kinds of values they take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ..errors import OutputError
from ..jobs.job import MOST_SAMPLE_PARTS
from ..kernels.backend import CANDIDATES
from ..methods import METHODS

PROFILES = ("tabulated", "curved", "dipole")
SAMPLINGS = ("auto", "relaxed", "repulsion", "poisson", "uniform")
MAX_PIXELS = 1 << 28
MAX_WORKERS = 1024
MOST_SPP = 1 << 24
SIZES = (1e-6, 1e9)  # beyond, areas in single precision are 0 or infinite
PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".bmp", ".tga")

Command = Callable[..., Any]


class Color(click.ParamType):
    """Three numbers for red, green and blue, or one for all."""

    name = "R,G,B"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Read ``0.1,0.2,0.3``."""
        try:
            numbers = tuple(float(part) for part in value.replace(",", " ").split())
        except ValueError:
            numbers = ()
        if len(numbers) not in (1, 3):
            self.fail(f"'{value}' is no colour: give three numbers as in 0.1,0.2,0.3, or one.", param, ctx)
        return numbers if len(numbers) == 3 else numbers * 3


class ColorOrPicture(Color):
    """A colour, or a picture that lies on the surface."""

    name = "R,G,B|FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...] | Path:  # type: ignore[override]
        """Read a colour as above, or the path of a picture."""
        path = Path(value)
        if path.is_file():
            return path
        if path.suffix.lower() in PICTURES:
            self.fail(f"there is no picture '{value}': check the path.", param, ctx)
        return super().convert(value, param, ctx)


class Resolution(click.ParamType):
    """Width and height of a picture."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Read ``640x480``."""
        width, cross, height = value.lower().partition("x")
        if not (cross and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
            self.fail(f"'{value}' is no resolution: give width and height in pixels, as in 640x480.", param, ctx)
        if int(width) * int(height) > MAX_PIXELS:
            self.fail(f"{value} has more than {MAX_PIXELS} pixels: give width and height in pixels.", param, ctx)
        return int(width), int(height)


class Definition(click.ParamType):
    """A value for a ``$name`` of a scene file."""

    name = "KEY=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Read ``key=value``."""
        key, equals, text = value.partition("=")
        if not (key and equals):
            self.fail(f"'{value}' is no definition: write -D key=value.", param, ctx)
        return key, text


class Methods(click.ParamType):
    """Several methods."""

    name = "A,B,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Read ``two_pass,exact``."""
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in value.split(",") if name.strip())
        for name in names:
            if name not in METHODS:
                self.fail(f"'{name}' is no method; known are {', '.join(METHODS)}.", param, ctx)
        if len(set(names)) < len(names) or not names:
            self.fail(f"'{value}': name each method once.", param, ctx)
        return names


class ClusterAddress(click.ParamType):
    """Where the workers are."""

    name = "ADDRESS"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Read ``tcp://HOST:PORT``, ``tls://HOST:PORT``, ``local`` or ``local:N``."""
        kind, _, rest = value.partition(":")
        number = rest.rpartition(":")[2]
        if kind == "local" and (value == "local" or (rest.isdecimal() and 0 < int(rest) <= MAX_WORKERS)):
            return value
        if kind in ("tcp", "tls") and rest.startswith("//") and number.isdecimal():
            return value
        self.fail(f"'{value}' is no cluster: write tcp://HOST:8786, tls://HOST:8786, local or local:N.", param, ctx)


FILE = click.Path(path_type=Path)

_SCENE = [
    click.argument("source", metavar="SCENE"),
    click.option(
        "--material",
        metavar="NAME|FILE",
        help="A measured material (see 'pellucid materials'), or a file of 'pellucid fit' (.json) or MaterialX (.mtlx, .mtlx:name).",
    ),
    click.option(
        "--radius",
        type=click.Choice(["mfp", "dmfp"]),
        help="What the radius in a material file is. Default: mfp, as the format says.",
    ),
    click.option(
        "--unit",
        type=click.FloatRange(min=0, min_open=True),
        metavar="MM",
        help="Unit of length of a material file [mm].",
    ),
    click.option("--sigma-a", type=Color(), help="Absorption coefficient [1/mm], with --sigma-s-prime."),
    click.option("--sigma-s-prime", type=Color(), help="Reduced scattering coefficient [1/mm], with --sigma-a."),
    click.option(
        "--reflectance", type=ColorOrPicture(), help="Total diffuse reflectance, a colour or a picture, with --dmfp."
    ),
    click.option(
        "--dmfp",
        type=ColorOrPicture(),
        help="Diffuse mean free path [mm], numbers or a picture, with --reflectance. White is 1 mm.",
    ),
    click.option("--dmfp-scale", type=Color(), help="Factor on the picture of --dmfp: what white is [mm]."),
    click.option("--eta", type=float, metavar="X", help="Relative index of refraction."),
    click.option("--g", type=float, metavar="X", help="Mean cosine of the scattering angle."),
    click.option(
        "--profile",
        type=click.Choice(PROFILES),
        help="How light spreads: as in a flat body, with curve and thickness, or by the dipole. Default: tabulated.",
    ),
    click.option("--alpha", type=float, metavar="X", help="Roughness of the surface (GGX); 0 is mirror-smooth."),
    click.option(
        "--size",
        type=click.FloatRange(*SIZES),
        metavar="MM",
        help="Largest extent of a mesh or of a built-in object [mm].",
    ),
    click.option("--up", type=click.Choice(["y", "z"]), help="Upward axis of a mesh. Default: by its format."),
    click.option(
        "--envmap",
        type=FILE,
        metavar="FILE",
        help="Environment picture (.exr, .hdr) that lights a mesh or teapot_env.",
    ),
    click.option("-D", "--define", "definitions", type=Definition(), multiple=True, help="Set $KEY in a scene file."),
    click.option(
        "-s", "--sensor", type=click.IntRange(min=0), metavar="N", default=0, help="Index of the camera, as in Mitsuba."
    ),
]

_PICTURE = [
    click.option("--resolution", type=Resolution(), help="Size of the picture, in place of that of the scene."),
    click.option(
        "--spp", type=click.IntRange(1, MOST_SPP), metavar="N", help="Samples a pixel, in place of those of the scene."
    ),
]

_METHOD = [
    click.option("--max-error", type=float, metavar="X", help="Largest solid angle of a cluster [sr], for two_pass."),
    click.option(
        "--samples", "sample_count", type=click.IntRange(min=1), metavar="N", help="Surface samples of each body."
    ),
    click.option(
        "--sampling",
        type=click.Choice(SAMPLINGS),
        help="How they are spread. Default: auto, which is relaxed.",
    ),
    click.option("--irradiance-paths", type=click.IntRange(min=1), metavar="N", help="Light paths to each of them."),
    click.option("--seed", type=click.IntRange(0, 2**31 - 1), metavar="N", default=0, help="Of everything random."),
]

_SESSION = [
    click.option(
        "-m",
        "--mode",
        "variant",
        metavar="VARIANT",
        help=f"Variant of Mitsuba. Default: the first that works of {', '.join(CANDIDATES)}.",
    ),
    click.option(
        "-t",
        "--threads",
        type=click.IntRange(min=1),
        metavar="N",
        help="Number of threads, at least 2: files need a second one. Default: all.",
    ),
    click.option("-q", "--quiet", is_flag=True, help="No progress and no summary."),
    click.option("-v", "--verbose", is_flag=True, help="Messages of Mitsuba, and where errors came from."),
]


def _apply(options: Sequence[Callable[[Any], Any]]) -> Callable[[Command], Command]:
    """Decorate a command with a list of options, in their order."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


scene_options = _apply(_SCENE)
picture_options = _apply(_PICTURE)
method_options = _apply(_METHOD)
session_options = _apply(_SESSION)
denoise_option = click.option(
    "--denoise/--no-denoise",
    default=None,
    help="Take the noise out of PNG and JPEG, and add that picture to EXR. Default: yes, but for the methods exact and sampled.",
)
fps_option = click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    default=24,
    show_default=True,
    help="For a video.",
)
cluster_options = _apply(
    [
        click.option(
            "--cluster",
            type=ClusterAddress(),
            help="Render on the workers of a scheduler of Dask, tcp://HOST:8786, or on N workers of this machine, local:N.",
        ),
        click.option(
            "--sample-parts",
            type=click.IntRange(1, MOST_SAMPLE_PARTS),
            metavar="N",
            help="With --cluster: surface samples stay in N parts on the workers, where they are too many for the memory of one.",
        ),
    ]
)


def check_cluster(cluster: str | None, sample_parts: int | None) -> None:
    """Refuse parts of samples without workers that keep them.

    Raises
    ------
    OutputError
        With the remedy.
    """
    if sample_parts and not cluster:
        raise OutputError("--sample-parts: one process holds all samples; add --cluster, or leave it out.")


one_method = click.option(
    "--method",
    type=click.Choice(list(METHODS)),
    help="How the exitance is summed. Default: as the scene says, or two_pass.",
)
