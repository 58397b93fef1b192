"""Figure 1 of Jensen and Buhler 2002: how far diffuse light travels, and how much of the exitance it is.

    python benchmarks/figure1_photons.py

writes docs/figures/figure1_photons.json and .png. Left: mean distance from entry to exit over the mean free path, for
g = 0.9: photons against equation 11, and against the mean distance over the dipole's profile. Right: share of the
exitance that scattered more than once, for g = 0 and 0.9. The index is 1.3, and light comes from random directions.
Takes under a minute on two cores; ``--quick`` follows few photons, and writes nothing.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pellucid.model.medium import Medium
from pellucid.model.photon_simulation import simulate

FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"
ALBEDOS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9998)
ETA = 1.3
FORWARD = 0.9


def predicted_ratio(albedo: float, g: float) -> float:
    """Diffuse over single-scattering mean free path. JB02 eq. 11."""
    return float(1 / np.sqrt(3 * (1 - albedo) * (1 - g * albedo)))


def dipole_distance(albedo: float, g: float) -> float:
    """Mean distance of the dipole's profile in mean free paths: ``int R_d r dA / int R_d dA``."""
    medium = Medium(albedo * (1 - g), 1 - albedo, g=g, eta=ETA, profile="dipole")
    r = np.geomspace(1e-3, 1e6, 20000)
    ring = medium.diffuse_reflectance(r)[:, 0] * r * r  # times d(ln r)
    return float((ring * r).sum() / ring.sum())


def measure(albedo: float, photons: int) -> dict[str, float]:
    """Trace photons for one albedo with both phase functions."""
    forward = simulate(albedo, FORWARD, ETA, photons)
    isotropic = simulate(albedo, 0.0, ETA, photons)
    return {
        "albedo": albedo,
        "equation_11": predicted_ratio(albedo, FORWARD),
        "dipole": dipole_distance(albedo, FORWARD),
        "photons_multiple": forward.distance_multiple,
        "photons_all": forward.distance,
        "multiple_share_g0": isotropic.multiple / isotropic.total,
        "multiple_share_g09": forward.multiple / forward.total,
    }


def plot(rows: list[dict[str, float]], path: Path) -> None:
    """Draw both graphs."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    albedo = np.array([r["albedo"] for r in rows])
    fine = np.linspace(0, 0.9998, 2000)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    left.semilogy(fine, [predicted_ratio(a, FORWARD) for a in fine], label="equation 11")
    left.semilogy(albedo, [r["dipole"] for r in rows], "--", color="0.5", label="mean over the dipole's profile")
    left.semilogy(albedo, [r["photons_multiple"] for r in rows], "o", label="photons, multiple scattering")
    left.semilogy(albedo, [r["photons_all"] for r in rows], "x", label="photons, all")
    left.set(xlabel="albedo", ylabel="mean distance / mean free path", title="g = 0.9")
    left.legend()
    right.plot(albedo, [r["multiple_share_g09"] for r in rows], "o-", label="g = 0.9")
    right.plot(albedo, [r["multiple_share_g0"] for r in rows], "s-", label="g = 0")
    right.set(xlabel="albedo", ylabel="share of multiple scattering", ylim=(0, 1.02), title="eta = 1.3")
    right.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few photons; writes nothing")
    quick = parser.parse_args().quick
    photons = 1 << 13 if quick else 1 << 18
    rows = []
    for albedo in ALBEDOS:
        rows.append(r := measure(albedo, photons))
        print(
            f"albedo {albedo:<6}  eq. 11 {r['equation_11']:7.2f}  dipole {r['dipole']:7.2f}  "
            f"photons {r['photons_multiple']:7.2f}   "
            f"multiple: g = 0 {r['multiple_share_g0']:.3f}, g = 0.9 {r['multiple_share_g09']:.3f}"
        )
    if quick:
        return
    FIGURES.mkdir(parents=True, exist_ok=True)
    data = {"command": "python benchmarks/figure1_photons.py", "photons": photons, "eta": ETA, "rows": rows}
    (FIGURES / "figure1_photons.json").write_text(json.dumps(data, indent=1))
    plot(rows, FIGURES / "figure1_photons.png")


if __name__ == "__main__":
    main()
