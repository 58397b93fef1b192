"""Make the table of flat profiles anew: ``python tools/profile_table/make.py``. It takes an hour and is resumed where it stopped."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from flat import fit, total
from walks import EARLY_ORDER, Array, Task, Walk, mean, run_all

from pellucid.model.flat_profile import MOST_ABSORBING
from pellucid.model.tabulated import FILE, decay, evaluate, integral, unreduced

G = (-0.5, 0.0, 0.3, 0.6, 0.8, 0.9, 0.95)
ETA = (1.0, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5, 1.7, 2.0)
S = np.linspace(0, np.sqrt(MOST_ABSORBING), 12) ** 2
S_TOTAL = np.linspace(0, np.sqrt(MOST_ABSORBING), 40) ** 2
PHOTONS, EARLY = 4_000_000, 8_000_000
"""In each of two halves: those that are followed to the end, and those that say what is missing of media that absorb most light."""
NOISIEST = 0.01  # that a half may have, of its light; the table has less by a factor of root 2


def main() -> None:
    """Walk, fit, check the noise, and write the file of the package."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/profile_table"), help="where walks are kept")
    parser.add_argument("--jobs", type=int, default=1, help="walks at a time")
    options = parser.parse_args()
    pairs = [(g, eta) for g in sorted(G, key=abs) for eta in ETA]  # the quick ones first
    halves = [[run_all(half_space(g, eta, half), options.folder, options.jobs) for g, eta in pairs] for half in (0, 1)]
    found = {}
    for pair, one, other in zip(pairs, *halves, strict=True):
        report_noise(pair, mean(one), mean(other))
        found[pair] = mean([*one, *other])
    y, log_total = (
        np.array([[rows(found[g, eta]) for eta in ETA] for g in G], np.float32) for rows in (shapes, totals)
    )
    np.savez_compressed(FILE, g=G, eta=ETA, s=S, s_total=S_TOTAL, y=y, log_total=log_total)
    print(f"{FILE}: {FILE.stat().st_size / 1000:.0f} kB")


def half_space(g: float, eta: float, half: int) -> list[Task]:
    """List the walks of one half of the photons of a medium."""
    return [
        Task("half_space", 0, g, eta, PHOTONS, 1 + half),
        Task("half_space", 0, g, eta, EARLY, 11 + half, EARLY_ORDER),
    ]


def shapes(walk: Walk) -> list[Array]:
    """Fit y at every node of s and scale it so that the profile integrates to 1."""
    fitted = [fit(walk, s) for s in S]
    return [y - np.log(integral(y, decay(s, walk.g))) for s, y in zip(S, fitted, strict=True)]


def totals(walk: Walk) -> list[float]:
    """Give ``log(R / a')`` at every node of s."""
    albedo = [unreduced(s, walk.g) for s in S_TOTAL]
    reduced = [a * (1 - walk.g) / (1 - walk.g * a) for a in albedo]
    return [float(np.log(total(walk, s) / a)) for s, a in zip(S_TOTAL, reduced, strict=True)]


def report_noise(pair: tuple[float, float], one: Walk, other: Walk) -> None:
    """Compare the profiles of two halves of the photons: their noise is their difference (L1) over root 2."""
    edges = np.geomspace(1e-3, 400, 1500)
    x, area = np.sqrt(edges[1:] * edges[:-1]), np.pi * np.diff(edges**2)
    noise = []
    for s in S[:-1]:
        profiles = [evaluate(fit(walk, s), x, decay(s, walk.g)) * area for walk in (one, other)]
        noise.append(float(np.abs(profiles[0] - profiles[1]).sum() / profiles[0].sum() / np.sqrt(2)))
    print(f"g {pair[0]:g}, eta {pair[1]:g}: noise of a half {min(noise):.2%} to {max(noise):.2%}", flush=True)
    if max(noise) > NOISIEST:
        raise SystemExit(f"g = {pair[0]:g}, eta = {pair[1]:g}: a noise of {max(noise):.2%}; trace more photons.")


if __name__ == "__main__":
    main()
