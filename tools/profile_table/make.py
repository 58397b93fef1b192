"""Make the table of flat profiles anew: ``python tools/profile_table/make.py``; an hour on one core, resumed where it stopped.

It needs a C compiler. ``check.py`` compares the result with other photons and another program.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from flat import fit, noise, total
from walks import EARLY_ORDER, Array, Task, Walk, mean, run_all

from pellucid.model.flat_profile import MOST_ABSORBING
from pellucid.model.tabulated import FILE, decay, integral, unreduced

G = (-0.5, 0.0, 0.3, 0.6, 0.8, 0.9, 0.95)
ETA = (1.0, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5, 1.7, 2.0)
S = np.sort(np.append(np.linspace(0, np.sqrt(MOST_ABSORBING), 12) ** 2, (1.55, 1.64, 1.7)))
S_TOTAL = np.linspace(0, np.sqrt(MOST_ABSORBING), 40) ** 2
PHOTONS, EARLY = 4_000_000, 8_000_000
"""Those that are followed to the end, and those that say what is missing of media that absorb most light."""
DARKEST = np.sqrt(3 * (1 - 0.1))  # s of the reduced albedo 0.1, down to which the noise is checked
NOISIEST = 0.02  # L1 noise, over the reflectance, in half octaves of distance; the fit, a knot an octave, has less


def main() -> None:
    """Walk, fit, check the noise, and write the file of the package."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/profile_table"), help="where walks are kept")
    parser.add_argument("--jobs", type=int, default=1, help="walks at a time")
    options = parser.parse_args()
    found = {(g, eta): half_space(g, eta, options) for g in sorted(G, key=abs) for eta in ETA}  # the quick ones first
    y, log_total = ([[rows(found[g, eta]) for eta in ETA] for g in G] for rows in (shapes, totals))
    np.savez_compressed(FILE, g=G, eta=ETA, s=S, s_total=S_TOTAL, y=np.float32(y), log_total=np.float32(log_total))
    print(f"{FILE}: {FILE.stat().st_size / 1000:.0f} kB")


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


def shapes(walk: Walk) -> list[Array]:
    """Fit y at every node of s and scale it so that the profile integrates to 1."""
    fitted = [fit(walk, s) for s in S]
    return [y - np.log(integral(y, decay(s, walk.g))) for s, y in zip(S, fitted, strict=True)]


def totals(walk: Walk) -> list[float]:
    """Give ``log(R / a')`` at every node of s."""
    albedo = [unreduced(s, walk.g) for s in S_TOTAL]
    reduced = [a * (1 - walk.g) / (1 - walk.g * a) for a in albedo]
    return [float(np.log(total(walk, s) / a)) for s, a in zip(S_TOTAL, reduced, strict=True)]


if __name__ == "__main__":
    main()
