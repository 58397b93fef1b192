"""Small scenes for the real-time engine, and pictures of them by the integrators through the same rays."""

import mitsuba as mi
import numpy as np

from pellucid.realtime.source import Camera

SIZE = 48
CAMERA = Camera((3.0, 5.0, 14.0), (0.3, 0.2, 0.0), fov=24.0)
LAMP = {"type": "point", "position": [4.0, 5.0, 6.0], "intensity": {"type": "rgb", "value": [60.0, 50.0, 40.0]}}


def ball(material="marble", scale=4.0, **parameters):
    bsdf = {"type": "pellucid_translucent", "material": material, "scale": scale, "specular_reflectance": 0.0}
    return {"type": "sphere", "radius": 1.5, "bsdf": bsdf | parameters}


def floor(reflectance=(0.8, 0.6, 0.4)):
    to_world = mi.ScalarTransform4f().translate([0, -1.6, 0]).rotate([1, 0, 0], -90).scale(6)
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(reflectance)}}
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def sensor(camera=CAMERA, size=SIZE):
    """A camera that sends one ray through the middle of each pixel."""
    return {
        "type": "perspective",
        "fov": camera.fov,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(list(camera.origin), list(camera.target), list(camera.up)),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        "sampler": {"type": "stratified", "sample_count": 1, "jitter": False},
    }


def assemble(light=LAMP, **shapes):
    content = {"type": "scene", "sensor": sensor(), "lamp": light, **(shapes or {"body": ball()})}
    return mi.load_dict(content, optimize=False)


def render(scene, method, **parameters):
    integrator = mi.load_dict({"type": method, **parameters})
    return np.array(mi.render(scene, integrator=integrator, spp=1))[..., :3]


def eight_bit_rmse(a, b):
    return float(np.sqrt(np.mean((a.astype(float) - b.astype(float)) ** 2)))
