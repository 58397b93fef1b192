"""Ways to spread points over a surface: no two too near, pushed apart until at rest, or first the one and then a little of the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from ...kernels.memory import lanes_where
from ...kernels.sequences import fibonacci_lattice, independent_points
from ...progress import stage_of, steps
from .draw import Sites, Surface, join_sites
from .grid import NONE, OPPOSITE, PointGrid

# So many samples take about a second to spread: from there on it is reported how many there are.
REPORTED = 150_000

# The share of the plane that discs of half the distance cover when no more fit is 0.547; after ten darts a sample it is
# a little less. The distance follows from it: r^2 = 4 cover / pi * A / n.
DART_COVER = 0.439
DART_ROUNDS = 10

# No sample costs more candidates than this, and no draw makes more at once.
CANDIDATES = 10_000
DRAWN_AT_ONCE = 2_000_000
# Rounds smaller than this cost as much time as this one.
LEAST_ROUND = 1 << 14
# Darts are given up after a round that found places for less than this share of the missing samples.
FUTILE = 0.02
# Filling begins at this distance at most, in usual ones: nearly all samples fit there, and darts are much cheaper.
FILL_REACH = 1.15
# Candidates of a filling round for each sample there is, and the share of the largest distance that is still taken.
FILL_POOL = 8
FILL_LEVEL = 0.9

# Repulsion: reach in mean spacings sqrt(A / n) (Turk's choice), step, and number of steps: from points that are even by area, and from
# such that are apart already.
REACH = 2.0
STEP = 0.25
STEPS = 25
STEPS_AFTER_DARTS = 3


def spread_poisson(surface: Surface, count: int, seed: int, distance: float | None = None) -> tuple[Sites, int, float]:
    """Throw darts, dropping those too near to others, until there are ``count``; fill with the farthest candidates.

    The distance kept is the larger of ``distance`` and the one at which ten darts a sample nearly give ``count``: where
    samples may be farther apart than they must, they are.

    Parameters
    ----------
    distance
        Distance [scene units] that no two samples should fall short of (AWB08: the mean free path), above zero.

    Returns
    -------
    tuple
        The ``count`` sites; how many of them have another nearer than ``distance`` on their side of the surface (none
        without one); and the mean number of candidates a sample.

    Source
    ------
    AWB08 section 5.3, Poisson sampling with at most 10,000 candidates a sample, of which the farthest is taken if all
    violate the condition (D. P. Mitchell, *Spectrally optimal sampling for distribution ray tracing*, SIGGRAPH 1991).

    Notes
    -----
    The paper places one sample after another; here a round places many. Candidates are counted for all missing samples
    together; darts are given up when a round finds places for less than 2 % of these, which is before 10,000 a sample
    but for a few. If far fewer than ``count`` fit at ``distance``, the next ones are darts at 1.15 times the usual
    distance, before the farthest candidates are looked for: such samples violate the condition in any case.
    """
    usual = float(np.sqrt(4 * DART_COVER / np.pi * surface.area / count))
    reach = usual if distance is None else max(usual, distance)
    thrower = DartThrower(surface, count, seed)
    thrower.throw(reach)
    if thrower.missing and reach > FILL_REACH * usual:
        reach = FILL_REACH * usual
        thrower.throw(reach)
    thrower.fill(reach)
    sites = thrower.accepted
    violations = 0 if distance is None else _count_crowded(sites, distance)
    return sites, violations, thrower.thrown / count


def reported(count: int) -> int:
    """Give a number of samples, or 0 where they are so few that their progress is not worth a report."""
    return count if count >= REPORTED else 0


def _count_crowded(sites: Sites, distance: float) -> int:
    """Count the sites with another one nearer than ``distance`` on the same side."""
    grid = PointGrid(sites.p, sites.n, distance)
    # Only who has no one near comes first in one order as well as in its reverse.
    order = dr.arange(mi.UInt32, len(sites))
    alone = grid.first_among_near(order) & grid.first_among_near(~order)
    return len(sites) - int(dr.count(alone)[0])


class DartThrower:
    """Accepts candidates until there are ``count``.

    Attributes
    ----------
    accepted
        The samples so far.
    thrown
        How many candidates there were.
    """

    def __init__(self, surface: Surface, count: int, seed: int):
        self.surface, self.count, self.seed = surface, count, seed
        self.accepted = dr.zeros(Sites, 0)
        self.thrown = 0
        self.draws = 0

    @property
    def missing(self) -> int:
        """How many samples are still to be found."""
        return self.count - len(self.accepted)

    def throw(self, distance: float) -> None:
        """Throw darts in rounds until there are enough, or hardly any finds a place.

        Of each round those too near to accepted samples are dropped; of the others, each that comes first among its
        neighbours by a random priority is accepted, and the rest is tried again with the next round.
        """
        with stage_of("darts", DART_ROUNDS * reported(self.count), "darts") as advance:
            self._throw(distance, advance)

    def _throw(self, distance: float, advance: Callable[[int], None]) -> None:
        """Throw darts, and report those of the first rounds, after which few are missing."""
        left: list[Sites] = []
        for number, darts in enumerate(self._rounds(), start=1):
            before = self.missing
            pool = join_sites([*left, darts])
            if len(self.accepted):
                near = PointGrid(self.accepted.p, self.accepted.n, distance).any_near(pool.p, pool.n)
                pool = pool.take(lanes_where(~near))
            left = self._accept(pool, distance, self._lots(len(pool))) if len(pool) else []
            advance(self.count if number <= DART_ROUNDS else 0)
            if self.missing == 0 or (number >= DART_ROUNDS and before - self.missing < FUTILE * before):
                return

    def _rounds(self) -> Iterator[Sites]:
        """Draw the darts of one round after the other, without end."""
        at_once = min(max(DRAWN_AT_ONCE // self.count, 1), DART_ROUNDS)
        for first in range(0, DART_ROUNDS, at_once):
            # A draw takes its time for every shape of the body: one serves several rounds, each an even part of it.
            rounds = min(at_once, DART_ROUNDS - first)
            pool = self._draw(rounds * self.count)
            for k in range(rounds):
                self.thrown += self.count
                yield (
                    pool.take(dr.arange(mi.UInt32, self.count) * rounds + dr.opaque(mi.UInt32, k))
                    if rounds > 1
                    else pool
                )
        while True:
            number = min(max(self.count, LEAST_ROUND), CANDIDATES * self.missing)
            self.thrown += number
            yield self._draw(number)

    def fill(self, distance: float) -> None:
        """Accept the candidates farthest from all samples, and from each other, until there are enough.

        A round takes those that are nearly as far away as the farthest; the next goes on with smaller holes.
        """
        while self.missing:
            number = min(max(FILL_POOL * len(self.accepted), LEAST_ROUND), CANDIDATES * self.missing, DRAWN_AT_ONCE)
            self.thrown += number
            pool = self._draw(number)
            index = PointGrid(self.accepted.p, self.accepted.n, distance).nearest(pool.p, pool.n)
            found = index != NONE
            gap = dr.norm(pool.p - dr.gather(mi.Point3f, self.accepted.p, index, found))
            # Beyond the distance of the last round there is hardly anyone.
            gap = dr.select(found, gap, distance)
            dr.eval(gap)
            farthest = float(dr.max(gap)[0])
            if farthest == 0:
                # All places that numbers of this precision can tell apart are taken: the others share them.
                shared = pool.take(dr.arange(mi.UInt32, min(number, self.missing)))
                self.accepted = join_sites([self.accepted, shared])
                continue
            far = lanes_where(gap >= FILL_LEVEL * farthest)
            # The upper bits are for the order by distance, the others for lots.
            step = mi.UInt32((1 - dr.gather(mi.Float, gap, far) / farthest) * (255 / (1 - FILL_LEVEL)))
            self._accept(pool.take(far), FILL_LEVEL * farthest, (step << 24) | (self._lots(dr.width(far)) >> 8))
            distance = farthest

    def _draw(self, number: int) -> Sites:
        """Draw candidates that differ from all before."""
        self.draws += 1
        return self.surface.draw(number, self.seed * 1024 + self.draws, independent_points)

    def _lots(self, number: int) -> mi.UInt32:
        """Draw lots: random priorities that differ from round to round."""
        salt = dr.opaque(mi.UInt32, (self.seed * 1024 + len(self.accepted)) & 0xFFFFFFFF)
        return mi.sample_tea_32(dr.arange(mi.UInt32, number), salt)[0]

    def _accept(self, pool: Sites, distance: float, priority: mi.UInt32) -> list[Sites]:
        """Accept each site of a pool that has the lowest priority within ``distance``; return the others, if any."""
        dr.eval(priority)
        grid = PointGrid(pool.p, pool.n, distance)
        rank = dr.gather(mi.UInt32, priority, grid.order)
        dr.eval(rank)
        first = grid.first_among_near(rank)
        won, lost = lanes_where(first), lanes_where(~first)
        if dr.width(won) > self.missing:
            best = np.argsort(np.array(dr.gather(mi.UInt32, rank, won)), kind="stable")[: self.missing]
            won = dr.gather(mi.UInt32, won, mi.UInt32(np.sort(best).astype(np.uint32)))
        self.accepted = join_sites([self.accepted, pool.take(dr.gather(mi.UInt32, grid.order, won))])
        return [pool.take(dr.gather(mi.UInt32, grid.order, lost))] if dr.width(lost) else []


def spread_relaxed(surface: Surface, count: int, seed: int) -> Sites:
    """Throw darts until there are ``count``, then push them apart in a few steps: as even as by many steps alone, in less time."""
    return _push_apart(surface, spread_poisson(surface, count, seed)[0], STEPS_AFTER_DARTS)


def spread_repulsion(surface: Surface, count: int, seed: int) -> Sites:
    """Push points apart until they are at rest.

    They begin evenly by area, so that no flow over long distances is needed: that would take many more steps.

    Source
    ------
    JB02 section 3.
    """
    return _push_apart(surface, surface.draw(count, seed, fibonacci_lattice), STEPS)


def _push_apart(surface: Surface, sites: Sites, count: int) -> Sites:
    """Push points apart ``count`` times along the tangent plane, with a force that falls linearly with distance, and put them back.

    Source
    ------
    G. Turk, *Re-tiling polygonal surfaces*, SIGGRAPH 1992.
    """
    spacing = float(np.sqrt(surface.area / len(sites)))
    across = dr.opaque(mi.Float, spacing)  # no part of the kernels: they serve bodies of every size
    tracer = Tracer(surface)
    for _ in steps("repulsion", [reported(len(sites))] * count, "samples"):
        grid = PointGrid(sites.p, sites.n, REACH * spacing)
        sites = sites.take(grid.order)
        push = grid.repulsion()
        push -= sites.n * dr.dot(sites.n, push)
        length = dr.norm(push) * STEP * across
        # No step is longer than half a spacing, so that no point jumps over its neighbour.
        push = dr.normalize(push) * dr.minimum(length, 0.5 * across)
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
        found = [
            entry if isinstance(entry, mi.Shape) else entry.get("shape")
            for entry in entries.values()
            if entry != "scene"
        ]
        before = [(shape, shape.id()) for shape in found if shape is not None]
        self.scene = mi.load_dict(entries, optimize=False)
        for shape, name in before:  # loading has named them anew, which are shapes of the scene of the user
            shape.set_id(name)
        instances = {shape.id(): shape for shape in self.scene.shapes()}
        # As literals, pointers would be part of the kernels, and each tracer would compile its own.
        self.targets = [
            (dr.opaque(mi.ShapePtr, target or instances[name]), target is None)
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
