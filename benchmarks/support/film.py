"""A short film: a built-in figure that moves, frame by frame, and the file that shows them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import trimesh
from numpy.typing import NDArray

from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scenes.builtin import build
from pellucid.scenes.stage import PictureSettings, Spec, start, studio
from support.images import to_srgb

SIZE, RATE = 60.0, 12  # [mm], frames a second
SPROUT = {"type": "pellucid_translucent", "reflectance": [0.5, 0.78, 0.2], "dmfp": [5.0, 5.0, 2.5], "alpha": 0.25}
"""Green jelly, or the stalk of a plant."""

Rest = tuple[NDArray[np.float64], NDArray[np.int64]]


def character() -> Rest:
    """Vertices [mm] and faces of `longneck` as it stands on the table, striding towards +x."""
    parameters = mi.traverse(build("longneck", size=SIZE)["longneck"])
    vertices = np.array(parameters["vertex_positions"], float).reshape(-1, 3)
    vertices[:, 2] -= vertices[:, 2].min()
    return vertices, np.array(parameters["faces"]).reshape(-1, 3)


def moved(vertices: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Let tail and neck swing, and the head nod: once around while ``time`` goes from 0 to 1. Its feet stay."""
    result = vertices.copy()
    along, turn = vertices[:, 0] / SIZE, 2 * np.pi * time
    free = np.clip((vertices[:, 2] / SIZE - 0.15) / 0.2, 0, 1) * np.abs(along)
    result[:, 1] += 0.28 * SIZE * free * np.sin(turn - 4 * along)
    result[:, 2] += 0.12 * SIZE * np.maximum(along, 0) ** 2 * np.sin(2 * turn)
    return result


def frame(rest: Rest, time: float, resolution: tuple[int, int]) -> Spec:
    """Describe the scene at a time: the lamp of the teapot behind the character, and a camera that goes a little around it."""
    vertices, faces = moved(rest[0], time), rest[1]
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    target = (0.0, 0.0, 0.3 * SIZE)
    angle = 25 * np.sin(2 * np.pi * time)
    scene = start(PictureSettings(resolution, camera_angle=float(angle)), (20, -150, 40), target, 28.0, "x")
    scene["character"] = mesh_from_arrays("character", vertices, faces, normals, bsdf=SPROUT)
    return scene | studio(target, SIZE)


def film(shoot: Callable[[dict[str, Any]], np.ndarray], frames: int, resolution: tuple[int, int], path: Path) -> Path:
    """Render all frames of a turn by ``shoot``, and write them as an animation."""
    from PIL import Image

    rest = character()
    pictures = [Image.fromarray(to_srgb(shoot(frame(rest, k / frames, resolution)))) for k in range(frames)]
    # Every frame by itself: patches that only change where much moves are seen in the noise.
    options = {"duration": round(1000 / RATE), "loop": 0, "quality": 80, "method": 6, "kmax": 1}
    pictures[0].save(path, save_all=True, append_images=pictures[1:], **options)
    return path
