"""Fill the table of the README from the results of the other benchmarks.

python benchmarks/summary.py
"""

from __future__ import annotations

import json

from pellucid.bench.record import DOCS, FIGURES, fill, markdown_table, median, saved

COLD, WARM = "first picture, no kernel compiled before", "picture, kernels cached"


def results(name: str):
    """Read what a benchmark has saved."""
    return json.loads((FIGURES / f"{name}.json").read_text())


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


def main() -> None:
    figure3, startup = results("figure3"), results("startup")["results"]["seconds"]
    found, machine = figure3["results"], figure3["machine"]
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
    source = "`python benchmarks/summary.py`, from the runs in [docs/benchmarks.md](docs/benchmarks.md)"
    note = f"{source}; {machine['cores']} cores, {machine['cpu']}."
    fill(DOCS.parent / "README.md", "summary", markdown_table(["what", "result"], rows) + "\n\n" + note)


if __name__ == "__main__":
    main()
