"""Print a hash of the exitance at fixed points, for every method and built-in scene.

Run it before and after a change that must not change results:

    python benchmarks/fingerprint.py > before.txt    # ... change the code ...
    python benchmarks/fingerprint.py | diff before.txt -

Scenes are built at their coarsest. The points are those that the first camera sees, on a grid of 48 by 36, and each of at most two
bodies of the scene is asked for its exitance at all of them. Bits differ between processors with and without AVX-512.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import warnings

import numpy as np

import pellucid  # before drjit: it says which LLVM compiles the kernels

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip

from pellucid.scenes.builtin import build, builtin_names  # isort: skip

COARSE = {
    "teapot": {"detail": 4},
    "teapot_env": {"detail": 4},
    "teapot_table": {"detail": 6, "size": 50.0},
    "kitchen": {"detail": 48, "samples": 5e3},
    "mezquita": {"detail": 56, "samples": 5e3, "bays": (1, 1)},
}
SURFACE = {"sample_count": 600, "irradiance_paths": 16}
METHODS = {
    "exact": SURFACE,
    "two_pass": SURFACE | {"translucent_passes": 1},
    "sampled": {},
    "texture_space": {"sample_count": 600, "resolution": 64},
    "texture_space hybrid": {"sample_count": 600, "resolution": 64, "hybrid": True},
    "single_pass": {"sample_count": 600, "direct": 128, "indirect": 512},
    "single_pass cut": {"mode": "cut", "sample_count": 600, "direct": 128, "indirect": 512, "max_cut": 256},
    "single_pass two_pass": {"mode": "two_pass", "sample_count": 600, "direct": 128, "indirect": 512},
    "single_pass exact": {"mode": "exact", "sample_count": 200, "direct": 64, "indirect": 64},
}


def spots() -> dict:
    """Describe two bodies under a point light and a faint sky, where the hybrid method has something to do."""
    look = mi.ScalarTransform4f().look_at([0, -40, 9], [0, 0, 0], [0, 0, 1])
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 30, "to_world": look},
        "ball": {"type": "sphere", "radius": 8, "bsdf": {"type": "pellucid_translucent"}},
        "other": {
            "type": "sphere",
            "center": [7, -9, 0],
            "bsdf": {"type": "pellucid_translucent", "material": "skin1"},
        },
        "lamp": {"type": "point", "position": [20, -20, 30], "intensity": 2000.0},
        "sky": {"type": "constant", "radiance": 0.2},
    }


def seen_points(scene: mi.Scene, width: int = 48, height: int = 36) -> tuple[np.ndarray, np.ndarray]:
    """Find the points that the first camera sees through the middles of a grid of pixels, and their normals."""
    u, v = (
        a.ravel().astype(np.float32)
        for a in np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    )
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(u, v), mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    keep = dr.compress(si.is_valid())
    p, n = dr.gather(mi.Point3f, si.p, keep), dr.gather(mi.Normal3f, si.sh_frame.n, keep)
    return p.numpy().T, n.numpy().T


def main() -> None:
    """Print one line for each scene and method."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--only", default="", help="names of scenes, comma-separated")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    mi.set_variant(options.variant)
    for name in options.only.split(",") if options.only else ["spots", *builtin_names()]:
        spec = spots() if name == "spots" else build(name, resolution=(48, 36), **COARSE.get(name, {}))
        scene = pellucid.load_scene(spec)
        points, normals = seen_points(scene)
        for label, settings in METHODS.items():
            method = label.split()[0]
            if "translucent_passes" in settings and name in ("kitchen", "mezquita"):
                settings = settings | {"translucent_passes": 0}
            prepared = pellucid.prepare(scene, method, **settings)
            digest, means = hashlib.sha256(), []
            for body in dict.fromkeys((prepared.bodies[0], prepared.bodies[-1])):
                value = prepared.exitance(points, normals=normals, body=body)
                digest.update(np.ascontiguousarray(value).tobytes())
                means.append(float(value.mean()))
            print(f"{name:14} {label:22} {digest.hexdigest()[:16]} " + " ".join(f"{m:.6e}" for m in means), flush=True)


if __name__ == "__main__":
    sys.exit(main())
