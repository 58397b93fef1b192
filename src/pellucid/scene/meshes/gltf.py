"""glTF and GLB made plain for trimesh 5.2, which reads whole numbers that stand for fractions as they are.

What the format allows and trimesh does not read is decoded here (normalised integers, sparse accessors, the second set of
texture coordinates) or refused (compression). Colours and materials keep the precision of the file.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError
from .sources import Beside

COLOR = "_COLOR"
"""The attribute under which trimesh hands COLOR_0 on, untouched: custom attributes begin with an underscore."""

_DTYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FLOAT = 5126
_COMPRESSION = {
    "KHR_draco_mesh_compression": "Draco",
    "EXT_meshopt_compression": "meshopt",
    "KHR_meshopt_compression": "meshopt",
}
_UNDERSTOOD = ("KHR_mesh_quantization", "KHR_texture_transform", "EXT_texture_webp", "KHR_lights_", "KHR_materials_")

Header = dict[str, Any]


class Gltf(NamedTuple):
    """A plain glTF: its header as JSON, the files beside it, and its materials in their order."""

    header: bytes
    beside: Beside
    materials: list[Header]


def plain_gltf(path: Path) -> Gltf:
    """Read a glTF or GLB file and rewrite what trimesh does not understand.

    Raises
    ------
    SceneError
        For a damaged file, a missing buffer, and for an extension that is required and not understood.
    """
    beside = Beside(path)
    header, binary = _read(path)
    _check_extensions(path.name, header)
    buffers = [_buffer(description, binary, beside) for description in header.get("buffers", [])]
    _decode_accessors(header, buffers)
    for mesh in header.get("meshes", []):
        for primitive in mesh["primitives"]:
            _rename_attributes(header, primitive)
    materials = [_metallic_roughness(material) for material in header.get("materials", [])]
    header["materials"] = [material | {"name": str(k)} for k, material in enumerate(materials)]
    beside.memory = {f"buffer {k}": content for k, content in enumerate(buffers)}
    header["buffers"] = [{"uri": name, "byteLength": len(content)} for name, content in beside.memory.items()]
    return Gltf(json.dumps(header).encode(), beside, materials)


def _read(path: Path) -> tuple[Header, bytes | None]:
    """Split a file into its header and, in GLB, its binary part."""
    content = path.read_bytes()
    if path.suffix.lower() == ".gltf":
        return json.loads(content.decode("utf-8-sig")), None
    if content[:4] != b"glTF" or struct.unpack_from("<I", content, 4) != (2,):
        raise SceneError(f"'{path}' is no GLB file of version 2: export it again.")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(content):
        length, kind = struct.unpack_from("<I4s", content, at)
        chunks.setdefault(kind, content[at + 8 : at + 8 + length])
        at += 8 + length
    return json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0")


def _check_extensions(name: str, header: Header) -> None:
    """Refuse what cannot be read without an extension."""
    for extension in header.get("extensionsRequired", []):
        if extension in _COMPRESSION:
            raise SceneError(
                f"'{name}' is compressed with {_COMPRESSION[extension]}, which is not read: undo it with "
                f"'gltf-transform copy {name} plain.glb' (npm install -g @gltf-transform/cli), or export it uncompressed."
            )
        if not extension.startswith(_UNDERSTOOD):
            raise SceneError(f"'{name}' requires the extension {extension}, which is not read: export it without.")


def _buffer(description: Header, binary: bytes | None, beside: Beside) -> bytes:
    """Fetch the content of a buffer, from the file itself, from its header, or from a file beside it."""
    uri = description.get("uri")
    if uri is None:
        if binary is None:
            raise SceneError(f"'{beside.path}' has a buffer without content: export it again.")
        return binary
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return beside.get(uri)


def _decode_accessors(header: Header, buffers: list[bytes]) -> None:
    """Replace accessors of fractions written as integers, and sparse ones, by plain ones in a new buffer."""
    extra = bytearray()
    views = header.setdefault("bufferViews", [])
    for accessor in header.get("accessors", []):
        fractions = accessor.get("normalized", False) and accessor["componentType"] != _FLOAT
        if not fractions and "sparse" not in accessor:
            continue
        values = _values(accessor, views, buffers)
        if "sparse" in accessor:
            values = _filled_in(values, accessor.pop("sparse"), views, buffers)
        if fractions:
            largest = np.iinfo(values.dtype).max
            values = np.maximum(values.astype(np.float32) / largest, -1)
            accessor |= {"componentType": _FLOAT, "normalized": False}
        content = values.tobytes()
        views.append({"buffer": len(buffers), "byteOffset": len(extra), "byteLength": len(content)})
        accessor |= {"bufferView": len(views) - 1, "byteOffset": 0}
        extra += content + bytes(-len(content) % 4)
    if extra:
        buffers.append(bytes(extra))


def _values(accessor: Header, views: list[Header], buffers: list[bytes]) -> NDArray[Any]:
    """Read the values of an accessor: ``(count, width)`` in its own type; zeros without a buffer."""
    dtype, width = np.dtype(_DTYPES[accessor["componentType"]]), _WIDTHS[accessor.get("type", "SCALAR")]
    if "bufferView" not in accessor:
        return np.zeros((accessor["count"], width), dtype)
    view = views[accessor["bufferView"]]
    stride = view.get("byteStride", dtype.itemsize * width)
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    shape, strides = (accessor["count"], width), (stride, dtype.itemsize)
    return np.ndarray(shape, dtype, buffers[view["buffer"]], start, strides).copy()


def _filled_in(values: NDArray[Any], sparse: Header, views: list[Header], buffers: list[bytes]) -> NDArray[Any]:
    """Put the exceptions of a sparse accessor in their places."""
    count, width = sparse["count"], {"type": "SCALAR"}
    index = _values(sparse["indices"] | width | {"count": count}, views, buffers)[:, 0]
    view = views[sparse["values"]["bufferView"]]
    start = view.get("byteOffset", 0) + sparse["values"].get("byteOffset", 0)
    values[index] = np.ndarray((count, values.shape[1]), values.dtype, buffers[view["buffer"]], start)
    return values


def _rename_attributes(header: Header, primitive: Header) -> None:
    """Let trimesh find the texture coordinates of the base colour, and leave the colours of the vertices as they are."""
    attributes = primitive["attributes"]
    if "COLOR_0" in attributes:
        attributes[COLOR] = attributes.pop("COLOR_0")
    if "material" in primitive:
        texture = _metallic_roughness(header["materials"][primitive["material"]])["pbrMetallicRoughness"]
        chosen = texture.get("baseColorTexture", {}).get("texCoord", 0)
        if f"TEXCOORD_{chosen}" in attributes:
            attributes["TEXCOORD_0"] = attributes[f"TEXCOORD_{chosen}"]


def _metallic_roughness(material: Header) -> Header:
    """Describe a material by its base colour, also one in the older way, by its diffuse colour."""
    base = dict(material.get("pbrMetallicRoughness", {}))
    older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    for name, old in (("baseColorFactor", "diffuseFactor"), ("baseColorTexture", "diffuseTexture")):
        if name not in base and old in older:
            base[name] = older[old]
    return material | {"pbrMetallicRoughness": base}
