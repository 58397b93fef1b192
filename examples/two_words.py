"""Make two objects of a Mitsuba scene translucent: one BSDF type and one integrator type change.

python examples/two_words.py cornell.png
"""

import sys

import pellucid

import mitsuba as mi  # isort: skip  (after pellucid, which chooses the LLVM)


def main(output: str, spp: int = 64) -> None:
    mi.set_variant("llvm_ad_rgb")
    scene = mi.cornell_box()
    scene["integrator"] = {"type": "pellucid_two_pass"}
    # Mitsuba's Cornell box is 2 units wide: as a box of 10 cm, a unit is 50 mm.
    scene["small-box"]["bsdf"] = {"type": "pellucid_translucent", "material": "wholemilk", "scale": 50.0}
    scene["large-box"]["bsdf"] = {"type": "pellucid_translucent", "material": "marble", "scale": 50.0}
    mi.util.write_bitmap(output, mi.render(pellucid.load_scene(scene), spp=spp), write_async=False)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "cornell.png")
