"""The surface nearest to points that come from elsewhere: which body they lie on, and its normal there."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ..kernels.memory import columns, rows, upload
from ..kernels.sequences import fibonacci_lattice
from .bodies import Body, build_lookup
from .samples.surface import outside_of

SAMPLES, FEWEST = 200_000, 4_000
"""Points spread over all bodies together, and over each at least."""

NEIGHBOURS = 8
ALIKE = 2.0
"""Bodies whose nearest samples differ by less than so many sample spacings are told apart by their tangent planes."""

BESIDE = 4.0
"""A point that is so many sample spacings away from the nearest sample lies on no surface."""


class NearestSurface:
    """Finds, for points on or near the bodies of a scene, the body and its normal, by samples spread over all surfaces."""

    def __init__(self, scene: mi.Scene, bodies: list[Body]):
        self._numbers = np.array([k for k, body in enumerate(bodies) if body.side != -1])
        self._is_open = np.array([body.side != 0 for body in bodies])
        bodies = [bodies[k] for k in self._numbers]
        self._scene, self._lookup = scene, build_lookup(scene, bodies)
        count = max(SAMPLES // len(bodies), FEWEST)
        surfaces = [body.surface() for body in bodies]
        with dr.suspend_grad():
            spread = [surface.alike(surface.draw(count, 0, fibonacci_lattice)) for surface in surfaces]
        inwards = [outside_of(rows(sites.p), rows(sites.n), np.ones(count)) < 0 for sites in spread]
        self.wound_inwards = np.zeros(len(self._is_open), bool)
        """By body: whether it is closed, and the normals of its faces point into it."""
        self.wound_inwards[self._numbers] = inwards & ~self._is_open[self._numbers]
        self._n = np.concatenate([rows(sites.n) for sites in spread])
        self._body = np.repeat(np.arange(len(bodies)), count)
        self._spacing = np.sqrt([surface.area / count for surface in surfaces])
        self._tree = cKDTree(np.concatenate([rows(sites.p) for sites in spread]), balanced_tree=False)

    def most_distant(self, points: np.ndarray) -> tuple[int, float]:
        """Find which of points is farthest from all surfaces, and how far; -1 and 0 if all are about as near as points of a surface."""
        distance, near = self._tree.query(points, workers=-1)
        beyond = distance - BESIDE * self._spacing[self._body[near]]
        worst = int(np.argmax(beyond))
        return (worst, float(distance[worst])) if beyond[worst] > 0 else (-1, 0.0)

    def find(
        self, points: np.ndarray, body: int | None = None, normals: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, Any]:
        """Find the nearest surface.

        Parameters
        ----------
        points : (n, 3) float
            On the surface, or not further from it than the spacing of samples (a few hundredths of a body's extent), where its
            normal is that of the surface itself; further away it is that of the nearest sample.
        body : int, optional
            Only look at this one.
        normals : (n, 3) float, optional
            They tell which side of an open surface is meant; without them it is the front.

        Returns
        -------
        body : (n,) int
            Numbers from 0 on. Where bodies touch, either.
        n : (n, 3) float32
            Normals.
        si : SurfaceInteraction3f
            The surface there.
        """
        if body is None:
            distance, near = self._tree.query(points, NEIGHBOURS, workers=-1)
        else:
            own = np.flatnonzero(self._body == np.searchsorted(self._numbers, body, "right") - 1)
            distance, near = cKDTree(self._tree.data[own]).query(points, NEIGHBOURS, workers=-1)
            near = own[near]
        offset = points[:, None] - self._tree.data[near]
        height = np.abs(np.sum(offset * self._n[near], axis=2))
        spacing = self._spacing[self._body[near]]
        beside = distance <= distance[:, :1] + ALIKE * spacing
        best = np.argmin(np.where(beside, height + 1e-3 * distance, np.inf), axis=1)
        nearest = near[np.arange(len(points)), best]
        found = self._body[nearest]
        n, si = self._meet(points, nearest, found)
        if body is not None:
            return np.full(len(points), body), n, si
        number = self._numbers[found]
        if normals is not None:
            number = number + (self._is_open[number] & (np.sum(n * normals, axis=1) < 0))
        return number, n, si

    def _meet(self, points: np.ndarray, nearest: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, Any]:
        """Meet the surface that lies within reach along the normal of the nearest sample; where there is none, take what that lies on.

        Returns
        -------
        normals, SurfaceInteraction3f
        """
        way, far = mi.Vector3f(*columns(self._n[nearest])), upload(self._spacing[body].astype(np.float32))

        def meet(p: np.ndarray) -> tuple[Any, mi.Bool]:
            ray = mi.Ray3f(mi.Point3f(*columns(p)) + way * far, -way)
            ray.maxt = 2 * far
            si = self._scene.ray_intersect(ray)
            own = self._lookup.body_index(si, si.is_valid()) == upload(body.astype(np.uint32) + 1)
            return si, si.is_valid() & own

        si, met = meet(points)
        n = dr.select(met, mi.Vector3f(si.n), way)
        return rows(n), dr.select(met, si, meet(self._tree.data[nearest])[0])
