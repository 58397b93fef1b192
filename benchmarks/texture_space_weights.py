"""Where R_d is divided into a local and a global part: figures 3 and 4 of CLHHC08, and the radius for every material.

    python benchmarks/texture_space_weights.py

writes docs/figures/texture_space_weights.json and .png, and the table in docs/texture_space.md between its marks.
Takes a few seconds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pellucid.model import PRESETS, Medium
from pellucid.model.decomposition import IMPORTANCE_BOUND, Decomposition, decompose, equal_radii, importance
from support.record import DOCS, FIGURES, fill, markdown_table, save

COMMAND = "python benchmarks/texture_space_weights.py"
SHOWN = "skimmilk"
PAPERS_RADIUS = 2.4141
BOUNDS = (0.05, IMPORTANCE_BOUND, 0.2)
COLORS = ("tab:red", "tab:green", "tab:blue")


def rows() -> list[dict]:
    """Find the radii of every material, and the part of its light that is local, by channel."""
    result = []
    for name in PRESETS:
        medium = Medium.from_preset(name, profile="dipole")
        split = decompose(medium)
        r = np.geomspace(1e-4, 1e4, 100_001) * float(medium.mfp.min())
        local = np.trapezoid(importance(medium, r) * split.local_weight(r), r, axis=0)
        result.append(
            {
                "material": name,
                "radii": {str(bound): equal_radii(medium, bound).round(4).tolist() for bound in BOUNDS},
                "radius": split.radius,
                "local_share": (local / medium.total_diffuse_reflectance).round(4).tolist(),
                "highest_importance": importance(medium, r).max(axis=0).round(4).tolist(),
            }
        )
    return result


def table(materials: list[dict]) -> str:
    """Write radii and local shares as Markdown."""
    head = ["material", "roots at c = 0.1/mm [mm]", "R_p [mm]", "local share", "highest R_d 2 pi r [1/mm]"]

    def triple(values: list[float], digits: int) -> str:
        return ", ".join("none" if v == 0 and digits > 1 else f"{v:.{digits}f}" for v in values)

    lines = []
    for row in materials:
        roots = triple(row["radii"][str(IMPORTANCE_BOUND)], 2)
        shares = ", ".join(f"{share:.0%}" for share in row["local_share"])
        radius = f"{row['radius']:.2f}" if row["radius"] else "all global"
        lines.append([row["material"], roots, radius, shares, triple(row["highest_importance"], 3)])
    return markdown_table(head, lines)


def plot(path: Path) -> None:
    """Draw figures 3 and 4: weights, the two parts of R_d, and how the radius is found."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    medium, r = Medium.from_preset(SHOWN, profile="dipole"), np.linspace(0, 8, 801)
    split = Decomposition(PAPERS_RADIUS, 1.5)
    figure, (weights, parts, bounds) = plt.subplots(1, 3, figsize=(14, 4))
    weights.plot(r, split.local_weight(r), label="W_l")
    weights.plot(r, split.global_weight(r), label="W_g")
    weights.axvline(PAPERS_RADIUS, color="0.7", lw=1)
    weights.set(title=f"Figure 3a: weights, R_p = {PAPERS_RADIUS} mm", xlabel="r [mm]")
    whole = medium.diffuse_reflectance(r)[:, :1]
    parts.semilogy(r, whole, "k", lw=1, label="R_d")
    parts.semilogy(r, whole * split.local_weight(r), label="R_l")
    parts.semilogy(r, whole * split.global_weight(r), label="R_g")
    parts.set(title=f"Figure 3b: {SHOWN}, red", xlabel="r [mm]", ylabel="[1/mm^2]", ylim=(1e-5, 0.2))
    for k, color in enumerate(COLORS):
        bounds.plot(r, importance(medium, r)[:, k], color=color)
        bounds.plot(equal_radii(medium, IMPORTANCE_BOUND)[k], IMPORTANCE_BOUND, "o", color=color)
    bounds.axhline(IMPORTANCE_BOUND, color="0.7", lw=1)
    bounds.axvline(decompose(medium).radius, color="0.7", lw=1)
    bounds.set(title=f"Figure 4: {SHOWN}, c = {IMPORTANCE_BOUND}/mm", xlabel="r [mm]", ylabel="R_d 2 pi r [1/mm]")
    weights.legend()
    parts.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    materials = rows()
    save("texture_space_weights", COMMAND, {"bound": IMPORTANCE_BOUND, "materials": materials})
    plot(FIGURES / "texture_space_weights.png")
    print(table(materials))
    document = DOCS / "texture_space.md"
    if document.exists():
        fill(document, "texture_space_weights", table(materials))


if __name__ == "__main__":
    main()
