"""How wrong single eye points are: the modes of the single pass against the sum over all triples.

    python benchmarks/single_pass_error.py

writes docs/figures/single_pass_error.json and .png, scene by scene, and the table of docs/benchmarks.md between its marks. Takes
about three minutes on two cores; ``--only kitchen`` measures one scene and keeps what is saved of the others, ``--quick`` goes
through the same steps in one minute, and writes nothing.

Scenes are made smaller in mean free paths, until the sum over all triples takes seconds: samples are as dense as always.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.methods.single_pass.modes import reflectance
from pellucid.methods.single_pass.trees.light_tree import LUMINANCE
from support.record import DOCS, FIGURES, fill, markdown_table, save, saved
from support.scenes import published
from support.single_pass import PUBLISHED, at_once, evaluate, some, take_picture, values

COMMAND = "python benchmarks/single_pass_error.py"
NAME = "single_pass_error"
SCENES: dict[str, dict[str, Any]] = {
    "teapot_table": {"size": 47.0},  # 8,000 samples
    "kitchen": {"samples": 60_000, "detail": 128},
    "mezquita": {"samples": 60_000, "bays": (4, 8)},
}
LIGHTS = {"direct": 256, "indirect": 2000}
MODES: dict[str, dict[str, Any]] = {
    "adaptive": {},
    "adaptive, 1 %": {"max_error": 0.01},
    "two_pass": {"mode": "two_pass"},
    "cut": {"mode": "cut"},
    "cut, m = 8": {"mode": "cut", "alternation": 8},
    "cut, 1 %": {"mode": "cut", "max_error": 0.01},
}
QUANTILES = (0.5, 0.95, 0.99)
GOAL = 0.02


def measure(name: str, resolution: tuple[int, int], points: int, **smaller: Any) -> dict[str, Any]:
    """Compare all modes at the same eye points of one scene, over the same samples and lights."""
    method = {**PUBLISHED, **LIGHTS}
    spec = published(name, resolution=resolution, integrator=method, **SCENES[name] | smaller)
    picture = take_picture(spec, 1, warm=False)
    # Of darker bodies errors are not relative to their own light.
    bright = [
        s for s in picture.seen if reflectance(s.body.prototype.bodies[0].medium) > picture.state.mode.least_reflectance
    ]
    chosen = some(at_once(bright), points, np.random.default_rng(0))
    row: dict[str, Any] = {
        "samples": picture.effort.counts["samples"],
        "light_samples": picture.effort.counts["light samples"],
        "eye_points": sum(len(s) for s in chosen),
        "modes": {},
    }
    found, _, seconds = evaluate(picture.scene, picture.prepared_with(mode="exact")[0], chosen)
    exact = values(found)
    print(f"{name}: {row['samples']:,} samples, {row['eye_points']:,} eye points, exact in {seconds:.1f} s", flush=True)
    everywhere = sum(len(s) for s in picture.seen)
    for label, options in MODES.items():
        start = time.perf_counter()
        state, preparing = picture.prepared_with(**options)
        found, spent, _ = evaluate(picture.scene, state, chosen)
        rays = preparing.counts["shadow rays"] / everywhere + spent.counts["shadow rays"] / row["eye_points"]
        row["modes"][label] = distribution(values(found), exact) | {
            "rays_a_point": rays,
            "cut_size": spent.counts["links"] / row["eye_points"],
            "full": spent.counts["full cuts"] / row["eye_points"],
        }
        shown = {k: v for k, v in row["modes"][label].items() if k != "curve"}
        print(f"  {label}: {time.perf_counter() - start:.1f} s {shown}", flush=True)
    return row


def distribution(found: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    """Describe the relative errors of the luminance of eye points that are lit at all."""
    a, b = found @ LUMINANCE, exact @ LUMINANCE
    lit = b > 0
    error = np.abs(a[lit] / b[lit] - 1)
    return {
        "rms": float(np.sqrt(np.mean(error**2))),
        "quantiles": [float(q) for q in np.quantile(error, QUANTILES)],
        "max": float(error.max()),
        "within": float(np.mean(error < GOAL)),
        "within_twice": float(np.mean(error < 2 * GOAL)),
        "rmse": float(np.sqrt(np.mean(np.square(found - exact))) / exact.mean()),
        "bias": float(a.mean() / b.mean() - 1),
        "curve": [float(q) for q in np.quantile(error, np.linspace(0, 1, 201))],
    }


def tables(rows: dict[str, Any]) -> None:
    """Put the distributions into the documentation."""
    head = [
        "scene",
        "mode",
        "rms",
        "RMSE over the mean",
        *(f"{q:.0%}" for q in QUANTILES),
        "largest",
        f"below {GOAL:.0%}",
        f"{2 * GOAL:.0%}",
        "bias of the mean",
        "cut size",
        "full cuts",
    ]
    body = [
        [name, label, f"{m['rms']:.2%}", f"{m['rmse']:.2%}", *(f"{q:.2%}" for q in m["quantiles"]), f"{m['max']:.1%}", f"{m['within']:.1%}",
         f"{m['within_twice']:.1%}", f"{m['bias']:+.2%}",
         *((f"{m['cut_size']:,.0f}", f"{m['full']:.0%}") if label.startswith("cut") else ("", ""))]
        for name, row in rows.items()
        for label, m in row["modes"].items()
    ]  # fmt: skip
    sizes = "; ".join(
        f"{name}: {row['samples']:,} irradiance samples, {row['light_samples']:,} light samples, {row['eye_points']:,} eye points"
        for name, row in rows.items()
    )
    fill(DOCS / "benchmarks.md", NAME, f"`{COMMAND}`\n\n{markdown_table(head, body)}\n\n{sizes}.")


def plot(rows: dict[str, Any]) -> None:
    """Draw the share of eye points over the error that they do not exceed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(rows), figsize=(3.4 * len(rows), 3.2), layout="constrained", squeeze=False)
    for axis, (name, row) in zip(axes[0], rows.items(), strict=True):
        for label, m in row["modes"].items():
            axis.semilogx(np.maximum(m["curve"], 1e-5), np.linspace(0, 1, len(m["curve"])), label=label)
        axis.axvline(GOAL, color="0.7", lw=0.8)
        axis.set(xlabel="relative error", title=name, xlim=(1e-4, 1), ylim=(0, 1))
    axes[0][0].set(ylabel="share of eye points")
    axes[0][0].legend()
    figure.savefig(FIGURES / f"{NAME}.png", dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs; writes nothing")
    parser.add_argument("--only", choices=list(SCENES), help="measure one scene, keep the others")
    arguments = parser.parse_args()
    for name in [arguments.only] if arguments.only else SCENES:
        if arguments.quick:
            measure(
                name, (64, 48), 256, **({"size": 20.0} if name == "teapot_table" else {"samples": 5000, "detail": 56})
            )
            continue
        row = measure(name, (240, 180), 4096)
        rows = saved(NAME) | {name: row}
        rows = {name: rows[name] for name in SCENES if name in rows}
        save(NAME, COMMAND, rows)
        tables(rows)
        plot(rows)


if __name__ == "__main__":
    main()
