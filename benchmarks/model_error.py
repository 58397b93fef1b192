"""How wrong is pellucid: the teapot by each profile and by a volumetric path tracer, for six materials.

    python benchmarks/model_error.py

writes docs/figures/model_error.json and .png, and the table of docs/benchmarks.md between its marks. Takes about
a quarter of an hour on two cores; ``--quick`` goes through the same steps in one minute, and writes nothing.

The volume has the reduced coefficients and scatters isotropically, inside the same smooth surface, so the pictures
differ by the profile alone: the dipole by diffusion and by taking every place for a flat half space, the tabulated one by
the second, the curved one by what two curvatures and the thickness do not tell of the shape. The teapot is a small one
(`SIZE`), where the second matters more than on one of full size, and where every channel's light still ends in minutes.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.model.medium import CHANNELS, Medium
from support.images import enlarged, save_rows
from support.pixels import body_mask
from support.record import DOCS, FIGURES, fill, markdown_table, save
from support.scenes import load, teapot_spec
from support.volume import as_volume, volume_path_tracer

COMMAND = "python benchmarks/model_error.py"
MATERIALS = ("marble", "wholemilk", "apple", "skin2", "skin1", "ketchup")
PROFILES = ("dipole", "tabulated", "curved")
SIZE = 100.0  # [mm]
SAMPLES = 150_000
LEAST_BATCHES = 5
SHOWN_MEAN = 0.35
KNOWN = 0.03
"""Standard error of the brightness of a block at which it is known well enough to be among the extremes."""


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
    block: int = 6
    """Side of the blocks of pixels that are compared."""


QUICK = Setup((48, 36), 16, 0.1, 4, LEAST_BATCHES)


class Subject(NamedTuple):
    """What is compared: the body under a key of a scene that is described for every profile, and its medium."""

    name: str
    medium: Medium
    key: str
    described: Callable[[str, Setup], dict[str, Any]]


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


def compare(subject: Subject, folder: Path, setup: Setup) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Render a body by every profile and as a volume: how they differ, and the pictures."""
    pictures: dict[str, np.ndarray] = {}
    for profile in PROFILES:
        spec = subject.described(profile, setup)
        scene = load(spec)
        integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": SAMPLES, "irradiance_paths": 64})
        integrator.prepared = integrator.prepare_scene(scene)
        mask = body_mask(scene, scene.sensors()[0], integrator.prepared.lookup, eroded=1)
        pictures[profile] = np.array(integrator.render(scene, 0, 0, setup.two_pass_spp))
    batches = volume_pictures(load(as_volume(spec, subject.key, subject.medium, folder)), mask, setup)
    error, true_mean = error_of_mean([p[mask].mean(axis=0) for p in batches])
    # In blocks of pixels the noise of the volume is small enough to be subtracted.
    noise, true_blocks = error_of_mean([blocks(p, mask, setup.block) for p in batches])
    result: dict[str, Any] = {
        "name": subject.name,
        "volume": true_mean.tolist(),
        "ratio_error": (error / true_mean).tolist(),
        "noise": float(np.sqrt(np.mean(noise**2)) / true_blocks.mean()),
        "spp": setup.batch * len(batches),
        "profiles": {},
    }
    for profile, picture in pictures.items():
        ours = blocks(picture, mask, setup.block)
        squared = np.mean((ours - true_blocks) ** 2) - np.mean(noise**2)
        ratio, rmse = picture[mask].mean(axis=0) / true_mean, float(np.sqrt(max(squared, 0)) / true_blocks.mean())
        result["profiles"][profile] = {"ratio": ratio.tolist(), "rmse": rmse, **extremes(ours, true_blocks, noise)}
        ratios = ", ".join(
            f"{c} {r:.3f} +- {e:.3f}" for c, r, e in zip(CHANNELS, ratio, result["ratio_error"], strict=True)
        )
        print(f"{subject.name:10} {profile:10} over the volume: {ratios};  RMSE {rmse:.1%}", flush=True)
    print(f"{subject.name:10} noise {result['noise']:.1%}, {result['spp']} samples a pixel", flush=True)
    return result, pictures | {"volpathmis": batches.mean(axis=0)}


def extremes(ours: np.ndarray, truth: np.ndarray, noise: np.ndarray) -> dict[str, float | None]:
    """Find the least and the largest ratio of a block's brightness, the mean of its channels, among those that are known well enough."""
    told = np.linalg.norm(noise, axis=1) / 3 < KNOWN * truth.mean(axis=1)
    ratio = ours[told].mean(axis=1) / truth[told].mean(axis=1)
    return (
        {"least": float(ratio.min()), "largest": float(ratio.max())} if told.any() else {"least": None, "largest": None}
    )


def teapot(material: str) -> Subject:
    """Put the teapot of a material behind a smooth surface."""

    def described(profile: str, setup: Setup) -> dict[str, Any]:
        bsdf = {"type": "pellucid_translucent", "material": material, "alpha": 0.0, "profile": profile}
        return teapot_spec(setup.resolution, size=SIZE, bsdf=bsdf)

    return Subject(material, Medium.from_preset(material), "teapot", described)


def blocks(picture: np.ndarray, mask: np.ndarray, size: int) -> np.ndarray:
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

    rows = [
        [
            r["material"],
            triple(Medium.from_preset(r["material"]).albedo_prime, ".3f"),
            triple(r["volume"], ".3f"),
            f"{max(r['ratio_error']):.1%}",
            *(f"**{triple(r['profiles'][p]['ratio'], '.2f')}**; {r['profiles'][p]['rmse']:.1%}" for p in PROFILES),
        ]
        for r in results
    ]
    head = [
        "material",
        "albedo'",
        "volpathmis, mean",
        "known to",
        *(f"`{profile}`: ratio; RMSE" for profile in PROFILES),
    ]
    fill(DOCS / "benchmarks.md", "model_error", f"`{COMMAND}`\n\n{markdown_table(head, rows)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    setup = QUICK if quick else Setup()
    mi.set_variant("llvm_ad_rgb")
    results, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for material in MATERIALS:
            result, pictures = compare(teapot(material), Path(folder), setup)
            results.append({"material": material, **result})
            scale = SHOWN_MEAN / max(result["volume"])  # one exposure for all
            rows.append([(f"{material}, {name}", enlarged(scale * p, 3)) for name, p in pictures.items()])
    if not quick:
        save("model_error", COMMAND, {"size": SIZE, "results": results})
        save_rows(FIGURES / "model_error.png", rows)
        table(results)
    else:
        save_rows(Path(tempfile.gettempdir()) / "model_error.png", rows)


if __name__ == "__main__":
    main()
