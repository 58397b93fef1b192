"""Fill the table of the README from the results of the other benchmarks.

python benchmarks/summary.py
"""

from __future__ import annotations

import json

from support.record import DOCS, FIGURES, fill, markdown_table, median, saved

RUNS = ("figure3", "startup", "single_pass_table", "texture_space_table", "texture_space_error", "texture_space_hybrid")
COLD, WARM = "first picture, no kernel compiled before", "picture, kernels cached"


def results(name: str):
    """Read what a benchmark has saved."""
    return json.loads((FIGURES / f"{name}.json").read_text())


def machines(names: tuple[str, ...]) -> str:
    """Tell on which machines benchmarks ran: on that of the first, and which of them on another."""
    found = {name: results(name)["machine"] for name in names}
    first = found[names[0]]
    text = f"{first['cores']} cores, {first['cpu']}"
    for name, machine in found.items():
        if machine["cpu"] != first["cpu"]:
            text += f"; `{name}` on {machine['cores']} cores, {machine['cpu']}"
    return text


def single_pass() -> list[tuple[str, str]]:
    """Compare the adaptive single pass with the reference of its paper, on the scenes that were measured."""
    scenes = saved("single_pass_table")
    ratios = {name: row["totals"]["adaptive"] for name, row in scenes.items()}
    return [
        (f"{name}, {scenes[name]['irradiance_samples']:,} samples: single pass against Lightcuts at every sample in view",
         f"{ratio['fewer_rays']:.0f} times fewer shadow rays, {ratio['faster']:.1f} times faster, "
         f"{scenes[name]['totals']['total']['adaptive']:.0f} s")
        for name, ratio in ratios.items()
    ]  # fmt: skip


def texture_space() -> list[tuple[str, str]]:
    """Compare the real-time pipeline with the paper's graphics card and its errors."""
    table, errors, hybrid = (saved(f"texture_space_{name}") for name in ("table", "error", "hybrid"))
    if not (table and errors and hybrid):
        return []
    fps = {mode: [1 / t["whole"] for row in table["rows"].values() for t in row["modes"][mode] if t["samples"] == 900]
           for mode in ("adaptive", "every pixel")}  # fmt: skip
    skin = {row["material"]: row["engine"]["exact"]["image"] for row in errors["figure 9"]}
    rows = [row["hybrid"] for row in hybrid["figure 14"]]
    slowest, worst = max(r["adaptive"] for r in rows), max(r["error"]["image"] for r in rows)
    return [
        ("frames a second, 512 by 512, light and camera moving, 900 samples, seven models (the paper's GPU: 25 to 57)",
         f"{min(fps['adaptive']):.0f} to {max(fps['adaptive']):.0f}; "
         f"every pixel summed, {min(fps['every pixel']):.0f} to {max(fps['every pixel']):.0f}"),
        ("RMSE of such pictures in [0, 1], 1600 samples, skin1 and skin2 (the paper: 0.0096, 0.0098)",
         f"{skin['skin1']:.4f}, {skin['skin2']:.4f}"),
        ("hybrid, 30 mm of skin1, marble, cream (the paper: 22 frames a second, 0.0144)",
         f"{1 / slowest:.0f} frames a second, {worst:.4f}"),
    ]  # fmt: skip


def main() -> None:
    figure3, startup = results("figure3"), results("startup")["results"]["seconds"]
    found = figure3["results"]
    default = found["hierarchical"]["the defaults"]
    rows = [
        (
            "the marble teapot of figure 3 (1024 by 768, 150,000 samples): samples, light, tree, picture",
            f"{default['total']:.1f} s",
        ),
        (
            "against sampling the profile, at equal error (the paper: 154 times)",
            f"{default['all']['ratio']:.0f} times faster",
        ),
        (
            "against Mitsuba's `volpathmis` in the same medium, at equal error, extrapolated",
            f"{found['volume']['seconds_needed'] / default['total']:.0e} times faster".replace("e+0", "e"),
        ),
        (
            "the picture alone against Mitsuba's `path` with an opaque teapot",
            f"{found['path']['ratio']:.2f} times as long",
        ),
        ("error of the hierarchy, over the mean", f"{default['clusters']:.2%}"),
        (
            "first picture from the shell prompt; with kernels cached",
            f"{median(startup[COLD]):.1f} s; {median(startup[WARM]):.1f} s",
        ),
    ]
    rows += single_pass()
    rows += texture_space()
    source = "`python benchmarks/summary.py`, from the runs in [docs/benchmarks.md](docs/benchmarks.md)"
    note = f"{source}; {machines(RUNS)}."
    fill(DOCS.parent / "README.md", "summary", markdown_table(["what", "result"], rows) + "\n\n" + note)


if __name__ == "__main__":
    main()
