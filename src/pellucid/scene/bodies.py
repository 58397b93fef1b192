"""Find the translucent solids of a Mitsuba scene, and tell in a kernel which of them a ray has hit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SceneError
from ..model.medium import Medium
from .meshes.buffers import mesh_buffers, part_of_mesh
from .openness import is_open_surface
from .samples.draw import Surface
from .shading import turned_normal
from .solids import separate_solids, turned_faces

NO_BODY = 0xFFFFFFFF
"""What stands for an instance that holds none of the bodies looked for."""


class Role(Enum):
    """What a translucent material shows to a path tracer."""

    STAND_IN = "a diffuse lobe for the light inside, under the reflection of the surface: what other integrators see"
    DIFFUSE = "one diffuse lobe for everything, so that light gathered from it has no fireflies"
    SURFACE = "the reflection of the surface alone: the integrator adds the exitance"


@dataclass
class Part:
    """One shape of a body, or one of the solids among the triangles of a mesh.

    Attributes
    ----------
    shape : mi.Shape
        The surface: the shape of the scene, or a mesh of the triangles of the solid alone.
    instance : mi.Shape, optional
    to_world : (4, 4) float, optional
        The transform of the instance.
    whole : mi.Shape, optional
        The mesh of the scene that a solid is part of.
    faces : (t,) bool, optional
        Its triangles there.
    """

    shape: mi.Shape
    instance: mi.Shape | None = None
    to_world: np.ndarray | None = None
    whole: mi.Shape | None = None
    faces: np.ndarray | None = None

    @property
    def has_holes(self) -> bool:
        """Tell whether rays may pass the surface untouched: an opacity, by ``mask``."""
        return mi.has_flag(self.shape.bsdf().flags(), mi.BSDFFlags.Null)

    @property
    def turns_normals(self) -> bool:
        """Tell whether the material may turn shading normals: it is inside another one, such as ``bumpmap``."""
        return not hasattr(self.shape.bsdf(), "medium")

    @property
    def in_scene(self) -> mi.Shape:
        """The shape of the scene that rays hit."""
        return self.shape if self.whole is None else self.whole


@dataclass
class Body:
    """One translucent solid: the shapes whose light mixes, and the plug-in that describes their medium (in scene units).

    Attributes
    ----------
    side : int
        0 for what is closed. An open surface is two bodies, each the half space behind one of its sides: 1 is that of the normals, -1 the
        other.
    """

    name: str
    bsdf: mi.BSDF
    parts: list[Part] = field(default_factory=list)
    side: int = 0

    @property
    def medium(self) -> Medium:
        """The medium of the body, per scene unit."""
        return self.bsdf.medium

    @property
    def is_stretched(self) -> bool:
        """Whether the profile is wider here and narrower there: where dmfp is a texture."""
        return self.bsdf.textures.dmfp is not None

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """Find the box around the shapes of the body, in the scene."""
        box = mi.ScalarBoundingBox3f()
        for part in self.parts:
            box.expand((part.instance or part.shape).bbox())
        return box

    def surface(self) -> Surface:
        """Gather the shapes of the body."""
        return Surface([(part.shape, part.to_world) for part in self.parts], self.side)

    def is_back_of(self, other: Body) -> bool:
        """Tell whether another body is the front of the same open surface."""
        return self.side == -1 and other.side == 1 and self.parts is other.parts


@dataclass
class Lookup:
    """Two tables over Dr.Jit's instance numbers that map a surface interaction to its body.

    The bodies of an instance follow each other, in the same order in every instance of a group: a body's number is that
    of the last body before its instance plus the number of its shape within the group. Of an open surface it is that of its front, which
    is followed by its back.
    """

    before_instance: mi.UInt32
    within: mi.UInt32
    """Twice the number within the group, and 1 more where the body has a back."""
    has_backs: bool
    has_holes: bool
    """Whether the material of a body has an opacity, by ``mask``."""
    turns_normals: bool
    """Whether the material of a body may turn shading normals (`shading.turned_normal`)."""
    first_face: mi.UInt32 | None = None
    """Of meshes with several solids, one more than where their triangles begin in ``within_by_face``; None if there are none."""
    within_by_face: mi.UInt32 | None = None

    def shading_normal(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Normal3f:
        """Evaluate the shading normals of points on bodies, on the side of the normals of their faces, which may be wound against them."""
        n = turned_normal(si.bsdf(), si, active) if self.turns_normals else mi.Normal3f(si.sh_frame.n)
        return mi.Normal3f(dr.mulsign(n, dr.dot(n, si.n)))

    def leaving_cosine(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Float:
        """Evaluate the cosine under which light leaves points on bodies, between the shading normal and the way back along the ray."""
        if not self.turns_normals:
            return dr.abs(si.wi.z)
        return dr.abs(dr.dot(self.shading_normal(si, active), si.to_world(si.wi)))

    def body_index(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.UInt32:
        """Look up the body that was hit, of an open surface on the side that the ray came from: 0 for none, k + 1 for ``bodies[k]``."""
        before = dr.gather(mi.UInt32, self.before_instance, dr.reinterpret_array(mi.UInt32, si.instance), active)
        shape = dr.reinterpret_array(mi.UInt32, si.shape)
        within = dr.gather(mi.UInt32, self.within, shape, active)
        if self.first_face is not None:
            first = dr.gather(mi.UInt32, self.first_face, shape, active)
            within += dr.gather(mi.UInt32, self.within_by_face, first + si.prim_index - 1, active & (first != 0))
        number = before + (within >> 1)
        if self.has_backs:
            number += dr.select(dr.dot(si.n, si.to_world(si.wi)) < 0, within & 1, 0)
        return dr.select((within != 0) & (before != NO_BODY), number, 0)


@cache
def _collector(variant: str) -> type:
    """Make the class that lists the children of a node. Once a variant: a class is garbage only a collector frees, and a
    scene that it kept alive until then could go in the middle of tracing a kernel, which Dr.Jit does not survive."""

    class Collector(mi.TraversalCallback):
        def __init__(self) -> None:
            super().__init__()
            self.found: list[tuple[str, object]] = []

        def put(self, name: str, value: object, *flags: object) -> None:
            if isinstance(value, mi.Object):
                self.found.append((name, value))

    return Collector


def children(node: Any) -> list[tuple[str, object]]:
    """List the scene objects directly below a node, by name."""
    collector = _collector(mi.variant())()
    node.traverse(collector)
    return collector.found


def translucent_bsdf(shape: mi.Shape) -> mi.BSDF | None:
    """Find the translucent plug-in of a shape, also below ``twosided``, ``bumpmap``, ``normalmap`` or ``mask``; None if it has none.

    Raises
    ------
    SceneError
        When it is blended with another material, for which the exitance is not defined.
    """
    bsdf = shape.bsdf()
    if hasattr(bsdf, "medium"):
        return bsdf
    return None if bsdf is None else _wrapped(bsdf, shape.id())


def _wrapped(bsdf: mi.BSDF, name: str) -> mi.BSDF | None:
    """Find the translucent plug-in inside another material, however deep."""
    for _, child in children(bsdf):
        found = child if hasattr(child, "medium") else _wrapped(child, name) if isinstance(child, mi.BSDF) else None
        if found is not None and "Blend" in bsdf.class_name():
            raise SceneError(
                f"Shape '{name}' blends pellucid_translucent with another material, which is not supported: "
                "use it alone, with a texture for 'reflectance'."
            )
        if found is not None:
            return found
    return None


def _parts(scene: mi.Scene) -> Iterator[Part]:
    """List every shape of a scene that can be hit, those inside instances once for each instance."""
    groups = {
        node.id(): [child for _, child in children(node) if isinstance(child, mi.Shape)]
        for _, node in children(scene)
        if isinstance(node, mi.Shape) and node.class_name().startswith("ShapeGroup")
    }
    for shape in scene.shapes():
        if shape.class_name() == "Instance":
            # An instance does not hand out its group; its description names it.
            group = re.search(r'ShapeGroup\[\s*name = "([^"]*)"', str(shape))
            to_world = np.array(mi.traverse(shape)["to_world"].matrix.numpy(), dtype=float).reshape(4, 4)
            for nested in groups[group.group(1)] if group else []:
                yield Part(nested, shape, to_world)
        else:
            yield Part(shape)


def find_bodies(scene: mi.Scene) -> list[Body]:
    """List the translucent bodies: every solid is one of its own, unless a ``body`` name joins several; an open surface is two.

    Mitsuba may merge meshes that share a material, and a file may hold several solids: closed parts of a mesh that neither touch
    nor overlap are told apart (`solids.separate_solids`).

    Raises
    ------
    SceneError
        When shapes of one body name have different media or textures of dmfp, or when there is no translucent shape at all.
    """
    bodies: dict[object, Body] = {}
    for part, bsdf, solid in _translucent_parts(scene):
        instance = part.instance.id() if part.instance is not None else ""
        key = (bsdf.body, instance) if bsdf.body else len(bodies)
        own = part.in_scene.id() and part.in_scene.id() + solid
        name = ".".join(filter(None, [instance, bsdf.body or own or f"body{len(bodies)}"]))
        body = bodies.setdefault(key, Body(name, bsdf))
        if body.medium != bsdf.medium:
            raise SceneError(
                f"The shapes of body '{bsdf.body}' have different media; one solid has one: give '{part.in_scene.id()}' another body name."
            )
        if bsdf is not body.bsdf and (body.is_stretched or bsdf.textures.dmfp is not None):
            raise SceneError(
                f"The shapes of body '{bsdf.body}' have a BSDF each, with a texture of dmfp: let them refer to one BSDF."
            )
        body.parts.append(part)
    if not bodies:
        raise SceneError(
            "The scene has no translucent shape: give at least one shape a BSDF of type 'pellucid_translucent', or use another integrator."
        )
    return [side for body in bodies.values() for side in _sides(body)]


def _sides(body: Body) -> list[Body]:
    """Make two bodies of an open surface: between its sides no light passes. A closed one is one."""
    if not is_open_surface([part.shape for part in body.parts]):
        return [body]
    return [replace(body, side=1), replace(body, side=-1, name=f"{body.name}.back")]


def _translucent_parts(scene: mi.Scene) -> Iterator[tuple[Part, mi.BSDF, str]]:
    """List the translucent shapes, meshes solid by solid unless a body name joins them; with what a solid adds to the name."""
    divided: dict[int, list[Part]] = {}
    for part in _parts(scene):
        bsdf = translucent_bsdf(part.shape)
        if bsdf is None:
            continue
        if bsdf.body or not part.shape.is_mesh():
            yield part, bsdf, ""
            continue
        if id(part.shape) not in divided:
            divided[id(part.shape)] = _solids(part.shape)
        solids = divided[id(part.shape)]
        for number, solid in enumerate(solids):
            placed = replace(solid, instance=part.instance, to_world=part.to_world)
            yield placed, bsdf, f".{number}" if len(solids) > 1 else ""


def _solids(mesh: mi.Mesh) -> list[Part]:
    """Divide a mesh into its solids."""
    vertices, faces = mesh_buffers(mesh)
    solid = separate_solids(vertices, faces) if len(faces) else np.zeros(0, np.int64)
    if solid.max(initial=0) == 0:
        return [Part(mesh)]
    chosen = [solid == k for k in range(int(solid.max()) + 1)]
    return [Part(part_of_mesh(mesh, faces), whole=mesh, faces=faces) for faces in chosen]


def marks_of_turned_faces(body: Body) -> list[tuple[mi.Shape, mi.UInt32]]:
    """Mark the faces of meshes of a closed body that are wound the other way than most: 1 for each of these among those of its shape."""
    marks: dict[int, tuple[mi.Shape, np.ndarray]] = {}
    for part in body.parts if body.side == 0 else ():
        turned = turned_faces(*mesh_buffers(part.shape)) if part.shape.is_mesh() else None
        if turned is not None and turned.any():
            faces = np.ones(len(turned), np.bool_) if part.faces is None else part.faces
            _, all_marks = marks.setdefault(id(part.in_scene), (part.in_scene, np.zeros(len(faces), np.uint32)))
            all_marks[faces] = turned
    return [(shape, mi.UInt32(own)) for shape, own in marks.values()]


def _number(shape: mi.Shape | None) -> int:
    """Read the number under which Dr.Jit's registry knows a shape; 0 for none."""
    return 0 if shape is None else int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def build_lookup(scene: mi.Scene, bodies: list[Body]) -> Lookup:
    """Tabulate body numbers over instances and shapes for use in kernels."""
    # Shapes and instances share one registry, and any shape of the scene can be hit: the tables cover all their numbers.
    parts = list(_parts(scene))
    shapes = {id(shape): shape for part in parts for shape in (part.instance, part.shape)}
    numbers = {key: _number(shape) for key, shape in shapes.items()}
    before_instance, within, first_face = np.zeros((3, max(numbers.values()) + 1), np.uint32)
    before_instance[[numbers[id(part.instance)] for part in parts if part.instance is not None]] = NO_BODY
    first: dict[int, int] = {0: 0}
    has_holes = any(part.has_holes for body in bodies for part in body.parts)
    turns_normals = any(part.turns_normals for body in bodies for part in body.parts)
    by_face: dict[int, np.ndarray] = {}
    for k, body in enumerate(bodies):
        for part in body.parts:
            instance, shape = numbers[id(part.instance)], numbers[id(part.in_scene)]
            before_instance[instance] = first.setdefault(instance, k)
            code = 2 * (k + 1 - first[instance])
            if k > 0 and body.is_back_of(bodies[k - 1]):
                code -= 1  # that of the front, with a back
            if part.faces is None:
                within[shape] = code
                continue
            if shape not in by_face:
                first_face[shape] = 1 + sum(map(len, by_face.values()))
                by_face[shape] = np.zeros(len(part.faces), np.uint32)
            by_face[shape][part.faces] = code
    has_backs = any(b.is_back_of(a) for a, b in pairwise(bodies))
    tables = mi.UInt32(before_instance), mi.UInt32(within), has_backs, has_holes, turns_normals
    if not by_face:
        return Lookup(*tables)
    return Lookup(*tables, mi.UInt32(first_face), mi.UInt32(np.concatenate(list(by_face.values()))))


@contextmanager
def acting_as(role: Role, bodies: list[Body]) -> Iterator[None]:
    """Give the materials of all bodies a role for a while."""
    bsdfs = {id(bsdf): bsdf for body in bodies for part in body.parts if (bsdf := translucent_bsdf(part.shape))}
    before = {key: bsdf.role for key, bsdf in bsdfs.items()}
    for bsdf in bsdfs.values():
        bsdf.act_as(role)
    try:
        yield
    finally:
        for key, bsdf in bsdfs.items():
            bsdf.act_as(before[key])
