"""A flat disk of marble under parallel light: every cosine is known, and so is the integral of the profile around its middle."""

import mitsuba as mi
import numpy as np

from worlds.balls import T, looking_at, scene, translucent


def sine(cosine):
    return float(np.sqrt(1 - cosine**2))


def slab(radius, light_cosine, irradiance=1.0, eye_cosine=1.0, **bsdf):
    """A disk of marble in the plane z = 0, lit and seen under given cosines to its normal; a lid below keeps it dark there."""
    light = {"type": "directional", "direction": [-sine(light_cosine), 0, -light_cosine], "irradiance": irradiance}
    disk = {
        "type": "disk",
        "to_world": T.scale(radius),
        "bsdf": translucent(**({"material": "marble", "specular_reflectance": 0.0} | bsdf)),
    }
    eye = 100.0 * radius * np.array([0, -sine(eye_cosine), eye_cosine])
    return scene(disk, light=light, sensor=looking_at([0, 0, 0], eye.tolist(), fov=0.01, size=4))


def render_slab(method, eye_cosine, light_cosine=0.8, settings=None, **bsdf):
    """Render the middle of a disk: its mean radiance, and its mean exitance; both ``(3,) float``."""
    content = slab(20.0, light_cosine, 3.0, eye_cosine, **bsdf)
    plugin = {"type": f"pellucid_{method}", "aovs": "exitance", "max_depth": 2, **(settings or {})}
    picture = np.array(mi.render(content, integrator=mi.load_dict(plugin), spp=16), dtype=float)
    return picture[..., :3].mean(axis=(0, 1)), picture[..., 3:6].mean(axis=(0, 1))
