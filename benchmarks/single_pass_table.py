"""Figures 5 and 7 of Arbree, Walter and Bala 2008: what the single pass saves on their three scenes.

    python benchmarks/single_pass_table.py

writes docs/figures/single_pass_table.json, scene by scene, and the tables of docs/benchmarks.md between their marks. Takes
about fifteen minutes on two cores; ``--only mezquita`` measures one scene and keeps what is saved of the others, ``--quick``
goes through the same steps on coarse scenes in a minute or two, and writes nothing.

The reference of the paper lights every irradiance sample of the bodies in view by Lightcuts. That and the paper's cuts are run
in part, on samples and eye points that are chosen at random, and scaled up.
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
from support.record import DOCS, fill, markdown_table, save, saved
from support.scenes import published
from support.single_pass import (
    Cost,
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
from support.timing import run

COMMAND = "python benchmarks/single_pass_table.py"
NAME = "single_pass_table"
PAPER: dict[str, dict[str, float]] = {
    "teapot_table": {
        "polygons": 16_422, "irradiance_samples": 173_671, "light_samples": 53_128, "rays_reference": 53e6, "rays_new": 12e6,
        "surface": 320, "pre": 321, "total_reference": 641, "total_new": 618, "cut_size": 3589, "rays_a_cut": 243,
    },
    "kitchen": {
        "polygons": 1_238_126, "irradiance_samples": 3_540_428, "light_samples": 53_896, "rays_reference": 1414e6,
        "rays_new": 62e6, "surface": 1719, "pre": 5179, "total_reference": 6727, "total_new": 2679, "cut_size": 3360,
        "rays_a_cut": 405,
    },
    "mezquita": {
        "polygons": 2_070_732, "irradiance_samples": 64_483_644, "light_samples": 53_128, "rays_reference": 91_100e6,
        "rays_new": 304e6, "surface": 1092, "pre": 50_276, "total_reference": 52_717, "total_new": 1258, "cut_size": 6306,
        "rays_a_cut": 6220,
    },
}  # fmt: skip
GOALS = {"teapot_table": (10, 2), "kitchen": (50, 10), "mezquita": (300, 42)}
"""How many times fewer shadow rays, and how many times faster in all, the adaptive mode is to be than the reference."""

PICTURE_GOAL = 0.01
"""The RMSE of the picture over its mean."""


@dataclass
class Setup:
    """How much work: the defaults are those of the tables.

    ``lit`` irradiance samples of the reference are lit, or one in a hundred where these are more, and all of them where there are no more
    than ``all_lit``; ``cuts`` are eye
    points at which the paper's cuts are run, and ``windows`` pixels at which errors are counted. A picture is taken ``repeats`` times,
    and so is its reference, in turns; times are medians.
    """

    resolution: tuple[int, int] = (640, 480)
    spp: int = 4
    lit: int = 100_000
    all_lit: int = 250_000
    cuts: dict[str, int] | None = None
    windows: int = 600
    bodies: int = 24
    repeats: int = 3


DEFAULT_CUTS = {"teapot_table": 4096, "kitchen": 4096, "mezquita": 1024}
QUICK = Setup((96, 72), 1, 4096, 0, dict.fromkeys(PAPER, 128), 12, 4, repeats=2)
COARSE: dict[str, dict[str, Any]] = {
    "teapot_table": {"detail": 6, "size": 50.0},
    "kitchen": {"detail": 48, "samples": 1e5},
    "mezquita": {"detail": 56, "samples": 1e5, "bays": (4, 8)},
}
FEW = {"direct": 256, "indirect": 2000}


def say(text: str, start: list[float]) -> None:
    """Print what is done, and when."""
    print(f"  {time.perf_counter() - start[0]:6.1f} s  {text}", flush=True)


# ------------------------------------------------------------------ one scene


def measure(name: str, setup: Setup, quick: bool) -> dict[str, Any]:
    """Fill a row: the picture by the adaptive mode, and the other two at its eye points."""
    clock = [time.perf_counter()]
    method = {"type": "pellucid_single_pass", **(FEW if quick else {})}
    spec = published(name, resolution=setup.resolution, integrator=method, **(COARSE[name] if quick else {}))
    picture = take_picture(spec, setup.spp)
    effort, direct = picture.effort, at_once(picture.seen)
    say(f"adaptive: {picture.seconds:.1f} s, {effort.counts['shadow rays'] / 1e6:.2f} M rays, {picture.stages}", clock)
    reference, stages = [reference_cost(picture, setup, clock)], [picture.stages]
    for _ in range(setup.repeats - 1):
        stages.append(take_picture(spec, setup.spp, warm=False).stages)
        reference.append(reference_cost(picture, setup, clock))
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
    }
    row["two_pass"] = path_traced(picture, spec, setup.spp, clock)
    row["half"], half = half_the_error(picture, clock)
    row["cut"], row["errors"] = errors(picture, direct, half, setup, name, clock)
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


def reference_cost(picture: Picture, setup: Setup, clock: list[float]) -> dict[str, Any]:
    """Measure both passes of the reference, scaled up from a part."""
    seen, others = at_once(picture.seen), only_by_others(picture.seen)
    light, indirect = (reference_light(picture, setup, some_of) for some_of in (seen, others))
    say(
        f"reference: {light.done:,} of {light.total:,} samples lit; all: {light.seconds:.0f} s, {light.shadow_rays / 1e6:.0f} M rays",
        clock,
    )
    tree, gathered = gather_reference(picture.seen, setup.bodies)
    say(f"reference: octrees {tree:.1f} s, sums {gathered.seconds:.1f} s from {gathered.done:,} eye points", clock)
    return {
        "shadow_rays": light.shadow_rays,
        "standard_error": light.standard_error,
        "every_path_rays": (light + indirect).shadow_rays,
        "every_path_irradiance": (light + indirect).seconds,
        "irradiance": light.seconds,
        "lit": light.done,
        "lit_of": light.total,
        "tree": tree,
        "gather": gathered.seconds,
        "gathered": gathered.done,
    }


def path_traced(picture: Picture, spec: dict[str, Any], spp: int, clock: list[float]) -> dict[str, float]:
    """Take the picture by `pellucid_two_pass`, whose light is path traced: its time, and how far the two pictures are apart.

    Light paths and point lights have errors of their own, which are all in the difference.
    """
    method = {"type": "pellucid_two_pass"}
    mi.load_dict(method | {"sample_count": 2000, "sampling": "poisson"}).render(picture.scene, spp=1)  # compiles
    integrator = mi.load_dict(method)

    def take() -> Any:
        integrator.prepared = integrator.prepare_scene(picture.scene)
        return integrator.render(picture.scene, spp=spp)

    seconds, image = run(take)
    samples = sum(len(lit.samples) for lit in integrator.prepared.bodies)
    difference = float(
        np.sqrt(np.mean((np.array(image) - picture.image)[..., :3] ** 2)) / picture.image[..., :3].mean()
    )
    say(f"pellucid_two_pass: {seconds:.1f} s, {samples:,} samples, pictures differ by {difference:.2%}", clock)
    return {"seconds": seconds, "samples": samples, "difference": difference}


def reference_light(picture: Picture, setup: Setup, seen: list[Seen]) -> Cost:
    """Measure the irradiance of the samples of all bodies that some eye points are on."""
    total = samples_in_view(seen)
    if not total:
        return Cost(0.0, 0.0, 0, 0)
    wanted = setup.all_lit if total <= setup.all_lit else max(setup.lit, total // 100)
    return light_reference(picture.scene, picture.state, seen, picture.integrator.method.max_error, wanted)


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
    say(f"errors: {found}", clock)
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
    scattering = pre - shared + reference["gather"]
    more = reference["every_path_irradiance"] - reference["irradiance"]
    for mode in ("adaptive", "half", "cut"):
        # The rays that choose virtual lights are a part of both.
        mine = row[mode]["shadow_rays"] + row["light_rays"]
        result[mode] = {
            "fewer_rays": (reference["shadow_rays"] + row["light_rays"]) / mine,
            "fewer_rays_every_path": (reference["every_path_rays"] + row["light_rays"]) / mine,
            "faster": result["total"]["reference"] / result["total"][mode],
            "faster_every_path": (result["total"]["reference"] + more) / result["total"][mode],
            "scattering_faster": scattering / row[mode]["exitance"],
        }
    return result


# ------------------------------------------------------------------ tables


def millions(rays: float) -> str:
    return f"{rays / 1e6:,.{0 if rays >= 1e8 else 1}f} M"


def tables(rows: dict[str, Any]) -> None:
    """Put all rows into the documentation."""
    document = DOCS / "benchmarks.md"
    text = [f"`{COMMAND}`"]
    for make in (size_table, ray_table, time_table, error_table, half_table, two_pass_table, goal_table):
        text.append(markdown_table(*make(rows)))
    text.append(parts(rows))
    fill(document, NAME, "\n\n".join(text))


def size_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    keys = ("polygons", "irradiance_samples", "light_samples")
    head = [
        "scene",
        *(f"{key.replace('_', ' ')}{of}" for key in keys for of in ("", " (paper)")),
        "samples of bodies that primary rays meet",
        "that any path meets",
    ]
    body = [
        [
            name,
            *(f"{source[name][key]:,}" for key in keys for source in (rows, PAPER)),
            f"{row['in_view']:,}",
            f"{row['in_any_path']:,}",
        ]
        for name, row in rows.items()
    ]
    return head, body


def ray_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "shadow rays", "reference", "cut", "adaptive", "to choose lights, in each", "cut, fewer", "adaptive, fewer",
        "bodies that any path meets: fewer", "paper: reference", "paper: cut", "fewer",
        "cut size: cut", "adaptive", "paper", "rays a cut: cut", "adaptive", "paper", "cache: links found",
    ]  # fmt: skip
    body = []
    for name, row in rows.items():
        paper, t = PAPER[name], row["totals"]
        body.append(
            [name, f"{millions(row['reference']['shadow_rays'])} +- {millions(row['reference']['standard_error'])}",
             *(millions(row[mode]["shadow_rays"]) for mode in ("cut", "adaptive")), millions(row["light_rays"]),
             f"{t['cut']['fewer_rays']:.1f}", f"**{t['adaptive']['fewer_rays']:.0f}**",
             f"{t['adaptive']['fewer_rays_every_path']:.0f}",
             millions(paper["rays_reference"]), millions(paper["rays_new"]),
             f"{paper['rays_reference'] / paper['rays_new']:.1f}",
             f"{row['cut']['cut_size']:,.0f}", f"{row['adaptive']['cut_size']:,.0f}", f"{paper['cut_size']:,}",
             f"{row['cut']['rays_a_cut']:,.0f}", f"{row['adaptive']['rays_a_cut']:,.1f}", f"{paper['rays_a_cut']:,}",
             f"{row['cut']['hit_rate']:.0%}"]
        )  # fmt: skip
    return head, body


def time_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "time", "surface", "samples and lights", "reference: pre-computation", "reference: total", "cut: total",
        "adaptive: total", "adaptive, faster", "bodies that any path meets: faster", "paper: reference", "paper: cut", "faster",
    ]  # fmt: skip
    body = []
    for name, row in rows.items():
        paper, t = PAPER[name], row["totals"]
        body.append(
            [name, f"{row['stages']['surface']:.1f} s", f"{t['pre']['adaptive']:.1f} s", f"{t['pre']['reference']:,.0f} s",
             f"{t['total']['reference']:,.0f} s", f"{t['total']['cut']:,.0f} s", f"{t['total']['adaptive']:.1f} s",
             f"**{t['adaptive']['faster']:.1f}**", f"{t['adaptive']['faster_every_path']:.1f}", f"{paper['total_reference']:,} s",
             f"{paper['total_new']:,} s", f"{paper['total_reference'] / paper['total_new']:.1f}"]
        )  # fmt: skip
    return head, body


def error_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "against the reference", "RMSE of the picture: adaptive", "at 1 %", "RMSE of multiple scattering: adaptive", "at 1 %", "cut",
        "bias: adaptive", "at 1 %", "cut", "full cuts",
    ]  # fmt: skip
    body = []
    for name, row in rows.items():
        errors = row["errors"]
        body.append(
            [name]
            + [f"**{e['picture']:.2%}** +- {e['picture_error']:.2%}" for e in (errors["adaptive"], errors["half"])]
            + [f"{errors[mode]['rmse']:.2%}" for mode in ("adaptive", "half", "cut")]
            + [f"{errors[mode]['bias']:+.2%}" for mode in ("adaptive", "half", "cut")]
            + [f"{row['cut']['full']:.0%}"]
        )
    return head, body


def half_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = ["adaptive at 1 %", "shadow rays", "fewer", "total", "faster"]
    body = []
    for name, row in rows.items():
        ratios = row["totals"]["half"]
        body.append(
            [name, millions(row["half"]["shadow_rays"]), f"{ratios['fewer_rays']:.1f}",
             f"{row['totals']['total']['half']:.1f} s", f"{ratios['faster']:.1f}"]
        )  # fmt: skip
    return head, body


def two_pass_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "path-traced light",
        "`pellucid_two_pass`: samples",
        "total",
        "adaptive: total",
        "the two pictures differ by",
    ]
    body = [
        [name, f"{row['two_pass']['samples']:,}", f"{row['two_pass']['seconds']:.1f} s",
         f"{row['totals']['total']['adaptive']:.1f} s", f"{row['two_pass']['difference']:.2%}"]
        for name, row in rows.items()
    ]  # fmt: skip
    return head, body


def goal_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "adaptive against the reference",
        "fewer rays",
        "goal",
        "",
        "faster",
        "goal",
        "",
        "RMSE of the picture",
        "goal",
        "",
    ]
    body = []
    for name, row in rows.items():
        line = [name]
        for key, goal in zip(("fewer_rays", "faster"), GOALS[name], strict=True):
            ratio = row["totals"]["adaptive"][key]
            line += [f"{ratio:.1f}", f"{goal}", "met" if ratio >= goal else "**NOT met**"]
        rmse = row["errors"]["adaptive"]["picture"]
        line += [f"{rmse:.2%}", f"{PICTURE_GOAL:.0%}", "met" if rmse <= PICTURE_GOAL else "**NOT met**"]
        body.append(line)
    return head, body


def spread(row: dict[str, Any]) -> str:
    """Say how several pictures of one process differ in time."""
    seconds = [sum(stages.values()) for stages in row["every_stage"]]
    if len(seconds) == 1:
        return ""
    taken = ", ".join(f"{s:.1f}" for s in seconds)
    return f"; medians of {len(seconds)} pictures ({taken} s) and, alternating with them, of references"


def parts(rows: dict[str, Any]) -> str:
    """Say what was run of the reference and of the cuts."""
    each = [
        f"{name}: irradiance at {row['reference']['lit']:,} of {row['reference']['lit_of']:,} samples, sums at "
        f"{row['reference']['gathered']:,} of {row['eye_points']:,} eye points, cuts at {row['cut']['points']:,}; errors at "
        f"{row['errors']['pixels']} pixels and {row['errors']['points']:,} directly visible eye points; "
        f"peak memory {row['peak_bytes'] / 2**30:.1f} GB{spread(row)}"
        for name, row in rows.items()
    ]
    spp = ", ".join(sorted({str(row["setup"]["spp"]) for row in rows.values()}))
    return f"What was computed; the rest is scaled up. {'. '.join(each)}. {spp} samples a pixel for the surface; in the paper 32."


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
    print(f"  totals: {row['totals']}", flush=True)
    if not arguments.quick:
        rows = saved(NAME) | {arguments.only: row}
        rows = {name: rows[name] for name in PAPER if name in rows}
        save(NAME, COMMAND, rows)
        tables(rows)


if __name__ == "__main__":
    main()
