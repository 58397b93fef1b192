"""How wrong the profiles are in whole bodies: balls, blocks, cylinders, slabs and bent sheets, beside a volumetric path tracer.

    python benchmarks/body_error.py

writes docs/figures/body_error.json and the tables of docs/theory/model.md between their marks. Takes a quarter of an hour on two cores;
``--quick`` goes through the same steps on a few bodies, and writes nothing.

Half a sky shines from above, on all bodies alike. Those with a mirror plane send out half of what they would send out under a whole sky, so
that one comparison tells of both. The volume is Mitsuba's: the same surface, smooth, with the reduced coefficients and isotropic
scattering inside. The furnace has no volume: what all bodies send out there is known.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import pellucid

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.errors import PellucidWarning
from pellucid.kernels.memory import rows
from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.model.medium import Medium
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scenes.builtin import build
from pellucid.scenes.shapes.lathe import bent, revolve, rounded_block
from support.record import DOCS, fill, markdown_table, save
from support.scenes import load
from support.volume import as_volume
from support.volume_exitance import volume_exitance

COMMAND = "python benchmarks/body_error.py"
PROFILES = ("dipole", "tabulated", "curved")
ALBEDO = np.array([0.9984, 0.988, 0.8])
"""Reduced: of marble in green, of skin2 in red, and one that absorbs."""
ETA = (1.3, 1.5)
BALLS, EDGED, SLABS = (4, 8, 20, 50, 200), (8, 20), (1, 2, 4, 8, 16, 32)
"""Extents in mean free paths ``1 / sigma_t'``."""
SHEET, BEND = 1.0, 8.0
"""Thickness of the bent sheet, and the radius of its middle [mm]."""
BANDS = 8
"""Parts of a ball that are compared by themselves, equal in area, from above to below."""
SHEETS = ("marble", "skin1")
FURNACE, FURNACE_GOAL, FURNACE_DEPTH = (40, 200), 1.02, 32
"""Longest extents; what is bright enough; and how often light may be reflected between parts of a body."""
TUBE = 0.45
"""Radius of the torus knot's tube; that of the tube on which it lies is 1."""
KNOWN = 0.03
"""Light that the volume is known worse of is not compared."""

Array = np.ndarray
Shape = Callable[[dict[str, Any]], Any]
"""Makes a shape of a scene that has a BSDF; of the volume that of a smooth diffuse one."""


class Setup(NamedTuple):
    """How much work."""

    points: int = 2048
    walks: int = 16
    """Paths at each point, in each batch."""
    error: float = 0.01
    """Standard error of every part of the volume at which it is known well enough."""
    most_walks: int = 96


QUICK = Setup(256, 4, 0.1, 8)


class Line(NamedTuple):
    """What is compared of a body: the mean over some of its parts, or with None how much all of them differ, RMSE over their mean."""

    name: str
    limit: float | None
    """By how much it may be off."""
    parts: tuple[int, ...] | None


class Body(NamedTuple):
    """A body that is compared: its shape, the points of it that are looked at, with normals, and the part that each of them belongs to."""

    name: str
    shape: Shape
    see: Callable[[Any, int], tuple[Array, Array]]
    part: Callable[[Array], Array]
    lines: tuple[Line, ...]


def over_surface(shape: Any, count: int) -> tuple[Array, Array]:
    """Draw points evenly over a shape: with their normals, ``(m, 3) float`` each."""
    k = np.arange(count)
    place = mi.Point2f(((k + 0.5) / count).astype(np.float32), (k * (np.sqrt(5) - 1) / 2 % 1).astype(np.float32))
    sample = shape.sample_position(0, place)
    return rows(sample.p), rows(sample.n)


def middle_of_slab(thickness: float, width: float) -> Callable[[Any, int], tuple[Array, Array]]:
    """Take points on both sides of the middle of a slab."""

    def see(_: Any, count: int) -> tuple[Array, Array]:
        side = np.linspace(-width / 16, width / 16, int(np.sqrt(count / 2)))
        x, y, z = (v.ravel() for v in np.meshgrid(side, side, [-1.0, 1.0]))
        return np.stack([x, y, z * thickness / 2], 1), np.stack([0 * x, 0 * x, z], 1)

    return see


def whole(n: Array) -> Array:
    """Take a body as one part."""
    return np.zeros(len(n), int)


def sides(n: Array) -> Array:
    """Tell the dark side, 0, from the lit one, 1."""
    return (n[:, 2] > 0).astype(int)


def bands(n: Array) -> Array:
    """Number bands of a ball from below to above."""
    return np.minimum((n[:, 2] + 1) / 2 * BANDS, BANDS - 1).astype(int)


def ball(size: float) -> Shape:
    """Make a ball."""
    return lambda bsdf: {"type": "sphere", "radius": size / 2, "bsdf": bsdf}


def cuboid(*extent: float) -> Shape:
    """Make a block with sharp edges."""
    to_world = mi.ScalarTransform4f().scale([size / 2 for size in extent])
    return lambda bsdf: {"type": "cube", "to_world": to_world, "bsdf": bsdf}


def solid(made: Any) -> Shape:
    """Make a mesh of a solid."""
    return lambda bsdf: mesh_from_arrays("body", made.vertices, made.faces, made.normals, bsdf=bsdf)


def cylinder(size: float) -> Shape:
    """Make a cylinder as high as wide, its edges hardly rounded."""
    r, off = size / 2, 0.002 * size
    ring = [(0, -r), (r - off, -r), (r, -r + off), (r, r - off), (r - off, r), (0, r)]
    return solid(revolve(np.array(ring), 256))


def torus_knot(size: float, around: int = 400, across: int = 48) -> Shape:
    """Make a tube along a knot that winds three times around a torus while it goes around its axis twice."""
    t = np.linspace(0, 2 * np.pi, around, endpoint=False)
    phi = np.linspace(0, 2 * np.pi, across, endpoint=False)[:, None]
    radius = 2 + np.cos(3 * t)
    middle = np.stack([radius * np.cos(2 * t), radius * np.sin(2 * t), np.sin(3 * t)], 1)
    ahead = np.roll(middle, -1, 0) - np.roll(middle, 1, 0)
    side = np.cross(ahead, middle - 2 * np.stack([np.cos(2 * t), np.sin(2 * t), 0 * t], 1))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, ahead / np.linalg.norm(ahead, axis=1, keepdims=True))
    normals = np.cos(phi)[..., None] * up + np.sin(phi)[..., None] * side
    points = middle + TUBE * normals
    here = np.arange(around * across).reshape(across, around)
    beside, above = np.roll(here, -1, 1), np.roll(here, -1, 0)
    both = np.roll(above, -1, 1)
    faces = np.concatenate([np.stack([here, both, beside], -1), np.stack([here, above, both], -1)]).reshape(-1, 3)
    vertices = points.reshape(-1, 3) * size / np.ptp(points[..., 0])
    return lambda bsdf: mesh_from_arrays("body", vertices, faces, normals.reshape(-1, 3), bsdf=bsdf)


def bodies() -> list[Body]:
    """List the bodies whose lengths are in mean free paths."""
    found = []
    for size in BALLS:
        goals = (0.02, 0.04) if size >= 8 else (None, None)
        lines = Line("mean", goals[0], tuple(range(BANDS))), Line("bands, RMSE", goals[1], None)
        found.append(Body(f"ball, {size}", ball(size), over_surface, bands, lines))
    edged = {
        "cube": lambda size: cuboid(size, size, size),
        "cylinder": cylinder,
        "block 1:2:4": lambda size: cuboid(size, 2 * size, 4 * size),
    }
    for name, shape in edged.items():
        found += [
            Body(f"{name}, {size}", shape(size), over_surface, whole, (Line("mean", 0.06, (0,)),)) for size in EDGED
        ]
    widths = {f"slab, {size}": (size, min(max(40, 20 * size), 320)) for size in SLABS}
    widths["tile, 4, 24 wide"] = 4, 24
    for name, (size, width) in widths.items():
        goals = (0.10, 0.15, 0.15) if name.startswith("slab") else (None, None, None)
        lines = (
            Line("both sides", goals[0], (0, 1)),
            Line("lit side", goals[1], (1,)),
            Line("dark side", goals[2], (0,)),
        )
        found.append(Body(name, cuboid(width, width, size), middle_of_slab(size, width), sides, lines))
    return found


def sheet() -> Body:
    """Describe a sheet with rounded edges that is bent down like a leaf or the rim of an ear; lengths in millimetres."""

    def bend(p: Array) -> Array:
        angle, radius = p[:, 0] / BEND, BEND + p[:, 2]
        return np.stack([radius * np.sin(angle), p[:, 1], radius * np.cos(angle) - BEND], 1)

    flat = rounded_block([BEND, BEND, SHEET / 2], 0.3 * SHEET, (80, 80, 2), arc=4)
    lines = Line("both sides", None, (0, 1)), Line("lit side", None, (1,)), Line("dark side", None, (0,))
    return Body("bent sheet of 1 mm", solid(bent(flat, bend)), over_surface, sides, lines)


def translucent(medium: Medium, profile: str) -> dict[str, Any]:
    """Describe a medium, behind a smooth surface, as it is rendered by a profile."""
    coefficients = {"sigma_s_prime": medium.sigma_s_prime.tolist(), "sigma_a": medium.sigma_a.tolist()}
    return {"type": "pellucid_translucent", **coefficients, "eta": medium.eta, "alpha": 0.0, "profile": profile}


def half_sky() -> dict[str, Any]:
    """Describe a sky of 1 that is black below the horizon."""
    pixels = np.zeros((512, 1024, 3), np.float32)
    pixels[:256] = 1
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90)}


def compare(body: Body, medium: Medium, folder: Path, setup: Setup) -> list[dict[str, Any]]:
    """Compare a body of one medium by every profile with the volume, line by line."""
    spec = {"type": "scene", "sky": half_sky(), "body": body.shape({"type": "diffuse"})}
    volume = load(as_volume(spec, "body", medium, folder))
    p, n = body.see(volume.shapes()[0], setup.points)
    part = body.part(n)
    walks: list[Array] = []
    while len(walks) < 2 * setup.walks or (len(walks) < setup.most_walks and not known(walks, setup.error)):
        walks += [of_parts(walk, part) for walk in volume_exitance(volume, medium, p, n, setup.walks, len(walks))]
    del volume
    ours = {}
    for profile in PROFILES:
        scene = load({**spec, "body": body.shape(translucent(medium, profile))})
        ours[profile] = of_parts(pellucid.prepare(scene, "two_pass", seed=1).exitance(p, normals=n), part)
    return [
        {"body": body.name, "medium": medium.name or f"eta {medium.eta}", **measured(line, ours, np.array(walks))}
        for line in body.lines
    ]


def of_parts(exitance: Array, part: Array) -> Array:
    """Average over the points of each part: ``(parts, 3) float``."""
    return np.stack([exitance[part == k].mean(axis=0) for k in range(part.max() + 1)])


def error_and_mean(walks: Any) -> tuple[Array, Array]:
    """Estimate the standard error of the mean of walks, and the mean."""
    return np.std(walks, axis=0, ddof=1) / len(walks) ** 0.5, np.mean(walks, axis=0)


def known(walks: list[Array], error: float) -> bool:
    """Tell whether every part is known to a relative error."""
    noise, mean = error_and_mean(walks)
    return bool((noise < error * mean).all())


def measured(line: Line, ours: dict[str, Array], walks: Array) -> dict[str, Any]:
    """Measure one line: what the volume sends out under light of 1, how well that is known, and how far every profile is off."""
    if line.parts is None:
        noise, truth = error_and_mean(walks)
        squares = {name: np.mean((values - truth) ** 2 - noise**2, axis=0) for name, values in ours.items()}
        truth, noise = truth.mean(axis=0), np.sqrt(np.mean(noise**2, axis=0))
        off = {name: np.sqrt(np.maximum(square, 0)) / truth for name, square in squares.items()}
    else:
        noise, truth = error_and_mean(walks[:, line.parts].mean(axis=1))
        off = {name: values[list(line.parts)].mean(axis=0) / truth - 1 for name, values in ours.items()}
    told = noise < KNOWN * truth
    return {
        "line": line.name,
        "truth": truth.tolist(),
        "noise": [float(value) if good else None for value, good in zip(noise / truth, told, strict=True)],
        "off": {
            name: [float(value) if good else None for value, good in zip(values, told, strict=True)]
            for name, values in off.items()
        },
        "limit": line.limit,
        "holds": None if line.limit is None else bool((np.abs(off["curved"][told]) <= line.limit).all()),
    }


def furnace(name: str, shape: Shape, size: float, setup: Setup) -> dict[str, Any]:
    """Find how bright a body without absorption is under a whole sky, over what it is in truth: on average, and at most."""
    medium, found = Medium(1.0, 0.0, eta=ETA[0]), {}
    for profile in PROFILES:
        spec = {"type": "scene", "sky": {"type": "constant"}, "body": shape(translucent(medium, profile))}
        scene = load(spec)
        p, n = over_surface(scene.shapes()[0], setup.points)
        prepared = pellucid.prepare(scene, "two_pass", seed=1, irradiance_depth=FURNACE_DEPTH)
        bright = prepared.exitance(p, normals=n) / (np.pi * external_diffuse_transmittance(medium.eta))
        found[profile] = {"mean": float(bright.mean()), "largest": float(bright.max())}
    return {"body": f"{name}, {size:g}", "profiles": found}


def furnace_shapes(size: float) -> dict[str, Shape]:
    """Name the bodies that stand in the furnace, by their longest extent."""
    return {
        "ball": ball(size),
        "torus knot": torus_knot(size),
        "bust": lambda bsdf: build("bust", bsdf=bsdf, size=size, edge=4.0)["bust"],
        "teapot": lambda bsdf: build("teapot", bsdf=bsdf, size=size)["teapot"],
    }


def percents(values: list[float | None]) -> str:
    """Write how far something is off in every channel."""
    return " ".join("-" if value is None else f"{100 * value:+.1f}" for value in values)


def table_of_bodies(results: list[dict[str, Any]]) -> str:
    """Format the comparison with volumes: a row for all media of a body and line."""
    rows = []
    for (body, name), group in groupby(results, lambda result: (result["body"], result["line"])):
        media = list(group)
        noise = max((value for result in media for value in result["noise"] if value is not None), default=np.nan)
        off = ["; ".join(percents(result["off"][profile]) for result in media) for profile in PROFILES]
        limit = media[0]["limit"]
        holds = "yes" if all(result["holds"] for result in media) else "**no**"
        rows.append(
            [f"{body}: {name}", f"{noise:.1%}", *off, *(("", "") if limit is None else (f"{limit:.0%}", holds))]
        )
    return markdown_table(["body", "known to", *(f"`{profile}` [%]" for profile in PROFILES), "goal", "holds"], rows)


def table_of_furnace(results: list[dict[str, Any]]) -> str:
    """Format the furnace."""
    rows = [
        [
            r["body"],
            *(f"{r['profiles'][p]['mean']:.3f}; {r['profiles'][p]['largest']:.3f}" for p in PROFILES),
            "yes" if r["profiles"]["curved"]["largest"] <= FURNACE_GOAL else "**no**",
        ]
        for r in results
    ]
    return markdown_table(["body, extent", *(f"`{p}`: mean; largest" for p in PROFILES), "within 1.02"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few bodies, roughly, to see that it runs")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore", PellucidWarning)  # of bodies that are small, and media that absorb
    setup = QUICK if quick else Setup()
    mi.set_variant("llvm_ad_rgb")
    grey = [Medium(ALBEDO, 1 - ALBEDO, eta=eta) for eta in ETA]
    wanted = [(body, grey) for body in bodies()[:: 6 if quick else 1]]
    wanted.append((sheet(), [Medium.from_preset(name) for name in SHEETS]))
    volumes, white = [], []
    with tempfile.TemporaryDirectory() as folder:
        for body, media in wanted:
            found = [compare(body, medium, Path(folder), setup) for medium in media]
            volumes += (lines := [line for lines in zip(*found, strict=True) for line in lines])
            print(table_of_bodies(lines).split("\n", 2)[2], flush=True)
    for size in FURNACE[: 1 if quick else None]:
        for name, shape in furnace_shapes(size).items():
            white.append(furnace(name, shape, size, setup))
            print(table_of_furnace(white[-1:]).split("\n", 2)[2], flush=True)
    if not quick:
        save("body_error", COMMAND, {"bodies": volumes, "furnace": white})
        fill(DOCS / "theory" / "model.md", "body error", f"{table_of_bodies(volumes)}\n\n{table_of_furnace(white)}")


if __name__ == "__main__":
    main()
