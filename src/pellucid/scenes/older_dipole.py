"""The dipole of Mitsuba 0.3 to 0.6, and the BSDF beside it, as a translucent material describes them."""

from __future__ import annotations

import re
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, did_you_mean
from ..model.medium import Medium

Array = NDArray[np.float64]

# Mitsuba's table of indices of refraction by name, at 589 nm (Hecht, Optics).
INDICES = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water": 1.333,
    "acetone": 1.36,
    "ethanol": 1.361,
    "carbon tetrachloride": 1.461,
    "glycerol": 1.4729,
    "benzene": 1.501,
    "silicone oil": 1.52045,
    "bromine": 1.661,
    "water ice": 1.31,
    "fused quartz": 1.458,
    "pyrex": 1.47,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "bk7": 1.5046,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.575,
    "diamond": 2.419,
}
DEFAULT_MATERIAL = "skin1"
PRESET_FACTOR = 100.0
"""By which Mitsuba 0.6 multiplies the coefficients of its measured materials: as if a scene unit were 100 mm."""
INSIDE, OUTSIDE, PLASTIC = "bk7", "air", "polypropylene"
SCALES = ("scale", "densityMultiplier", "sizeMultiplier")
MEDIUM = {"material", "sigmaS", "sigmaA", "sigmaT", "albedo", "g", "intIOR", "extIOR", *SCALES}
SETTINGS = {"irrSamples": "irradiance_paths", "quality": "max_error", "irrIndirect": ""}
DIRECT = 2
"""The depth of paths that bring light straight from an emitter to a sample."""
SURFACES = ("plastic", "roughplastic", "dielectric", "roughdielectric")
ROUGHNESS = 0.1


class Dipole(NamedTuple):
    """A medium: a measured ``material``, or coefficients [1/mm]; None or empty where the material says it.

    ``settings`` are parameters of `pellucid_two_pass` that the file has with the medium.
    """

    material: str
    sigma_s_prime: Array
    sigma_a: Array
    g: float | None
    eta: float | None
    scale: float
    settings: dict[str, float]
    lost: list[str]


class Reflecting(NamedTuple):
    """What a surface reflects, as parameters of the translucent material, and what of it has no counterpart."""

    values: dict[str, float]
    lost: list[str]


def dipole_medium(file: str, subsurface: Element) -> Dipole:
    """Read the medium of a dipole.

    Its coefficients are per scene unit once they are multiplied by its scale. Ours are per millimetre, with the
    millimetres of a scene unit: the same two numbers, as only their product matters. The measured materials, per millimetre
    here, Mitsuba 0.6 multiplies by 100 besides, although its manual does not say so: scenes were made to look right with it.

    Raises
    ------
    SceneError
        For another model than the dipole, a medium described twice, and values that are no numbers.
    """
    kind = subsurface.get("type")
    if kind != "dipole":
        raise SceneError(f"'{file}': the subsurface model '{kind}' is not known here, only 'dipole' is: replace it.")
    values = {child.get("name", ""): child for child in subsurface}
    by_sum = {"sigmaS", "sigmaA"} & set(values)
    by_albedo = {"sigmaT", "albedo"} & set(values)
    if bool(by_sum) + bool(by_albedo) + ("material" in values) > 1:
        raise SceneError(f"'{file}': a dipole has its medium described twice; keep one of {', '.join(values)}.")
    name = values["material"].get("value", "").lower() if "material" in values else DEFAULT_MATERIAL
    preset = Medium.from_preset(name)
    g = _numbers(file, values["g"]) if "g" in values else np.zeros(3)
    sigma_s, sigma_a = PRESET_FACTOR * preset.sigma_s_prime, PRESET_FACTOR * preset.sigma_a
    if by_sum:
        sigma_s = _numbers(file, values["sigmaS"]) if "sigmaS" in values else sigma_s
        sigma_a = _numbers(file, values["sigmaA"]) if "sigmaA" in values else sigma_a
    elif by_albedo:
        sigma_t = _numbers(file, values["sigmaT"]) if "sigmaT" in values else PRESET_FACTOR * preset.sigma_t_prime
        albedo = _numbers(file, values["albedo"]) if "albedo" in values else preset.albedo_prime
        sigma_s, sigma_a = albedo * sigma_t, (1 - albedo) * sigma_t
    scale = [float(_numbers(file, values[key])[0]) for key in SCALES if key in values]
    plain = not (by_sum or by_albedo or g.any())
    return Dipole(
        name if plain else "",
        sigma_s * (1 - g),
        sigma_a,
        float(g.mean()) if g.any() else None,
        _index(file, values, INSIDE) or (None if plain else preset.eta),
        (PRESET_FACTOR if plain else 1.0) * (scale[0] if scale else 1.0),
        _settings(file, values),
        [f"{key} of the dipole" for key in values if key and key not in MEDIUM and key not in SETTINGS],
    )


def _settings(file: str, values: dict[str, Element]) -> dict[str, float]:
    """Read how exactly light is gathered: paths to a sample, solid angle of a cluster, and whether light is indirect."""
    found = {ours: float(_numbers(file, values[key])[0]) for key, ours in SETTINGS.items() if key in values and ours}
    if "irrIndirect" in values and values["irrIndirect"].get("value", "").lower() == "false":
        found["irradiance_depth"] = DIRECT
    return found


def surface_of(bsdf: Element | None, eta: float | None) -> Reflecting:
    """Read what the BSDF beside a dipole reflects; without one, or with one of another kind, there is no reflection."""
    nested = [] if bsdf is None else [element for element in bsdf.iter("bsdf") if element.get("type") in SURFACES]
    if bsdf is None or not nested:
        return Reflecting({"specular_reflectance": 0.0}, [] if bsdf is None else [f"the BSDF '{bsdf.get('type')}'"])
    kind = nested[0].get("type", "")
    values = {child.get("name", ""): child for child in nested[0]}
    lost = [
        f"'{element.get('type')}' around {kind}" for element in bsdf.iter("bsdf") if element.get("type") not in SURFACES
    ]
    found = {"alpha": ROUGHNESS if kind.startswith("rough") else 0.0}
    for name, ours in (("alpha", "alpha"), ("specularReflectance", "specular_reflectance")):
        if name in values and (number := try_numbers(values[name])) is not None:
            found[ours] = float(number.mean())
        elif name in values:
            lost.append(f"the texture of {name} of {kind}")
    diffuse = values.get("diffuseReflectance")
    if diffuse is not None and ((number := try_numbers(diffuse)) is None or number.any()):
        lost.append(f"diffuseReflectance of {kind}")
    own = _index("", values, PLASTIC)
    if own is not None and eta is not None and abs(own - eta) > 1e-3:
        lost.append(f"the index of {kind}, {own:.4g} (the dipole has {eta:.4g})")
    return Reflecting(found, lost)


def _index(file: str, values: dict[str, Element], inside: str) -> float | None:
    """Read the index of the inside over the outside, numbers or names; None where neither is given."""
    if "intIOR" not in values and "extIOR" not in values:
        return None
    pair = []
    for key, default in (("intIOR", inside), ("extIOR", OUTSIDE)):
        text = values[key].get("value", "").strip() if key in values else default
        try:
            pair.append(float(text))
        except ValueError:
            if text.lower() not in INDICES:
                hint = did_you_mean(text.lower(), INDICES)
                raise SceneError(f"'{file}': {key} = '{text}' is no number and no known substance{hint}.") from None
            pair.append(INDICES[text.lower()])
        if not 0 < pair[-1] < np.inf:
            raise SceneError(f"'{file}': {key} = {text}: an index of refraction is a positive number, 1 for a vacuum.")
    return pair[0] / pair[1]


def _numbers(file: str, element: Element) -> Array:
    """Read a colour or a number, for three channels."""
    found = try_numbers(element)
    if found is None:
        raise SceneError(
            f"'{file}': {element.get('name')} = '{element.get('value', element.get('type'))}' is neither one number nor "
            "three for red, green and blue."
        )
    return found


def try_numbers(element: Element) -> Array | None:
    """Read one number, three, or a colour in hexadecimal digits; None for anything else."""
    text = element.get("value", "")
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text.strip()):
        return np.array([int(text.strip()[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    try:
        numbers = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError:
        return None
    return np.resize(numbers, 3) if numbers.size in (1, 3) and "type" not in element.attrib else None
