"""Which surfaces are closed, and enclose a solid, and which are open: sheets, bowls, tubes."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..kernels.memory import rows
from ..kernels.sequences import fibonacci_lattice
from .meshes.buffers import mesh_buffers
from .samples.draw import Surface
from .solids import hole_share

OPEN = 0.05
"""Surfaces whose holes have more than this share of their area are open."""

NORMALS = 4096
"""Points at which the normals of shapes that are no meshes are looked at."""


def is_open_surface(shapes: Sequence[mi.Shape]) -> bool:
    """Tell whether the surface that shapes make up together is open.

    Holes of meshes are measured by their borders. Of other shapes a cylinder has no lids, and several enclose something if their normals
    cancel.
    """
    if all(shape.is_mesh() for shape in shapes):
        return _holes_of_meshes(shapes) > OPEN
    if len(shapes) == 1 and shapes[0].class_name() in ("Cylinder", "Disk"):
        return True
    normals = rows(Surface([(shape, None) for shape in shapes]).draw(NORMALS, 0, fibonacci_lattice).n)
    return float(np.linalg.norm(normals.mean(axis=0, dtype=float))) > OPEN


def _holes_of_meshes(meshes: Sequence[mi.Shape]) -> float:
    """Measure the holes of several meshes together, as a share of their area."""
    vertices, faces = zip(*(mesh_buffers(mesh) for mesh in meshes), strict=True)
    first = np.cumsum([0, *(len(v) for v in vertices[:-1])], dtype=np.uint32)
    return hole_share(np.concatenate(vertices), np.concatenate([f + k for f, k in zip(faces, first, strict=True)]))
