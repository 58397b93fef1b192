"""Scene files of Mitsuba 0.3 to 0.6 with ``<subsurface type="dipole">``, rewritten so that Mitsuba 3 can read them.

Mitsuba 3 renames most parameters of such files by itself. What it refuses is rewritten here: elements it does not know,
and each dipole, which becomes a `pellucid_translucent` of the same medium in place of the BSDF beside it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..errors import SceneError
from ..scene.meshes.looks import linear
from .older_dipole import PRESET_FACTOR, Dipole, dipole_medium, surface_of, try_numbers

RENAMED = {"lookAt": "lookat", "luminaire": "emitter", "camera": "sensor"}
SUBSTITUTES = {
    "film": {"ldrfilm": "hdrfilm", "tiledhdrfilm": "hdrfilm", "mfilm": "hdrfilm"},
    "sampler": {"halton": "independent", "hammersley": "independent", "sobol": "independent"},
}
WITHOUT_COUNTERPART = {"emitter": ("sky", "sun"), "sampler": (), "film": ()}
DEPTHS = {"maxDepth": "max_depth", "rrDepth": "rr_depth", "hideEmitters": "hide_emitters"}
TWO_PASS = "pellucid_two_pass"


class Older(NamedTuple):
    """A scene file that has been rewritten: its text, what was converted, and what has no counterpart."""

    text: str
    converted: list[str]
    lost: list[str]


def is_older(path: Path, parameters: Mapping[str, str]) -> bool:
    """Tell whether a scene file has to be rewritten: whether it, or a file that it includes, has a subsurface model.

    Of a file that cannot be read the answer is no, and whoever reads it next says what is wrong with it.
    """
    try:
        root = _parse(path)
        if root.find(".//subsurface") is None:
            names = _names(root, parameters)
            _resolve(root, names)
            _include(root, path.parent, names)
    except SceneError:
        return False
    return root.find(".//subsurface") is not None


def rewritten(path: Path, parameters: Mapping[str, str]) -> Older:
    """Rewrite a scene file.

    Parameters
    ----------
    path : Path
        The file; files that it includes are read from its folder.
    parameters : dict
        Values for the ``$names``, before those that the file has itself.

    Raises
    ------
    SceneError
        For a file that is no XML, a parameter that it does not have, and a subsurface model other than the dipole.
    """
    root = _parse(path)
    names = _names(root, parameters)
    _check_parameters(path, parameters)
    _resolve(root, names)
    _include(root, path.parent, names)
    converted: list[str] = []
    lost: list[str] = []
    _rename(root, converted, lost)
    settings = _convert_dipoles(path.name, root, converted, lost)
    _convert_integrator(root, settings, converted, lost)
    root.set("version", root.get("version", "0.6.0"))
    return Older(ElementTree.tostring(root, encoding="unicode"), converted, lost)


def _parse(path: Path) -> Element:
    """Parse an XML file."""
    try:
        return ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise SceneError(f"'{path}' is no XML file: {error}.") from error
    except OSError as error:
        raise SceneError(f"'{path}' cannot be read: {error.strerror}.") from error


def _check_parameters(path: Path, parameters: Mapping[str, str]) -> None:
    """Refuse values for names that the file does not have."""
    text = path.read_text(errors="replace")
    for name in parameters:
        if not re.search(rf"\$\{{?{re.escape(name)}\b", text):
            raise SceneError(f"-D {name}: '{path}' has no ${name} to set.")


def _names(root: Element, given: Mapping[str, str]) -> dict[str, str]:
    """Collect the values of the ``$names`` of a file: those given, and its own for the others."""
    return {e.get("name", ""): e.get("value", "") for e in root.iter("default")} | dict(given)


def _resolve(root: Element, names: Mapping[str, str]) -> None:
    """Put in the values of the ``$names``."""
    for element in root.iter():
        for key, text in element.attrib.items():
            if "$" in text:
                element.set(key, re.sub(r"\$\{?(\w+)\}?", lambda m: names.get(m[1], m[0]), text))
    for default in root.findall("default"):
        root.remove(default)


def _include(root: Element, folder: Path, names: Mapping[str, str], depth: int = 15) -> None:
    """Put the contents of included files in their place."""
    for parent in list(root.iter()):
        for place, element in reversed(list(enumerate(parent))):
            if element.tag != "include":
                continue
            if not depth:
                raise SceneError(f"'{element.get('filename')}' includes itself, or files are included too deep.")
            included = _parse(folder / element.get("filename", ""))
            _resolve(included, _names(included, names))
            _include(included, folder, names, depth - 1)
            parent[place : place + 1] = list(included)


def _rename(root: Element, converted: list[str], lost: list[str]) -> None:
    """Rename elements and plug-ins that Mitsuba 3 does not know, and drop those that it has nothing for."""
    for parent in list(root.iter()):
        for element in list(parent):
            element.tag = RENAMED.get(element.tag, element.tag)
            if element.tag in ("rgb", "srgb"):
                _colour(element)
            kind = element.get("type", "")
            if kind in WITHOUT_COUNTERPART.get(element.tag, ()):
                lost.append(f"the {element.tag} '{kind}'")
                parent.remove(element)
            elif kind in SUBSTITUTES.get(element.tag, {}):
                element.set("type", SUBSTITUTES[element.tag][kind])
                converted.append(f"the {element.tag} '{kind}' became '{element.get('type')}'")
            elif element.tag == "spectrum" and re.fullmatch(
                r"\s*[^:\s,]+([\s,]+[^:\s,]+){2}\s*", element.get("value", "")
            ):
                element.tag = "rgb"
            elif element.tag == "blackbody":
                _blackbody(element)
            elif element.tag == "texture" and kind == "vertexcolors":
                element.set("type", "mesh_attribute")
                SubElement(element, "string", name="name", value="vertex_color")


def _colour(element: Element) -> None:
    """Write a colour as Mitsuba 3 reads it: linear, in decimals, without what it was meant for (``intent``)."""
    element.attrib.pop("intent", None)
    if (numbers := try_numbers(element)) is not None:
        element.set("value", _text(linear(numbers) if element.tag == "srgb" else numbers))
    element.tag = "rgb"


def _text(values: Iterable[float]) -> str:
    """Write numbers as the value of an element."""
    return ", ".join(f"{value:.9g}" for value in values)


def _blackbody(element: Element) -> None:
    """Write a blackbody as the spectrum plug-in that it is today."""
    kelvin = element.attrib.pop("temperature", "5000").rstrip("kK ")
    element.tag = "spectrum"
    element.set("type", "blackbody")
    SubElement(element, "float", name="temperature", value=kelvin)
    if "scale" in element.attrib:
        SubElement(element, "float", name="scale", value=element.attrib.pop("scale"))


# ---------------------------------------------------------------------- media


def _convert_dipoles(file: str, root: Element, converted: list[str], lost: list[str]) -> dict[str, float]:
    """Give each shape with a dipole the translucent material of the same medium; return the most exact of their settings."""
    by_id = {element.get("id", ""): element for element in root.iter() if element.get("id") and element.tag != "ref"}
    count, presets = 0, False
    settings: dict[str, float] = {}
    for shape in list(root.iter("shape")):
        models = list(_subsurfaces(shape, by_id))
        if len(models) > 1:
            raise SceneError(f"'{file}': a shape has {len(models)} subsurface models; keep one.")
        for place, subsurface, body in models:
            medium = dipole_medium(file, subsurface)
            lost += medium.lost
            for name, value in medium.settings.items():
                more_exact = min if name == "max_error" else max
                settings[name] = more_exact(value, settings.get(name, value))
            presets |= bool(medium.material)
            shape.remove(place)
            beside, bsdf = _bsdf(shape, by_id)
            surface = surface_of(bsdf, medium.eta)
            lost += surface.lost
            if beside is not None:
                shape.remove(beside)
            shape.append(_translucent(medium, surface.values, body))
            count += 1
    for parent in list(root.iter()):
        for element in parent.findall("subsurface"):
            parent.remove(element)
    of_presets = f", measured materials times {PRESET_FACTOR:g} as there" if presets else ""
    converted.insert(0, f"{count} shape{'s' * (count != 1)} with a dipole became pellucid_translucent{of_presets}")
    return settings


def _subsurfaces(shape: Element, by_id: Mapping[str, Element]) -> Iterator[tuple[Element, Element, str]]:
    """Find the subsurface model of a shape, its own or one it refers to: its place, itself, and the name of the body.

    Shapes that refer to one model form one solid in Mitsuba 0.6.
    """
    for child in list(shape):
        if child.tag == "subsurface":
            yield child, child, ""
        elif (
            child.tag == "ref" and (target := by_id.get(child.get("id", ""))) is not None and target.tag == "subsurface"
        ):
            yield child, target, child.get("id", "")


def _bsdf(shape: Element, by_id: Mapping[str, Element]) -> tuple[Element | None, Element | None]:
    """Find the BSDF of a shape, its own or one it refers to: its place, and itself."""
    for child in shape:
        target = by_id.get(child.get("id", "")) if child.tag == "ref" else child
        if target is not None and target.tag == "bsdf":
            return child, target
    return None, None


def _translucent(medium: Dipole, surface: Mapping[str, float], body: str) -> Element:
    """Describe a translucent material."""
    bsdf = Element("bsdf", type="pellucid_translucent")
    if medium.material:
        SubElement(bsdf, "string", name="material", value=medium.material)
    else:
        for name, values in (("sigma_s_prime", medium.sigma_s_prime), ("sigma_a", medium.sigma_a)):
            SubElement(bsdf, "rgb", name=name, value=_text(values))
    numbers = {"eta": medium.eta, "g": medium.g, "scale": medium.scale} | dict(surface)
    for name, value in numbers.items():
        if value is not None:
            SubElement(bsdf, "float", name=name, value=f"{value:.9g}")
    if body:
        SubElement(bsdf, "string", name="body", value=body)
    return bsdf


def _convert_integrator(root: Element, settings: Mapping[str, float], converted: list[str], lost: list[str]) -> None:
    """Let the scene be rendered by a method of ours, with the depths of the integrator that it had."""
    found = root.find("integrator")
    if found is not None and found.get("type", "").startswith("pellucid_"):
        lost += [f"{name} {value:g} beside the integrator of the file" for name, value in settings.items()]
        return
    ours = Element("integrator", type=TWO_PASS)
    for name, value in settings.items():
        real = name == "max_error"
        SubElement(ours, "float" if real else "integer", name=name, value=f"{value:.9g}" if real else f"{value:.0f}")
    was = "none"
    if found is not None:
        was = f"'{found.get('type')}'"
        for child in found:
            name = child.get("name", "")
            if name in DEPTHS or name in DEPTHS.values():
                SubElement(ours, child.tag, name=DEPTHS.get(name, name), value=child.get("value", ""))
            else:
                lost.append(f"{name or child.tag} of the integrator")
        root.remove(found)
    root.insert(0, ours)
    taken = "".join(f", {name} {value:.9g}" for name, value in settings.items())
    converted.append(f"the integrator is {TWO_PASS}{taken} (was {was})")
