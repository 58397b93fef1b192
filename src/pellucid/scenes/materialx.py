"""Material files of MaterialX (.mtlx): the subsurface scattering of an OpenPBR or a standard surface as a translucent material."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import MediumError, SceneError, did_you_mean, import_optional, install, warn
from ..model.conventions import medium_of_colour
from ..scene.meshes.looks import linear
from .stage import Spec, rgb

Array = NDArray[np.float64]

SUFFIX = ".mtlx"
RADII = ("mfp", "dmfp")


class Surface(NamedTuple):
    """The inputs of a kind of surface, by what they mean."""

    weight: str
    colour: str
    length: str
    lengths: str
    g: str
    eta: str
    roughness: str
    specular: str
    others: tuple[str, ...]
    """Inputs that make something else of the surface where they are not 0."""


SURFACES = {
    "open_pbr_surface": Surface(
        "subsurface_weight",
        "subsurface_color",
        "subsurface_radius",
        "subsurface_radius_scale",
        "subsurface_scatter_anisotropy",
        "specular_ior",
        "specular_roughness",
        "specular_weight",
        (
            "base_metalness",
            "transmission_weight",
            "coat_weight",
            "fuzz_weight",
            "thin_film_weight",
            "emission_luminance",
        ),
    ),
    "standard_surface": Surface(
        "subsurface",
        "subsurface_color",
        "subsurface_scale",
        "subsurface_radius",
        "subsurface_anisotropy",
        "specular_IOR",
        "specular_roughness",
        "specular",
        ("metalness", "transmission", "coat", "sheen", "thin_film_thickness", "emission"),
    ),
}


def material_of_file(file: Path, name: str = "", radius: str = "mfp", unit: float = 1.0) -> Spec:
    """Read a translucent material of a MaterialX file.

    Parameters
    ----------
    file : Path
    name : str
        Of the material; may be left out where there is one alone.
    radius : {"mfp", "dmfp"}
        What the file's radius is: the mean free path, as the formats define it, or the diffuse mean free path.
    unit : float
        Millimetres to a unit of length in the file, where it names none.

    Returns
    -------
    dict
        For ``mi.load_dict``; coefficients per millimetre.

    Raises
    ------
    SceneError
        For a file that is not there or cannot be read, for one without such a material, and for an input that is no value.
    EnvironmentProblem
        Without the package ``materialx``.
    """
    if radius not in RADII:
        raise SceneError(f"radius = '{radius}': it is mfp, the mean free path, or dmfp, the diffuse one.")
    mx = _library()
    document = _read(mx, file)
    inputs = _Inputs(mx, document, file.name, _shader(mx, document, file, name))
    return _described(inputs, SURFACES[inputs.node.getCategory()], radius, unit)


def file_and_name(material: str) -> tuple[str, str] | None:
    """Split ``file.mtlx`` or ``file.mtlx:name``; None for what is no name of a file."""
    file, suffix, name = material.partition(SUFFIX)
    return (file + suffix, name[1:]) if suffix and name[:1] in ("", ":") else None


def _described(inputs: _Inputs, surface: Surface, radius: str, unit: float) -> Spec:
    """Write a surface as a translucent material."""
    weight = inputs.number(surface.weight)
    if weight == 0:
        raise SceneError(f"{inputs.name}: {surface.weight} is 0, so that nothing of it is translucent: set it to 1.")
    if weight < 1:
        warn(f"{inputs.name}: {surface.weight} {weight:g} is taken for 1, as a body is translucent or it is not.")
    lost = [f"{name} {value:g}" for name in surface.others if (value := inputs.number(name)) > 0]
    if lost:
        warn(f"{inputs.name}: not shown are {', '.join(lost)}.")
    eta, specular = inputs.number(surface.eta), inputs.number(surface.specular)
    lengths = inputs.length(surface.length, unit) * inputs.colour(surface.lengths)
    try:
        medium = medium_of_colour(
            inputs.colour(surface.colour), lengths, eta, inputs.number(surface.g), radius == "dmfp"
        )
    except MediumError as error:
        raise SceneError(f"{inputs.name}: subsurface {error}") from None
    return {
        "type": "pellucid_translucent",
        "sigma_s_prime": rgb(*medium.sigma_s_prime),
        "sigma_a": rgb(*medium.sigma_a),
        "eta": medium.eta,
        "g": medium.g,
        "alpha": inputs.number(surface.roughness) ** 2,
        "specular_reflectance": specular,
    }


def _library() -> Any:
    """Import MaterialX.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    return import_optional(
        "MaterialX", f"Files of MaterialX (.mtlx) need the package materialx: {install('materialx')}."
    )


def _read(mx: Any, file: Path) -> Any:
    """Parse a file, with the definitions of MaterialX beside it, from which the inputs that it leaves out have their values."""
    if not file.is_file():
        raise SceneError(f"There is no material file '{file}': check the path.")
    library, document = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    document.setDataLibrary(library)
    try:
        mx.readFromXmlString(document, file.read_text(errors="replace"), mx.FileSearchPath(str(file.parent)))
    except (mx.ExceptionParseError, mx.ExceptionFileMissing) as error:
        raise SceneError(f"'{file}' cannot be read as MaterialX: {str(error).strip() or 'it is no text'}.") from None
    return document


def _shader(mx: Any, document: Any, file: Path, name: str) -> Any:
    """Find the surface of the material of that name, or of the only one."""
    found = {m.getName(): s for m in document.getMaterialNodes() for s in mx.getShaderNodes(m)}
    found = {key: node for key, node in found.items() if node.getCategory() in SURFACES}
    if not found:
        raise SceneError(f"'{file}' has no material of a surface that is understood: {', '.join(SURFACES)}.")
    if name and name not in found:
        raise SceneError(f"'{file}' has no material '{name}'{did_you_mean(name, found)}: it has {', '.join(found)}.")
    if not name and len(found) > 1:
        raise SceneError(
            f"'{file}' has the materials {', '.join(found)}: write {file}:{next(iter(found))} for one of them."
        )
    return found[name] if name else next(iter(found.values()))


class _Inputs:
    """The values of a surface: linear RGB in the primaries of Rec. 709, and lengths in millimetres."""

    def __init__(self, mx: Any, document: Any, file: str, node: Any):
        self.mx, self.document, self.node = mx, document, node
        kinds = document.getDataLibrary().getMatchingNodeDefs(node.getCategory())
        self.definition = next(kind for kind in kinds if kind.getDefaultVersion())
        self.name = f"'{file}', {node.getCategory()} '{node.getName()}'"

    def number(self, name: str) -> float:
        """Read a number."""
        return float(self._value(name))

    def colour(self, name: str) -> Array:
        """Read a colour in the space that the file says it is in; what is outside of ours is cut off at 0, as in MaterialX."""
        colour = np.array(self._value(name).asTuple())
        given = self.node.getInput(name)
        space = given.getActiveColorSpace() if given is not None else ""
        if space == "srgb_texture":
            return linear(colour)
        if space in ("", "none", "lin_rec709"):
            return colour
        graph = self.document.getDataLibrary().getNodeGraph(f"NG_{space}_to_lin_rec709_color3")
        matrix = graph.getNode("mat") if graph is not None and (space.startswith("lin_") or space == "acescg") else None
        if matrix is None:
            raise SceneError(f"{self.name}: the colour space '{space}' of {name} is not read: give it as lin_rec709.")
        value = matrix.getInputValue("value")
        return np.maximum(colour @ np.array([[value[row, column] for column in range(3)] for row in range(3)]), 0)

    def length(self, name: str, unit: float) -> float:
        """Read a length [mm]."""
        given = self.node.getInput(name)
        named = given.getUnit() if given is not None else ""
        if named:
            kind = self.document.getDataLibrary().getUnitTypeDef("distance")
            unit = self.mx.LinearUnitConverter.create(kind).convert(1.0, named, "millimeter")
        return unit * self.number(name)

    def _value(self, name: str) -> Any:
        """Read the value of an input, or its default.

        Raises
        ------
        SceneError
            For one that is connected to a node.
        """
        given = self.node.getInput(name)
        if given is not None and (given.getConnectedNode() or given.getConnectedOutput()):
            raise SceneError(
                f"{self.name}: {name} comes from another node, and only values are read: bake it to one value."
            )
        return (given if given is not None else self.definition.getActiveInput(name)).getValue()
