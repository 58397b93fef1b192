"""Three ways to spread points over a surface: evenly by area, no two too near, or pushed apart until at rest."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .sampling_draw import Sites, Surface, even_square, join_sites, random_square
from .sampling_grid import OPPOSITE, PointGrid

# The share of the plane that discs of half the distance cover when no more fit is 0.547; with a pool of ten darts a
# sample it is a little less. The distance follows from it: r^2 = 4 cover / pi * A / n.
DART_COVER = 0.439
DART_ROUNDS = 10

# Repulsion: reach in mean spacings sqrt(A / n) (Turk's choice), step, and number of steps.
REACH = 2.0
STEP = 0.25
STEPS = 25


def spread_poisson(surface: Surface, count: int, seed: int) -> Sites:
    """Throw darts until hardly any more fits: no two samples are nearer than a distance chosen to give ``count``.

    In every round all darts are thrown at once. Those too near to accepted samples are dropped; of the others, each
    that comes first among its neighbours by a random priority is accepted, and the rest is tried again next round.

    Returns
    -------
    Sites
        About ``count`` samples: within a few per cent where the surface is smooth at their distance.
    """
    distance = np.sqrt(4 * DART_COVER / np.pi * surface.area / count)
    accepted: Sites | None = None
    left: Sites | None = None
    number = 0
    while number < DART_ROUNDS or left is not None:
        darts = [left] if left is not None else []
        if number < DART_ROUNDS:
            darts.append(surface.draw(count, seed * 64 + number, random_square))
        number += 1
        pool = join_sites(darts)
        if accepted is not None:
            alive = dr.compress(~PointGrid(accepted.p, accepted.n, distance).any_near(pool.p, pool.n))
            if dr.width(alive) == 0:
                left = None
                continue
            pool = pool.take(alive)
        grid = PointGrid(pool.p, pool.n, distance)
        priority = mi.sample_tea_32(grid.order, dr.opaque(mi.UInt32, seed * 64 + number))[0]
        dr.eval(priority)
        first = grid.first_among_near(priority)
        won, lost = dr.compress(first), dr.compress(~first)
        winners = pool.take(dr.gather(mi.UInt32, grid.order, won))
        accepted = winners if accepted is None else join_sites([accepted, winners])
        left = pool.take(dr.gather(mi.UInt32, grid.order, lost)) if dr.width(lost) else None
    assert accepted is not None
    return accepted


def spread_repulsion(surface: Surface, count: int, seed: int) -> Sites:
    """Push points apart along the tangent plane, with a force that falls linearly with distance, and put them back.

    The points begin evenly by area, so that no flow over long distances is needed: that would take many more steps.

    Source
    ------
    JB02 section 3; G. Turk, *Re-tiling polygonal surfaces*, SIGGRAPH 1992.
    """
    sites = surface.draw(count, seed, even_square)
    spacing = np.sqrt(surface.area / count)
    tracer = Tracer(surface)
    for _ in range(STEPS):
        grid = PointGrid(sites.p, sites.n, REACH * spacing)
        sites = sites.take(grid.order)
        push = grid.repulsion()
        push -= sites.n * dr.dot(sites.n, push)
        length = dr.norm(push) * STEP * spacing
        # No step is longer than half a spacing, so that no point jumps over its neighbour.
        push = dr.normalize(push) * dr.minimum(length, 0.5 * spacing)
        sites = tracer.move(sites, dr.select(length > 0, push, 0))
    return sites


class Tracer:
    """Moves points over the surface of a body: a step along the tangent plane, then rays that put them back."""

    def __init__(self, surface: Surface):
        entries: dict = {"type": "scene"}
        names = [f"pellucid_piece_{k}" for k in range(len(surface.pieces))]
        targets = []
        for piece, name in zip(surface.pieces, names, strict=True):
            entry, target = piece.for_tracing(name)
            entries |= entry
            targets.append(target)
        self.scene = mi.load_dict(entries, optimize=False)
        instances = {shape.id(): shape for shape in self.scene.shapes()}
        self.targets = [
            (mi.ShapePtr(target or instances[name]), target is None)
            for target, name in zip(targets, names, strict=True)
        ]

    def move(self, sites: Sites, push: mi.Vector3f) -> Sites:
        """Move sites by ``push`` [scene units], which lies in their tangent planes; those that would leave it stay.

        Straight down or up finds a surface that bends slowly. Beyond a convex or inside of a concave edge the way back
        leads under 45 degrees towards the old place: at a right angle this folds the step around the edge.
        """
        length = dr.norm(push)
        along = push / dr.maximum(length, 1e-30)
        q = sites.p + push
        best, moved = 1.5 * length, sites
        for sign, slant in ((-1, 0), (1, 0), (-1, -1), (1, -1)):
            way = dr.normalize(sign * mi.Vector3f(sites.n) + slant * along)
            # A folded step is taken only where no straight one is possible.
            open_ = length > 0 if slant == 0 else best == 1.5 * length
            hit, distance = self._first_hit(q, way, length, open_)
            # Seen from above a surface shows its front, from below its back.
            closer = (distance < best) & (sign * dr.dot(hit.n, way) > 0) & (dr.dot(hit.n, sites.n) > OPPOSITE)
            best = dr.select(closer, distance, best)
            moved = Sites(**{name: dr.select(closer, new, vars(moved)[name]) for name, new in vars(hit).items()})
        dr.eval(*vars(moved).values())
        return moved

    def _first_hit(self, q: mi.Point3f, way: mi.Vector3f, length: mi.Float, active: mi.Bool) -> tuple[Sites, mi.Float]:
        """Find the site that a ray from ``q`` meets, and its distance from there; infinite if there is none."""
        # A little way back, so that a surface through q itself is met.
        ray = mi.Ray3f(q - way * (0.1 * length), way)
        ray.maxt = 1.6 * length
        hit = self.scene.ray_intersect_preliminary(ray, coherent=True, active=active)
        si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.is_valid())
        shape_index = dr.zeros(mi.UInt32, dr.width(q))
        for k, (target, is_instance) in enumerate(self.targets):
            shape_index = dr.select((hit.instance if is_instance else hit.shape) == target, k, shape_index)
        distance = dr.select(si.is_valid(), dr.abs(hit.t - 0.1 * length), dr.inf)
        return Sites(shape_index, hit.prim_index, hit.prim_uv, si.p, si.n), distance
