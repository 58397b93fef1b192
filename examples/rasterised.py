"""Shade a rasterised picture: OpenGL finds the point that each pixel shows, pellucid the light that leaves there.

python examples/rasterised.py head.png

Needs ``pip install moderngl`` and OpenGL without a window, which Mesa has for machines without a graphics card (``libegl1``).
"""

import sys

import moderngl
import numpy as np

import pellucid

import mitsuba as mi  # isort: skip  (after pellucid, which chooses the LLVM)

VERTEX = """#version 330
uniform mat4 camera; in vec3 p; in vec3 n; out vec3 point, normal;
void main() { point = p; normal = n; gl_Position = camera * vec4(p, 1); }"""

FRAGMENT = """#version 330
in vec3 point, normal; layout(location = 0) out vec4 at; layout(location = 1) out vec4 facing;
void main() { at = vec4(point, 1); facing = vec4(normalize(normal), 0); }"""


def camera_matrix(origin, target, fov: float, near: float, far: float) -> np.ndarray:
    """From the world, where z is up, to the clip space of OpenGL; ``fov`` in degrees."""
    back = (origin - target) / np.linalg.norm(origin - target)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(back, right), back
    view[:3, 3] = -view[:3, :3] @ origin
    f = 1 / np.tan(np.radians(fov) / 2)
    depth = [(far + near) / (near - far), 2 * far * near / (near - far)]
    return np.array([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, *depth], [0, 0, -1, 0]]) @ view


def rasterise(mesh, camera, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The point that each pixel shows, with a 1 where there is one: ``(side, side, 4)``; and its normal: ``(side, side, 3)``."""
    gl = moderngl.create_context(standalone=True, backend="egl")
    program = gl.program(VERTEX, FRAGMENT)
    program["camera"].write(camera.T.astype("f4").tobytes())
    parameters = mi.traverse(mesh)
    p, n = (gl.buffer(np.array(parameters[f"vertex_{key}"], "f4")) for key in ("positions", "normals"))
    faces = gl.buffer(np.array(parameters["faces"], "u4"))
    targets = [gl.texture((side, side), 4, dtype="f4") for _ in range(2)]
    gl.framebuffer(targets, gl.depth_renderbuffer((side, side))).use()
    gl.clear()
    gl.enable(moderngl.DEPTH_TEST)
    gl.vertex_array(program, [(p, "3f", "p"), (n, "3f", "n")], faces).render()
    at, facing = (np.frombuffer(t.read(), "f4").reshape(side, side, -1)[::-1] for t in targets)
    gl.release()
    return at, facing[..., :3]


def main(output: str, side: int = 1024) -> None:
    mi.set_variant("llvm_ad_rgb")
    scene = pellucid.load_scene("antique_head", light_angle=75.0)
    marble = pellucid.prepare(scene)
    mesh = next(shape for shape in scene.shapes() if shape.id() == "antique_head")
    camera = camera_matrix(np.array([19.0, -27.0, 4.6]), np.zeros(3), 20.0, 10.0, 60.0)
    at, facing = rasterise(mesh, camera, side)
    shown = at[..., 3] > 0
    picture = np.zeros((side, side, 3))
    picture[shown] = marble.exitance(at[shown, :3], normals=facing[shown]) / np.pi  # the same in all directions
    picture = picture.reshape(side // 2, 2, side // 2, 2, 3).mean(axis=(1, 3))
    mi.util.write_bitmap(output, mi.Bitmap(picture.astype(np.float32)), write_async=False)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "head.png")
