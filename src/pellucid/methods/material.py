"""What a scene says about a translucent medium: read from a plug-in, shown to ``mi.traverse``, and changed there."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MediumError, first_cause, warn
from ..model.materials import clear_warning
from ..model.medium import DEFAULT_PROFILE, Medium

Array = NDArray[np.float64]

COEFFICIENTS = ("sigma_a", "sigma_s_prime")
REFLECTANCE = ("reflectance", "dmfp")
DEFAULT_MATERIAL = "marble"
MEASURED = ".json"
"""Files of materials that were measured."""
BLACKEST, WHITEST = 1e-3, 0.999
UNKNOWN_DMFP = np.ones(3)
"""Of a texture, until it is known on which body it lies [mm]."""
OUTSIDE = 1e-2  # by which filters may carry a texture beyond 0 or 1


@dataclass(frozen=True)
class Description:
    """A medium as it was described: by its coefficients, or by its reflectance and diffuse mean free path.

    Attributes
    ----------
    given : dict
        The two `COEFFICIENTS` [1/mm], or the reflectance and the dmfp [mm]: ``(3,) float`` each.
    """

    given: dict[str, Array]
    eta: float
    g: float
    name: str | None = None
    profile: str = DEFAULT_PROFILE

    @classmethod
    def from_medium(cls, medium: Medium, names: tuple[str, str] = COEFFICIENTS) -> Description:
        """Describe a medium by `COEFFICIENTS` or by `REFLECTANCE`."""
        given = {name: _read(medium, name) for name in names}
        return cls(given, medium.eta, medium.g, medium.name, medium.profile)

    def medium(self) -> Medium:
        """Make the medium."""
        if "reflectance" in self.given:
            return Medium.from_reflectance(**self.given, eta=self.eta, g=self.g, profile=self.profile)
        return Medium(**self.given, eta=self.eta, g=self.g, name=self.name, profile=self.profile)

    def values(self, medium: Medium) -> dict[str, Any]:
        """List all parameters of the medium: those that were given, and those that follow."""
        return {name: _read(medium, name) for name in (*COEFFICIENTS, *REFLECTANCE)} | self.given | {"eta": self.eta}

    def changed(self, new: dict[str, Any]) -> Description:
        """Change some of the parameters; the last ones that were given describe the medium.

        Raises
        ------
        MediumError
            When both coefficients and reflectance or dmfp are changed.
        """
        ways = [names for names in (COEFFICIENTS, REFLECTANCE) if new.keys() & set(names)]
        if len(ways) > 1:
            both = sorted(new.keys() & {*COEFFICIENTS, *REFLECTANCE})
            raise MediumError(
                f"{', '.join(both)} were changed at once: change sigma_a and sigma_s_prime, or reflectance and dmfp."
            )
        changed = replace(self, eta=new["eta"]) if "eta" in new else self
        if not ways:
            return changed
        old = self.values(self.medium())
        return replace(changed, given={name: new.get(name, old[name]) for name in ways[0]}, name=None)


def _read(medium: Medium, name: str) -> Array:
    """Read a parameter of a medium by the name that it has in a scene."""
    return medium.total_diffuse_reflectance if name == "reflectance" else getattr(medium, name)


class ShownValues:
    """Numbers and colours as ``mi.traverse`` shows them, in variables of the active variant.

    Attributes
    ----------
    variables : dict
        A ``Float`` or a ``Color3f`` by name. They stay the same objects: whoever has traversed the scene holds them.
    """

    def __init__(self) -> None:
        self.variables: dict[str, Any] = {}
        self._last: dict[str, tuple[Any, NDArray[np.float32]]] = {}

    def show(self, **values: ArrayLike) -> None:
        """Show values: one number, or three for red, green and blue."""
        for name, value in values.items():
            array = np.asarray(value, np.float32)
            kind = mi.Color3f if array.ndim else mi.Float
            if name not in self.variables:
                self.variables[name] = kind(array.tolist())
            elif not np.array_equal(array, self._now(name)):  # a variable that was set from outside may have gradients
                mi.set_property(self.variables[name], array.tolist())
            self._last[name] = kind(self.variables[name]), array

    def changed(self) -> dict[str, Any]:
        """List the values that are other ones than were shown: those that somebody has changed.

        Raises
        ------
        MediumError
            For an array where one value is asked for.
        """
        new = {}
        for name, (_, last) in self._last.items():
            now = self._now(name)
            if now.shape != last.shape:
                raise MediumError(f"{name} was given an array of shape {now.shape}: give one value.")
            if not np.array_equal(now, last):
                new[name] = now.astype(float) if now.ndim else float(now)
        return new

    def _now(self, name: str) -> NDArray[np.float32]:
        """Read a variable. One that is still what was shown is not computed: that would compile a kernel for each value."""
        variable, (shown, last) = self.variables[name], self._last[name]
        if dr.detail.collect_indices(variable) == dr.detail.collect_indices(shown):
            return last
        return np.squeeze(np.asarray(dr.detach(variable).numpy(), np.float32))


# ------------------------------------------------------------------ reading a plug-in


@dataclass
class Textures:
    """The textures of a medium.

    Attributes
    ----------
    reflectance : mi.Texture, optional
    dmfp : mi.Texture, optional
        Its values times ``dmfp_scale (3,)`` are the diffuse mean free path [mm].
    """

    reflectance: Any = None
    dmfp: Any = None
    dmfp_scale: Array = field(default_factory=lambda: np.ones(3))

    def named(self) -> dict[str, mi.Texture]:
        """List those that there are, by the names that they have in a scene."""
        textures = {"reflectance": self.reflectance, "dmfp": self.dmfp}
        return {name: texture for name, texture in textures.items() if texture is not None}


def read_description(props: mi.Properties) -> tuple[Description, Textures]:
    """Read the medium of a plug-in [1/mm], and its textures.

    Raises
    ------
    MediumError
        For an unknown material, for a coefficient that cannot be, and for two descriptions of one medium.
    """
    ways = {
        "material": "material" in props,
        "sigma_a and sigma_s_prime": any(c in props for c in COEFFICIENTS),
        "reflectance and dmfp": any(c in props for c in REFLECTANCE),
    }
    found = [way for way, is_given in ways.items() if is_given]
    if len(found) > 1:
        raise MediumError(f"The medium was described by {' and by '.join(found)}: keep one of them.")
    optional: dict[str, Any] = {key: float(props[key]) for key in ("eta", "g") if key in props}
    optional |= {"profile": str(props["profile"])} if "profile" in props else {}
    defaults = {"eta": Medium.eta, "g": Medium.g} | optional

    if ways["sigma_a and sigma_s_prime"]:
        sigma_a, sigma_s_prime = (read_color(props, c) for c in COEFFICIENTS)
        if sigma_a is None or sigma_s_prime is None:
            raise MediumError("Only one of sigma_a and sigma_s_prime was given: both are needed [1/mm].")
        return Description({"sigma_a": sigma_a, "sigma_s_prime": sigma_s_prime}, **defaults), Textures()

    if ways["reflectance and dmfp"]:
        if not all(name in props for name in REFLECTANCE):
            raise MediumError(
                "Only one of reflectance and dmfp (diffuse mean free path [mm]) was given: both are needed."
            )
        textures = Textures(**{name: props[name] for name in REFLECTANCE if isinstance(props[name], mi.Texture)})
        given: Any = {name: read_color(props, name) for name in REFLECTANCE if name not in textures.named()}
        if textures.reflectance is not None:
            check_range(textures.reflectance)
            given["reflectance"] = mean_values(textures.reflectance)
        if textures.dmfp is not None:
            scale = read_color(props, "dmfp_scale")
            textures.dmfp_scale = textures.dmfp_scale if scale is None else scale
            given["dmfp"] = UNKNOWN_DMFP
        return Description(given, **defaults), textures

    name = str(props.get("material", DEFAULT_MATERIAL))
    if name.endswith(MEASURED):
        description, texture = read_measured(Path(str(mi.file_resolver().resolve(name))))
        return replace(description, **optional), Textures(texture)
    preset = Medium.from_preset(name)
    if (text := clear_warning(name)) is not None:
        warn(text)
    return replace(Description.from_medium(preset), **optional), Textures()


def read_measured(file: Path) -> tuple[Description, mi.Texture | None]:
    """Read a material file (.json), as ``pellucid fit`` writes it, and the texture of the reflectance that may lie beside it.

    Raises
    ------
    MediumError
        For a file that is none.
    """
    try:
        values = json.loads(file.read_text(encoding="utf-8", errors="replace"))
        if not isinstance(values, dict):
            raise ValueError("it has no names")
        about = {key: values[key] for key in ("g", "eta", "profile")}
        if "reflectance" not in values:
            given = {key: values[key] for key in COEFFICIENTS}
            return Description.from_medium(Medium(**given, **about, name=file.stem)), None
        picture = {"type": "bitmap", "filename": str(file.with_name(values["reflectance"])), "raw": True}
        texture, dmfp = mi.load_dict(picture), np.asarray(values["dmfp"], float)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError) as error:
        lacks = f"there is no {error}" if isinstance(error, KeyError) else first_cause(str(error)).rstrip(".")
        raise MediumError(
            f"'{file}' is no material file of pellucid fit, which has sigma_a, sigma_s_prime, eta, g and profile: {lacks}."
        ) from error
    return Description({"reflectance": mean_values(texture), "dmfp": dmfp}, **about), texture


def read_color(props: mi.Properties, name: str) -> Array | None:
    """Read an RGB triple however it is written: float, ``<rgb>``, ``<spectrum>``, vector, or ``"r, g, b"``; None if absent."""
    if name not in props:
        return None
    value = props[name]
    if isinstance(value, str):
        value = [float(v) for v in value.replace(",", " ").split()]
    if isinstance(value, mi.Spectrum):  # <spectrum value="0.3"/>: one number for all wavelengths
        texture = props.get_unbounded_texture(name)
        value = texture.eval(dr.zeros(mi.SurfaceInteraction3f)).numpy().ravel()
    array = np.asarray(value, dtype=float).ravel()
    if array.size not in (1, 3):
        raise MediumError(f"{name} was given {array.size} values; give one number, or three for red, green and blue.")
    return np.broadcast_to(array, 3).copy()


def texture_mean(texture: mi.Texture) -> mi.Color3f:
    """Average an RGB texture over the unit square of its coordinates, kept where a medium can be; with its gradients."""
    return mi.Color3f(*(dr.clip(dr.mean(channel), BLACKEST, WHITEST) for channel in _over_unit_square(texture)))


def mean_values(texture: mi.Texture) -> Array:
    """Average a texture as `texture_mean` does: ``(3,) float``."""
    return np.clip(np.mean(np.asarray(dr.detach(_over_unit_square(texture)).numpy()), axis=-1), BLACKEST, WHITEST)


def check_range(texture: mi.Texture) -> None:
    """Refuse a texture that no surface reflects.

    Raises
    ------
    MediumError
        For values outside of 0 to 1.
    """
    values = np.asarray(dr.detach(_over_unit_square(texture)).numpy())
    if np.min(values) < -OUTSIDE or np.max(values) > 1 + OUTSIDE:
        raise MediumError(
            f"The texture of the reflectance has values from {np.min(values):.3g} to {np.max(values):.3g}: a surface reflects a share "
            "between 0 and 1; divide them by the largest, or repair the picture."
        )


def _over_unit_square(texture: mi.Texture, resolution: int = 64) -> mi.Color3f:
    """Evaluate a texture over the unit square."""
    grid = (dr.arange(mi.Float, resolution) + 0.5) / resolution
    si = dr.zeros(mi.SurfaceInteraction3f, resolution * resolution)
    si.uv = mi.Point2f(*dr.meshgrid(grid, grid))
    return mi.Color3f(texture.eval(si))
