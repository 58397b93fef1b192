"""Figure 3 of Jensen and Buhler 2002: what the hierarchy saves on the marble teapot.

    python benchmarks/figure3.py

writes docs/figures/figure3.json and two pictures, and the table of docs/benchmarks.md between their marks. Takes about
ten minutes on two cores; ``--quick`` goes through the same steps in one, with a small picture, and writes nothing.

The kernels are compiled into an empty cache of this run's own, so that compilation times are those of a first run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ["HOME"] = tempfile.mkdtemp(prefix="figure3-")  # where Dr.Jit keeps its kernels

import pellucid  # noqa: F401, I001  (points Dr.Jit at its LLVM, which has to come before mitsuba)

import mitsuba as mi
import numpy as np

from support.images import save_row
from support.pixels import body_mask
from support.record import DOCS, FIGURES, fill, markdown_table, median, save
from support.reference import CONVERGED_PATHS, Reference, converge, parts_of_error
from support.scenes import load, teapot_spec, with_dipoles
from support.timing import run, timed
from support.volume import as_volume, volume_path_tracer
from pellucid.cli.reporter import StageClock
from pellucid.model.medium import Medium
from pellucid.progress import reporting_to

COMMAND = "python benchmarks/figure3.py"
TEMPORARY = Path(os.environ["HOME"])
SPP = 4
SETTINGS: dict[str, dict[str, Any]] = {
    "the defaults": {},
    "64 light paths": {"irradiance_paths": 64},
    "four times the samples": {"sample_count": 600_000},
}
DEFAULT = next(iter(SETTINGS))
DEPTH = {"max_depth": 6, "irradiance_depth": 6}


@dataclass
class Setup:
    """How much work: the defaults are those of the figure."""

    resolution: tuple[int, int] = (1024, 768)
    repeats: int = 3
    pixels: int = 2048
    reference_samples: int = 2_400_000
    sampled_spp: tuple[int, int] = (8, 32)
    volume_resolution: tuple[int, int] = (128, 96)
    volume_spp: int = 16
    volume_renders: int = 4
    paths: int = CONVERGED_PATHS


QUICK = Setup((96, 72), 1, 32, 200_000, (2, 4), (24, 18), 2, 2, 64)


def method(name: str, **settings: Any) -> Any:
    return mi.load_dict({"type": f"pellucid_{name}", **DEPTH, **settings})


def with_exitance(name: str, prepared: Any) -> Any:
    """Make an integrator that also writes the exitance, from what another has prepared."""
    integrator = method(name, aovs="exitance")
    integrator.prepared = prepared
    return integrator


def render(integrator: Any, scene: Any, spp: int, seed: int = 0) -> Any:
    return integrator.render(scene, 0, seed, spp)


# ------------------------------------------------------------------ (a) the two passes


def hierarchical(scene: Any, settings: dict[str, Any], setup: Setup) -> tuple[dict[str, Any], Any]:
    """Time a hierarchical picture and its stages; return also what was prepared."""
    integrator = method("two_pass", **settings)
    totals, stages, own = [], [], []

    def picture() -> Any:
        clock = StageClock()
        with reporting_to(clock):
            integrator.prepared = integrator.prepare_scene(scene)
            seconds, result = run(lambda: render(integrator, scene, SPP))
        own.append(clock.times.pop("exitance"))  # a part of the picture
        stages.append({**clock.times, "picture": seconds})
        return result

    for _ in range(setup.repeats + 1):
        totals.append(run(picture)[0])
    result = {
        "samples": len(integrator.prepared.bodies[0].samples.p),
        "seconds": {name: median(times[name] for times in stages[1:]) for name in stages[0]},
        "exitance": median(own[1:]),
        "total": median(totals[1:]),
    }
    result["compilation"] = max(0.0, totals[0] - result["total"])
    parts = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result["seconds"].items())
    print(f"  {parts}; in all {result['total']:.2f} s (and {result['compilation']:.1f} s of compilation)", flush=True)
    return result, integrator.prepared


# ------------------------------------------------------------------ (b) sampling the profile


def sampled(scene: Any, reference: Reference, setup: Setup) -> dict[str, Any]:
    """Time `pellucid_sampled`, of that what is its own and no path to the surface, and measure its noise at two numbers of samples."""
    plain, own = method("sampled"), []
    plain.prepared = plain.prepare_scene(scene)

    def picture() -> Any:
        clock = StageClock()
        with reporting_to(clock):
            result = render(plain, scene, SPP)
        own.append(clock.times["exitance"])
        return result

    timing = timed(picture, setup.repeats)
    seconds_per_spp, own_per_spp = timing.median / SPP, median(own[1:]) / SPP
    integrator = with_exitance("sampled", plain.prepared)
    errors, ratio = {}, 1.0
    for spp in setup.sampled_spp:
        picture = np.array(render(integrator, scene, spp, seed=spp))
        errors[spp] = reference.error(picture)
        ratio = float(picture[reference.rows, reference.columns, 3:6].mean() / reference.exitance.mean())
        print(f"  sampled, {spp} samples a pixel: RMSE {errors[spp]:.2%}, {spp * seconds_per_spp:.1f} s")
    few, many = setup.sampled_spp
    slope = np.log(errors[many] / errors[few]) / np.log(many / few)
    print(f"  slope {slope:.2f}; mean over that of the reference {ratio:.4f}")
    return {
        "seconds_per_spp": seconds_per_spp,
        "own_per_spp": own_per_spp,
        "compilation": timing.compilation,
        "errors": {str(spp): error for spp, error in errors.items()},
        "slope": float(slope),
        "mean_ratio": ratio,
        "error_of_one": errors[many] * many**0.5,
    }


def equal_error(noisy: dict[str, Any], picture: dict[str, Any], error: float) -> dict[str, float]:
    """Extrapolate the samples and the time that `sampled` needs for an error, against the time of a hierarchical picture.

    `sampled` traces a path to the surface for each of its samples. ``once`` is its time if it traced as many as the hierarchical
    picture, and drew all its samples at their ends.
    """
    spp, total = (noisy["error_of_one"] / error) ** 2, picture["total"]
    seconds = spp * noisy["seconds_per_spp"]
    once = picture["seconds"]["picture"] - picture["exitance"] + spp * noisy["own_per_spp"]
    print(f"  RMSE {error:.2%}: {spp:.0f} samples, {seconds:.0f} s against {total:.2f} s: {seconds / total:.0f} times; "
          f"paths to the surface once: {once / total:.0f} times")  # fmt: skip
    return {"spp": spp, "seconds": seconds, "ratio": seconds / total, "once": once, "once_ratio": once / total}


# ------------------------------------------------------------------ (c) the volume


def volumetric(target: float, setup: Setup) -> dict[str, Any]:
    """Measure the noise of `volpathmis` on a coarse picture, and extrapolate to the size and the RMSE of the figure."""
    medium = Medium.from_preset("marble", profile="dipole")
    spec = with_dipoles(teapot_spec(setup.volume_resolution))
    mask = teapot_mask(load(spec))
    scene = load(as_volume(spec, "teapot", medium, TEMPORARY))
    integrator = volume_path_tracer()
    seconds, pictures = [], []
    for seed in range(setup.volume_renders + 1):
        spent, picture = run(lambda seed=seed: render(integrator, scene, setup.volume_spp, seed))
        seconds.append(spent)
        pictures.append(np.array(picture)[mask])
    variance = np.var(pictures[1:], axis=0, ddof=1).mean()
    noise = float(np.sqrt(variance) / np.mean(pictures))
    paths = int(np.prod(setup.volume_resolution)) * setup.volume_spp
    per_path = median(seconds[1:]) / paths
    needed = setup.volume_spp * (noise / target) ** 2
    total = needed * per_path * float(np.prod(setup.resolution))
    print(f"  volpathmis, {setup.volume_spp} samples a pixel: RMSE {noise:.1%}, {1e6 * per_path:.1f} us a path")
    print(f"  needs {needed:.3g} samples a pixel: {total / 3600:.3g} hours")
    return {
        "spp": setup.volume_spp,
        "noise": noise,
        "seconds_per_path": per_path,
        "spp_needed": needed,
        "seconds_needed": total,
    }


def teapot_mask(scene: Any) -> np.ndarray:
    """Tell which pixels show the teapot, away from its outline."""
    from pellucid.methods.preparation import open_scene

    return body_mask(scene, scene.sensors()[0], open_scene(scene).lookup, eroded=1)


# ------------------------------------------------------------------ results


def plot(results: dict[str, Any], path: Path) -> None:
    """Draw error against time: points for the hierarchy, and the lines along which noise falls."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(6.4, 4), layout="constrained")
    pictures, b, c = list(results["hierarchical"].values()), results["sampled"], results["volume"]
    least = min(a["error"] for a in pictures)
    axis.loglog([a["total"] for a in pictures], [a["error"] for a in pictures], "o", color="tab:red", label="two_pass")
    spp = np.array([int(s) for s in b["errors"]])
    axis.loglog(spp * b["seconds_per_spp"], list(b["errors"].values()), "s", color="tab:blue", label="sampled")
    start = c["seconds_needed"] * (pictures[0]["error"] / c["noise"]) ** 2
    axis.loglog(start, c["noise"], "^", color="tab:green", label="Mitsuba's volpathmis")
    for seconds, error, color in (
        (spp[0] * b["seconds_per_spp"], b["errors"][str(spp[0])], "tab:blue"),
        (start, c["noise"], "tab:green"),
    ):
        axis.loglog([seconds, seconds * (error / least) ** 2], [error, least], "--", lw=1, color=color)
    axis.set(xlabel="time [s], compilation apart", ylabel="RMSE / mean", title="Marble teapot, 1024 wide")
    axis.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def tables(results: dict[str, Any]) -> None:
    """Put the results into the documentation."""
    b, c = results["sampled"], results["volume"]
    default = results["hierarchical"][DEFAULT]
    document = DOCS / "benchmarks.md"
    head = [
        "`pellucid_two_pass`", "samples", "time", "RMSE / mean", "`pellucid_sampled` needs", "times", "paths traced once: times",
        "RMSE, same samples", "`sampled` needs", "times", "paths traced once: times",
    ]  # fmt: skip
    rows = [
        [how, f"{a['samples']:,}", f"{a['total']:.2f} s",
         f"{a['error']:.2%}", f"{a['all']['seconds']:.0f} s", f"**{a['all']['ratio']:.0f}**", f"**{a['all']['once_ratio']:.0f}**",
         f"{a['same_samples']:.2%}", f"{a['same']['seconds']:.0f} s", f"**{a['same']['ratio']:.0f}**", f"**{a['same']['once_ratio']:.0f}**"]
        for how, a in results["hierarchical"].items()
    ]  # fmt: skip
    stages = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in default["seconds"].items())
    days = c["seconds_needed"] / 86400
    text = (
        f"`{COMMAND}`\n\n{markdown_table(head, rows)}\n\n"
        f"The first row is made of {stages}; a first run compiles for {default['compilation']:.1f} s more. Clusters alone are "
        f"wrong by {default['clusters']:.3%}. One sample a pixel of `sampled` takes {b['seconds_per_spp']:.2f} s, of which "
        f"{b['own_per_spp'] / b['seconds_per_spp']:.0%} are its own and the rest is a path to the surface. Its RMSE falls with the "
        f"power {b['slope']:.2f} of their number, and its mean is {b['mean_ratio']:.3f} of that of the reference. "
        f"`volpathmis` needs {days:.2g} days and {c['spp_needed']:.2g} samples a pixel for the RMSE of the first row: "
        f"**{c['seconds_needed'] / default['total']:.2g}** times."
    )
    fill(document, "figure3", text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    setup = QUICK if quick else Setup()
    mi.set_variant("llvm_ad_rgb")
    scene = load(with_dipoles(teapot_spec(setup.resolution)))

    results: dict[str, Any] = {"setup": asdict(setup), "hierarchical": {}}
    pictures, prepared = results["hierarchical"], {}
    for how, settings in list(SETTINGS.items())[: 2 if quick else None]:
        print(f"The hierarchical picture, {how}", flush=True)
        pictures[how], prepared[how] = hierarchical(scene, settings, setup)
    print("A converged reference", flush=True)
    reference = converge(
        scene,
        prepared[DEFAULT],
        setup.pixels,
        **DEPTH,
        sampling="poisson",
        sample_count=setup.reference_samples,
        seed=12345,
    )
    for how, a in pictures.items():
        shown = np.array(render(with_exitance("two_pass", prepared[how]), scene, SPP))
        a["error"] = reference.error(shown)
        count = SETTINGS[how].get("sample_count", 0)
        a |= parts_of_error(scene, prepared[how], reference.points, setup.paths, **DEPTH, sample_count=count)
        print(
            f"  RMSE {a['error']:.3%}, on the same samples {a['same_samples']:.3%}, clusters {a['clusters']:.3%}: {how}"
        )
    print("Sampling the profile", flush=True)
    results["sampled"] = b = sampled(scene, reference, setup)
    for how, a in pictures.items():
        print(f"  {how}")
        a["all"], a["same"] = (equal_error(b, a, a[key]) for key in ("error", "same_samples"))
    print("The volume", flush=True)
    results["volume"] = volumetric(pictures[DEFAULT]["error"], setup)
    if quick:
        return
    save("figure3", COMMAND, results)
    plot(results, FIGURES / "figure3.png")
    total = pictures[DEFAULT]["total"]
    picture = np.array(render(with_exitance("two_pass", prepared[DEFAULT]), scene, SPP))
    spp = max(1, round(total / b["seconds_per_spp"]))
    noisy = np.array(render(with_exitance("sampled", None), scene, spp, seed=1))
    rows, columns = slice(160, 640), slice(272, 752)
    shown = [(f"two_pass, {total:.1f} s", picture), (f"sampled, {spp * b['seconds_per_spp']:.1f} s", noisy)]
    save_row(FIGURES / "figure3_equal_time.png", [(c, p[rows, columns, :3]) for c, p in shown])
    tables(results)


if __name__ == "__main__":
    try:
        main()
    finally:
        shutil.rmtree(TEMPORARY, ignore_errors=True)
