"""How wrong is diffusion: the teapot by the two passes and by a volumetric path tracer, for five materials.

    python benchmarks/diffusion_error.py

writes docs/figures/diffusion_error.json and .png, and the table of docs/benchmarks.md between its marks. Takes about
ten minutes on two cores; ``--quick`` goes through the same steps in one, and writes nothing.

The volume has the reduced coefficients and scatters isotropically, inside the same smooth surface, so the two pictures
differ by the dipole alone: by diffusion, and by taking every place for a flat half space. The teapot is a small one
(`SIZE`), where the second matters more than on one of full size, and where every channel's light still ends in minutes.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.model.medium import CHANNELS, Medium
from support.images import enlarged, save_rows
from support.pixels import body_mask
from support.record import DOCS, FIGURES, fill, markdown_table, save
from support.scenes import load, teapot_spec, with_dipoles
from support.volume import as_volume, volume_path_tracer

COMMAND = "python benchmarks/diffusion_error.py"
MATERIALS = ("marble", "wholemilk", "apple", "skin2", "skin1")
SIZE = 100.0  # [mm]
SAMPLES = 150_000
LEAST_BATCHES = 5
SHOWN_MEAN = 0.35


@dataclass
class Setup:
    """How much work."""

    resolution: tuple[int, int] = (96, 72)
    two_pass_spp: int = 256
    error: float = 0.005
    """Standard error of the mean of a channel at which the volume is known well enough."""
    batch: int = 32
    """Samples a pixel in each batch."""
    most_batches: int = 16


QUICK = Setup((48, 36), 16, 0.1, 4, LEAST_BATCHES)


def volume_pictures(scene: Any, mask: np.ndarray, setup: Setup) -> np.ndarray:
    """Render batches until the mean over the teapot is known, or there are as many as are allowed: ``(batches, h, w, 3) float``."""
    integrator = volume_path_tracer()
    pictures: list[np.ndarray] = []
    while len(pictures) < setup.most_batches:
        pictures.append(np.array(integrator.render(scene, 0, len(pictures), setup.batch)))
        if len(pictures) >= LEAST_BATCHES:
            error, mean = error_of_mean([p[mask].mean(axis=0) for p in pictures])
            if (error < setup.error * mean).all():
                break
    return np.array(pictures)


def error_of_mean(batches: Any) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the standard error of the mean of batches, and the mean."""
    return np.std(batches, axis=0, ddof=1) / len(batches) ** 0.5, np.mean(batches, axis=0)


def compare(material: str, folder: Path, setup: Setup) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Render one material both ways."""
    medium = Medium.from_preset(material)
    bsdf = {"type": "pellucid_translucent", "material": material, "alpha": 0.0}
    spec = with_dipoles(teapot_spec(setup.resolution, size=SIZE, bsdf=bsdf))
    scene = load(spec)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": SAMPLES, "irradiance_paths": 64})
    integrator.prepared = integrator.prepare_scene(scene)
    mask = body_mask(scene, scene.sensors()[0], integrator.prepared.lookup, eroded=1)
    ours = np.array(integrator.render(scene, 0, 0, setup.two_pass_spp))
    batches = volume_pictures(load(as_volume(spec, "teapot", medium, folder)), mask, setup)
    mean = ours[mask].mean(axis=0)
    error, true_mean = error_of_mean([p[mask].mean(axis=0) for p in batches])
    # In blocks of pixels the noise of the volume is small enough to be subtracted.
    noise, true_blocks = error_of_mean([blocks(p, mask) for p in batches])
    squared = np.mean((blocks(ours, mask) - true_blocks) ** 2) - np.mean(noise**2)
    spp = setup.batch * len(batches)
    result = {
        "material": material,
        "two_pass": mean.tolist(),
        "volume": true_mean.tolist(),
        "ratio": (mean / true_mean).tolist(),
        "ratio_error": (error / true_mean).tolist(),
        "rmse": float(np.sqrt(max(squared, 0)) / true_blocks.mean()),
        "noise": float(np.sqrt(np.mean(noise**2)) / true_blocks.mean()),
        "spp": spp,
    }
    ratios = ", ".join(
        f"{c} {r:.3f} +- {e:.3f}" for c, r, e in zip(CHANNELS, result["ratio"], result["ratio_error"], strict=True)
    )
    print(
        f"{material:10} two-pass over volume: {ratios};  RMSE {result['rmse']:.1%}, noise {result['noise']:.1%}  ({spp} samples a pixel)",
        flush=True,
    )
    return result, ours, batches.mean(axis=0)


def blocks(picture: np.ndarray, mask: np.ndarray, size: int = 6) -> np.ndarray:
    """Average the masked pixels of every block: ``(k, 3) float`` of the blocks that are at least half covered."""
    height, width, _ = picture.shape
    shape = (height // size, size, width // size, size)
    covered = mask.reshape(shape).sum(axis=(1, 3))
    total = (picture * mask[..., None]).reshape(*shape, 3).sum(axis=(1, 3))
    keep = covered >= size * size / 2
    return total[keep] / covered[keep][:, None]


def table(results: list[dict[str, Any]]) -> None:
    """Put the comparison into the documentation."""

    def triple(values: list[float], form: str) -> str:
        return " ".join(format(v, form) for v in values)

    rows = []
    for r in results:
        medium = Medium.from_preset(r["material"])
        rows.append(
            [
                r["material"],
                triple(medium.albedo_prime, ".3f"),
                triple(r["two_pass"], ".3f"),
                triple(r["volume"], ".3f"),
                "**" + triple(r["ratio"], ".2f") + "**",
                f"{max(r['ratio_error']):.1%}",
                f"{r['rmse']:.1%}",
            ]
        )
    head = ["material", "albedo'", "two_pass, mean", "volpathmis, mean", "ratio", "known to", "RMSE of blocks"]
    fill(DOCS / "benchmarks.md", "diffusion_error", f"`{COMMAND}`\n\n{markdown_table(head, rows)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    setup = QUICK if quick else Setup()
    mi.set_variant("llvm_ad_rgb")
    results, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for material in MATERIALS:
            result, ours, truth = compare(material, Path(folder), setup)
            results.append(result)
            scale = SHOWN_MEAN / max(result["volume"])  # one exposure for both
            signed = 0.5 + 2 * scale * (ours - truth).mean(axis=-1, keepdims=True).repeat(3, axis=-1)
            shown = ((f"{material}, two_pass", scale * ours), ("volpathmis", scale * truth), ("2 x difference", signed))
            rows.append([(caption, enlarged(picture, 3)) for caption, picture in shown])
    if not quick:
        save("diffusion_error", COMMAND, {"size": SIZE, "results": results})
        save_rows(FIGURES / "diffusion_error.png", rows)
        table(results)
    else:
        save_rows(Path(tempfile.gettempdir()) / "diffusion_error.png", rows)


if __name__ == "__main__":
    main()
