"""The tables of what the single pass saves: rows of `single_pass_table` as Markdown, beside what AWB08 measured."""

from __future__ import annotations

from typing import Any

from support.record import DOCS, fill, markdown_table

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

NEWEST = "curve"
"""What only rows of the newest version have."""


def millions(rays: float) -> str:
    return f"{rays / 1e6:,.{0 if rays >= 1e8 else 1}f} M"


def tables(rows: dict[str, Any]) -> None:
    """Put all rows into the documentation, but for those of older versions, which are named."""
    document = DOCS / "benchmarks.md"
    old = [name for name, row in rows.items() if NEWEST not in row]
    for name in old:
        print(f"{name}: saved by an older version, so it is not in the tables; measure it with --only {name}.")
    rows = {name: row for name, row in rows.items() if name not in old}
    if not rows:
        print(f"No row is of this version: the tables of {document.name} stay as they are.")
        return
    text = [f"`{COMMAND}`"]
    for make in (size_table, ray_table, time_table, error_table, equal_table, curve_table, two_pass_table, goal_table):
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


def equal_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "at equal RMSE of the exitance at eye points", "RMSE", "reference: bound, largest cut",
        "shadow rays", "adaptive: shadow rays", "fewer",
        "reference: total", "adaptive: total", "faster", "reference at 2 %: fewer rays", "faster",
    ]  # fmt: skip
    body = []
    for name, row in rows.items():
        for mode, label in (("adaptive", "adaptive"), ("half", "adaptive at 1 %")):
            ratios = row["totals"][mode]
            e = ratios["equal"]
            body.append(
                [f"{name}, {label}", f"{row['errors'][mode]['rmse']:.2%}", f"{e['max_error']:.0%}, {e['max_cut']:.0f}",
                 millions(e["shadow_rays"]),
                 millions(row[mode]["shadow_rays"]), f"**{e['end']}{e['fewer_rays']:.1f}**", f"{e['total']:,.1f} s",
                 f"{row['totals']['total'][mode]:.1f} s", f"**{e['end']}{e['faster']:.1f}**",
                 f"{ratios['fewer_rays']:.0f}", f"{ratios['faster']:.1f}"]
            )  # fmt: skip
    return head, body


def curve_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    every = [f"{point['max_error']:.0%}, {point['max_cut']}" for point in next(iter(rows.values()))["curve"]]
    head = ["reference: bound, largest cut", *every, "Lightcuts at 2 % against all lights: RMSE", "bias"]
    body = []
    for name, row in rows.items():
        errors = [f"{p['rmse']:.2%} +- {p['rmse_error']:.2%}" for p in row["curve"]]
        lights = row["lights"]
        body.append(
            [
                f"{name}: RMSE of the exitance",
                *errors,
                f"{lights['rmse']:.1%}",
                f"{lights['bias']:+.2%} +- {lights['bias_error']:.2%}",
            ]
        )
        body.append([f"{name}: shadow rays", *(millions(p["shadow_rays"]) for p in row["curve"]), "", ""])
        body.append([f"{name}: irradiance", *(f"{p['irradiance']:,.1f} s" for p in row["curve"]), "", ""])
    return head, body


def two_pass_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "path-traced light",
        "`pellucid_two_pass`: samples",
        "total",
        "adaptive: total",
        "the two pictures differ by",
    ]
    body = []
    for name, row in rows.items():
        found, adaptive = row["two_pass"], f"{row['totals']['total']['adaptive']:.1f} s"
        if found:
            body.append(
                [name, f"{found['samples']:,}", f"{found['seconds']:.1f} s", adaptive, f"{found['difference']:.2%}"]
            )
        else:
            body.append([name, f"{row['irradiance_samples']:,}", "not measured", adaptive, "–"])
    return head, body


def goal_table(rows: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    head = [
        "adaptive against the reference", "fewer rays at equal error", "goal", "", "faster at equal error", "goal", "",
        "RMSE of the picture", "goal", "", "with equal bounds: fewer rays", "faster",
    ]  # fmt: skip
    body = []
    for name, row in rows.items():
        line, ratios = [name], row["totals"]["adaptive"]
        equal = ratios["equal"]
        for key, goal in zip(("fewer_rays", "faster"), GOALS[name], strict=True):
            met = equal[key] >= goal and equal["end"] != "<"
            line += [f"{equal['end']}{equal[key]:.1f}", f"{goal}", "met" if met else "**NOT met**"]
        rmse = row["errors"]["adaptive"]["picture"]
        line += [f"{rmse:.2%}", f"{PICTURE_GOAL:.0%}", "met" if rmse <= PICTURE_GOAL else "**NOT met**"]
        body.append([*line, f"{ratios['fewer_rays']:.1f}", f"{ratios['faster']:.1f}"])
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
