"""Small scenes with known answers."""

import mitsuba as mi

T = mi.ScalarTransform4f()


def looking_at(target, origin, fov=20.0, size=24, spp=16):
    """A square perspective camera with a box filter."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": T.look_at(origin, target, [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": spp},
    }


def translucent(**parameters):
    return {"type": "pellucid_translucent", **parameters}


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def diffuse(*value):
    return {"type": "diffuse", "reflectance": rgb(*value)}


def scene(*shapes, light=None, sensor=None, **extra):
    """Assemble a scene of shapes, a light (a sky of radiance 1 by default) and a camera on the z axis."""
    content = {"type": "scene", "sensor": sensor or looking_at([0, 0, 0], [0, 0, 100])}
    content |= {f"shape{k}": shape for k, shape in enumerate(shapes)}
    content["light"] = light or {"type": "constant", "radiance": 1.0}
    return mi.load_dict(content | extra, optimize=False)
