"""How far the dipole is off: total reflectance and radial profile of a half space against Monte Carlo.

    python benchmarks/dipole_accuracy.py

writes docs/figures/dipole_accuracy.json and .png, and the tables in docs/theory/model.md between their marks.
Takes about two minutes on two cores; ``--quick`` follows few photons, and writes nothing.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pellucid.model.fresnel import external_diffuse_transmittance
from pellucid.model.medium import Medium
from pellucid.model.photon_simulation import PhotonTally, ring_bounds, simulate, unreduced_albedo

DOCS = Path(__file__).resolve().parents[1] / "docs"
ALBEDOS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
ETAS = (1.0, 1.15, 1.3, 1.5, 1.8)
SHOWN_ETAS = (1.0, 1.3, 1.5)
PLOTTED = (0.5, 0.9, 0.99, 0.999)
RING_ALBEDOS = (0.9, 0.99, 0.999)
FORWARD = 0.9


@dataclass
class Row:
    """One medium, ``sigma_t' = 1``: what the dipole says, and what photons do under diffuse light."""

    albedo_prime: float
    eta: float
    dipole: float
    total: float
    error: float
    multiple: float
    total_forward: float
    multiple_forward: float
    profile_error: float
    half_radius: float
    half_radius_dipole: float
    profile: list[float]
    profile_dipole: list[float]


def ring_energy(medium: Medium, radii: np.ndarray) -> np.ndarray:
    """Integrate the dipole over rings in closed form: its primitive is ``-z exp(-sigma_tr d) / d``."""
    energy = np.zeros(len(radii))
    for z in (medium.z_r[0], medium.z_v[0]):
        d = np.hypot(radii, z)
        energy -= 0.5 * medium.albedo_prime[0] * z * np.exp(-medium.sigma_tr[0] * d) / d
    return np.diff(energy)


def half_radius(radii: np.ndarray, energy: np.ndarray) -> float:
    """Radius within which half of the light leaves again."""
    cumulated = np.concatenate([[0], np.cumsum(energy)])
    return float(np.interp(0.5 * cumulated[-1], cumulated, radii))


def measure(albedo_prime: float, eta: float, photons: int) -> Row:
    """Compare one medium: isotropic scattering, and strongly forward scattering as the other end of similarity."""
    medium = Medium(albedo_prime, 1 - albedo_prime, eta=eta, profile="dipole")
    isotropic: PhotonTally = simulate(albedo_prime, 0.0, eta, photons)
    forward = simulate(unreduced_albedo(albedo_prime, FORWARD), FORWARD, eta, photons // 4)
    areas = np.pi * np.diff(isotropic.radii**2)
    photon_energy = (isotropic.profile_single + isotropic.profile_multiple) * areas
    dipole_energy = ring_energy(medium, isotropic.radii)
    return Row(
        albedo_prime=albedo_prime,
        eta=eta,
        dipole=float(medium.total_diffuse_reflectance[0]),
        total=isotropic.total,
        error=isotropic.error,
        multiple=isotropic.multiple,
        total_forward=forward.total,
        multiple_forward=forward.multiple,
        profile_error=float(np.abs(dipole_energy - photon_energy).sum() / photon_energy.sum()),
        half_radius=half_radius(isotropic.radii, photon_energy),
        half_radius_dipole=half_radius(isotropic.radii, dipole_energy),
        profile=(photon_energy / areas).tolist(),
        profile_dipole=(dipole_energy / areas).tolist(),
    )


def rounded(value: float | list[float]) -> float | list[float]:
    """Keep five digits: the photons are not surer than that."""
    return [float(f"{v:.5g}") for v in value] if isinstance(value, list) else float(f"{value:.5g}")


def table(rows: list[Row]) -> str:
    """Write the comparison as Markdown."""
    lines = [
        "| eta | albedo' | dipole (15) | photons, all | multiple only | dipole off by | all, g = 0.9 | off by "
        "| half radius: dipole, photons | profile off by |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in (r for r in rows if r.eta in SHOWN_ETAS):
        off, off_forward = r.dipole / r.total - 1, r.dipole / r.total_forward - 1
        lines.append(
            f"| {r.eta} | {r.albedo_prime} | {r.dipole:.4f} | {r.total:.4f} | {r.multiple:.4f} | {off:+.1%} "
            f"| {r.total_forward:.4f} | {off_forward:+.1%} | {r.half_radius_dipole:.2f}, {r.half_radius:.2f} "
            f"| {r.profile_error:.0%} |"
        )
    return "\n".join(lines)


def ring_table(rows: list[Row], radii: np.ndarray) -> str:
    """Write how much light the dipole lets out of each ring, over what the photons do, as Markdown."""
    bounds = (0, 0.25, 0.5, 1, 2, 4, 8, 16)
    names = [f"{low} to {high}" for low, high in pairwise(bounds)]
    lines = [f"| eta | albedo' | {' | '.join(names)} |", "| --- " * (len(names) + 2) + "|"]
    areas = np.diff(radii**2)
    rings = np.digitize(np.sqrt(radii[1:] * radii[:-1]), bounds[1:])
    for r in (r for r in rows if r.eta in SHOWN_ETAS and r.albedo_prime in RING_ALBEDOS):
        dipole, photons = (np.bincount(rings, np.array(p) * areas) for p in (r.profile_dipole, r.profile))
        ratios = " | ".join(f"{ratio:.2f}" for ratio in (dipole / photons)[: len(names)])
        lines.append(f"| {r.eta} | {r.albedo_prime} | {ratios} |")
    return "\n".join(lines)


def insert(path: Path, text: str) -> None:
    """Replace what stands between the marks of this command."""
    before, rest = path.read_text().split("<!-- dipole_accuracy: begin -->")
    after = rest.split("<!-- dipole_accuracy: end -->")[1]
    marked = f"<!-- dipole_accuracy: begin -->\n{text}\n<!-- dipole_accuracy: end -->"
    path.write_text(before + marked + after)


def plot(rows: list[Row], radii: np.ndarray, path: Path) -> None:
    """Draw total reflectance by reduced albedo, and four radial profiles."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2))
    for color, eta in zip(("tab:green", "tab:blue", "tab:red"), SHOWN_ETAS, strict=True):
        mine = [r for r in rows if r.eta == eta]
        x = [r.albedo_prime for r in mine]
        left.plot(x, [r.dipole / r.total - 1 for r in mine], "o-", color=color, label=f"eta = {eta}, g = 0")
        left.plot(
            x, [r.dipole / r.total_forward - 1 for r in mine], "s--", ms=3, color=color, label=f"eta = {eta}, g = 0.9"
        )
    left.axhspan(-0.1, 0.1, color="0.9")
    left.set(xlabel="reduced albedo", ylabel="dipole / photons - 1", ylim=(-0.4, 1.0), title="Total reflectance")
    left.legend(fontsize=7)
    centre = 0.5 * (radii[1:] + radii[:-1])
    for albedo_prime in PLOTTED:
        (r,) = (r for r in rows if r.eta == 1.3 and r.albedo_prime == albedo_prime)
        shown = (centre > 0.02) & (centre < 60)
        (line,) = right.loglog(centre[shown], np.array(r.profile_dipole)[shown], label=f"albedo' = {albedo_prime}")
        right.loglog(centre[shown], np.array(r.profile)[shown], ".", ms=3, color=line.get_color())
    right.set(
        xlabel="r sigma_t'", ylabel="R_d / sigma_t'^2", ylim=(1e-8, 10), title="Profile, eta = 1.3 (dots: photons)"
    )
    right.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few photons; writes nothing")
    quick = parser.parse_args().quick
    photons = 1 << 14 if quick else 1 << 19
    rows = []
    for eta in ETAS:
        for albedo_prime in ALBEDOS:
            rows.append(measure(albedo_prime, eta, photons))
            r = rows[-1]
            print(f"eta {eta}  albedo' {albedo_prime:<6} dipole {r.dipole:.4f}  photons {r.total:.4f} +- {r.error:.4f}")
    radii = ring_bounds()
    if quick:
        return
    (DOCS / "figures").mkdir(parents=True, exist_ok=True)
    data = {
        "command": "python benchmarks/dipole_accuracy.py",
        "photons": photons,
        "incidence": "diffuse",
        "unit_of_length": "1 / sigma_t'",
        "external_diffuse_transmittance": {str(eta): float(external_diffuse_transmittance(eta)) for eta in ETAS},
        "radii": rounded(radii.tolist()),
        "rows": [{key: rounded(value) for key, value in asdict(r).items()} for r in rows],
    }
    (DOCS / "figures" / "dipole_accuracy.json").write_text(json.dumps(data))
    plot(rows, radii, DOCS / "figures" / "dipole_accuracy.png")
    between = "The dipole's light over the photons', by distance in mean free paths:"
    insert(DOCS / "theory" / "model.md", f"{table(rows)}\n\n{between}\n\n{ring_table(rows, radii)}")


if __name__ == "__main__":
    main()
