"""An ear, a leaf and the rim of a candle, lit through, by each profile and by a volumetric path tracer.

    python benchmarks/thin_bodies.py

writes docs/figures/thin_bodies.json and .png, and the table of docs/failures.md between its marks. Takes ten minutes on two cores;
``--quick`` goes through the same steps, and writes nothing.

What is compared, and how, is that of model_error.py: a smooth surface, reduced coefficients and isotropic scattering inside. Lengths are in
millimetres.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from pathlib import Path
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

from model_error import PROFILES, Setup, Subject, compare
from pellucid.errors import PellucidWarning
from pellucid.model.medium import Medium
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scenes.shapes.distance import capsule, cut, ellipsoid, union
from pellucid.scenes.shapes.lathe import Solid, bent, revolve, rounded, rounded_block
from pellucid.scenes.shapes.level_set import surface_mesh
from pellucid.scenes.stage import PictureSettings, lamp, rgb, start
from support.images import enlarged, save_rows
from support.record import DOCS, FIGURES, fill, markdown_table, save
from support.scenes import independent

COMMAND = "python benchmarks/thin_bodies.py"
SETUP = Setup((120, 96), 128, 0.002, 64, 20, block=12)
QUICK = Setup((48, 36), 16, 0.1, 8, 5, block=12)
EDGE = 0.6
"""Side of the triangles of the ear."""
MEDIA = {
    "ear": Medium.from_preset("skin2"),
    "leaf": Medium((3.0, 3.0, 3.0), (0.5, 0.12, 0.9), eta=1.4),
    "candle": Medium.from_reflectance((0.8, 0.7, 0.5), (6.0, 4.0, 2.0), eta=1.4),
}
HALF = 28.0
"""Half the length of the leaf."""
SHOWN_MEAN = 0.25

Array = np.ndarray


def ear() -> Solid:
    """Model an ear, of which the front looks along x: a bowl of about 2 mm within a rim of 4 to 6 mm, and a lobe."""

    def distance(p: Array) -> Array:
        p = np.stack([p[0], p[1] / (0.85 + 0.006 * p[2]), p[2]])  # narrower below
        d = ellipsoid(p, (0, 0, 0), (7, 18, 29))
        d = cut(d, ellipsoid(p, (8, -1, 4), (7.5, 13, 21)), 2)
        d = cut(d, ellipsoid(p, (-9, 0, 3), (7.5, 13, 22)), 2)
        d = union(d, capsule(p, (0.5, 4, 16), (0.5, 3, -8), 1.2, 1.8), 2)
        return union(d, ellipsoid(p, (3, -12, -3), (3, 4, 6)), 2)

    vertices, normals, faces = surface_mesh(distance, np.array([-12, -24, -36]), np.array([12, 24, 36]), EDGE)
    return Solid(vertices, faces, normals)


def leaf() -> Solid:
    """Model a leaf of 0.8 mm that hangs over, with a vein of 2 mm along its middle."""

    def bend(p: Array) -> Array:
        x, y, z = p.T
        along = x / HALF
        y = y * (0.12 + 0.88 * (1 - along**2) * (1 - 0.35 * along))
        z = z * (1 + 1.5 * np.exp(-((y / 1.2) ** 2)) * (0.3 + 0.35 * (1 - along)))
        angle, radius = x / 45, 45 + z + 0.3 * np.sqrt(y**2 + 4)
        return np.stack([radius * np.sin(angle), y, radius * np.cos(angle) - 45], 1)

    return bent(rounded_block([HALF, 13, 0.4], 0.3, (160, 80, 2), arc=3), bend)


def candle() -> Solid:
    """Model a candle of 36 mm that has burnt down within its rim of 2 to 4 mm."""
    outline = [(0, 0), (0, 0), (18, 0), (18, 0), (18, 50), (17, 52), (15.5, 50), (14, 42), (11, 36), (0, 35), (0, 35)]
    return revolve(rounded(outline, 160), 192)


def set_up(name: str, setup: Setup) -> dict[str, Any]:
    """Describe camera and light of a body: lamps behind the ear and above the leaf, a flame within the rim of the candle."""
    settings = PictureSettings(setup.resolution)
    if name == "ear":
        spec = start(settings, (250, -90, 20), (0, 0, 0), 15.0)
        spec["lamp"] = lamp((-120, 200, 110), (0, 0, 0), 240, (12, 11, 10))
    elif name == "leaf":
        spec = start(settings, (-90, -170, -190), (0, 0, -3), 13.0)
        spec["lamp"] = lamp((140, -40, 200), (0, 0, 0), 240, (6, 5.8, 5.6))
    else:
        spec = start(settings, (0, -260, 105), (0, 0, 33), 13.0)
        flame = {"type": "area", "radiance": rgb(70, 50, 25)}
        spec["flame"] = {"type": "cylinder", "p0": [0, 0, 38], "p1": [0, 0, 48], "radius": 2.5, "emitter": flame}
    spec["sky"] = {"type": "constant", "radiance": rgb(0.02, 0.022, 0.025)}
    spec["sensor"]["film"]["rfilter"] = {"type": "box"}
    return independent(spec)


def subject(name: str, solid: Solid) -> Subject:
    """Put a body before its lights."""
    medium = MEDIA[name]

    def described(profile: str, setup: Setup) -> dict[str, Any]:
        coefficients = {"sigma_s_prime": medium.sigma_s_prime.tolist(), "sigma_a": medium.sigma_a.tolist()}
        bsdf = {"type": "pellucid_translucent", **coefficients, "eta": medium.eta, "alpha": 0.0, "profile": profile}
        return set_up(name, setup) | {name: mesh_from_arrays(name, *solid[:3], bsdf=bsdf)}

    return Subject(name, medium, name, described)


def extreme(ratio: float | None) -> str:
    """Write the ratio of one block, if any is known."""
    return "–" if ratio is None else f"{ratio:.2f}"


def table(results: list[dict[str, Any]]) -> str:
    """Format the comparison."""
    rows = []
    for r in results:
        off = [
            f"{' '.join(f'{v:.2f}' for v in p['ratio'])}; {extreme(p['least'])} to {extreme(p['largest'])}; {p['rmse']:.0%}"
            for p in (r["profiles"][name] for name in PROFILES)
        ]
        rows.append([r["name"], f"{max(r['ratio_error']):.1%}", *off])
    return markdown_table(["body", "known to", *(f"`{name}`: mean; blocks; RMSE" for name in PROFILES)], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore", PellucidWarning)  # of bodies that are small, and media that absorb
    mi.set_variant("llvm_ad_rgb")
    results, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for name, solid in {"ear": ear(), "leaf": leaf(), "candle": candle()}.items():
            result, pictures = compare(subject(name, solid), Path(folder), QUICK if quick else SETUP)
            results.append(result)
            scale = SHOWN_MEAN / max(result["volume"])
            rows.append([(f"{name}, {method}", enlarged(scale * p, 2)) for method, p in pictures.items()])
    if not quick:
        save("thin_bodies", COMMAND, {"results": results})
        save_rows(FIGURES / "thin_bodies.png", rows)
        fill(DOCS / "failures.md", "thin bodies", f"`{COMMAND}`\n\n{table(results)}")
    else:
        save_rows(Path(tempfile.gettempdir()) / "thin_bodies.png", rows)


if __name__ == "__main__":
    main()
