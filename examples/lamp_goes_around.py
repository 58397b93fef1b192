"""Frames in real time without a window: a lamp goes around a head of marble, which then becomes skin and larger.

python examples/lamp_goes_around.py frames.png
"""

import sys
import time

import numpy as np

import pellucid

import mitsuba as mi  # isort: skip  (after pellucid, which chooses the LLVM)


def main(output: str, side: int = 256) -> None:
    mi.set_variant("llvm_ad_rgb")

    engine = pellucid.Engine(pellucid.load_scene("horned_head"))
    camera = pellucid.Camera(origin=(19.0, -27.0, 5.0), target=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0), fov=20.0)
    reach = np.linalg.norm(engine.lights[0].position[:2])
    height = engine.lights[0].position[2]
    pictures = []
    for k, angle in enumerate(np.linspace(0, 2 * np.pi, 6, endpoint=False)):
        engine.set_light(0, position=(reach * np.cos(angle), reach * np.sin(angle), height))
        if k == 3:
            engine.set_medium(0, pellucid.Medium.from_preset("skin1"))
            engine.set_size(20.0)
        start = time.perf_counter()
        pictures.append(engine.frame(camera, (side, side), moving=True).pixels)
        print(f"frame {k}: {1e3 * (time.perf_counter() - start):.0f} ms")
    mi.util.write_bitmap(output, mi.Bitmap(np.concatenate(pictures, axis=1)), write_async=False)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "frames.png")
