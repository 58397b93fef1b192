"""The Cornell box with a translucent block in it (figure 4 of JB02)."""

from __future__ import annotations

from typing import Any

from .stage import PictureSettings, Spec, Vector, diffuse, material, rgb, start

# Reflectances of the painted walls, as red, green and blue.
WHITE, RED, GREEN = (0.74, 0.73, 0.71), (0.60, 0.055, 0.045), (0.115, 0.42, 0.085)


def _wall(centre: Vector, facing: Vector, up: Vector, half: float, bsdf: Spec) -> Spec:
    """A square of side ``2 half`` around ``centre`` that faces a direction."""
    import mitsuba as mi

    target = [c + f for c, f in zip(centre, facing, strict=True)]
    place = mi.ScalarTransform4f().look_at(origin=list(centre), target=target, up=list(up))
    return {"type": "rectangle", "to_world": place @ mi.ScalarTransform4f().scale([half, half, 1]), "bsdf": bsdf}


def _block(foot: Vector, extents: Vector, turn: float, bsdf: Spec) -> dict[str, Any]:
    """A block that stands on ``foot`` with its sides turned by an angle [degrees]."""
    import mitsuba as mi

    x, y, z = foot
    place = mi.ScalarTransform4f().translate([x, y, z + extents[2] / 2]).rotate([0, 0, 1], turn)
    return {"type": "cube", "to_world": place.scale([e / 2 for e in extents]), "bsdf": bsdf}


def cornell_box(settings: PictureSettings, bsdf: Spec | None = None, size: float = 120.0) -> Spec:
    """A room of ``size`` [mm] with one red and one green wall, a translucent block (skim milk) and a white one.

    Light goes through the block, and colours bleed from the walls onto it and from it onto the floor. The room is a
    model: in one of the classic half metre the block would be too thick for light to come through.
    """
    half = size / 2
    scene = start(settings, (0, -1.93 * size, half), (0, 0, half), fov=38.6)
    white = diffuse(*WHITE)
    scene["floor"] = _wall((0, 0, 0), (0, 0, 1), (0, 1, 0), half, white)
    scene["ceiling"] = _wall((0, 0, size), (0, 0, -1), (0, 1, 0), half, white)
    scene["back"] = _wall((0, half, half), (0, -1, 0), (0, 0, 1), half, white)
    scene["left"] = _wall((-half, 0, half), (1, 0, 0), (0, 0, 1), half, diffuse(*RED))
    scene["right"] = _wall((half, 0, half), (-1, 0, 0), (0, 0, 1), half, diffuse(*GREEN))
    scene["light"] = _wall((0, 0, 0.998 * size), (0, 0, -1), (0, 1, 0), 0.13 * size, diffuse(0.0))
    scene["light"]["emitter"] = {"type": "area", "radiance": rgb(21.0, 17.5, 12.5)}
    bsdf = material(bsdf, {"type": "pellucid_translucent", "material": "skimmilk", "alpha": 0.15})
    extents = [e * size for e in (0.27, 0.27, 0.56)]
    scene["block"] = _block((-0.17 * size, 0.10 * size, 0.0), extents, -18.0, bsdf)
    extents = [e * size for e in (0.28, 0.28, 0.28)]
    scene["white_block"] = _block((0.20 * size, -0.17 * size, 0.0), extents, 20.0, white)
    return scene
