"""What the eye sees: one primary hit a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.memory import opaque, upload
from ..scene.bodies import Lookup
from .source import Camera

TILE = 4
"""Pixels along each side of a tile; 16 neighbouring lanes of every kernel are the pixels of one tile."""

NOTHING, OPAQUE, FIRST_BODY = 0, 1, 2
"""Kinds of hits; body k is ``FIRST_BODY + k``."""


MIDDLE = (TILE // 2) * (TILE + 1)
"""Lane of a tile that stands for it: third column, third row."""

FEWEST = 64
"""A kernel that works on fewer points would be another one."""


@dataclass
class Screen:
    """The pixels of a picture in the order of tiles, padded to whole tiles.

    Attributes
    ----------
    x, y : Float
        Column and row of each lane.
    place : UInt32
        Row by row, where each lane belongs.
    inside : Bool
        Whether it belongs anywhere.
    """

    width: int
    height: int
    tiles_x: int
    tiles_y: int
    x: mi.Float
    y: mi.Float
    place: mi.UInt32
    inside: mi.Bool

    @classmethod
    def make(cls, width: int, height: int) -> Screen:
        """Number the pixels of a picture."""
        tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
        tile_y, tile_x, y, x = np.indices((tiles_y, tiles_x, TILE, TILE)).reshape(4, -1)
        x, y = tile_x * TILE + x, tile_y * TILE + y
        inside = (x < width) & (y < height)
        place = upload(np.where(inside, y * width + x, width * height).astype(np.uint32))
        bounded = place < dr.opaque(mi.UInt32, width * height)
        dr.eval(bounded)
        return cls(
            width,
            height,
            tiles_x,
            tiles_y,
            upload(x.astype(np.float32)),
            upload(y.astype(np.float32)),
            place,
            bounded,
        )

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return self.tiles_x * self.tiles_y * TILE * TILE


@dataclass
class DeviceCamera:
    """A camera on the device: eye, and the direction through the upper left corner, with its steps to the right and down."""

    origin: mi.Point3f
    corner: mi.Vector3f
    right: mi.Vector3f
    down: mi.Vector3f

    @classmethod
    def make(cls, camera: Camera, width: int, height: int) -> DeviceCamera:
        """Bring a camera to the device; where ``up`` is along the view, any other direction is up."""
        origin, target, up = (np.asarray(v, float) for v in (camera.origin, camera.target, camera.up))
        forward = target - origin
        forward /= max(float(np.linalg.norm(forward)), 1e-30)
        right = np.cross(forward, up)
        if np.linalg.norm(right) < 1e-6 * np.linalg.norm(up):
            right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
        right /= np.linalg.norm(right)
        step = 2 * np.tan(np.deg2rad(camera.fov) / 2) / height
        down = np.cross(forward, right)
        corner = forward - step * (width / 2 * right + height / 2 * down)
        return cls(opaque(mi.Point3f, origin), *(opaque(mi.Vector3f, v) for v in (corner, step * right, step * down)))

    def rays(self, x: mi.Float, y: mi.Float) -> mi.Ray3f:
        """Send rays through places of the picture [pixels]."""
        return mi.Ray3f(self.origin, dr.normalize(self.corner + self.right * x + self.down * y))


@dataclass
class GBuffer:
    """Primary hits, one a lane.

    Attributes
    ----------
    ray : Ray3f
        From the eye; not in memory.
    kind : UInt32
        NOTHING, OPAQUE, or FIRST_BODY + k.
    p : Point3f
        Where they are.
    n : Normal3f
        Shading normal, turned to the eye.
    hit : PreliminaryIntersection3f or None
        For materials; only where the scene has opaque shapes.
    """

    ray: mi.Ray3f
    kind: mi.UInt32
    p: mi.Point3f
    n: mi.Normal3f
    hit: mi.PreliminaryIntersection3f | None

    @cached_property
    def seen(self) -> mi.UInt32:
        """List the lanes that show a body."""
        return lanes_where(self.kind >= FIRST_BODY)

    @cached_property
    def seen_tiles(self) -> mi.UInt32:
        """List the tiles with a body in the middle."""
        tiles = dr.arange(mi.UInt32, dr.width(self.kind) // TILE**2)
        return lanes_where(dr.gather(mi.UInt32, self.kind, tiles * TILE**2 + MIDDLE) >= FIRST_BODY)


def trace_gbuffer(
    scene: mi.Scene, lookup: Lookup, screen: Screen, device_camera: DeviceCamera, jitter: mi.Point2f, keep_hits: bool
) -> GBuffer:
    """Find what every pixel sees at ``jitter`` in it ((0.5, 0.5) is its middle)."""
    ray = device_camera.rays(screen.x + jitter.x, screen.y + jitter.y)
    hit = scene.ray_intersect_preliminary(ray, True, screen.inside)
    valid = hit.is_valid()
    flags = mi.RayFlags.All if lookup.turns_normals else mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame
    si = hit.compute_surface_interaction(ray, flags, valid)
    body = lookup.body_index(si, valid)
    kind = dr.select(body != 0, body + (FIRST_BODY - 1), dr.select(valid, mi.UInt32(OPAQUE), mi.UInt32(NOTHING)))
    p = dr.select(valid, si.p, 0)
    n = lookup.shading_normal(si, body != 0)
    n = dr.select(valid, dr.mulsign(n, -dr.dot(n, ray.d)), 0)
    gbuffer = GBuffer(ray, kind, mi.Point3f(p), mi.Normal3f(n), hit if keep_hits else None)
    dr.eval(gbuffer.kind, gbuffer.p, gbuffer.n, gbuffer.hit)
    return gbuffer


class Eye:
    """Looks at a scene, and remembers what it saw for as long as it looks from the same place.

    Attributes
    ----------
    screen, device_camera, gbuffer : Screen, DeviceCamera, GBuffer
        Of the latest look.
    """

    screen: Screen
    device_camera: DeviceCamera
    gbuffer: GBuffer

    def __init__(self, scene: mi.Scene, lookup: Lookup, keep_hits: bool):
        self.scene, self.lookup, self.keep_hits = scene, lookup, keep_hits
        self.size: tuple[int, int] | None = None
        self.key: object = None

    def look(self, camera: Camera, size: tuple[int, int], jitter: tuple[float, float]) -> None:
        """Find what the pixels of a picture of ``size`` = (width, height) see, at ``jitter`` in each."""
        if size != self.size:
            self.screen, self.size = Screen.make(*size), size
        key = (camera_key(camera), size, jitter)
        if key != self.key:
            self.device_camera = DeviceCamera.make(camera, *size)
            place = opaque(mi.Point2f, jitter)
            self.gbuffer = trace_gbuffer(
                self.scene, self.lookup, self.screen, self.device_camera, place, self.keep_hits
            )
            self.key = key
            _ = self.gbuffer.seen, self.gbuffer.seen_tiles

    def forget(self) -> None:
        """Look again the next time: shapes have moved."""
        self.key = None

    def to_host(self, channels: Sequence[Any]) -> np.ndarray:
        """Bring pictures to the host: ``(h, w, len(channels))`` of their type."""
        screen, count = self.screen, len(channels)
        dr.eval(channels)  # once for all: every channel is written by a kernel of its own
        result = dr.empty(type(channels[0]), screen.width * screen.height * count)
        for k, channel in enumerate(channels):
            dr.scatter(result, channel, screen.place * dr.opaque(mi.UInt32, count) + k, screen.inside)
        return result.numpy().reshape(screen.height, screen.width, count)

    def to_lanes(self, picture: np.ndarray) -> mi.Color3f:
        """Bring a picture of the host, ``(h, w, 3) float32``, to the lanes that show it."""
        values = upload(picture.ravel())
        return mi.Color3f(
            [dr.gather(mi.Float, values, self.screen.place * 3 + c, self.screen.inside) for c in range(3)]
        )


def camera_key(camera: Camera) -> tuple[float, ...]:
    """Make a camera comparable."""
    return tuple(np.concatenate([np.ravel(v) for v in (camera.origin, camera.target, camera.up, camera.fov)]).tolist())


def lanes_where(mask: mi.Bool) -> mi.UInt32:
    """List the lanes of a mask, none or at least `FEWEST`: the last is repeated."""
    index = dr.compress(mask)
    count = dr.width(index)
    if 0 < count < FEWEST:
        last = dr.opaque(mi.UInt32, count - 1)
        index = dr.gather(mi.UInt32, index, dr.minimum(dr.arange(mi.UInt32, FEWEST), last))
        dr.eval(index)
    return index
