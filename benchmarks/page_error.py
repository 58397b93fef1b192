"""The exported page beside the engine in Python: errors of its pixels, and what it asks of a graphics card.

    python benchmarks/page_error.py

writes docs/figures/page_error.json, and the tables of docs/page.md between their marks. Takes about 25 minutes on two
cores, which draw in place of a graphics card; ``--quick`` goes through the same steps small, and writes nothing.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from itertools import product
from pathlib import Path
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.model.medium import Medium
from pellucid.page.assemble import page as written
from pellucid.page.scene import page_scene
from pellucid.page.surface import RESOLUTION
from pellucid.realtime.engine import Engine
from support.browser import browser, frame, open_page
from support.realtime import camera_of, model_scene, reference, say, see_pixels, settled, toned
from support.record import DOCS, fill, markdown_table, save

COMMAND = "python benchmarks/page_error.py"
MODELS = {"antique_head": 10.0, "horned_head": 20.0, "longneck": 20.0}
MATERIALS = ("marble", "skin1", "cream", "wholemilk")
CURVED = ("marble", "skin1")
"""Materials that are compared with the curved profile as well."""

METHODS = {"texture_space": False, "hybrid": True}
SAMPLES, TAPS = 900, 401
FULL = {"sides": (128, 256), "samples": 20_000, "models": 3, "materials": 4}
QUICK = {"sides": (64,), "samples": 4000, "models": 1, "materials": 1}
SAME = 0.25
"""Pixels: where rasteriser and ray see places further apart, they see different things."""

SCREENS = {"1920 x 1080": 1920 * 1080, "3840 x 2160": 3840 * 2160}
COVERED = 0.21
"""Of a screen of 16:9, by a head that fills its height."""

FRAMES = 60
ESTIMATES = {
    "pellucid on two cores (measured)": 1.3,
    "Intel UHD 630": 2.0,
    "phones": 6.0,
    "Intel Iris Xe": 12.0,
    "Apple M1": 25.0,
    "GeForce RTX 3060": 100.0,
    "larger cards": 200.0,
}
"""Billions of pairs a second. Except for the first row these are estimates from arithmetic rates: nothing was measured."""


def rmse(one: Any, other: Any, where: np.ndarray) -> float:
    """Take the RMSE over the whole picture of what differs in some of the pixels."""
    return float(np.sqrt(np.mean(np.where(where[..., None], one - other, 0) ** 2)))


def compare(page: Any, scene: mi.Scene, engine: Engine, material: str, side: int, samples: int) -> list[dict[str, Any]]:
    """Compare pictures of one material with the engine and with the sum over all samples."""
    medium = Medium.from_preset(material, profile=engine.bodies[0].medium.profile)
    size = engine.bodies[0].size_mm
    engine.set_medium(0, medium)
    camera = camera_of(scene)
    described = {key: np.asarray(getattr(camera, key), float).tolist() for key in ("origin", "target", "up")}
    seen = see_pixels(scene, camera, (side, side), medium.eta)
    exact = reference(scene, seen, "exact", sample_count=samples)
    truth, places = toned(exact.picture, exact.average), np.zeros((side, side, 3))
    places[seen.mask] = seen.points
    pixel = 2 * np.tan(np.deg2rad(camera.fov) / 2) / side * np.linalg.norm(np.subtract(camera.origin, camera.target))
    coefficients = {"scattering": medium.sigma_s_prime.tolist(), "absorption": medium.sigma_a.tolist()}
    coefficients |= {"eta": medium.eta, "g": medium.g}
    rows = []
    for method, hybrid in METHODS.items():
        engine.settings.method = method
        ours = toned(engine.linear(camera, (side, side)), engine.half())
        state = {"medium": coefficients, "millimetres": size, "hybrid": hybrid, "samples": SAMPLES}
        shown = frame(page, {**described, "fov": camera.fov}, side, **state)
        everywhere = np.ones((side, side), bool)
        same = np.linalg.norm(shown["places"] - places, axis=2) < SAME * pixel
        row: dict[str, Any] = {"material": material, "profile": medium.profile, "side": side, "method": method}
        row["other places"] = int((~same).sum())
        for name, where in (("all", everywhere), ("same", same)):
            row[name] = {
                "page, exact": rmse(shown["picture"], truth, where),
                "engine, exact": rmse(ours, truth, where),
                "page, engine": rmse(shown["picture"], ours, where),
            }
        row["light"] = shown["half"] / float(engine.half())
        row["seconds"] = shown["seconds"]
        say(f"{row}")
        rows.append(row)
    return rows


def pixels(setup: dict[str, Any], chromium: Any) -> list[dict[str, Any]]:
    """Compare all models and materials, and some with the curved profile."""
    rows: list[dict[str, Any]] = []
    profiles = {"tabulated": MATERIALS, "curved": CURVED}
    models = list(MODELS.items())[: setup["models"]]
    with tempfile.TemporaryDirectory() as folder:
        for (model, size), (profile, materials) in product(models, profiles.items()):
            path = Path(folder) / f"{model}.html"
            path.write_text(
                written(page_scene(model_scene(model, size=size, profile=profile), model)), encoding="utf-8"
            )
            page = open_page(chromium, path)
            for material in materials[: setup["materials"]]:
                scene = model_scene(model, material, size, profile=profile)
                engine = settled(Engine(scene, RESOLUTION), samples=SAMPLES)
                for side in setup["sides"]:
                    found = compare(page, scene, engine, material, side, setup["samples"])
                    rows += [{"model": model, "size": size, **row} for row in found]
            page.close()
    return rows


def pixel_table(rows: list[dict[str, Any]]) -> None:
    """Put the errors into the documentation."""
    head = [
        "",
        "material",
        "profile",
        "pixels",
        "method",
        "page against `exact`",
        "engine against `exact`",
        "page against engine",
        "light",
    ]
    lines = [
        [f"{row['model']}, {row['size']:g} mm", row["material"], row["profile"], f"{row['side']}²", row["method"].replace("_", " "),
         *(f"{row['same'][key]:.4f} ({row['all'][key]:.4f})" for key in row["same"]), f"{100 * (row['light'] - 1):+.2f} %"]
        for row in rows
    ]  # fmt: skip
    fill(DOCS / "page.md", "page_error", f"`{COMMAND}`\n\n{markdown_table(head, lines)}")


def pair_table() -> None:
    """Put into the documentation what 60 frames a second ask for, and what devices may give."""
    head = [
        "screen, of which 21 % show the object",
        f"N = {SAMPLES}",
        f"N = {SAMPLES}, hybrid",
        "N = 2500",
        "hybrid at 1 of 4 pixels",
    ]
    lines = []
    for name, count in SCREENS.items():
        each = count * COVERED * FRAMES / 1e9
        taps = SAMPLES + TAPS
        lines.append([name, *(f"{each * pairs:.0f}" for pairs in (SAMPLES, taps, 2500, 0.35 * taps))])
    needed = markdown_table(head, lines)
    given = markdown_table(["device", "estimate"], ([name, f"{rate:g}"] for name, rate in ESTIMATES.items()))
    fill(DOCS / "page.md", "page_pairs", f"{needed}\n\n{given}")


def main() -> None:
    """Measure, and write the documents."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the same steps, small; writes nothing")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore", pellucid.PellucidWarning)
    with browser() as chromium:
        rows = pixels(QUICK if quick else FULL, chromium)
    if not quick:
        save("page_error", COMMAND, rows)
        pixel_table(rows)
        pair_table()


if __name__ == "__main__":
    main()
