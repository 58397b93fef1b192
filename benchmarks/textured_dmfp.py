"""How wrong a texture of the mean free path is beside its borders: a flat body of two halves, by pellucid's rule and by photons.

    python benchmarks/textured_dmfp.py

A thin beam of diffuse light falls on one half, at a distance from the border. pellucid spreads it by the profile of where it leaves;
photons meet the free path of where they are. Also under even light, where the rule returns the same everywhere. Writes
docs/figures/textured_dmfp.json and the table in docs/theory/model.md between its marks. Takes about two minutes on one core;
``--quick`` follows few photons, and writes nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import pairwise

import pellucid  # noqa: F401 (points Dr.Jit at its LLVM)

# isort: split
import numpy as np
from drjit.llvm import Float64

from pellucid.model.fresnel import fresnel_dielectric
from pellucid.model.medium import Medium
from support.record import DOCS, fill, markdown_table, save

COMMAND = "python benchmarks/textured_dmfp.py"
LENGTHS = (0.5, 2.0)  # of the left half and of the right one [mm]
REFLECTANCE, ETA = 0.7, 1.3
BEAMS = (-1.0, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Where they fall [mm]."""
STRIPS = (-4.0, -2.0, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Bounds of the strips in which what comes back of even light is counted [mm]."""
REACH = 12.0
"""Even light falls this far to both sides of the border [mm]."""
ROULETTE_BELOW = 0.05

Array = np.ndarray


def fresnel(cosine: Array) -> Array:
    """Evaluate which part of light the boundary reflects."""
    return fresnel_dielectric(Float64(cosine), ETA).numpy()


def half_plane(medium: Medium, distance: float) -> float:
    """Integrate a profile over all that lies beyond a line at a distance [mm]."""
    edges = distance + np.geomspace(1e-5, 200 * float(medium.dmfp[0]), 4000)
    r = 0.5 * (edges[1:] + edges[:-1])
    rings = medium.diffuse_reflectance(r)[:, 0] * 2 * np.arccos(distance / r) * r * np.diff(edges)
    return float(rings.sum())


def by_rule(media: list[Medium], x: float) -> tuple[float, float]:
    """Give what comes back of a beam at x, and what of it on the other half, by the profile of where it leaves."""
    here, there = media if x < 0 else media[::-1]
    crossed = half_plane(there, abs(x))
    return float(here.total_diffuse_reflectance[0]) - half_plane(here, abs(x)) + crossed, crossed


def by_photons(media: list[Medium], x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Walk photons that enter at x ``(n,)``: where each leaves ``(m,)``, and what it carries of the entering flux.

    Free flights are drawn for the denser half; in the other one most of their ends are no collisions (Woodcock 1965).
    """
    sigma = np.array([float(medium.sigma_t_prime[0]) for medium in media])
    albedo = float(media[0].albedo_prime[0])
    p = np.stack([x, 0 * x, 0 * x], axis=1)
    sine = np.sqrt(rng.random(len(x)))
    weight = 1 - fresnel(np.sqrt(1 - sine**2))
    flux = weight.sum()
    phi = 2 * np.pi * rng.random(len(x))
    inside = sine / ETA
    d = np.stack([inside * np.cos(phi), inside * np.sin(phi), np.sqrt(1 - inside**2)], axis=1)
    left, carried = [], []
    while len(p):
        flight = -np.log(1 - rng.random(len(p))) / sigma.max()
        to_surface = np.where(d[:, 2] < 0, p[:, 2] / np.maximum(-d[:, 2], 1e-12), np.inf)
        surfaced = to_surface <= flight
        p += d * np.minimum(flight, to_surface)[:, None]
        reflected = rng.random(len(p)) < fresnel(np.where(surfaced, d[:, 2], -1.0))
        leaves = surfaced & ~reflected
        p[surfaced, 2] = 0
        d[surfaced & reflected, 2] *= -1
        left.append(p[leaves, 0])
        carried.append(weight[leaves])
        collided = ~surfaced & (rng.random(len(p)) * sigma.max() < sigma[(p[:, 0] > 0).astype(int)])
        cosine, phi = 2 * rng.random(len(p)) - 1, 2 * np.pi * rng.random(len(p))
        sine = np.sqrt(1 - cosine**2)
        d = np.where(collided[:, None], np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=1), d)
        weight = np.where(collided, weight * albedo, weight)
        faint = weight < ROULETTE_BELOW
        survives = ~faint | (rng.random(len(p)) < 0.5)
        weight = np.where(faint, 2 * weight, weight)
        on = survives & ~leaves
        p, d, weight = p[on], d[on], weight[on]
    return np.concatenate(left), np.concatenate(carried) / flux


def of_beams(media: list[Medium], walk: Callable[[Array], tuple[Array, Array]], count: int) -> list[list[float]]:
    """Compare what comes back of beams, and what crosses the border: a row a beam."""
    rows = []
    for x in BEAMS:
        at, carried = walk(np.full(count, x))
        beyond = carried[(at < 0) != (x < 0)].sum()
        total, crossed = by_rule(media, x)
        rows.append([x, total, float(carried.sum()), crossed, float(beyond)])
    return rows


def of_even_light(walk: Callable[[Array], tuple[Array, Array]], count: int) -> Array:
    """Find what comes back under even light of 1 in each strip."""
    x = ((np.arange(count) + 0.5) / count * 2 - 1) * REACH
    at, carried = walk(x)
    return np.histogram(at, STRIPS, weights=carried)[0] * 2 * REACH / np.diff(STRIPS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    media = [Medium.from_reflectance(REFLECTANCE, length, ETA) for length in LENGTHS]
    rng, count = np.random.default_rng(0), 1_000 if quick else 30_000
    rows = of_beams(media, lambda x: by_photons(media, x, rng), count)
    even = of_even_light(lambda x: by_photons(media, x, rng), 20 * count)
    head = ["beam at [mm]", "returned", "by photons", "of it beyond the border", "by photons"]
    beams = markdown_table(head, [[f"{row[0]:g}", *(f"{value:.3f}" for value in row[1:])] for row in rows])
    head = ["even light; from, to [mm]", *(f"{a:g}, {b:g}" for a, b in pairwise(STRIPS))]
    lines = f"{beams}\n\n{markdown_table(head, [['by photons', *(f'{value:.3f}' for value in even)]])}"
    print(lines)
    if not quick:
        save("textured_dmfp", COMMAND, {"beams": rows, "strips": STRIPS, "even": even.tolist()})
        fill(DOCS / "theory" / "model.md", "textured dmfp", lines)


if __name__ == "__main__":
    main()
