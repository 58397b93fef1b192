"""How a method answers the translucent vertices of paths: with the exitance there, turned into radiance towards the path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..kernels.memory import lanes_where
from ..kernels.sequences import ROUNDS
from ..light.transport import VERTEX_SLOTS, Vertices
from ..progress import paced
from .aovs import FirstPoints
from .contract import Method, Points, key_of_positions
from .preparation import LitScene, follows_curve, shortest_mfp

INDIRECT_TOLERANCE = 4.0
"""How many times larger the error may be of what is seen only by way of another surface, where nothing is known of the pixel."""

LEAST_TOLERANCE, MOST_TOLERANCE = 2.0, 256.0
"""Bounds of the same where it is known which part of its pixel shows the point: it is the reciprocal of that part. A dielectric
reflects a twentieth, and of several paths few may meet the same body."""

ALIKE, NEAR, FLAT = 0.95, 0.5, 0.2
"""Samples of a pixel share an exitance where the cosine between their normals is larger than the first, where they lie within so many mean
free paths (a quarter of the distance of surface samples, between which their sum is a little uneven), and where the direction from one to
the other leaves the surface by a sine of less than the third: else the pixel sees two places of the body, or more of it than one value can
stand for."""

TURNS = 4
"""Groups of samples of one body that share, in a pixel at most."""

OPAQUE_SAMPLES = 16
"""At most so many samples of a pixel share the light of an opaque surface, which is noisy: more samples a pixel have less of that noise."""

WHOLE_PIXEL = 1 << 16
"""Parts of pixels are added up as whole numbers of this unit, whose sum does not depend on the order."""


@dataclass
class Part:
    """Some of ``count`` paths: their ``numbers``."""

    numbers: mi.UInt32
    count: int

    def numbers_of(self, vertices: mi.UInt32) -> mi.UInt32:
        """Number vertices of the part, of which each path has one in every slot, as those of all paths are numbered."""
        width = dr.opaque(mi.UInt32, dr.width(self.numbers))
        slot = vertices // width
        return dr.gather(mi.UInt32, self.numbers, vertices - slot * width) + slot * dr.opaque(mi.UInt32, self.count)


class Answer:
    """Answers the translucent vertices of paths with the exitance of a method (``light.transport.Translucency``).

    Parameters
    ----------
    state : LitScene
        What the method has prepared.
    seed : int
        Of the random numbers of points.
    from_eye : bool
        Whether the first vertex of each path is seen directly. All others are seen by way of another surface: their exitance may
        be less exact.
    per_pixel : int
        So many consecutive paths belong to one pixel.
    part : Part, optional
        Where the paths are some of many more: which of them.
    """

    def __init__(
        self,
        method: Method[Any],
        scene: mi.Scene,
        state: LitScene,
        seed: int,
        from_eye: bool,
        per_pixel: int = 1,
        part: Part | None = None,
    ):
        self.method, self.scene, self.state, self.seed = method, scene, state, seed
        self.from_eye, self.per_pixel, self.part = from_eye, per_pixel, part
        self.lookup, self.eta_table, self.leave_table = state.lookup, state.eta_table, state.leave_table
        self.shading_normals, self.stretch = follows_curve(state), state.stretch
        self.last_body = dr.opaque(mi.UInt32, len(state.bodies))
        self.opaque = self.last_body + 1 if state.lights_opaque and from_eye else None

    def radiance(self, vertices: Vertices) -> mi.Color3f:
        """Sum weight times ``B / (pi T_d)`` over the vertices of each path (JB02 eq. 14)."""
        return self.emitted(vertices)[0]

    def emitted(self, vertices: Vertices) -> tuple[mi.Color3f, FirstPoints]:
        """Sum the radiance of the vertices of each path; also what the first vertices are, and their exitance."""
        points, place = self.points(vertices)
        exitance = dr.zeros(mi.Color3f, max(dr.width(points.p), 1))
        for first, size in paced("exitance", dr.width(points.p), "points"):
            here = dr.arange(mi.UInt32, size) + dr.opaque(mi.UInt32, first)
            dr.scatter(exitance, self.method.exitance(self.scene, self.state, points.take(here)), here)
            dr.eval(exitance)
            dr.sync_thread()
        first = dr.arange(mi.UInt32, vertices.width)
        body = dr.gather(mi.UInt32, vertices.body, first)
        body = dr.select(body <= self.last_body, body, 0)
        seen = dr.gather(mi.Color3f, exitance, dr.gather(mi.UInt32, place, first), body != 0)
        return self.sum_up(vertices, exitance, place), FirstPoints(body, seen)

    def sum_up(self, vertices: Vertices, exitance: mi.Color3f, place: mi.UInt32) -> mi.Color3f:
        """Sum weight times ``B / (pi T_d)`` over the vertices of each path, B known at the points of `points` (JB02 eq. 14)."""
        total = dr.zeros(mi.Color3f, vertices.width)
        for slot in range(VERTEX_SLOTS):
            lane = dr.arange(mi.UInt32, vertices.width) + dr.opaque(mi.UInt32, slot * vertices.width)
            body = dr.gather(mi.UInt32, vertices.body, lane)
            inside, there = body <= self.last_body, body != 0
            leave = dr.select(inside, dr.gather(mi.Float, self.leave_table, body, inside), dr.inv_pi)
            weight = dr.gather(mi.Color3f, vertices.weight, lane, there)
            value = dr.gather(mi.Color3f, exitance, dr.gather(mi.UInt32, place, lane, there), there)
            total += dr.select(there, weight * value * leave, 0)
        return total

    def points(self, vertices: Vertices) -> tuple[Points, mi.UInt32]:
        """Choose the points where the exitance is asked for; also tell for each vertex which of them has its exitance."""
        dr.eval(vertices)
        number, body = dr.arange(mi.UInt32, dr.width(vertices.body)), vertices.body
        indirect = (number >= dr.opaque(mi.UInt32, vertices.width)) | mi.Bool(not self.from_eye)
        owner, tolerance = self._owner(vertices, indirect), dr.full(mi.Float, INDIRECT_TOLERANCE, dr.width(body))
        if self.method.one_point_a_pixel and owner is not None:
            tolerance = dr.clip(dr.rcp(self._shown(vertices, owner)), LEAST_TOLERANCE, MOST_TOLERANCE)
        asked = lanes_where((body != 0) if owner is None else (owner == number) & (body != 0))
        p = dr.gather(mi.Point3f, vertices.p, asked)
        key = self._keys(p, asked) if dr.width(asked) else asked
        tolerance = dr.gather(mi.Float, dr.select(indirect, tolerance, 1), asked)
        points = Points(p, dr.gather(mi.Normal3f, vertices.n, asked), dr.gather(mi.UInt32, body, asked), tolerance, key)
        if vertices.stretch is not None:
            points.stretch = dr.gather(mi.Color3f, vertices.stretch, asked)
        place = dr.empty(mi.UInt32, dr.width(body))
        dr.scatter(place, dr.arange(mi.UInt32, dr.width(asked)), asked)
        if owner is not None:
            place = dr.gather(mi.UInt32, place, owner, body != 0)
        dr.eval(points.p, points.n, points.body, points.tolerance, points.stretch, place)
        return points, place

    def _keys(self, p: mi.Point3f, asked: mi.UInt32) -> mi.UInt32:
        """Make the keys of vertices from where they are and from their numbers."""
        number = self.part.numbers_of(asked) if self.part else asked
        return mi.sample_tea_32(key_of_positions(p, self.seed), number, ROUNDS)[0]

    def _owner(self, vertices: Vertices, indirect: mi.Bool) -> mi.UInt32 | None:
        """Find the vertex whose exitance each shares.

        What is seen directly and like the first of its pixel on the same body shares that of the one in the middle of them all; so do those
        that are left, a few times; on opaque surfaces those of each block of samples do. Where one point a pixel is all that is asked for,
        what is not seen directly is shared in any case, and however far it is, but for opaque surfaces; else it shares none, and is not
        looked at.
        """
        whole = self.method.one_point_a_pixel
        if self.method.is_random or not (whole or (self.per_pixel > 1 and self.from_eye)):
            return None
        number = dr.arange(mi.UInt32, dr.width(vertices.body) if whole else vertices.width)
        p, n, body = (dr.gather(type(v), v, number) for v in (vertices.p, vertices.n, vertices.body))
        indirect = indirect if whole else mi.Bool(False)
        reach = mi.Float([0.0, *(NEAR * shortest_mfp(lit.body) for lit in self.state.bodies)])
        blocks = -(-self.per_pixel // OPAQUE_SAMPLES)
        block = dr.select(body <= self.last_body, self.per_pixel, dr.opaque(mi.UInt32, -(-self.per_pixel // blocks)))
        owner, left = number, body
        for turn in range(TURNS):
            first = _first_of_block(left, vertices.width, self.per_pixel, block)
            step = dr.gather(mi.Point3f, vertices.p, first) - p
            facing = dr.gather(mi.Normal3f, vertices.n, first)
            away = dr.maximum(dr.abs(dr.dot(step, facing)), dr.abs(dr.dot(step, n)))
            alike = (dr.dot(facing, n) > ALIKE) & (away <= FLAT * dr.norm(step))
            if not whole:
                alike &= dr.norm(step) < dr.gather(mi.Float, reach, body)
            loosely = indirect & (body <= self.last_body)
            shares = (left != 0) & dr.select(loosely, whole and turn == 0, alike)
            owner, left = dr.select(shares, first, owner), dr.select(shares, 0, left)
            dr.eval(owner, left)
        leader = lanes_where((owner == number) & ~indirect & (body != 0))
        if dr.width(leader):
            dr.scatter(number, _in_the_middle(vertices.p, owner, leader, self.per_pixel), leader)
            owner = dr.gather(mi.UInt32, number, owner)
        if not whole:
            every = dr.arange(mi.UInt32, dr.width(vertices.body))
            dr.scatter(every, owner, dr.arange(mi.UInt32, vertices.width))
            owner = every
        dr.eval(owner)
        return owner

    def _shown(self, vertices: Vertices, owner: mi.UInt32) -> mi.Float:
        """Add up which part of its pixel shows each point that several vertices share, by the number of its owner."""
        total = dr.opaque(mi.UInt32, 0, dr.width(owner))
        part = mi.UInt32(WHOLE_PIXEL / self.per_pixel * dr.max(dr.abs(vertices.weight)))
        dr.scatter_add(total, part, owner, vertices.body != 0, mode=dr.ReduceMode.Direct)
        dr.eval(total)
        return mi.Float(total) / WHOLE_PIXEL


@dr.syntax
def _first_of_block(body: mi.UInt32, width: int, per_pixel: int, block: mi.UInt32) -> mi.UInt32:
    """Find, for each vertex, the first one of its pixel and slot on the same body: its own number if there is none.

    Only among ``block`` samples, into which those of a pixel are divided.
    """
    count = dr.opaque(mi.UInt32, per_pixel)
    number = dr.arange(mi.UInt32, dr.width(body))
    slot = number // dr.opaque(mi.UInt32, width) * dr.opaque(mi.UInt32, width)
    pixel = slot + (number - slot) // count * count
    owner = pixel + (number - pixel) // block * block
    while dr.hint(dr.gather(mi.UInt32, body, owner) != body, label="pellucid owner"):
        owner += 1
    dr.eval(owner)
    return owner


@dr.syntax
def _in_the_middle(p: mi.Point3f, owner: mi.UInt32, leader: mi.UInt32, per_pixel: int) -> mi.UInt32:
    """Find, among the vertices of a pixel that belong to each leader, its first one, that which is nearest to their mean."""
    count = dr.opaque(mi.UInt32, per_pixel)
    end = (leader // count + 1) * count
    total, members, k = dr.zeros(mi.Point3f, dr.width(leader)), mi.Float(0), mi.UInt32(leader)
    while dr.hint(k < end, label="pellucid mean place"):
        mine = dr.gather(mi.UInt32, owner, k) == leader
        total += dr.gather(mi.Point3f, p, k, mine)
        members += dr.select(mine, 1, 0)
        k += 1
    mean, nearest, best, k = total / members, mi.Float(dr.inf), mi.UInt32(leader), mi.UInt32(leader)
    while dr.hint(k < end, label="pellucid middle"):
        d2 = dr.squared_norm(dr.gather(mi.Point3f, p, k) - mean)
        nearer = (dr.gather(mi.UInt32, owner, k) == leader) & (d2 < nearest)
        nearest, best = dr.select(nearer, d2, nearest), dr.select(nearer, k, best)
        k += 1
    dr.eval(best)
    return best
