"""How well media are found from pictures of them, and what a gradient costs: beside the sum, and beside path tracing.

    python benchmarks/fit.py

writes docs/figures/fit.json after every part, and the tables of docs/gradients.md. Takes twenty minutes on two cores; ``--only PART`` keeps
the saved results of the others, ``--quick`` goes through the same steps with few samples, and writes nothing.

The pictures show a block under half a sky (`support.block`): pellucid's own, with other samples, and those of the volumetric path tracer
``volpathmis`` behind a smooth surface, which knows nothing of profiles. Three views are fitted, a fourth is predicted.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import pellucid

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.model.medium import Medium
from support.block import block_spec, counted, in_units
from support.fit_cost import gradient_cost
from support.fit_speed import gradient_speed
from support.record import DOCS, fill, markdown_table, save, saved
from support.volume import volume_path_tracer

COMMAND = "python benchmarks/fit.py"
PAGE = DOCS / "gradients.md"
MATERIALS, COSINES = ("marble", "skin1", "ketchup"), (0.0, 0.8)
STARTS = ((1.6, 0.7), (0.6, 1.6), (1.3, 1.4))
"""Factors on the absorption and scattering of the medium with which a fit begins."""

FITTED, PREDICTED = 3, 3
"""How many views are fitted, and the number of the one that is predicted."""


@dataclass
class Setup:
    """How much work: pixels along a side, samples a pixel of volumes by material and mean cosine, and surface samples."""

    size: int = 64
    volume_spp: tuple[tuple[int, int], ...] = ((64, 24), (128, 128), (384, 384))
    sample_count: int = 80_000
    paths: int = 48
    spp: int = 4
    starts: int = 3
    evaluations: int = 40


QUICK = Setup(24, ((4, 2), (8, 8), (16, 16)), 2000, 8, 1, 1, 3)


def block(medium: Medium, setup: Setup) -> mi.Scene:
    """Load the scene with a translucent block."""
    colours = {name: {"type": "rgb", "value": getattr(medium, name).tolist()} for name in ("sigma_a", "sigma_s_prime")}
    bsdf = {"type": "pellucid_translucent", **colours, "g": medium.g, "eta": medium.eta, "alpha": 0.0}
    return pellucid.load_scene(block_spec({"bsdf": bsdf}, setup.size))


def volume_photos(medium: Medium, setup: Setup, spp: int) -> list[np.ndarray]:
    """Render all views of the block as a volume."""
    largest = float(medium.sigma_t.max())
    interior = {
        "type": "homogeneous",
        "scale": largest,
        "sigma_t": {"type": "rgb", "value": (medium.sigma_t / largest).tolist()},
        "albedo": {"type": "rgb", "value": medium.albedo.tolist()},
        "phase": {"type": "hg", "g": medium.g} if medium.g else {"type": "isotropic"},
    }
    smooth = {"type": "dielectric", "int_ior": medium.eta, "ext_ior": 1.0}
    scene = pellucid.load_scene(block_spec({"bsdf": smooth, "interior": interior}, setup.size))
    views = range(FITTED + 1)
    tracer = volume_path_tracer(medium.g)
    return [mi.render(scene, sensor=k, integrator=tracer, spp=spp, seed=k).numpy() for k in views]


def own_photos(medium: Medium, setup: Setup) -> list[np.ndarray]:
    """Render all views by pellucid, with more and other samples than a fit has."""
    scene = block(medium, setup)
    kind = {"type": "pellucid_two_pass", "seed": 9, "sample_count": 3 * setup.sample_count}
    integrator: Any = mi.load_dict(kind)
    integrator.prepared = integrator.prepare_scene(scene)
    return [integrator.render(scene, sensor=k, seed=50 + k, spp=4 * setup.spp).numpy() for k in range(FITTED + 1)]


def recover(true: Medium, photos: list[np.ndarray], parameters: str, setup: Setup) -> dict[str, Any]:
    """Fit the medium of photos from every start, and compare it with the true one."""
    runs = []
    for absorption, scattering in STARTS[: setup.starts]:
        begin = Medium(true.sigma_s_prime * scattering, true.sigma_a * absorption, true.g, true.eta)
        scene = block(begin, setup)
        masks = [counted(scene, k) for k in range(FITTED)]
        since = time.process_time()
        work = {"spp": setup.spp, "sample_count": setup.sample_count, "irradiance_paths": setup.paths}
        found = pellucid.fit(
            scene, photos[:FITTED], masks, parameters=parameters, max_evaluations=setup.evaluations, **work
        )
        runs.append((found, time.process_time() - since))
        print(*found.summary(), f"{found.evaluations} media, {runs[-1][1]:.0f} processor s", sep="\n", flush=True)
    found, seconds = runs[0]
    known = {name: np.ravel(getattr(true, _name(name))) for name in ("reflectance", "dmfp", "sigma_a", "sigma_s_prime")}
    errors = {name: (getattr(found.medium, _name(name)) / value - 1).tolist() for name, value in known.items()}
    fitted = dict.fromkeys(name.split(".")[0] for name in found.names)
    off = np.log(found.values / np.concatenate([known[name] for name in fitted]))
    deviations = np.array(list(found.standard_deviation.values()))
    values = np.log([run.values for run, _ in runs])
    return {
        "errors": errors,
        "deviations": deviations.tolist(),
        "off_in_deviations": (off / deviations).tolist(),
        "starts_differ": float(np.exp(np.ptp(values, axis=0).max()) - 1),
        "residual": found.residual,
        "condition_number": found.condition_number,
        "evaluations": found.evaluations,
        "processor_seconds": seconds,
        "predicted": predicted(found.medium, photos[PREDICTED], setup),
    }


def predicted(medium: Medium, photo: np.ndarray, setup: Setup) -> dict[str, list[float]]:
    """Compare the mean of the view that was not fitted with that of a picture of the medium; its noise is that of the photo's mean."""
    scene = block(medium, setup)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "sample_count": setup.sample_count})
    picture = mi.render(scene, sensor=PREDICTED, integrator=integrator, spp=4 * setup.spp).numpy()
    mask = counted(scene, PREDICTED) > 0
    ours, theirs = picture[mask], photo[mask]
    noise = (theirs - ours).std(axis=0) / np.sqrt(len(ours)) / theirs.mean(axis=0)
    return {"error": (ours.mean(axis=0) / theirs.mean(axis=0) - 1).tolist(), "noise": noise.tolist()}


def _name(parameter: str) -> str:
    return "total_diffuse_reflectance" if parameter == "reflectance" else parameter


def percent(values: list[float]) -> str:
    """Write relative errors of the three channels."""
    return ", ".join(f"{100 * v:+.1f}" for v in values)


def accuracy_table(results: dict[str, Any]) -> str:
    """Write what was found of every medium."""
    head = [
        "medium",
        "reflectance [%]",
        "mean free path [%]",
        "truth within two deviations (at most off)",
        "starts differ [%]",
        "fourth view (noise) [%]",
        "condition",
        "processor s",
    ]
    rows = []
    for name, r in results.items():
        errors, view = r["errors"], r["predicted"]
        worst = max(np.abs(r["off_in_deviations"]))
        noise = f"{percent(view['error'])} ({100 * max(view['noise']):.1f})"
        rows.append(
            [
                name,
                percent(errors["reflectance"]),
                percent(errors["dmfp"]),
                f"{'yes' if worst < 2 else 'no'} ({worst:.1f})",
                f"{100 * r['starts_differ']:.1f}",
                noise,
                f"{r['condition_number']:.0f}",
                f"{r['processor_seconds']:.0f}",
            ]
        )
    return markdown_table(head, rows)


def own_table(r: dict[str, Any]) -> str:
    """Write what was found of pellucid's own pictures."""
    head = ["", "red", "green", "blue"]
    rows = [[name, *(f"{100 * v:+.2f} %" for v in r["errors"][name])] for name in ("sigma_a", "sigma_s_prime")]
    return markdown_table(head, rows)


def speed_table(r: dict[str, Any]) -> str:
    """Write what gradients take, and how sure they are."""
    head = ["gradient by", "`pellucid_two_pass`", "`prbvolpath`", "time at equal noise"]
    rows = [
        [f"`{name}`", *(f"{m['seconds']:.2f} s, {100 * m['noise']:.2g} %" for m in both), f"{ratio:.0f} to 1"]
        for name, both, ratio in ((n, (v["pellucid"], v["prbvolpath"]), v["ratio"]) for n, v in r.items())
    ]
    return markdown_table(head, rows)


def cost_table(r: dict[str, Any]) -> str:
    """Write how often the sum could be evaluated while its gradient is."""
    head = [
        "sum",
        "processor s",
        "gradient by the coefficients, times the sum",
        "and by all powers, times the sum",
        "tables of slopes [s]",
    ]
    rows = [
        [name, f"{t['sum']:.3f}", *(f"{t[k] / t['sum']:.1f}" for k in ("coefficients", "powers")), f"{t['tables']:.2f}"]
        for name, t in r.items()
    ]
    return markdown_table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few samples; writes nothing")
    media = [f"{material}, g = {g:g}" for material in MATERIALS for g in COSINES]
    names = ["own", *media, "cost", "speed"]
    parser.add_argument("--only", choices=names, metavar="PART", help="one of: " + "; ".join(names))
    arguments = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    setup, quick = (QUICK, True) if arguments.quick else (Setup(), False)
    results = {} if quick else saved("fit")
    for name in [arguments.only] if arguments.only else names:
        results[name] = measure(name, setup)
        print(name, results[name], flush=True)
        if not quick:
            save("fit", COMMAND, results)
    if not quick:
        tables(results, media)


def tables(results: dict[str, Any], media: list[str]) -> None:
    """Fill the tables of the parts that have been measured."""
    if measured := {name: results[name] for name in media if name in results}:
        fill(PAGE, "fit: media", accuracy_table(measured))
    for name, table in (("own", own_table), ("cost", cost_table), ("speed", speed_table)):
        if name in results:
            fill(PAGE, f"fit: {name}", table(results[name]))


def measure(name: str, setup: Setup) -> dict[str, Any]:
    """Measure one part."""
    if name == "own":
        true, _ = in_units(Medium.from_preset("marble"))
        return recover(true, own_photos(true, setup), "coefficients", setup)
    if name == "cost":
        return gradient_cost(*((1, 7) if setup.starts > 1 else (20, 1)))
    if name == "speed":
        return gradient_speed(setup.size // 2, setup.sample_count // 4, 8 if setup.starts > 1 else 2)
    material, g = name.split(", g = ")
    preset = Medium.from_preset(material)
    true, _ = in_units(Medium(preset.sigma_s_prime, preset.sigma_a, float(g), preset.eta))
    spp = setup.volume_spp[MATERIALS.index(material)][COSINES.index(float(g))]
    return recover(true, volume_photos(true, setup, spp), "reflectance", setup)


if __name__ == "__main__":
    main()
