"""A translucent shadow map: the light that enters a body, as a picture seen from the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...kernels.memory import opaque
from ...light.entering import entering_along
from ...scene.bodies import Body, Lookup

MAPPED = ("PointLight", "SpotLight", "DirectionalEmitter")
"""Emitters from which a picture can be taken: those whose light comes from one point or one direction."""

STEEPEST = 64.0
"""Largest change of depth over the distance across the light by which the surface within a pixel is followed: light that grazes it."""

WIDEST = 0.9
"""Largest radius of a body over its distance from a light that still is seen as a whole: an angle of 64 degrees."""


@dataclass
class MapCamera:
    """A square camera that looks at a ball, from a point or along a direction, as numbers for kernels that are compiled once.

    Positions are taken relative to the centre of the ball, along ``right``, ``up`` and ``axis`` (away from the eye). A
    point at the depth z behind the centre is drawn ``zoom / (1 + z inv_distance)`` pixels a scene unit large.

    Attributes
    ----------
    resolution : int
        Pixels along a side.
    size : UInt32
        The same, for kernels.
    centre, eye : Point3f
        Of the ball; and where rays start, unless they are parallel.
    right, up, axis : Vector3f
    zoom : Float
        Pixels a scene unit, at the depth of the centre.
    inv_distance : Float
        One over the distance of the eye; 0 for parallel rays.
    reach : Float
        How far before the centre parallel rays start: outside the scene.
    """

    resolution: int
    size: mi.UInt32
    centre: mi.Point3f
    eye: mi.Point3f
    right: mi.Vector3f
    up: mi.Vector3f
    axis: mi.Vector3f
    zoom: mi.Float
    inv_distance: mi.Float
    reach: mi.Float

    def rays(self) -> tuple[mi.Ray3f, mi.Float]:
        """Shoot a ray through the middle of every pixel, row by row.

        Returns
        -------
        ray : Ray3f
        extent : Float
            Solid angle of the pixel [sr], or its area [scene units squared] for parallel rays.
        """
        index = dr.arange(mi.UInt32, self.resolution * self.resolution)
        x, y, _ = self.place(index % self.size, index // self.size, mi.Float(0))
        target = self.centre + x * self.right + y * self.up
        parallel = self.inv_distance == 0
        origin = dr.select(parallel, target - self.reach * self.axis, self.eye)
        distance = dr.norm(target - origin)
        # Of a square in a plane at the distance d, seen under the angle theta: dA cos^3(theta) / d^2.
        angle = dr.rcp(self.inv_distance * dr.square(distance) * distance)
        return mi.Ray3f(origin, (target - origin) / distance), dr.select(parallel, 1, angle) / dr.square(self.zoom)

    def locate(self, p: mi.Point3f) -> mi.Vector3f:
        """Take a point relative to the centre: along ``right``, ``up`` and ``axis``."""
        return self.turn(p - self.centre)

    def turn(self, v: mi.Vector3f) -> mi.Vector3f:
        """Take a direction to ``right``, ``up`` and ``axis``."""
        return mi.Vector3f(dr.dot(v, self.right), dr.dot(v, self.up), dr.dot(v, self.axis))

    def scale(self, depth: mi.Float) -> mi.Float:
        """Evaluate how many pixels a scene unit has at a depth behind the centre."""
        return self.zoom / dr.maximum(dr.fma(depth, self.inv_distance, 1), 1e-6)

    def flatten(self, p: mi.Vector3f, n: mi.Vector3f) -> tuple[mi.Float, mi.Vector2f]:
        """Evaluate the flattened depth of a plane at one of its points, and how it changes from pixel to pixel.

        That is the depth z over ``1 + z inv_distance``, as in a depth buffer: even along planes, whether rays are parallel or not.
        The change is limited to `STEEPEST`. ``p`` is as from `locate`, the normal ``n`` as from `turn`.
        """
        facing = dr.fma(dr.dot(n, p), self.inv_distance, n.z)
        facing = dr.mulsign(dr.maximum(dr.abs(facing), 1e-6), facing)
        slope = dr.clip(mi.Vector2f(-n.x, -n.y) / facing, -STEEPEST, STEEPEST)
        return p.z * dr.rcp(dr.fma(p.z, self.inv_distance, 1)), slope / self.zoom

    def place(self, column: Any, row: Any, flat: mi.Float) -> mi.Vector3f:
        """Find the place of a flattened depth in a pixel, as `locate` does; parts of columns and rows are places beside its middle."""
        half = 0.5 * mi.Float(self.size) - 0.5
        larger = dr.rcp(dr.fma(-flat, self.inv_distance, 1))
        size = larger / self.zoom
        return mi.Vector3f((mi.Float(column) - half) * size, (mi.Float(row) - half) * size, flat * larger)


@dataclass
class TranslucentShadowMap:
    """The light that enters a body through each pixel of a picture.

    Attributes
    ----------
    camera : MapCamera
    records : Float
        Four numbers a pixel: the power that enters in red, green and blue, and the flattened depth of what the camera looks at.
    slopes : Float
        Two numbers a pixel: by how much that depth changes from column to column and from row to row.
    """

    camera: MapCamera
    records: mi.Float
    slopes: mi.Float

    def power(self) -> NDArray[np.float32]:
        """Bring the power of all pixels to the host: ``(resolution, resolution, 3) float32``."""
        side = self.camera.resolution
        return np.asarray(self.records.numpy()).reshape(side, side, 4)[..., :3]


def bounding_sphere(points: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """Enclose points ``(n, 3)`` in a ball around the middle of their box: its centre and radius."""
    p = np.asarray(points, dtype=np.float64)
    centre = 0.5 * (p.min(axis=0) + p.max(axis=0))
    return centre, float(np.sqrt(np.square(p - centre).sum(axis=1).max()))


def look(
    centre: ArrayLike, radius: float, resolution: int, *, eye: ArrayLike | None = None, along: ArrayLike | None = None
) -> MapCamera:
    """Look at a ball from a point ``eye``, or from infinitely far ``along`` a unit vector.

    From within the ball, or from just outside it, the picture shows a cone of `WIDEST`.
    """
    middle = np.asarray(centre, dtype=np.float64)
    half, distance = radius, np.inf
    if eye is not None:
        along = middle - np.asarray(eye, dtype=np.float64)
        distance = max(float(np.linalg.norm(along)), 1e-6 * radius)
        sine = min(radius / distance, WIDEST)
        half = distance * sine / np.sqrt(1 - sine * sine)
    axis = np.asarray(along, dtype=np.float64)
    axis = axis / max(float(np.linalg.norm(axis)), 1e-30)
    # The frame turns along with the axis, without a jump except where it points straight up or down.
    right = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.999 else [1.0, 0.0, 0.0], axis)
    right /= np.linalg.norm(right)
    start = middle if eye is None else np.asarray(eye, dtype=np.float64)
    return MapCamera(
        resolution,
        dr.opaque(mi.UInt32, resolution),
        opaque(mi.Point3f, middle),
        opaque(mi.Point3f, start),
        opaque(mi.Vector3f, right),
        opaque(mi.Vector3f, np.cross(axis, right)),
        opaque(mi.Vector3f, axis),
        dr.opaque(mi.Float, 0.5 * resolution / half),
        dr.opaque(mi.Float, 1 / distance),
        dr.opaque(mi.Float, 2 * radius),
    )


def emitter_camera(
    scene: mi.Scene, emitter: mi.Emitter, centre: ArrayLike, radius: float, resolution: int
) -> MapCamera | None:
    """Look at a ball from an emitter; None if it has no one place, or is too near for the whole ball to be seen."""
    if emitter.class_name() not in MAPPED:
        return None
    here = dr.zeros(mi.SurfaceInteraction3f)
    here.p = opaque(mi.Point3f, np.asarray(centre, dtype=np.float64))
    ds, _ = emitter.sample_direction(here, mi.Point2f(0.5))
    if emitter.class_name() == "DirectionalEmitter":
        camera = look(centre, radius, resolution, along=-ds.d.numpy().ravel())
        camera.reach = dr.opaque(mi.Float, _reach(scene, centre, radius))
        return camera
    eye = ds.p.numpy().ravel()
    if radius > WIDEST * np.linalg.norm(eye - np.asarray(centre)):
        return None
    return look(centre, radius, resolution, eye=eye)


def shadow_map(
    scene: mi.Scene, emitter: mi.Emitter, camera: MapCamera, lookup: Lookup, number: int, body: Body
) -> TranslucentShadowMap:
    """See a body from an emitter, and measure the light that enters it through each pixel.

    The power is that of the pixel, intensity times solid angle (or irradiance times area), times the exact Fresnel
    transmittance of its direction: no cosine divides it. Where a mesh stands for a smooth surface the facet passes what
    that surface would, as far as the light sees it; only there do two cosines, one over the other, come in.

    Parameters
    ----------
    camera : MapCamera
        Of `emitter_camera`.
    lookup, number
        Tell the body ``bodies[number]`` from whatever else may stand before it.
    body : Body

    Source: CLHHC08 section 4.2, after DS03; power instead of irradiance is ours.
    """
    ray, extent = camera.rays()
    si = scene.ray_intersect(ray)
    met = si.is_valid() & (lookup.body_index(si) == dr.opaque(mi.UInt32, number + 1))
    power = entering_along(scene, emitter, ray.d, si, met, lookup, body, extent, camera.inv_distance == 0)
    return store(camera, si, power, met)


def store(camera: MapCamera, si: mi.SurfaceInteraction3f, power: mi.Color3f, active: Any) -> TranslucentShadowMap:
    """Put the power of each pixel and the plane that it sees into memory; nothing where not ``active``."""
    depth, slope = camera.flatten(camera.locate(si.p), camera.turn(si.n))
    records = dr.ravel(mi.Array4f(*(dr.select(active, channel, 0) for channel in (*power, depth))))
    slopes = dr.ravel(dr.select(active, slope, 0))
    dr.eval(records, slopes)
    return TranslucentShadowMap(camera, records, slopes)


def _reach(scene: mi.Scene, centre: ArrayLike, radius: float) -> float:
    """Bound the distance from a point to whatever else the scene holds."""
    box = scene.bbox()
    if not box.valid():
        return 2 * radius
    corners = np.stack([np.array(box.min), np.array(box.max)]).astype(float) - np.asarray(centre)
    return 2 * radius + float(np.linalg.norm(np.abs(corners).max(axis=0)))
