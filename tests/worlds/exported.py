"""A small model, its exported page, and how to talk with the page in a browser."""

import mitsuba as mi
import numpy as np
import trimesh

from pellucid.scene.meshes.buffers import mesh_from_arrays

SAMPLES = 256
SIDE = 64


def bumpy(subdivisions=3):
    """A ball with bumps, about 20 mm large, that shades itself: vertices, normals, faces."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    radius = 8 + 3 * np.sin(4 * x) * np.cos(3 * y + 1) + 2 * np.sin(5 * z + x)
    mesh.vertices = mesh.vertices * radius[:, None]
    return np.array(mesh.vertices), np.array(mesh.vertex_normals), np.array(mesh.faces)


def model_scene(mesh=None, material=None, light=None, shapes=(), colours=None, uv=None):
    """A body under a lamp, before a camera that sees it from the side."""
    vertices, normals, faces = mesh or bumpy()
    bsdf = {"type": "pellucid_translucent", "alpha": 0.3} | (material or {"material": "marble"})
    lamp = {"type": "point", "position": [30.0, -10.0, 25.0], "intensity": {"type": "rgb", "value": [4000, 3500, 3000]}}
    content = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 24.0,
            "to_world": mi.ScalarTransform4f().look_at([12, -60, 18], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
        },
        "lamp": light or lamp,
        "body": mesh_from_arrays("body", vertices, faces, normals, uv, bsdf, colours),
    }
    content |= {f"shape{k}": shape for k, shape in enumerate(shapes)}
    return mi.load_dict(content, optimize=False)


def coloured_scene(light=None):
    """The same with vertices of two colours, that scatter far."""
    mesh = bumpy()
    colours = np.where(mesh[0][:, :1] > 0, [[0.8, 0.3, 0.2]], [[0.2, 0.4, 0.7]])
    texture = {"type": "mesh_attribute", "name": "vertex_color"}
    return model_scene(mesh, {"reflectance": texture, "dmfp": 2.0}, light, colours=colours)


PLAIN = """(changes) => ({...pellucid.forEngine(), highlight: 0, stops: 0, autoExposure: false, hybrid: false,
    floor: false, sky: null, background: [0, 0, 0], samples: SAMPLES, ...changes})""".replace("SAMPLES", str(SAMPLES))
"""The state of a page without what the engine in Python leaves out, and with ``changes``."""

FRAME = """([changes, mode, side]) => {
    const { engine, state } = pellucid;
    engine.frame((PLAIN)(changes), state.camera, side, side, mode, 0);
    return Array.from(engine.device.read(engine.composite.picture));
}""".replace("PLAIN", PLAIN)


def frame(page, side=SIDE, mode="pixels", **changes):
    """Ask a page for a picture, tone-mapped, in the middle of its pixels: ``(side, side, 3)``."""
    values = np.array(page.evaluate(FRAME, [changes, mode, side]), np.float32)
    return values.reshape(side, side, 4)[::-1, :, :3]


def coefficients(medium):
    """A medium as the page has it."""
    return {
        "scattering": list(medium.sigma_s_prime),
        "absorption": list(medium.sigma_a),
        "eta": medium.eta,
        "g": medium.g,
    }


def seen_places(page, side=SIDE):
    """Read what the pixels of the last picture see: ``(side, side, 3)``, zero where that is nothing."""
    values = page.evaluate("() => Array.from(pellucid.engine.device.read(pellucid.engine.surface.places))")
    return np.array(values, np.float32).reshape(side, side, 4)[::-1, :, :3]
