"""A marble sphere under light from one side, as many samples as its size asks for."""

import types

import numpy as np
import pytest

from pellucid.gather.octree import build_octree
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from worlds.points import spread_on_sphere

COUNT = 6000


@pytest.fixture(scope="session")
def body():
    medium = Medium.from_preset("marble")
    total_area = COUNT * np.pi * medium.mfp.min() ** 2
    radius = np.sqrt(total_area / (4 * np.pi))
    n = spread_on_sphere(COUNT, 0)
    area = np.random.default_rng(1).uniform(0.8, 1.2, COUNT)
    area *= total_area / area.sum()
    light = np.maximum(n @ [0.6, 0.0, 0.8], 0)[:, None] * [1.0, 0.9, 0.8] + 0.01
    return types.SimpleNamespace(
        medium=medium,
        table=ProfileTable.from_medium(medium),
        p=(radius * n).astype(np.float32),
        area=area.astype(np.float32),
        power=(light * area[:, None]).astype(np.float32),
        radius=radius,
        queries=(radius * spread_on_sphere(1201, 2)).astype(np.float32),
    )


@pytest.fixture(scope="session")
def octree(body):
    return build_octree(body.p, body.area, body.power)
