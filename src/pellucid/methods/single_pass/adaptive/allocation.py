"""How the light of clusters is measured: by rays that are dealt out by concern and by doubt, and that teach what is seen from where."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ....kernels.memory import rows, upload
from ....progress import steps
from ..trees.light_tree import LightTree
from .candidates import MOST_LIGHTS, ChosenLights, bound_patches, choose_lights
from .copies import VisibleCopies
from .cut import Frontier
from .estimator import Receiver, sampled_cut
from .visibility import LightGuide, build_guide

PATCH = 256
"""Clusters to a patch that lights are chosen for, and that learns which of them it sees, at most."""

LAUNCHES, FEW_PATCHES, MANY_PATCHES = 4, 64, 512
"""Launches that patches are divided among at least, so that the first tell for the others how much is in doubt; and patches of one at
least and at most: what is known of their lights takes memory, which takes longer to get than to use."""

LEARN = 16
"""One cluster in so many learns for the others of its patch."""

LEAST_RAYS = 0.5
"""Rays of a cluster at least, in the mean: where little is asked, every second one tries a light."""

FEW_LIGHTS, LEAST_LIGHTS, LIGHTS_WANTED, LIGHTS_POWER = 512, 256, 600.0, 0.4
"""Lights that are weighed to learn; at least; where a single ray would do if all light was in doubt; and the power of the accuracy
asked for that they go with. Were it not for shadows, the noise they leave would fall with the power 2.5 of their number."""

PARTS = (slice(0, None, 8), slice(4, None, 8), slice(2, None, 4), slice(1, None, 2))
"""Clusters are measured in parts, so that the later ones profit from what the rays of the earlier ones taught."""

ENDLESS = 1e30
"""Rays for a doubt of 1 where nothing is allowed to be wrong: in the dark."""

STILL_IN_DOUBT, FIRST_GUESS = 0.3, 0.02
"""Share of the doubt about all light that is left once patches have learnt, as far as one can tell beforehand; and how much this
guess counts beside what is measured, as a share of all clusters."""


class Meter:
    """Measures the light that enters at one member of each cluster, and learns from the rays what is seen from where."""

    def __init__(
        self,
        scene,
        cut: VisibleCopies,
        lights: LightTree,
        frontier: Frontier,
        member: NDArray[np.uint32],
        most_rays: int,
    ) -> None:
        self.scene, self.cut, self.lights = scene, cut, lights
        self.most_rays, self.eta = dr.opaque(mi.Float, most_rays), dr.opaque(mi.Float, cut.eta)
        self.count = len(member)
        self.member = upload(member, mi.UInt32)
        self.node = upload(frontier.node.astype(np.uint32), mi.UInt32)
        self.copy = upload(cut.copies[frontier.copy].astype(np.uint32), mi.UInt32)
        self.patch = frontier.groups(cut.samples, PATCH)
        patches = int(self.patch[-1]) + 1
        self.guide: LightGuide = build_guide(patches)
        self.at_once = min(max(patches // LAUNCHES, FEW_PATCHES), MANY_PATCHES)
        self.shadow_rays = 0

    def learn(self, rays: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Measure some clusters roughly: irradiance ``(f, 3)`` and doubt ``(f,)`` of all, those of the others being their
        neighbours'."""
        begins = np.flatnonzero(np.diff(self.patch, prepend=-1))
        place = np.arange(self.count) - np.repeat(begins, np.diff(begins, append=self.count))
        every = np.flatnonzero(place % LEARN == 0)
        patches = self.patch[every]
        light, doubt = np.empty((len(every), 3), np.float32), np.empty(len(every), np.float32)
        least = dr.opaque(mi.Float, rays)
        for first, size in steps("visibility", _chunks(patches, self.at_once), "clusters"):
            here = slice(first, first + size)
            number, patch = every[here], patches[here]
            chosen = self._choose(number, patch, np.full(patch[-1] + 1 - patch[0], FEW_LIGHTS))
            self.guide.inform(chosen)
            light[here], doubt[here] = self._trace(number, patch - patch[0], chosen, np.zeros(size), least, least)
            self.guide.count(chosen)
        self.guide.learn()
        nearest = np.cumsum(place % LEARN == 0) - 1
        return light[nearest], doubt[nearest]

    def measure(self, concern: NDArray, points: int, rough: NDArray, doubt: NDArray) -> NDArray[np.float32]:
        """Measure all clusters, such that the error is what is allowed in the mean over the eye points: ``(f, 3)``.

        Parameters
        ----------
        concern : (f,) float
            How much errors matter: n rays for a doubt of t leave t^2 concern^2 / n, in squares of what is allowed.
        points : int
            Number of the eye points.
        rough, doubt : (f,) float
            Irradiance in luminance as far as it is known, and how much of it was in doubt when nothing was known.
        """
        patches, light = self.patch, np.zeros((self.count, 3), np.float32)
        # With n = k t concern rays, errors sum up to those of all eye points if k is the sum of t concern over their number. Of
        # the doubt there was when nothing was known, a part is left: the clusters measured before tell how much.
        unknown = doubt * concern
        per_point, guess = unknown.sum() / points, FIRST_GUESS * unknown.sum()
        left, before = STILL_IN_DOUBT * guess, max(guess, 1e-30)
        accuracy = np.abs(rough) * concern * (STILL_IN_DOUBT * per_point)
        wanted = LIGHTS_WANTED * (np.bincount(patches, accuracy) / np.bincount(patches)) ** LIGHTS_POWER
        wanted = np.clip(wanted, LEAST_LIGHTS, MOST_LIGHTS) // 32 * 32
        least = dr.opaque(mi.Float, LEAST_RAYS)
        for first, size in steps("irradiance", _chunks(patches, self.at_once), "clusters"):
            number, patch = np.arange(first, first + size), patches[first : first + size]
            chosen = self._choose(number, patch, wanted[patch[0] : patch[-1] + 1])
            for part in PARTS:
                some, here = number[part], patch[part] - patch[0]
                if not len(some):
                    continue
                self.guide.inform(chosen)
                demand = np.minimum(per_point * left / before * concern[some], ENDLESS)
                light[some], found = self._trace(some, here, chosen, demand, least, self.most_rays)
                left, before = left + (found * concern[some]).sum(), before + unknown[some].sum()
                self.guide.count(chosen)
        return light

    def _receivers(self, number: NDArray) -> tuple[mi.UInt32, mi.SurfaceInteraction3f]:
        """Describe the places where the light of clusters is measured."""
        index = upload(number.astype(np.uint32), mi.UInt32)
        leaf, copy = dr.gather(mi.UInt32, self.member, index), dr.gather(mi.UInt32, self.copy, index)
        si = self.cut.samples.receiver(leaf, self.cut.placement, copy)
        dr.eval(si)
        return index, si

    def _choose(self, number: NDArray, patch: NDArray, wanted: NDArray) -> ChosenLights:
        """Choose the lights of the patches that some clusters lie in."""
        _, si = self._receivers(number)
        bounds = bound_patches(rows(si.p), rows(si.sh_frame.n), patch - patch[0])
        name = upload(np.arange(patch[0], patch[-1] + 1, dtype=np.uint32), mi.UInt32)
        asked = upload(wanted.astype(np.uint32), mi.UInt32)
        return choose_lights(self.lights, self.guide.visibility, bounds, name, name, asked)

    def _trace(
        self, number: NDArray, patch: NDArray, chosen: ChosenLights, demand, least, most
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Trace the rays of some clusters: the light that enters at a member, times the mean of the texture; and what was in
        doubt."""
        index, si = self._receivers(number)
        place = upload(patch.astype(np.uint32), mi.UInt32)
        wanted = upload(demand.astype(np.float32), mi.Float)
        receiver = Receiver(si, self.eta, place, index)
        found = sampled_cut(self.scene, self.lights, chosen, receiver, wanted, least, most)
        dr.eval(found, chosen.rays)
        self.shadow_rays += int(found.traced.numpy().sum(dtype=np.int64))
        light, colours = found.light, self.cut.samples.colours
        if colours is not None:
            packet = dr.gather(mi.Array4f, colours, dr.gather(mi.UInt32, self.node, index))
            light *= mi.Color3f(packet[0], packet[1], packet[2])
        return rows(light), found.doubt.numpy()


def _chunks(patch: NDArray, at_once: int) -> list[int]:
    """Cut clusters into chunks of whole patches, so many at most: their sizes."""
    ends = np.searchsorted(patch, np.arange(patch[0] + at_once, patch[-1] + at_once + 1, at_once))
    return np.diff([0, *ends]).tolist()
