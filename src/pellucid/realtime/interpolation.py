"""Where the exitance is summed: at every pixel, or at one pixel of each tile with the rest interpolated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import drjit as dr
import mitsuba as mi

from .gbuffer import FIRST_BODY, MIDDLE, TILE, DeviceCamera, GBuffer, Screen, lanes_where

Exitance = Callable[[int, mi.Point3f, mi.Normal3f], mi.Color3f]
"""Sums the exitance of a body, by its number, at points with normals."""

AGREEMENT = 0.3
"""Sum of weights below which neighbours do not count, and a pixel is summed itself."""

PACKETS = 3  # of four floats a tile: position and kind, normal, exitance


def every_pixel(gbuffer: GBuffer, bodies: int, exitance: Exitance) -> mi.Color3f:
    """Sum the exitance at every pixel that shows a body; elsewhere there is no telling."""
    result = dr.empty(mi.Color3f, dr.width(gbuffer.kind))
    for k, lane in _by_body(gbuffer.kind, gbuffer.seen, bodies):
        _fill(result, gbuffer, lane, k, exitance)
    return result


def every_tile(screen: Screen, camera: DeviceCamera, gbuffer: GBuffer, bodies: int, exitance: Exitance) -> mi.Color3f:
    """Sum the exitance at one pixel of each tile; interpolate the others, and sum those whose neighbours disagree.

    The weights of the four nearest are bilinear, times how well normal and tangent plane agree: joint-bilateral
    interpolation within one body.
    """
    result = dr.empty(mi.Color3f, screen.lanes)
    if dr.width(gbuffer.seen) == 0:
        return result
    records = _sum_tiles(screen, gbuffer, bodies, exitance)
    value, weight = _interpolate(screen, camera, gbuffer, records)
    dr.scatter(result, value, gbuffer.seen)
    alone = weight < AGREEMENT
    dr.eval(result, alone)
    few = lanes_where(alone)
    if dr.width(few):
        for k, lane in _by_body(gbuffer.kind, dr.gather(mi.UInt32, gbuffer.seen, few), bodies):
            _fill(result, gbuffer, lane, k, exitance)
    return result


def _by_body(kind: mi.UInt32, lanes: mi.UInt32, bodies: int) -> Iterator[tuple[int, mi.UInt32]]:
    """Divide lanes, all of which show a body, among the bodies; leave out those that none shows."""
    if dr.width(lanes) == 0:
        return
    if bodies == 1:
        yield 0, lanes
        return
    for k in range(bodies):
        index = lanes_where(dr.gather(mi.UInt32, kind, lanes) == dr.opaque(mi.UInt32, FIRST_BODY + k))
        if dr.width(index):
            yield k, dr.gather(mi.UInt32, lanes, index)


def _fill(result: mi.Color3f, gbuffer: GBuffer, lane: mi.UInt32, k: int, exitance: Exitance) -> None:
    """Sum the exitance at some lanes."""
    p, n = dr.gather(mi.Point3f, gbuffer.p, lane), dr.gather(mi.Normal3f, gbuffer.n, lane)
    dr.scatter(result, exitance(k, p, n), lane)


def _sum_tiles(screen: Screen, gbuffer: GBuffer, bodies: int, exitance: Exitance) -> mi.Float:
    """Sum the exitance in the middle of each tile: ``PACKETS`` records a tile, zero where there is no body."""
    records = dr.zeros(mi.Float, screen.tiles_x * screen.tiles_y * PACKETS * 4)
    for k, lane in _by_body(gbuffer.kind, gbuffer.seen_tiles * TILE**2 + MIDDLE, bodies):
        place = (lane // TILE**2) * PACKETS
        p, n = dr.gather(mi.Point3f, gbuffer.p, lane), dr.gather(mi.Normal3f, gbuffer.n, lane)
        value = exitance(k, p, n)
        number = dr.opaque(mi.Float, FIRST_BODY + k)
        dr.scatter(records, mi.Array4f(p.x, p.y, p.z, number), place)
        dr.scatter(records, mi.Array4f(n.x, n.y, n.z, 0), place + 1)
        dr.scatter(records, mi.Array4f(value.x, value.y, value.z, 0), place + 2)
    dr.eval(records)
    return records


def _interpolate(
    screen: Screen, camera: DeviceCamera, gbuffer: GBuffer, records: mi.Float
) -> tuple[mi.Color3f, mi.Float]:
    """Blend the four nearest tiles of each lane that shows a body: exitance, and the sum of the weights."""
    kind, p, n, across, along = (
        dr.gather(type(v), v, gbuffer.seen) for v in (gbuffer.kind, gbuffer.p, gbuffer.n, screen.x, screen.y)
    )
    body = mi.Float(kind)
    # How long a tile is on a surface that faces the eye.
    reach = TILE * dr.norm(p - camera.origin) * dr.norm(camera.right)
    x, y = ((v - TILE // 2) * (1 / TILE) for v in (across, along))
    left, upper = dr.floor(x), dr.floor(y)
    last_x, last_y = (dr.opaque(mi.Int32, count - 1) for count in (screen.tiles_x, screen.tiles_y))
    total, weights = mi.Color3f(0), mi.Float(0)
    for i, j in product((0, 1), repeat=2):
        column, row = (dr.clip(mi.Int32(v) + k, 0, last) for v, k, last in ((left, i, last_x), (upper, j, last_y)))
        place = mi.UInt32(row * (last_x + 1) + column) * PACKETS
        there, facing, value = (dr.gather(mi.Array4f, records, place + k) for k in range(PACKETS))
        offset = mi.Vector3f(there[0], there[1], there[2]) - p
        normal = mi.Normal3f(facing[0], facing[1], facing[2])
        plane = dr.maximum(dr.abs(dr.dot(offset, normal)), dr.abs(dr.dot(offset, n)))
        weight = dr.abs(x - left - (1 - i)) * dr.abs(y - upper - (1 - j))
        weight *= dr.clip(2 * dr.dot(normal, n) - 1, 0, 1) * dr.clip(2 - plane / reach, 0, 1)
        weight = dr.select(there[3] == body, weight, 0)
        total += mi.Color3f(value[0], value[1], value[2]) * weight
        weights += weight
    return total * dr.select(weights > 0, dr.rcp(weights), 0), weights
