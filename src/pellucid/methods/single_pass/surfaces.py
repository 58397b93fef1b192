"""The light that falls on opaque surfaces, from the light samples of the scene.

What a view shows of opaque surfaces is divided into cells. Each has the clusters of a cut through the light tree, some lights drawn of
each of them, and what a few rays have told of their visibility; all of that is decided for the view. A point then weighs all lights of its
cell, and traces some rays that correct what is expected of them (`adaptive.estimator`). What it finds depends on no other point.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ...effort import count
from ...kernels.memory import columns, rows, upload
from ...kernels.morton import LEVELS, morton_codes
from ...light.opaque import INDICES
from ...progress import steps
from ..contract import Points
from .adaptive.candidates import DRAWS, Candidates, GroupBounds, bound_groups, choose_lights
from .adaptive.estimator import Receiver, estimate_light
from .adaptive.visibility import Expectation, LightGuide, RayCounts, build_guide
from .trees.light_tree import LightTree

CELL, MOST_CELLS = 256, 2048
"""Points of a view in a cell at most; and about how many cells there are at most, for the memory that they take."""

AT_ONCE, RECEIVERS_AT_ONCE = 256, 1 << 15
"""Cells whose lights are chosen in one kernel launch, and points that are lit in one, each of which takes 2 kB."""

FEW_LIGHTS, LIGHTS = 256, 512
"""Clusters of lights of a cell while it learns, and afterwards."""

LEARN, LEARN_RAYS = 16, 16
"""One in so many points of the view traces rays that learn the visibility of lights for its cell; and how many."""

RAYS, LEAST_RAYS = 64.0, 8.0
"""Rays of a point that is seen directly, and at least where other surfaces show it."""

LEAST_DEVIATION = 0.05
"""Least standard deviation assumed of the visibility of a light: without it, a light whose rays all agree would hardly ever be tested
again, and the one ray that found a shadow there would stand for very many."""

WIDER, TURNED = 1.25, 0.1
"""Factor on the radius of the sphere around a cell, and angle [rad] added to its cone of normals: other rays through the same pixels meet
points a little outside of what the view has shown."""


@dataclass
class Cells:
    """What a view shows of opaque surfaces, in cells: of six directions that surfaces face each by itself, cubes along a Morton curve.

    The first cell is for points outside of all others.

    Attributes
    ----------
    low, high : (3,) float32
        Box of what is seen.
    begins : (k,) uint64
        Where each but the first begins, by the keys of `_keys`.
    bounds : GroupBounds
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    begins: NDArray[np.uint64]
    bounds: GroupBounds

    def __len__(self) -> int:
        return len(self.begins) + 1

    def find(self, p: mi.Point3f, n: mi.Normal3f) -> NDArray[np.int64]:
        """Tell which cell holds each point."""
        key = _keys(rows(p), rows(n), self.low, self.high)
        cell = np.searchsorted(self.begins, key, side="right")
        index, b = upload(cell.astype(np.uint32)), self.bounds
        centre, axis = dr.gather(mi.Point3f, b.centre, index), dr.gather(mi.Normal3f, b.axis, index)
        near = dr.squared_norm(p - centre) <= dr.square(dr.gather(mi.Float, b.radius, index))
        near &= dr.dot(n, axis) >= dr.gather(mi.Float, b.cos_cone, index)
        return np.where(near.numpy(), cell, 0)


def _keys(p: NDArray, n: NDArray, low: NDArray, high: NDArray) -> NDArray[np.uint64]:
    """Number places within a box along a Morton curve, those that face one of six directions by themselves."""
    codes = morton_codes(np.concatenate([np.clip(p, low, high), [low, high]]).astype(np.float32))[:-2]
    axis = np.abs(n).argmax(axis=1)
    face = 2 * axis + (np.take_along_axis(n, axis[:, None], 1)[:, 0] > 0)
    return face.astype(np.uint64) << np.uint64(60) | codes >> np.uint64(3)


def make_cells(scene: mi.Scene, p: NDArray, n: NDArray) -> tuple[Cells, NDArray[np.int64], NDArray[np.int64]]:
    """Divide points of a view into the largest cubes that hold few enough of them.

    Returns
    -------
    Cells
    order, cell : (k,) int
        The points, cell by cell, and the cell of each.
    """
    box = scene.bbox()
    everything = np.array([box.center()], np.float32), float(np.linalg.norm(box.extents())) / 2
    if not len(p):
        low = high = np.zeros(3, np.float32)
        return Cells(low, high, np.zeros(0, np.uint64), _with_all(everything, None)), *np.zeros((2, 0), np.int64)
    low, high = p.min(axis=0), p.max(axis=0)
    key = _keys(p, n, low, high)
    order = np.argsort(key, kind="stable")
    key = key[order]
    begins, open_ = np.zeros(len(key), bool), np.ones(len(key), bool)
    most = max(CELL, 4 * len(key) // MOST_CELLS)
    for level in range(LEVELS):
        cube = key >> np.uint64(3 * (LEVELS - 1 - level))
        first = np.flatnonzero(np.diff(cube, prepend=cube[0] + np.uint64(1)) != 0)
        size = np.diff(first, append=len(key))
        done = np.repeat((size <= most) | (level == LEVELS - 1), size) & open_
        begins[first] |= done[first]
        open_ &= ~done
    cell = np.cumsum(begins)
    bounds = bound_groups(p[order], n[order], cell - 1)
    return Cells(low, high, key[begins], _with_all(everything, bounds)), order, cell


def _with_all(everything: tuple[NDArray, float], bounds: GroupBounds | None) -> GroupBounds:
    """Put a cell that holds the whole scene before the others, and widen these (`WIDER`, `TURNED`)."""
    centre, radius = everything
    cones, axes, radii, centres = (np.array([-1.0]), np.array([[0.0, 0, 1]]), np.array([radius]), centre)
    if bounds is not None:
        wide = np.arccos(np.clip(bounds.cos_cone.numpy(), -1, 1)) + TURNED
        own = bounds.radius.numpy()
        cones = np.concatenate([cones, np.where(wide < np.pi, np.cos(np.minimum(wide, np.pi)), -1)])
        axes = np.concatenate([axes, rows(bounds.axis)])
        radii = np.concatenate([radii, WIDER * np.maximum(own, np.median(own) / 4)])
        centres = np.concatenate([centres, rows(bounds.centre)])
    (radius,), (cosine,) = columns(radii[:, None]), columns(cones[:, None])
    return GroupBounds(mi.Point3f(*columns(centres)), radius, mi.Normal3f(*columns(axes)), cosine)


@dataclass
class SurfaceLight:
    """The lights of all cells, and their visibility as far as it was learnt: by chunks of cells."""

    lights: LightTree
    cells: Cells
    chunks: list[tuple[Candidates, Expectation]]

    def entering(self, scene: mi.Scene, points: Points, coat: mi.UInt32) -> mi.Color3f:
        """Estimate the light that falls on points and passes their coats, of `light.opaque.INDICES`."""
        cell, drawn = self.cells.find(points.p, points.n), points.key.numpy() % DRAWS
        order = np.lexsort((drawn, cell))
        light = dr.zeros(mi.Color3f, len(order))
        ends = np.searchsorted(cell[order], np.arange(0, len(self.cells) + AT_ONCE, AT_ONCE))
        for number, chunk in enumerate(self.chunks):
            for first in range(ends[number], ends[number + 1], RECEIVERS_AT_ONCE):
                some = order[first : min(first + RECEIVERS_AT_ONCE, ends[number + 1])]
                here, used = upload(some.astype(np.uint32)), upload(drawn[some].astype(np.uint32))
                group = upload((cell[some] - number * AT_ONCE).astype(np.uint32))
                receiver, rays = _asked(points.take(here), dr.gather(mi.UInt32, coat, here), group)
                demand = dr.opaque(mi.Float, 0, len(some))  # the number of rays is given
                found = estimate_light(scene, self.lights, *chunk, receiver, demand, least=rays, most=rays, drawn=used)
                dr.scatter(light, found.light, here)
                dr.eval(light)
                count("surface rays", rays)
        return light


def _asked(points: Points, coat: mi.UInt32, group: mi.UInt32) -> tuple[Receiver, mi.Float]:
    """Describe points to the estimator, and choose the number of their rays."""
    index = dr.select(coat == 0, mi.Float(INDICES[0]), mi.Float(INDICES[1]))
    receiver = Receiver(_receivers(points.p, points.n), index, group, points.key)
    rays = dr.maximum(RAYS / points.tolerance, LEAST_RAYS)
    dr.eval(receiver, rays)
    return receiver, rays


def _receivers(p: mi.Point3f, n: mi.Normal3f) -> mi.SurfaceInteraction3f:
    """Describe points."""
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(p))
    si.p, si.n, si.sh_frame = p, n, mi.Frame3f(n)
    return si


def light_surfaces(scene: mi.Scene, lights: LightTree, p: NDArray, n: NDArray) -> SurfaceLight:
    """Choose the lights of what a view shows of opaque surfaces, and learn which of them it sees.

    Parameters
    ----------
    p, n : (k, 3) float
        Points of the view and their normals.
    """
    cells, order, cell = make_cells(scene, p, n)
    begins = np.flatnonzero(np.diff(cell, prepend=0))
    place = np.arange(len(cell)) - np.repeat(begins, np.diff(begins, append=len(cell)))
    every = place % LEARN == 0
    points, cell = order[every], cell[every]
    guide = build_guide(len(cells))
    sizes = [min(AT_ONCE, len(cells) - k) for k in range(0, len(cells), AT_ONCE)]
    learnt: list[tuple[Candidates, RayCounts]] = []
    for wanted in (FEW_LIGHTS, LIGHTS):
        learnt = []
        for first, size in steps("surfaces", sizes, "cells"):
            here = (cell >= first) & (cell < first + size)
            some = Learners(p[points[here]], n[points[here]], cell[here] - first, points[here])
            learnt.append(_learn(scene, lights, guide, cells, range(first, first + size), wanted, some))
        guide.learn()
    return SurfaceLight(lights, cells, [(found[0], _expected(guide, *found)) for found in learnt])


@dataclass
class Learners:
    """Points of some cells, by their cells: positions and normals ``(k, 3)``, cells, and running numbers."""

    p: NDArray[np.float32]
    n: NDArray[np.float32]
    cell: NDArray[np.int64]
    number: NDArray[np.int64]


def _learn(
    scene: mi.Scene, lights: LightTree, guide: LightGuide, cells: Cells, some: range, wanted: int, points: Learners
) -> tuple[Candidates, RayCounts]:
    """Choose the lights of some cells, and trace rays from their points."""
    name = upload(np.array(some, np.uint32))
    bounds = dr.gather(GroupBounds, cells.bounds, name)
    asked = upload(np.full(len(some), wanted, np.uint32))
    candidates = choose_lights(lights, guide.visibility, bounds, name, name, asked)
    rays = RayCounts.none(candidates)
    if len(points.p):
        receiver = Receiver(
            _receivers(mi.Point3f(*columns(points.p)), mi.Normal3f(*columns(points.n))),
            dr.opaque(mi.Float, 1),
            upload(points.cell.astype(np.uint32)),
            upload(points.number.astype(np.uint32)),
        )
        demand, number = dr.opaque(mi.Float, 0, len(points.p)), dr.opaque(mi.Float, LEARN_RAYS)
        expected = guide.expect(candidates, rays)
        rays = estimate_light(scene, lights, candidates, expected, receiver, demand, least=number, most=number).rays
        count("surface rays", rays.tried)
        guide.add(candidates.place, rays)
    return candidates, rays


def _expected(guide: LightGuide, candidates: Candidates, rays: RayCounts) -> Expectation:
    """Tell the visibility of the lights of cells."""
    expected = guide.expect(candidates, rays)
    expected.deviation = dr.maximum(expected.deviation, LEAST_DEVIATION)
    dr.eval(expected)
    return expected
