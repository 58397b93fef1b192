"""Make the tables of profiles anew: ``python tools/profile_table/make.py``. It takes an hour on one core and is resumed where it stopped.

It needs a C compiler. ``check.py`` compares the result with other photons and another program.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import curve
import numpy as np
import thin
from flat import fit, noise, total
from walks import EARLY_ORDER, Array, Task, Walk, mean, run_all

from pellucid.model.flat_profile import MOST_ABSORBING
from pellucid.model.tabulated import CURVES, FLAT, THIN, decay, integral, unreduced

G = (-0.5, 0.0, 0.3, 0.6, 0.8, 0.9, 0.95)
ETA = (1.0, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5, 1.7, 2.0)
S = np.sort(np.append(np.linspace(0, np.sqrt(MOST_ABSORBING), 12) ** 2, (1.55, 1.64, 1.7)))
S_TOTAL = np.linspace(0, np.sqrt(MOST_ABSORBING), 40) ** 2
PHOTONS, EARLY = 4_000_000, 8_000_000
"""Those that are followed to the end, and those that say what is missing of media that absorb most light."""
DARKEST = np.sqrt(3 * (1 - 0.1))  # s of the reduced albedo 0.1, down to which the noise is checked
NOISIEST = 0.02  # L1 noise, over the reflectance, in half octaves of distance; the fit, a knot an octave, has less


def main() -> None:
    """Walk, fit, check the noise, and write the files of the package."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/profile_table"), help="where walks are kept")
    parser.add_argument("--jobs", type=int, default=1, help="walks at a time")
    options = parser.parse_args()
    found = {(g, eta): half_space(g, eta, options) for g in sorted(G, key=abs) for eta in ETA}  # the quick ones first
    write_flat(found)
    write_curves(found, options)
    write_thin(options)


def half_space(g: float, eta: float, options: argparse.Namespace) -> Walk:
    """Walk in a half space."""
    tasks = [
        Task("half_space", 0, g, eta, PHOTONS, 1),
        Task("half_space", 0, g, eta, EARLY, 11, EARLY_ORDER),
    ]
    walk = mean(run_all(tasks, options.folder, options.jobs))
    noises = [noise(walk, s) for s in (*S[S < DARKEST], DARKEST)]
    print(f"g {g:g}, eta {eta:g}: noise {min(noises):.2%} to {max(noises):.2%}", flush=True)
    if max(noises) > NOISIEST:
        raise SystemExit(f"g = {g:g}, eta = {eta:g}: a noise of {max(noises):.2%}; trace more photons.")
    return walk


def write_flat(found: dict[tuple[float, float], Walk]) -> None:
    """Write the flat profiles."""
    y, log_total = ([[rows(found[g, eta]) for eta in ETA] for g in G] for rows in (shapes, totals))
    write(FLAT, g=G, eta=ETA, s=S, s_total=S_TOTAL, y=np.float32(y), log_total=np.float32(log_total))


def shapes(walk: Walk) -> list[Array]:
    """Fit y at every node of s and scale it so that the profile integrates to 1."""
    fitted = [fit(walk, s) for s in S]
    return [y - np.log(integral(y, decay(s, walk.g))) for s, y in zip(S, fitted, strict=True)]


def totals(walk: Walk) -> list[float]:
    """Give ``log(R / a')`` at every node of s."""
    albedo = [unreduced(s, walk.g) for s in S_TOTAL]
    reduced = [a * (1 - walk.g) / (1 - walk.g * a) for a in albedo]
    return [float(np.log(total(walk, s) / a)) for s, a in zip(S_TOTAL, reduced, strict=True)]


def write_curves(found: dict[tuple[float, float], Walk], options: argparse.Namespace) -> None:
    """Write beta."""
    walks = [run_all(curve.spheres(eta), options.folder, options.jobs) for eta in curve.ETA]
    beta = [[curve.beta(found[0.0, eta], of_eta, s) for s in S] for eta, of_eta in zip(curve.ETA, walks, strict=True)]
    write(CURVES, eta=curve.ETA, s=S, octave=curve.OCTAVE, beta=np.float32(beta))


def write_thin(options: argparse.Namespace) -> None:
    """Write the factors of thin parts; they need the other two tables."""
    walks = [run_all(thin.slabs(eta), options.folder, options.jobs) for eta in curve.ETA]
    own = [[thin.own_sums(of_eta, s) for s in S] for of_eta in walks]
    factor = [[thin.factors(of_eta, s) for s in S] for of_eta in walks]
    write(THIN, eta=curve.ETA, s=S, own=np.float32(own), factor=np.float32(factor))


def write(path: Path, **arrays: object) -> None:
    """Write a file and say how large it is."""
    np.savez_compressed(path, **arrays)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
