"""Fill the table of the README from the results of the other benchmarks: beside every time the error of that same picture.

python benchmarks/summary.py
"""

from __future__ import annotations

import json
from typing import Any

from support.record import DOCS, FIGURES, fill, markdown_table, median

MARK = "summary"
RUNS = ("figure3", "picture_time", "startup", "model_error", "single_pass_table", "virtual_lights", "texture_space_table",
        "texture_space_error", "texture_space_frames", "texture_space_hybrid")  # fmt: skip
COLD, WARM = "first picture, no kernel compiled before", "picture, kernels cached"
SAMPLES = 900
"""Of the frames in motion."""

PAPER = {"skin1": 0.0096, "skin2": 0.0098}
"""Errors of figure 9 of CLHHC08."""

ERRORS = """\
*Error*, two passes: RMSE of the exitance over its mean, against the sum over 2.4 million other samples. Single pass: RMSE of the
picture over its mean, against Lightcuts at the same surface samples (Poisson-disk sets, as in the paper) and the same point lights;
the noise of the path-traced surfaces around the translucent ones (4 samples a pixel) is the same in both and does not count.
Texture space: RMSE of the tone-mapped picture in [0, 1], background included as in the paper, against the sum over 60,000 samples."""

Row = tuple[str, str, str]


def results(name: str) -> dict[str, Any]:
    """Read what a benchmark has saved."""
    return json.loads((FIGURES / f"{name}.json").read_text())


def machines(names: tuple[str, ...]) -> str:
    """Tell on which machines benchmarks ran: on that of the first, and which of them on another."""
    found = {name: results(name)["machine"] for name in names}
    first = found[names[0]]
    others: dict[str, list[str]] = {}
    for name, machine in found.items():
        if machine["cpu"] != first["cpu"]:
            others.setdefault(f"{machine['cores']} cores, {machine['cpu']}", []).append(f"`{name}`")
    text = "".join(f"; {', '.join(those)} on {machine}" for machine, those in others.items())
    return f"{first['cores']} cores, {first['cpu']}{text}"


def two_pass() -> list[Row]:
    """List the pictures of figure 3 of JB02, and what others take for the same error."""
    found, startup = results("figure3")["results"], results("startup")["results"]["seconds"]
    beside = [row["seconds"] for row in results("picture_time")["results"]["teapots"]]
    pictures = found["hierarchical"]
    default = pictures["the defaults"]
    error = f"{default['error']:.1%}"
    volume = found["volume"]["seconds_needed"]
    return [
        (f"**Marble teapot, `pellucid_two_pass`**, 1024 by 768, {default['samples']:,} surface samples: whole picture",
         f"**{default['total']:.1f} s**", f"**{error}** (of which the octree's clusters {default['clusters']:.2%})"),
        *((f"the same with {how}", f"{pictures[how]['total']:.1f} s", f"{pictures[how]['error']:.1%}")
          for how in ("64 light paths", "four times the samples")),
        ("the same from the shell prompt; with kernels cached",
         f"{median(startup[COLD]):.1f} s; {median(startup[WARM]):.1f} s", error),
        ("its second pass alone (Mitsuba's `path` with an opaque teapot = 1)", f"{beside[0]['two_pass'] / beside[0]['path']:.2f}", error),
        ("the same error by sampling the profile at every pixel, extrapolated",
         f"{default['all']['seconds']:.0f} s, {default['all']['ratio']:.0f} times as long{traced_once(default['all'])} "
         "(the paper: 154)", error),
        ("the same error by Mitsuba's `volpathmis`, extrapolated",
         f"{volume / 86400:.0f} days, {volume / default['total']:.0e} times as long".replace("e+0", "e"), error),
    ]  # fmt: skip


def traced_once(sampled: dict[str, float]) -> str:
    """Tell the ratio without the paths to the surface that every sample repeats, where it was measured."""
    return f", {sampled['once_ratio']:.0f} if paths to the surface were traced once" if "once_ratio" in sampled else ""


def model() -> list[Row]:
    """Tell how far pictures are from those of a volumetric path tracer, by profile."""
    found = {row["material"]: row["profiles"] for row in results("model_error")["results"]["results"]}
    rows = []
    for material in ("marble", "skin1"):
        what = f"**not in these errors: the profile**, teapot of 100 mm of {material} against `volpathmis`"
        texts = []
        for name, row in found[material].items():
            least, most = min(row["ratio"]), max(row["ratio"])
            texts.append(f"`{name}` {least:.2f} to {most:.2f} times as much, blocks off by **{row['rmse']:.0%}**")
        rows.append((what, "–", "; ".join(texts)))
    return rows


def single_pass() -> list[Row]:
    """Compare the adaptive single pass with the reference of its paper."""
    rows: list[Row] = []
    for name, row in results("single_pass_table")["results"].items():
        totals, errors = row["totals"], row["errors"]["adaptive"]
        rows.append((
            f"**{name}, `pellucid_single_pass`**, 640 by 480, {row['irradiance_samples']:,} samples: whole picture",
            f"**{totals['total']['adaptive']:.1f} s**{lightcuts(totals['adaptive'])}",
            f"**{errors['picture']:.2%}** ± {errors['picture_error']:.2%}",
        ))  # fmt: skip
    noise = {name: lights[-1]["noise"] for name, lights in results("virtual_lights")["results"].items()}
    rows.append((f"not in these errors: the noise of the 50,000 virtual lights; {', '.join(noise)}", "–",
                 "; ".join(f"{value:.1%}" for value in noise.values()) + " of the indirect irradiance at a point (median)"))  # fmt: skip
    return rows


def lightcuts(ratios: dict[str, Any]) -> str:
    """Tell what the paper's reference takes for the same error of the exitance at eye points; nothing where an older run has not asked."""
    if "equal" not in ratios:
        return ""
    equal = ratios["equal"]
    end = {"<": "at most ", ">": "at least ", "": ""}[equal["end"]]
    return (
        f"; Lightcuts at every sample of the bodies in view, as wrong at eye points: {end}{equal['faster']:.1f} times as long, "
        f"{end}{equal['fewer_rays']:.0f} times the shadow rays"
    )


def texture_space() -> list[Row]:
    """Give the frame rates of the real-time pipeline and the errors of these frames; the paper sums at every pixel."""
    rates, hybrid = (results(f"texture_space_{name}")["results"] for name in ("table", "hybrid"))
    frames = results("texture_space_frames")["results"]["rows"]
    still, moving, near = [], [], []
    for row in results("texture_space_error")["results"]["figure 9"][: len(PAPER)]:
        what = f"antique_head at rest, {row['material']}, 10 mm, 1600 samples"
        error = f"{row['engine']['exact']['image']:.4f} (the paper: {PAPER[row['material']]})"
        still.append((what, f"{row['seconds']['engine']:.2f} s", error))
    for mode, how in (("interpolated", "summed at 1 of 16 pixels"), ("every pixel", "summed at every pixel")):
        times = [t["whole"] for row in rates["rows"].values() for t in row["modes"][mode] if t["samples"] == SAMPLES]
        plain = [row[mode]["image"] for row in frames if row["method"] == "texture_space"]
        what = f"**seven models in motion, marble, 10 mm**, 512 by 512, {SAMPLES} samples, {how}"
        rate, error = (
            f"**{1 / max(times):.0f} to {1 / min(times):.0f} frames/s**",
            f"**{min(plain):.4f} to {max(plain):.4f}**",
        )
        moving.append((what, rate + beside(mode, "the paper's GPU: 25 to 57"), error))
        slowest = max(row["hybrid"][mode] for row in hybrid["figure 14"])
        worst = max(row[mode]["image"] for row in frames if row["method"] == "hybrid" and row["model"] == "wanderer")
        what = f"the hybrid in motion, wanderer, 30 mm of skin1, marble or cream, {how}: slowest, largest error"
        rate = f"{1 / slowest:.0f} frames/s{beside(mode, 'the paper: 22')}"
        near.append((what, rate, f"{worst:.4f}{beside(mode, 'the paper: 0.0144')}"))
    return [*moving, *still, *near]


def beside(mode: str, paper: str) -> str:
    """Give the paper's number where it was measured in the same way."""
    return f" ({paper})" if mode == "every pixel" else ""


def block() -> str:
    """Make the table of the README, and say under it what its errors are."""
    rows = [*two_pass(), *model(), *single_pass(), *texture_space()]
    source = "`python benchmarks/summary.py`, from the runs in [docs/benchmarks.md](docs/benchmarks.md)"
    return f"""{markdown_table(["picture", "time", "error of that picture"], rows)}

{ERRORS}

{source}; {machines(RUNS)}."""


def main() -> None:
    text = block()
    print(text)
    fill(DOCS.parent / "README.md", MARK, text)


if __name__ == "__main__":
    main()
