"""Measure the light of the clusters of a cut: rays are allocated by importance and standard deviation, and tell what is seen."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....effort import count
from ....kernels.memory import rows, upload
from ....progress import steps
from ..trees.light_tree import LightTree
from .candidates import MOST_LIGHTS, Candidates, bound_groups, choose_lights
from .copies import Copies
from .cut import Cut
from .estimator import Receiver, estimate_light
from .visibility import Expectation, LightGuide, RayCounts, build_guide

GROUP = 256
"""Most clusters of a receiver group, which shares candidates and learns which of them it sees."""

LAUNCHES, FEW_GROUPS, MANY_GROUPS = 4, 64, 512
"""Launches that groups are divided among at least, so that the first tell the others which standard deviations are left; and groups
of one at least and at most: what is known of their lights takes memory, which takes longer to get than to use."""

LEARN = 16
"""One cluster in so many learns for the others of its group."""

LEAST_RAYS = 0.5
"""Rays of a cluster at least, in the mean: where little is asked, every second one tries a light."""

FEW_LIGHTS, LEAST_LIGHTS, LIGHTS_WANTED, LIGHTS_POWER = 512, 256, 600.0, 0.4
"""Candidates while groups learn; at least; where a single ray would do if nothing was known; and the power of the accuracy asked for
that their number goes with. Were it not for shadows, the noise they leave would fall with the power 2.5 of their number."""

PARTS = (slice(0, None, 8), slice(4, None, 8), slice(2, None, 4), slice(1, None, 2))
"""Clusters are measured in parts, so that the later ones profit from what the rays of the earlier ones taught."""

MOST_DEMAND = 1e30
"""Rays for a unit of standard deviation where nothing is allowed to be wrong: in the dark."""

DEVIATION_LEFT, GUESS_WEIGHT = 0.3, 0.02
"""Share of the standard deviations before anything was learnt that is left afterwards, as a first guess; and how much this guess counts
beside what is measured, as a share of all clusters."""


class Measurement:
    """Measures the light that enters at one member of each cluster of a cut."""

    def __init__(
        self, scene: mi.Scene, copies: Copies, lights: LightTree, cut: Cut, member: NDArray[np.uint32], most_rays: int
    ) -> None:
        self.scene, self.copies, self.lights = scene, copies, lights
        self.most_rays, self.eta = dr.opaque(mi.Float, most_rays), dr.opaque(mi.Float, copies.eta)
        self.count = len(member)
        self.member = upload(member, mi.UInt32)
        self.node = upload(cut.node.astype(np.uint32), mi.UInt32)
        self.copy = upload(copies.numbers[cut.copy].astype(np.uint32), mi.UInt32)
        self.group = cut.groups(copies.samples, GROUP)
        groups = int(self.group[-1]) + 1
        self.guide: LightGuide = build_guide(groups)
        self.at_once = min(max(groups // LAUNCHES, FEW_GROUPS), MANY_GROUPS)

    def learn(self, rays: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Measure some clusters roughly: irradiance ``(f, 3)`` and standard deviation of a ray ``(f,)`` of all, those of the others being
        their neighbours'."""
        begins = np.flatnonzero(np.diff(self.group, prepend=-1))
        place = np.arange(self.count) - np.repeat(begins, np.diff(begins, append=self.count))
        every = np.flatnonzero(place % LEARN == 0)
        groups = self.group[every]
        light, deviation = np.empty((len(every), 3), np.float32), np.empty(len(every), np.float32)
        least = dr.opaque(mi.Float, rays)
        for first, size in steps("visibility", _chunks(groups, self.at_once), "clusters"):
            here = slice(first, first + size)
            number, group = every[here], groups[here]
            candidates = self._choose(number, group, np.full(group[-1] + 1 - group[0], FEW_LIGHTS))
            expected = self.guide.expect(candidates, RayCounts.none(candidates))
            light[here], deviation[here], found = self._estimate(
                number, group - group[0], candidates, expected, np.zeros(size), least, least
            )
            self.guide.add(candidates.place, found)
        self.guide.learn()
        nearest = np.cumsum(place % LEARN == 0) - 1
        return light[nearest], deviation[nearest]

    def measure(self, importance: NDArray, points: int, irradiance: NDArray, deviation: NDArray) -> NDArray[np.float32]:
        """Measure all clusters, such that the error is what is allowed in the mean over the eye points: ``(f, 3)``.

        If n_c rays leave the variance ``(t_c / allowed_c)^2 / n_c`` in the light of a cluster, the squared errors of all eye points sum up
        to that of ``(t_c w_c)^2 / n_c`` over all clusters. For a given number of rays that is least with n_c in proportion to t_c w_c.

        Parameters
        ----------
        importance : (f,) float
            The weights w_c: roots of the sum over eye points of squared weights over squared errors that are allowed.
        points : int
            Number of the eye points.
        irradiance, deviation : (f,) float
            Irradiance in luminance as far as it is known, and the standard deviation t_c of a ray when nothing was known.
        """
        groups, light = self.group, np.zeros((self.count, 3), np.float32)
        # With n = k t w the errors are those that are allowed if k is the sum of t w over the number of eye points. Of t when nothing
        # was known a part is left: the clusters measured before tell how much.
        unknown = deviation * importance
        per_point, guess = unknown.sum() / points, GUESS_WEIGHT * unknown.sum()
        left, before = DEVIATION_LEFT * guess, max(guess, 1e-30)
        accuracy = np.abs(irradiance) * importance * (DEVIATION_LEFT * per_point)
        wanted = LIGHTS_WANTED * (np.bincount(groups, accuracy) / np.bincount(groups)) ** LIGHTS_POWER
        wanted = np.clip(wanted, LEAST_LIGHTS, MOST_LIGHTS) // 32 * 32
        least = dr.opaque(mi.Float, LEAST_RAYS)
        for first, size in steps("irradiance", _chunks(groups, self.at_once), "clusters"):
            number, group = np.arange(first, first + size), groups[first : first + size]
            candidates = self._choose(number, group, wanted[group[0] : group[-1] + 1])
            own = RayCounts.none(candidates)
            for part in PARTS:
                some, here = number[part], group[part] - group[0]
                if not len(some):
                    continue
                expected = self.guide.expect(candidates, own)
                demand = np.minimum(per_point * left / before * importance[some], MOST_DEMAND)
                light[some], there, found = self._estimate(
                    some, here, candidates, expected, demand, least, self.most_rays
                )
                left, before = left + (there * importance[some]).sum(), before + unknown[some].sum()
                self.guide.add(candidates.place, found)
                own = own + found
        return light

    def _receivers(self, number: NDArray) -> tuple[mi.UInt32, mi.SurfaceInteraction3f]:
        """Describe the places where the light of clusters is measured."""
        index = upload(number.astype(np.uint32), mi.UInt32)
        leaf, copy = dr.gather(mi.UInt32, self.member, index), dr.gather(mi.UInt32, self.copy, index)
        si = self.copies.samples.receiver(leaf, self.copies.placement, copy)
        dr.eval(si)
        return index, si

    def _choose(self, number: NDArray, group: NDArray, wanted: NDArray) -> Candidates:
        """Choose the candidates of the groups that some clusters lie in."""
        _, si = self._receivers(number)
        bounds = bound_groups(rows(si.p), rows(si.sh_frame.n), group - group[0])
        name = upload(np.arange(group[0], group[-1] + 1, dtype=np.uint32), mi.UInt32)
        asked = upload(wanted.astype(np.uint32), mi.UInt32)
        return choose_lights(self.lights, self.guide.visibility, bounds, name, name, asked)

    def _estimate(
        self,
        number: NDArray,
        group: NDArray,
        candidates: Candidates,
        expected: Expectation,
        demand,
        least: Any,
        most: Any,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], RayCounts]:
        """Estimate the light that enters at a member of some clusters, times the mean of the texture; the standard deviation of a
        ray; and the rays."""
        index, si = self._receivers(number)
        place = upload(group.astype(np.uint32), mi.UInt32)
        wanted = upload(demand.astype(np.float32), mi.Float)
        receiver = Receiver(si, self.eta, place, index)
        found = estimate_light(self.scene, self.lights, candidates, expected, receiver, wanted, least, most)
        dr.eval(found)
        count("shadow rays", found.rays.tried)
        light, colours = found.light, self.copies.samples.colours
        if colours is not None:
            colour = dr.gather(mi.Array4f, colours, dr.gather(mi.UInt32, self.node, index))
            light *= mi.Color3f(colour[0], colour[1], colour[2])
        return rows(light), found.deviation.numpy(), found.rays


def _chunks(group: NDArray, at_once: int) -> list[int]:
    """Cut clusters into chunks of whole groups, so many at most: their sizes."""
    ends = np.searchsorted(group, np.arange(group[0] + at_once, group[-1] + at_once + 1, at_once))
    return np.diff([0, *ends]).tolist()
