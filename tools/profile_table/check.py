"""Check the table of the package: profiles against fresh photons between its nodes, totals against adding-doubling.

``python tools/profile_table/check.py``; adding-doubling is that of ``iadpython`` (PyPI).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import iadpython
import numpy as np
from flat import ring_energy, stretched_edges
from walks import EARLY_ORDER, Array, Task, Walk, mean, run_all

from pellucid.model.photon_simulation import unreduced_albedo
from pellucid.model.tabulated import Tabulated

MEDIA = (
    (0.0, 1.3),
    (0.0, 1.5),
    (0.45, 1.25),
    (0.7, 1.35),
    (0.85, 1.33),
    (0.93, 1.45),
    (-0.25, 1.6),
    (0.2, 1.02),
    (0.75, 1.85),
)
ALBEDOS = (0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 0.995, 0.999, 0.9999)
PHOTONS, EARLY, SEED = 4_000_000, 16_000_000, 1001
QUADRATURE = 32


def main() -> None:
    """Print both comparisons."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/profile_table"), help="where walks are kept")
    parser.add_argument("--media", type=int, default=len(MEDIA), help="how many media")
    options = parser.parse_args()
    print("L1 of the profile / noise that it has by the photons alone; total over adding-doubling [%]")
    print("g, eta | " + " | ".join(f"{a:g}" for a in ALBEDOS))
    for g, eta in MEDIA[: options.media]:
        tasks = [
            Task("half_space", 0, g, eta, PHOTONS, SEED),
            Task("half_space", 0, g, eta, EARLY, SEED + 1, EARLY_ORDER),
        ]
        walk = mean(run_all(tasks, options.folder, 1))
        cells = [f"{l1:.2%}/{noise:.2%}; {off:+.2%}" for l1, noise, off in (compare(walk, a) for a in ALBEDOS)]
        print(f"{g:g}, {eta:g} | " + " | ".join(cells), flush=True)


def compare(walk: Walk, albedo_prime: float) -> tuple[float, float, float]:
    """Compare profile and total: L1 over the reflectance, in half octaves of distance; its noise; error of the total."""
    s = float(np.sqrt(3 * (1 - albedo_prime)))
    energy, variance = ring_energy(walk, s)
    expected = table_rings(stretched_edges(walk, s), s, walk.g, walk.eta)
    parts = np.arange(0, len(energy), 4)
    found, model, variance = (np.add.reduceat(v, parts) for v in (energy, expected, variance))
    total = Tabulated().total(s, walk.g, walk.eta)
    noise = np.sqrt(2 / np.pi) * np.sqrt(variance).sum()
    off = total / adding_doubling(albedo_prime, walk.g, walk.eta) - 1
    return float(np.abs(found - model).sum() / total), float(noise / total), off


def table_rings(edges: Array, s: float, g: float, eta: float, nodes: int = 8) -> Array:
    """Integrate the tabulated profile over rings."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    x = 0.5 * (edges[1:] + edges[:-1])[:, None] + 0.5 * np.diff(edges)[:, None] * node
    return (Tabulated().density(x, s, g, eta) * 2 * np.pi * x * weight).sum(axis=1) * 0.5 * np.diff(edges)


def adding_doubling(albedo_prime: float, g: float, eta: float) -> float:
    """Return the share of the entering diffuse light that a half space sends back."""

    def reflectance(albedo: float) -> float:
        sample = iadpython.Sample(a=albedo, b=1e5, g=g, n=eta, n_above=1.0, n_below=eta, quad_pts=QUADRATURE)
        return float(sample.rt()[2])

    surface = reflectance(0.0)
    return (reflectance(float(unreduced_albedo(albedo_prime, g))) - surface) / (1 - surface)


if __name__ == "__main__":
    main()
