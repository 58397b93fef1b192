"""Photon walks: compiled once, run once for each set of arguments, kept in a folder so that the work can be resumed."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SOURCE = Path(__file__).with_name("walk.c")
SHAPES = ("half_space", "slab", "sphere", "cylinder", "cube")
FACES, RINGS, ORDERS = 3, 161, 224
LAST_ORDER, EARLY_ORDER = 500, 4  # in units of 1 / (1 - g)
ENDLESS = 20_000  # the same, of walks in bodies, which all light leaves before
SINGLE_ORDERS, PER_OCTAVE = 32, 16  # bins of orders: one each, then so many an octave
EDGES = np.concatenate([[0.0], 2.0 ** (np.arange(RINGS) / 8 - 10)])
"""Bounds of the rings [reduced mean free paths of the medium without absorption]: ``(RINGS + 1,)``."""


@dataclass(frozen=True)
class Task:
    """One run of the walk: shape, its size [reduced mean free paths], g, eta, photons, seed, last order in units of ``1 / (1 - g)``."""

    shape: str
    size: float
    g: float
    eta: float
    photons: int
    seed: int
    orders: float = LAST_ORDER

    def file(self, folder: Path) -> Path:
        """Name the file of the result."""
        name = f"{self.shape}_{self.size:g}_g{self.g:g}_eta{self.eta:g}_{self.photons}_{self.seed}"
        return folder / (name + (".bin" if self.orders == LAST_ORDER else f"_{self.orders:g}.bin"))

    def run(self, program: Path, folder: Path) -> Path:
        """Walk, unless that has been done."""
        target = self.file(folder)
        if not target.exists():
            partial = target.with_suffix(".partial")
            given = (
                SHAPES.index(self.shape),
                self.size,
                self.g,
                self.eta,
                self.photons,
                self.orders,
                self.seed,
                partial,
            )
            subprocess.run([program, *map(str, given)], check=True)
            os.replace(partial, target)
        return target


def run_all(tasks: Iterable[Task], folder: Path, jobs: int) -> list[Walk]:
    """Run tasks in ``jobs`` processes and read what they found."""
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "walk"
    subprocess.run(["cc", "-O3", "-march=native", "-ffast-math", "-o", program, SOURCE, "-lm"], check=True)
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(lambda task: Walk.read(task.run(program, folder), task.orders), tasks))


def mean(walks: Sequence[Walk]) -> Walk:
    """Take walks that differ in their seed for one; those that ended early, after the first, count for the orders that they saw."""
    first = walks[0]
    photons = np.array([walk.photons * (walk.saw() | (walk.last == first.last)) for walk in walks])
    share = photons / photons.sum(axis=0)
    found = sum(part * walk.found for part, walk in zip(share, walks, strict=True))
    squares = sum(part**2 * walk.squares for part, walk in zip(share, walks, strict=True))
    left = float(np.mean([walk.left for walk in walks if walk.last == first.last]))
    return replace(first, photons=float(photons[:, 1].sum()), left=left, found=found, squares=squares)


@dataclass
class Walk:
    """What came back out of a body, per unit of entering flux.

    Attributes
    ----------
    shape : str
        One of `SHAPES`.
    size, g, eta : float
        The body [reduced mean free paths] and its medium.
    photons : float
        How many walked.
    left : float
        The light that was still inside after the last order.
    last : float
        That order.
    found, squares : (FACES, RINGS, ORDERS) float
        Light by the face and the ring in which it leaves and by its order of scattering, and its variance.
    order : (ORDERS,) float
        Mean order of each bin.
    """

    shape: str
    size: float
    g: float
    eta: float
    photons: float
    left: float
    last: float
    found: Array
    squares: Array
    order: Array

    @classmethod
    def read(cls, path: Path, orders: float) -> Walk:
        """Read the file of a task of so many orders, in units of ``1 / (1 - g)``."""
        data = np.fromfile(path)
        shape, size, g, eta, photons, left = data[:6]
        sums = data[6:-ORDERS].reshape(2, FACES, RINGS, ORDERS) / photons
        body = SHAPES[int(shape)], size, g, eta
        return cls(
            *body, photons, left / photons, int(orders / (1 - g)), sums[0], sums[1] / photons, data[-ORDERS:].copy()
        )

    def saw(self) -> NDArray[np.bool_]:
        """Tell of which bins of orders all were followed: ``(ORDERS,)``."""
        number = np.arange(ORDERS)
        largest = SINGLE_ORDERS * 2.0 ** (np.maximum(number + 1 - SINGLE_ORDERS, 0) / PER_OCTAVE)
        return np.where(number < SINGLE_ORDERS, number, largest) <= self.last
