"""The present state as a scene file of Mitsuba, with its meshes and pictures beside it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import OutputError, SceneError
from ..realtime.source import BodyState, Camera, FrameSource, Light
from ..scene.bodies import translucent_bsdf
from ..scene.meshes.buffers import recorded_materials
from ..scenes.loading import scene_dict
from ..scenes.scene_file import parse_scene_file

SCENE_FILE = "scene.xml"
STRENGTH = {"point": "intensity", "spot": "intensity", "directional": "irradiance", "area": "radiance"}
MEDIUM = ("material", "sigma_a", "sigma_s_prime", "reflectance", "dmfp", "eta", "g", "profile", "scale")

Spec = dict[str, Any]
Materials = list[tuple[Any, Spec]]


@dataclass
class Origin:
    """Where a scene came from: the arguments of `load_scene`."""

    source: str | Path | Spec
    parameters: dict[str, str] = field(default_factory=dict)
    options: Spec = field(default_factory=dict)

    @property
    def is_file(self) -> bool:
        """Tell whether it is a scene file of Mitsuba."""
        return not isinstance(self.source, dict) and Path(self.source).suffix.lower() == ".xml"


class SceneWriter:
    """Writes a scene as it is now: what has changed since it was loaded, and a camera, go into its description."""

    def __init__(self, origin: Origin, source: FrameSource):
        self.origin, self.source = origin, source
        self.lights: list[Light] = list(source.lights)
        self.bodies: list[BodyState] = list(source.bodies)

    def write(self, folder: Path, camera: Camera, resolution: tuple[int, int]) -> Path:
        """Write ``folder/scene.xml`` and the files it needs. The folder is new: it appears complete or not at all.

        Raises
        ------
        OutputError
            When it cannot be written.
        SceneError
            For scenes with parts that were made by a program and have no description.
        """
        try:
            with _beside(folder) as unfinished:
                state = self._parse(unfinished)
                self._update_camera(state, camera, resolution)
                self._update_lights(state)
                self._update_media(state)
                mi.parser.write_file(state, str(unfinished / SCENE_FILE))
        except OSError as error:
            raise OutputError(f"'{folder}' could not be written: {error.strerror or error}.") from error
        return folder / SCENE_FILE

    # ------------------------------------------------------------------ the description

    def _parse(self, folder: Path) -> Any:
        """Describe the scene as it was loaded; meshes and pictures go into the folder."""
        config = mi.parser.ParserConfig(mi.variant())
        if self.origin.is_file:
            state = parse_scene_file(Path(str(self.origin.source)), self.origin.parameters).state
            mi.parser.transform_resolve_references(config, state)
            _gather_files(state, Path(str(self.origin.source)).resolve().parent, folder)
            return state
        if isinstance(self.origin.source, dict):
            return _parse_dictionary(self.origin.source, [], folder)
        with recorded_materials() as materials:
            spec = scene_dict(self.origin.source, **self.origin.options)
        return _parse_dictionary(spec, materials, folder)

    # ------------------------------------------------------------------ what has changed

    def _update_camera(self, state: Any, camera: Camera, resolution: tuple[int, int]) -> None:
        """Put the camera where the looker-on is."""
        sensor = next(node for node in state.nodes if node.type == mi.ObjectType.Sensor)
        origin, target, up = (np.asarray(v, float).tolist() for v in (camera.origin, camera.target, camera.up))
        sensor.props["to_world"] = mi.ScalarTransform4f().look_at(origin, target, up)
        sensor.props["fov"], sensor.props["fov_axis"] = float(camera.fov), "y"
        if "focal_length" in sensor.props:
            del sensor.props["focal_length"]
        for film in (state.nodes[i] for i in _children(sensor)):
            if film.type == mi.ObjectType.Film:  # without one Mitsuba has a film of its own
                film.props["width"], film.props["height"] = resolution

    def _update_lights(self, state: Any) -> None:
        """Write the lights that have changed; they come in the order of the scene's children, as Mitsuba collects them."""
        places = list(_emitters(state))
        if len(places) != len(self.lights):
            raise SceneError(
                f"The scene describes {len(places)} lights, but has {len(self.lights)}: it cannot be saved."
            )
        for (emitter, shape), before, now in zip(places, self.lights, self.source.lights, strict=True):
            strength, earlier = now.colour * now.intensity, before.colour * before.intensity
            if not np.allclose(strength, earlier, rtol=1e-6):
                _brighten(emitter, now, strength / np.maximum(earlier, 1e-30))
            if not (_equal(before.position, now.position) and _equal(before.direction, now.direction)):
                _place(emitter if shape is None else shape, before, now)

    def _update_media(self, state: Any) -> None:
        """Write the media that have changed, as coefficients [1/mm], and the scale that their size stands for."""
        pairs = list(zip(self.bodies, self.source.bodies, strict=True))
        new_medium = any(before.medium != now.medium for before, now in pairs)
        if not new_medium and all(np.isclose(before.size_mm, now.size_mm, rtol=1e-6) for before, now in pairs):
            return
        for described, shape in zip(_top_shapes(state), self.source.scene.shapes(), strict=True):
            bsdf = translucent_bsdf(shape)
            if bsdf is None:
                continue
            node = _translucent_node(state, described)
            if new_medium:
                _describe_medium(node, bsdf)
            node.props["scale"] = float(bsdf.scale)


def write_dictionary(spec: Spec, materials: Materials, folder: Path) -> Path:
    """Write a scene dictionary as ``folder/scene.xml`` with its meshes and pictures; the folder is new.

    Parameters
    ----------
    materials : list of (mi.Mesh, dict)
        Of the meshes in the dictionary, in place of their own.

    Raises
    ------
    OutputError, SceneError
        As `SceneWriter.write`.
    """
    try:
        with _beside(folder) as unfinished:
            mi.parser.write_file(_parse_dictionary(spec, materials, unfinished), str(unfinished / SCENE_FILE))
    except OSError as error:
        raise OutputError(f"'{folder}' could not be written: {error.strerror or error}.") from error
    return folder / SCENE_FILE


def _parse_dictionary(spec: Spec, materials: Materials, folder: Path) -> Any:
    """Describe a scene dictionary; meshes and pictures go into the folder."""
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_dict(config, _plain(spec, folder, materials))
    for node in state.nodes:  # Mitsuba does not know what plug-ins written in Python are
        if node.type == mi.ObjectType.Unknown:
            is_bsdf = node.props.plugin_name() == "pellucid_translucent"
            node.type = mi.ObjectType.BSDF if is_bsdf else mi.ObjectType.Integrator
    mi.parser.transform_resolve_references(config, state)
    return state


# ---------------------------------------------------------------------- files


@contextmanager
def _beside(folder: Path) -> Iterator[Path]:
    """Give a folder beside the one that is wanted, and let it take its place when all went well."""
    if folder.exists():
        raise OutputError(f"'{folder}' is there already: choose another name.")
    unfinished = Path(tempfile.mkdtemp(prefix=".pellucid-", dir=folder.parent))
    try:
        yield unfinished
        unfinished.chmod(0o755)
        os.rename(unfinished, folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def free_name(folder: Path) -> Path:
    """Find a folder that is not there yet: itself, or with the first free number."""
    number, free = 1, folder
    while free.exists():
        number += 1
        free = folder.with_name(f"{folder.name}_{number}")
    return free


def _gather_files(state: Any, home: Path, folder: Path) -> None:
    """Copy the files that a description names into a folder, and name them there."""
    for number, node in enumerate(state.nodes):
        name = node.props.get("filename", None)
        if not isinstance(name, str):
            continue
        found = next((path for path in (home / name, Path(name)) if path.is_file()), None)
        if found is not None:
            copy = f"{number}_{found.name}"
            shutil.copyfile(found, folder / copy)
            node.props["filename"] = copy


def _plain(value: Any, folder: Path, materials: Materials) -> Any:
    """Turn what a scene dictionary holds as objects into descriptions; meshes and pictures become files."""
    if isinstance(value, mi.Mesh):
        material = next((bsdf for mesh, bsdf in materials if mesh is value), None)
        name = f"{len(list(folder.glob('*.ply')))}.ply"
        value.write_ply(str(folder / name))
        return {"type": "ply", "filename": name, "bsdf": _plain(material or value.bsdf(), folder, materials)}
    if isinstance(value, mi.Bitmap):
        raise TypeError("a picture is written by the texture that it belongs to")
    if isinstance(value, mi.BSDF):
        if hasattr(value, "medium") and value.texture is None:
            return _described(value)
        raise SceneError(
            f"The scene cannot be saved: one of its materials was made by a program ({value.class_name()})."
        )
    if isinstance(value, dict):
        value = dict(value)
        if isinstance(value.get("bitmap"), mi.Bitmap):
            name = f"{len(list(folder.glob('*.exr')))}.exr"
            value.pop("bitmap").write(str(folder / name))
            value["filename"] = name
        return {key: _plain(item, folder, materials) for key, item in value.items()}
    return value


def _described(bsdf: Any) -> Spec:
    """Describe a translucent material."""
    medium = bsdf.medium.scaled(1 / bsdf.scale)
    colours = {name: {"type": "rgb", "value": list(getattr(medium, name))} for name in ("sigma_s_prime", "sigma_a")}
    numbers = {"eta": medium.eta, "g": medium.g, "scale": bsdf.scale, "alpha": bsdf.alpha}
    texts = {"profile": medium.profile} | ({"body": bsdf.body} if bsdf.body else {})
    switches = {"specular_reflectance": bsdf.specular, "single_scattering": bsdf.single_scattering}
    return {"type": "pellucid_translucent", **colours, **numbers, **texts, **switches}


# ---------------------------------------------------------------------- nodes


def _children(node: Any) -> list[int]:
    """List the numbers of the nodes that a node refers to."""
    values = (value for _, value in node.props.items())
    return [value.index() for value in values if isinstance(value, mi.Properties.ResolvedReference)]


def _top_shapes(state: Any) -> list[Any]:
    """List the shapes of a scene that can be hit."""
    children = [state.nodes[i] for i in _children(state.root)]
    return [node for node in children if node.type == mi.ObjectType.Shape and node.props.plugin_name() != "shapegroup"]


def _emitters(state: Any) -> Iterator[tuple[Any, Any]]:
    """List the emitters of a scene in Mitsuba's order, with the shape of those that have one."""
    for i in _children(state.root):
        node = state.nodes[i]
        if node.type == mi.ObjectType.Emitter:
            yield node, None
        elif node.type == mi.ObjectType.Shape:
            for j in _children(node):
                if state.nodes[j].type == mi.ObjectType.Emitter:
                    yield state.nodes[j], node


def _translucent_node(state: Any, node: Any) -> Any:
    """Find the description of the translucent material below a shape."""
    waiting = _children(node)
    while waiting:
        child = state.nodes[waiting.pop(0)]
        if child.props.plugin_name() == "pellucid_translucent":
            return child
        waiting += _children(child)
    raise SceneError("The scene cannot be saved: a translucent material in it has no description.")


def _describe_medium(node: Any, bsdf: Any) -> None:
    """Write a medium into the description of a material, as coefficients [1/mm]."""
    medium = bsdf.medium.scaled(1 / bsdf.scale)
    for name in MEDIUM:
        if name in node.props:
            del node.props[name]
    node.props["sigma_s_prime"] = mi.ScalarColor3f(*medium.sigma_s_prime)
    node.props["sigma_a"] = mi.ScalarColor3f(*medium.sigma_a)
    node.props["eta"], node.props["g"], node.props["profile"] = medium.eta, medium.g, medium.profile


def _equal(before: Any, now: Any) -> bool:
    """Compare two vectors; what a light does not have, it has not changed."""
    return now is None or np.allclose(before, now)


def _brighten(emitter: Any, light: Light, factor: np.ndarray) -> None:
    """Write how bright a light is: as a colour, or for a picture of the sky as its ``scale``."""
    name = "radiance" if emitter.props.plugin_name() == "constant" else STRENGTH.get(light.kind)
    if name is None:
        before = float(emitter.props["scale"]) if "scale" in emitter.props else 1.0
        emitter.props["scale"] = before * float(np.max(factor))
        return
    emitter.props[name] = mi.ScalarColor3f(*(light.colour * light.intensity))


def _place(node: Any, before: Light, now: Light) -> None:
    """Write where a light stands and along what it shines; the shape of an area light is moved with it."""
    if now.kind == "point":
        assert now.position is not None
        node.props["position"] = mi.ScalarPoint3f(*now.position)
        return
    if now.kind == "area":
        assert now.position is not None and before.position is not None
        matrix = np.array(node.props["to_world"].matrix, float).reshape(4, 4) if "to_world" in node.props else np.eye(4)
        matrix[:3, 3] += now.position - before.position
        node.props["to_world"] = mi.ScalarTransform4f(matrix.tolist())
        return
    origin = np.zeros(3) if now.position is None else now.position
    assert now.direction is not None
    up = np.eye(3)[int(np.argmin(np.abs(now.direction)))]
    if "direction" in node.props:
        del node.props["direction"]
    target = origin + now.direction
    node.props["to_world"] = mi.ScalarTransform4f().look_at(origin.tolist(), target.tolist(), up.tolist())
