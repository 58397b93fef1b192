"""The two passes without Mitsuba's second one: bake the exitance of a body into vertex colours for another renderer.

python examples/exitance_for_any_renderer.py candle.ply
"""

import sys

import numpy as np
import trimesh

import pellucid

import mitsuba as mi  # isort: skip  (after pellucid, which chooses the LLVM)


def main(output: str) -> None:
    mi.set_variant("llvm_ad_rgb")
    candle = trimesh.creation.cylinder(radius=12.0, height=60.0, sections=96).subdivide().subdivide()
    candle.export(output)
    scene = pellucid.load_scene(
        {
            "type": "scene",
            "candle": {
                "type": "ply",
                "filename": output,
                "bsdf": {"type": "pellucid_translucent", "reflectance": [0.9, 0.8, 0.6], "dmfp": [6.0, 3.0, 1.5]},
            },
            "flame": {
                "type": "point",
                "position": [0.0, 0.0, 40.0],
                "intensity": {"type": "rgb", "value": [900.0, 600.0, 300.0]},
            },
        }
    )
    wax = pellucid.prepare(scene, sample_count=20_000)
    exitance = wax.exitance(candle.vertices)
    shown = np.clip(exitance / np.percentile(exitance, 99), 0, 1) ** (1 / 2.2)
    candle.visual.vertex_colors = np.uint8(255 * shown)
    candle.export(output)
    print(f"{len(exitance)} vertices, exitance {exitance.min():.3g} to {exitance.max():.3g}, written to {output}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "candle.ply")
