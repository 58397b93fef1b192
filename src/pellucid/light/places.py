"""Places on the shapes of area lights."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..kernels.sequences import hammersley_set
from ..scene.samples.draw import to_world_frame


def places_on(emitter: mi.Emitter, count: int, seed: int) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
    """Spread places over the shape of an area light, where its texture is bright; with the part of the surface that each stands for."""
    ps, _ = emitter.sample_position(0.0, mi.Point2f(*hammersley_set(mi.Float, count, seed)))
    shape = emitter.get_shape()
    if shape.class_name() == "Sphere":  # of a turned one Mitsuba turns the points, and forgets their normals
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        ps.n = to_world_frame(ps.p, ps.n, matrix)[1]
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p, si.n, si.uv, si.sh_frame, si.wi = ps.p, ps.n, ps.uv, mi.Frame3f(ps.n), mi.Vector3f(0, 0, 1)
    return si, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0) / dr.opaque(mi.Float, count)
