"""From the options of a command to a scene, a camera and an integrator."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import PellucidError, SceneError, did_you_mean
from ..version import __version__
from .output import shows_denoised
from .tiles import Picture, Tile

MATERIAL_OPTIONS = (
    "material",
    "radius",
    "unit",
    "sigma_a",
    "sigma_s_prime",
    "reflectance",
    "dmfp",
    "dmfp_scale",
    "eta",
    "g",
    "profile",
    "alpha",
)
BUILT_OPTIONS = ("size", "up", "envmap")
BUILDER_NAMES = {"envmap": "environment"}
OPTION_NAMES = {"sample_count": "samples"}
MOST_SAMPLE_PARTS = 1024
METHOD_OPTIONS = ("max_error", "sample_count", "sampling", "irradiance_paths", "seed")


@dataclass
class SessionOptions:
    """How to run, whatever is rendered."""

    variant: str | None = None
    threads: int | None = None
    quiet: bool = False
    verbose: bool = False


@dataclass
class Request:
    """What a command was asked to do: its options, sorted by who reads them."""

    source: str
    session: SessionOptions
    bsdf: dict[str, Any] = field(default_factory=dict)
    built: dict[str, Any] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    sensor: int = 0
    resolution: tuple[int, int] | None = None
    spp: int = 0
    method: str | None = None
    denoise: bool | None = None
    sample_parts: int = 0
    parameters: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> Request:
        """Sort the options of the command line; those that were not given are left out."""
        given = {name: value for name, value in options.items() if value is not None}

        def take(names: tuple[str, ...]) -> dict[str, Any]:
            return {name: given[name] for name in names if name in given}

        return cls(
            source=given["source"],
            session=SessionOptions(**take(("variant", "threads", "quiet", "verbose"))),
            bsdf=take(MATERIAL_OPTIONS),
            built=take(BUILT_OPTIONS),
            definitions=dict(given.get("definitions", ())),
            parameters=take(METHOD_OPTIONS),
            **take(("sensor", "resolution", "spp", "method", "denoise", "sample_parts")),
        )

    @classmethod
    def of(cls, source: str | Path, **options: Any) -> Request:
        """Make a checked request of a program: options as of the command line.

        Raises
        ------
        PellucidError
            For an option that there is not, and as `check`.
        """
        known = {*MATERIAL_OPTIONS, *BUILT_OPTIONS, *METHOD_OPTIONS, "variant", "threads", "definitions"}
        known |= {"sensor", "resolution", "spp", "method", "denoise", "sample_parts"}
        for name in options:
            if name not in known:
                meant = [known_as for known_as, told in OPTION_NAMES.items() if told == name]
                hint = f" (did you mean '{meant[0]}'?)" if meant else did_you_mean(name, known)
                raise PellucidError(f"There is no option '{name}'{hint}.")
        request = cls.from_options({"source": str(source), **options})
        request.check()
        return request

    @property
    def is_file(self) -> bool:
        """Tell whether the scene is a scene file of Mitsuba."""
        return Path(self.source).suffix.lower() == ".xml"

    @property
    def name(self) -> str:
        """What to call the pictures of this scene."""
        return Path(self.source).stem

    @property
    def seed(self) -> int:
        """The seed of the picture."""
        return self.parameters.get("seed", 0)

    def settings(self) -> dict[str, Any]:
        """Write down what the picture depends on; a file by its contents."""
        contents = _fingerprint(Path(self.source))
        return {
            **{"pellucid": __version__, "scene": self.source, "its contents": contents, "sensor": self.sensor},
            **{"resolution": self.resolution, "spp": self.spp, "method": self.method, "denoise": self.denoise},
            **{name: _named(value) for name, value in (self.bsdf | self.built | self.definitions).items()},
            **({"sample parts": self.sample_parts} if self.sample_parts else {}),
            **self.parameters,
        }

    def check(self) -> None:
        """Refuse options that the kind of scene has no use for, and scenes that are not there.

        Raises
        ------
        SceneError
            With the option and the reason.
        """
        if self.is_file:
            surplus = [*self.bsdf, *self.built]
            if surplus:
                option = "--" + surplus[0].replace("_", "-")
                raise SceneError(
                    f"{option}: a scene file has its own materials and sizes; edit '{self.source}' instead."
                )
        elif self.definitions:
            raise SceneError(f"-D {next(iter(self.definitions))}: only a scene file (.xml) has $names to set.")
        for text in (self.source, *self.definitions.values(), str(self.built.get("envmap", ""))):
            if not _is_utf8(text):
                raise SceneError(
                    f"The name '{text}' is not UTF-8, and Mitsuba opens no such file: give it another name."
                )
        if not isinstance(self.sample_parts, int) or not 0 <= self.sample_parts <= MOST_SAMPLE_PARTS:
            raise SceneError(
                f"sample_parts is a whole number from 1 to {MOST_SAMPLE_PARTS}, or 0 for none; found {self.sample_parts!r}."
            )
        if Path(self.source).suffix and not Path(self.source).is_file():
            if Path(self.source).exists():
                raise SceneError(f"'{self.source}' is no ordinary file: give a scene file (.xml) or a mesh.")
            raise SceneError(f"There is no file '{self.source}': check the path.")

    def load(self) -> Job:
        """Load the scene, and choose its camera, its picture and its method."""
        from ..scenes.loading import load_scene

        scene = load_scene(self.source, self.definitions, **self.load_options())
        sensors = scene.sensors()
        if self.sensor >= len(sensors):
            raise SceneError(f"-s {self.sensor}: the scene has {len(sensors)} camera(s), counted from 0.")
        sensor = sensors[self.sensor]
        if self.resolution is not None and self.is_file:
            set_resolution(sensor, self.resolution)
        return Job(self, scene, sensor)

    def load_options(self) -> dict[str, Any]:
        """Write what was asked for as the options of `load_scene`."""
        options: dict[str, Any] = {}
        if self.bsdf:
            options["bsdf"] = {"type": "pellucid_translucent", **{k: _plain(k, v) for k, v in self.bsdf.items()}}
        options |= {BUILDER_NAMES.get(name, name): value for name, value in self.built.items()}
        if self.resolution is not None and not self.is_file:
            options["resolution"] = self.resolution  # the camera frames a mesh by it
        return options


@dataclass
class Job:
    """A loaded scene with the camera that looks at it."""

    request: Request
    scene: Any
    sensor: Any

    def integrator(self, method: str | None = None) -> Any:
        """Make an integrator: that of the scene if it is one of ours, with what was asked for in place of its own.

        ``method`` overrules ``--method``; then parameters of another method are left out instead of refused.
        """
        import mitsuba as mi

        from ..methods import METHODS, method_class
        from ..methods.contract import shared_parameters

        own = getattr(self.scene.integrator(), "method", None)
        chosen = method or self.request.method or (own.name if own else "two_pass")
        cls = method_class(chosen)
        if self.request.denoise and cls.is_reference:
            raise PellucidError(
                f"--denoise: the method {chosen} is there to measure others against, and keeps its noise."
            )
        parameters = own.parameters() if own else {}
        if own and chosen != own.name:
            parameters = {name: parameters[name] for name in shared_parameters(type(own), cls) if name in parameters}
        asked = dict(self.request.parameters)
        for name in [name for name in asked if name not in cls.__dataclass_fields__]:
            if method is None:
                having = [other for other in METHODS if name in method_class(other).__dataclass_fields__]
                option = "--" + OPTION_NAMES.get(name, name).replace("_", "-")
                raise PellucidError(f"{option} belongs to the method {' or '.join(having)}, not to {chosen}.")
            del asked[name]
        return mi.load_dict({"type": f"pellucid_{chosen}", **parameters, **asked})

    def prepare(self, integrator: Any, number: int = 1, count: int = 1, prepare: Any = None) -> None:
        """Let an integrator prepare the scene, once for all pictures of it, if there is memory for a tile of them.

        ``prepare`` is as of `methods.integrator.TranslucentIntegrator.prepare_scene`.
        """
        import drjit as dr

        from ..methods.film import check_pass
        from ..methods.tiles import make_tile

        film = self.sensor.film()
        check_pass(make_tile(film, number, count), film, self.request.spp or self.sensor.sampler().sample_count())
        integrator.prepared = integrator.prepare_scene(self.scene, self.sensor, prepare)
        dr.sync_thread()  # kernels run on while Python goes ahead: wait, so that the times are those of the stages

    def render(self, integrator: Any, paths: Iterable[Path] = ()) -> Any:
        """Render the picture into the film of the camera.

        Returns
        -------
        Layers or None
            With the denoised picture, if one of the files at ``paths`` is to show it.
        """
        import drjit as dr

        from ..methods.denoising import can_denoise
        from ..progress import steps

        seed, spp = self.request.seed, self.request.spp
        if not (self._may_denoise(integrator) and any(map(shows_denoised, paths)) and can_denoise()):
            integrator.render(self.scene, self.sensor, seed=seed, spp=spp, develop=False)
            dr.sync_thread()
            return None
        layers = integrator.render_layers(self.scene, self.sensor, seed, spp)
        for _ in steps("denoising", [1], "pictures"):
            layers.denoised  # noqa: B018  (made once, when it is first asked for)
        return layers

    def render_tile(self, integrator: Any, number: int, count: int) -> Tile:
        """Render tile ``number``, from 1 to ``count``, with the layers that a denoiser needs if the whole may be denoised."""
        from ..methods.layers import LayerSums
        from ..methods.tiles import Region, describe_film, make_tile, sums_of

        whole = self.sensor.film()
        film = make_tile(whole, number, count)
        layers = LayerSums(film, Region.around(film, whole)) if self._may_denoise(integrator) else None
        integrator.render_tile(self.scene, self.sensor, film, self.request.seed, self.request.spp, layers)
        picture = Picture(self.request.settings(), describe_film(whole), integrator.aov_names(), count)
        x, y = (int(n) for n in film.crop_offset())
        return Tile(picture, number, (x, y), sums_of(film), vars(layers.means()) if layers else None)

    def _may_denoise(self, integrator: Any) -> bool:
        """Tell whether pictures of a method are denoised, if nothing else is asked for."""
        return self.request.denoise is not False and not integrator.method.is_reference


def _fingerprint(path: Path) -> str | None:
    """Tell contents of files apart; None where there is no file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else None


def _named(value: Any) -> Any:
    """Write down the value of an option: of a picture or a material in a file also what is in it."""
    if not isinstance(value, str | Path):
        return value
    contents = _fingerprint(Path(value))
    return f"{value} ({contents})" if contents else str(value)


def _is_utf8(text: str) -> bool:
    """Tell whether text from the command line holds nothing but characters."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _plain(name: str, value: Any) -> Any:
    """Write a colour, or a picture in its place, as Mitsuba's dictionaries want it: a picture of lengths is no picture of colours."""
    if isinstance(value, Path):
        return {"type": "bitmap", "filename": str(value), "raw": name == "dmfp"}
    return {"type": "rgb", "value": list(value)} if isinstance(value, tuple) else value


def set_resolution(sensor: Any, resolution: tuple[int, int]) -> None:
    """Change the size of the picture of a camera, to which its field of view adapts."""
    import mitsuba as mi

    parameters = mi.traverse(sensor)
    parameters["film.size"] = list(resolution)
    parameters.update()
