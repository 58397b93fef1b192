"""Figures 5 and 7 of Arbree, Walter and Bala 2008: what the single pass saves on their three scenes.

    python benchmarks/single_pass_table.py

writes docs/figures/single_pass_table.json, scene by scene, and the tables of docs/benchmarks.md between their marks. Takes up to
fifteen minutes a scene on two cores; ``--only mezquita`` measures one scene and keeps what is saved of the others, ``--tables``
measures nothing and writes the tables anew, ``--quick`` goes through the same steps on coarse scenes in a minute or two, and writes
nothing.

The reference of the paper lights every irradiance sample of the bodies that primary rays meet by Lightcuts. That and the paper's
cuts are run in part, on samples and eye points that are chosen at random, and scaled up. At equal error the reference has a looser
bound than in the paper, or smaller cuts, such that its exitance at eye points errs as much as that of the adaptive mode.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.effort import Effort
from support.equal_error import FINEST, against_all_lights, at_error, reference_errors
from support.record import save, saved
from support.scenes import published
from support.single_pass import (
    PUBLISHED,
    Cost,
    Cuts,
    Picture,
    Seen,
    at_once,
    evaluate,
    gather_reference,
    light_reference,
    only_by_others,
    polygons,
    samples_in_view,
    some,
    take_picture,
    values,
)
from support.single_pass_errors import call_judge
from support.single_pass_tables import COMMAND, NAME, PAPER, tables
from support.timing import run


@dataclass
class Setup:
    """How much work: the defaults are those of the tables.

    ``lit`` irradiance samples of the reference are lit, or one in a hundred where these are more, and all of them where there are no
    more than ``all_lit``; ``cuts`` are eye points at which the paper's cuts are run, ``windows`` pixels at which errors are counted,
    ``curve`` eye points at which the reference errs so much, and ``checked`` samples at which Lightcuts are compared with all lights.
    A picture is taken ``repeats`` times, and so is its reference, in turns; times are medians.
    """

    resolution: tuple[int, int] = (640, 480)
    spp: int = 4
    lit: int = 100_000
    all_lit: int = 250_000
    cuts: dict[str, int] | None = None
    windows: int = 600
    bodies: int = 24
    curve: int = 192
    checked: int = 1024
    repeats: int = 3


DEFAULT_CUTS = {"teapot_table": 4096, "kitchen": 4096, "mezquita": 1024}
QUICK = Setup((96, 72), 1, 4096, 0, dict.fromkeys(PAPER, 128), 12, 4, 16, 64, repeats=2)
COARSE: dict[str, dict[str, Any]] = {
    "teapot_table": {"detail": 6, "size": 50.0},
    "kitchen": {"detail": 48, "samples": 1e5},
    "mezquita": {"detail": 56, "samples": 1e5, "bays": (4, 8)},
}
FEW = {"direct": 256, "indirect": 2000}
ALL_BY_PATHS = 8_000_000
"""Samples at most of a scene that is also rendered with path-traced light."""


def say(text: str, start: list[float]) -> None:
    """Print what is done, and when."""
    print(f"  {time.perf_counter() - start[0]:6.1f} s  {text}", flush=True)


# ------------------------------------------------------------------ one scene


def measure(name: str, setup: Setup, quick: bool) -> dict[str, Any]:
    """Fill a row: the picture by the adaptive mode, and the other two at its eye points."""
    clock = [time.perf_counter()]
    # Eye points on bodies alone are compared: opaque surfaces are left to paths.
    method = {**PUBLISHED, "light_opaque": False, **(FEW if quick else {})}
    spec = published(name, resolution=setup.resolution, integrator=method, **(COARSE[name] if quick else {}))
    picture = take_picture(spec, setup.spp)
    effort, direct = picture.effort, at_once(picture.seen)
    say(f"adaptive: {picture.seconds:.1f} s, {effort.counts['shadow rays'] / 1e6:.2f} M rays, {picture.stages}", clock)
    reference, stages = [reference_cost(picture, direct, setup, clock)], [picture.stages]
    for _ in range(setup.repeats - 1):
        stages.append(take_picture(spec, setup.spp, warm=False).stages)
        reference.append(reference_cost(picture, direct, setup, clock))
    others = reference_light(picture, setup, only_by_others(picture.seen))
    eye_points = sum(len(s) for s in picture.seen)
    row: dict[str, Any] = {
        "setup": asdict(setup),
        "polygons": polygons(spec),
        "irradiance_samples": effort.counts["samples"],
        "in_view": samples_in_view(direct),
        "in_any_path": samples_in_view(picture.seen),
        "light_rays": effort.counts["light rays"],
        "light_samples": effort.counts["light samples"],
        "violations": effort.counts["violations"],
        "eye_points": eye_points,
        "direct_eye_points": sum(len(s) for s in direct),
        "every_stage": stages,
        "stages": medians(stages),
        "adaptive": of_effort(effort, eye_points) | {"exitance": medians(stages)["exitance"]},
        "reference": medians(reference),
        "others": {"shadow_rays": others.shadow_rays, "irradiance": others.seconds, "lit": others.done},
    }
    row["curve"], row["lights"] = loosened(picture, direct, row["reference"], setup, clock)
    row["two_pass"] = path_traced(picture, setup.spp, clock)
    row["half"], half = half_the_error(picture, clock)
    row["cut"], row["errors"] = errors(picture, direct, half, setup, name, clock)
    if not quick:  # of a few small pixels an error says nothing
        say(f"errors: {row['errors']}", clock)
    row["totals"] = totals(row)
    row["peak_bytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return row


def medians(runs: list[dict[str, float]]) -> dict[str, float]:
    """Take the median of each number over all runs."""
    return {key: type(value)(np.median([run[key] for run in runs])) for key, value in runs[0].items()}


def of_effort(effort: Effort, eye_points: int) -> dict[str, float]:
    """Put the counts of an effort into the terms of figure 5."""
    return {
        "shadow_rays": effort.counts["shadow rays"],
        "cut_size": effort.counts["links"] / eye_points,
        "rays_a_cut": effort.counts["shadow rays"] / eye_points,
        "receivers": effort.counts["receivers"],
    }


def half_the_error(picture: Picture, clock: list[float]) -> tuple[dict[str, float], list[Seen]]:
    """Prepare and evaluate the adaptive mode once more, at half the ``max_error``: what it took, and what it found."""
    state, spent = picture.prepared_with(max_error=picture.integrator.method.max_error / 2)
    found, gathering, _ = evaluate(picture.scene, state, picture.seen)
    spent.counts.update(gathering.counts)
    seconds = spent.seconds["exitance"] + gathering.seconds["exitance"]
    say(f"half the error: {seconds:.1f} s, {spent.counts['shadow rays'] / 1e6:.2f} M rays", clock)
    return of_effort(spent, sum(len(s) for s in picture.seen)) | {"exitance": seconds}, found


def reference_cost(picture: Picture, direct: list[Seen], setup: Setup, clock: list[float]) -> dict[str, Any]:
    """Measure both passes of the reference, scaled up from a part."""
    light = reference_light(picture, setup, direct)
    say(
        f"reference: {light.done:,} of {light.total:,} samples lit; all: {light.seconds:.0f} s, {light.shadow_rays / 1e6:.0f} M rays",
        clock,
    )
    tree, gathered = gather_reference(picture.seen, setup.bodies)
    say(f"reference: octrees {tree:.1f} s, sums {gathered.seconds:.1f} s from {gathered.done:,} eye points", clock)
    return {
        "shadow_rays": light.shadow_rays,
        "standard_error": light.standard_error,
        "irradiance": light.seconds,
        "lit": light.done,
        "lit_of": light.total,
        "tree": tree,
        "gather": gathered.seconds,
        "gathered": gathered.done,
    }


def loosened(
    picture: Picture, direct: list[Seen], reference: dict[str, Any], setup: Setup, clock: list[float]
) -> tuple[list[dict[str, float]], dict[str, float]]:
    """Measure what the reference takes with coarser cuts, and how much it errs; and how good Lightcuts are at single samples."""
    points = some(direct, setup.curve, np.random.default_rng(1), 1)
    curve = reference_errors(picture, points).curve()
    for row in curve:
        cuts = Cuts(row["max_error"], int(row["max_cut"]))
        if cuts == FINEST:
            row |= {key: reference[key] for key in ("shadow_rays", "irradiance")}
            continue
        light = reference_light(picture, setup, direct, cuts)
        row |= {"shadow_rays": light.shadow_rays, "irradiance": light.seconds}
    rays = ", ".join(f"{r['max_error']:.0%} {r['max_cut']}: {r['shadow_rays'] / 1e6:.0f} M" for r in curve)
    say(f"reference, rays by bound and largest cut: {rays}", clock)
    lights = against_all_lights(picture, points, setup.checked)
    say(f"Lightcuts against all lights at {lights['samples']:,} samples", clock)
    return curve, lights


def path_traced(picture: Picture, spp: int, clock: list[float]) -> dict[str, float] | None:
    """Take the picture by `pellucid_two_pass`, whose light is path traced: its time, and how far the two pictures are apart.

    Light paths and point lights have errors of their own, which are all in the difference. None of more samples than `ALL_BY_PATHS`.
    """
    if picture.effort.counts["samples"] > ALL_BY_PATHS:
        return None
    method = {"type": "pellucid_two_pass"}
    mi.load_dict(method | {"sample_count": 2000, "sampling": "poisson"}).render(picture.scene, spp=1)  # compiles
    integrator = mi.load_dict(method)

    def take() -> Any:
        integrator.prepared = integrator.prepare_scene(picture.scene)
        return integrator.render(picture.scene, spp=spp)

    seconds, image = run(take)
    samples = sum(len(lit.samples) for lit in integrator.prepared.bodies)
    squares = (np.array(image) - picture.image)[..., :3] ** 2
    difference = float(np.sqrt(squares.mean()) / picture.image[..., :3].mean())
    say(f"pellucid_two_pass: {seconds:.1f} s, {samples:,} samples, pictures differ by {difference:.2%}", clock)
    return {"seconds": seconds, "samples": samples, "difference": difference}


def reference_light(picture: Picture, setup: Setup, seen: list[Seen], cuts: Cuts = FINEST) -> Cost:
    """Measure the irradiance of the samples of all bodies that some eye points are on."""
    total = samples_in_view(seen)
    if not total:
        return Cost(0.0, 0.0, 0, 0)
    wanted = setup.all_lit if total <= setup.all_lit else max(setup.lit, total // 100)
    return light_reference(picture.scene, picture.state, seen, cuts, wanted)


def errors(
    picture: Picture, direct: list[Seen], half: list[Seen], setup: Setup, name: str, clock: list[float]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run the paper's cuts at some eye points; and compare both modes with the reference at some pixels."""
    scene, rng = picture.scene, np.random.default_rng(0)
    chosen = some(direct, (setup.cuts or DEFAULT_CUTS)[name], rng, 32)
    count = sum(len(s) for s in chosen)
    state = picture.prepared_with(mode="cut")[0]
    evaluate(scene, state, [s.take(np.arange(min(len(s), 16))) for s in chosen])  # compiles
    state = picture.prepared_with(mode="cut")[0]  # an empty cache
    _, spent, seconds = evaluate(scene, state, chosen)
    everywhere = sum(len(s) for s in picture.seen) / count
    cut = of_effort(spent, count) | {
        "seconds_a_point": seconds / count,
        "points": count,
        "exitance": seconds * everywhere,
        "shadow_rays": spent.counts["shadow rays"] * everywhere,
        "full": spent.counts["full cuts"] / count,
        "hit_rate": spent.counts["cache hits"] / max(spent.counts["irradiance links"], 1),
    }
    say(
        f"cut: {count} eye points in {seconds:.1f} s; size {cut['cut_size']:.0f}, {cut['rays_a_cut']:.0f} rays each",
        clock,
    )
    judge = call_judge(picture, setup.spp, setup.windows)
    plain = judge.plain()
    few = [s.take(index) for s, index in zip(judge.windows.take(picture.seen), plain, strict=True)]
    found = {"pixels": len(judge.windows.pixel), "points": sum(len(s) for s in few)}
    for mode, seen in (("adaptive", picture.seen), ("half", half)):
        everywhere = [s.exitance.numpy().T for s in judge.windows.take(seen)]
        picked = [value[index] for value, index in zip(everywhere, plain, strict=True)]
        found[mode] = judge.of_eye_points(picked, plain) | judge.of_picture(everywhere)
    cuts = [values(evaluate(scene, state, [s])[0]) if len(s) else np.zeros((0, 3)) for s in few]
    found["cut"] = judge.of_eye_points(cuts, plain)
    return cut, found


def totals(row: dict[str, Any]) -> dict[str, Any]:
    """Add up the times of each mode, and compare them with the reference."""
    stages, reference = row["stages"], row["reference"]
    shared = stages["samples"] + stages["lights"]
    pre = shared + reference["tree"] + reference["irradiance"]
    result: dict[str, Any] = {
        "pre": {"adaptive": shared, "cut": shared, "reference": pre},
        "total": {
            "adaptive": stages["surface"] + shared + row["adaptive"]["exitance"],
            "half": stages["surface"] + shared + row["half"]["exitance"],
            "cut": stages["surface"] + shared + row["cut"]["exitance"],
            "reference": stages["surface"] + pre + reference["gather"],
        },
    }
    scattering, others = pre - shared + reference["gather"], row["others"]
    for mode in ("adaptive", "half", "cut"):
        # The rays that choose virtual lights are a part of both.
        mine = row[mode]["shadow_rays"] + row["light_rays"]
        result[mode] = {
            "fewer_rays": (reference["shadow_rays"] + row["light_rays"]) / mine,
            "fewer_rays_every_path": (reference["shadow_rays"] + others["shadow_rays"] + row["light_rays"]) / mine,
            "faster": result["total"]["reference"] / result["total"][mode],
            "faster_every_path": (result["total"]["reference"] + others["irradiance"]) / result["total"][mode],
            "scattering_faster": scattering / row[mode]["exitance"],
        }
        if mode in row["errors"] and row["errors"][mode]["rmse"] > 0:
            loose, end = at_error(row["curve"], row["errors"][mode]["rmse"])
            total = result["total"]["reference"] - reference["irradiance"] + loose["irradiance"]
            result[mode]["equal"] = loose | {
                "total": total, "end": end,
                "fewer_rays": (loose["shadow_rays"] + row["light_rays"]) / mine,
                "faster": total / result["total"][mode],
            }  # fmt: skip
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarse scenes, to see that it runs; writes nothing")
    parser.add_argument("--only", choices=list(PAPER), help="measure one scene, keep the others")
    parser.add_argument("--tables", action="store_true", help="measure nothing, write the tables from what is saved")
    arguments = parser.parse_args()
    if arguments.tables:
        tables(saved(NAME))
        return
    if arguments.only is None:
        # Each scene in a process of its own: what one leaves in memory does not slow the next down.
        options = ["--quick"] if arguments.quick else []
        done = [subprocess.run([sys.executable, __file__, "--only", name, *options]).returncode for name in PAPER]
        sys.exit(max(map(abs, done)))
    print(arguments.only, flush=True)
    setup = QUICK if arguments.quick else Setup()
    row = measure(arguments.only, setup, arguments.quick)
    if not arguments.quick:
        print(f"  totals: {row['totals']}", flush=True)
        rows = saved(NAME) | {arguments.only: row}
        rows = {name: rows[name] for name in PAPER if name in rows}
        save(NAME, COMMAND, rows)
        tables(rows)


if __name__ == "__main__":
    main()
