"""Two turned copies of a ball of marble under many point lights, one of them partly below a plate; and the sum over all triples."""

import types

import drjit as dr
import mitsuba as mi
import numpy as np

from pellucid.light.points.discretise import irradiance_of_all
from pellucid.light.points.records import DIRECTIONAL, OMNI, ORIENTED, LightSamples, to_device
from pellucid.methods.single_pass.trees.sample_tree import build_placement, build_sample_tree
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from pellucid.scene.samples.surface import sample_surface

ETA = 1.5


def lamps(side, width, height, sky, far, strength):
    """A square lamp of ``side^2`` points, so wide and so high; a sky of so many lights; 20 bulbs so far away and so strong."""
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(*[np.linspace(-width, width, side)] * 2), -1).reshape(-1, 2)
    square = np.column_stack([grid, np.full(side**2, float(height))])
    above, bulbs = rng.normal(size=(sky, 3)), rng.normal(size=(20, 3))
    above, bulbs = (v / np.linalg.norm(v, axis=1)[:, None] for v in (above, bulbs))
    return LightSamples.join(
        [
            LightSamples.make(ORIENTED, square, [[0, 0, -1]], np.full((1, 3), 4.0), 0.2),
            LightSamples.make(DIRECTIONAL, 0, above, rng.exponential(size=(sky, 3)) * 0.02),
            LightSamples.make(OMNI, bulbs * far, 0, rng.exponential(size=(20, 3)) * strength),
        ]
    )


def two_copies(radius, apart, plate, sample_count, colours, scale=1.0):
    """Build the scene, the tree of the samples and the places of the copies; without eye points and lights.

    ``plate`` is where the plate lies and half its side; ``colours`` the range of the random colours of the samples, of which
    the first 50 are black. ``scale`` is that of the medium.
    """
    turn = mi.ScalarTransform4f().translate(apart).rotate([0.6, 0, 0.8], 70)
    where, half = plate
    body = {"type": "sphere", "radius": radius}
    scene = mi.load_dict(
        {
            "type": "scene",
            "body": body,
            "copy": body | {"to_world": turn},
            "plate": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate(where).scale(half)},
        },
        optimize=False,
    )
    samples = sample_surface([(scene.shapes()[0], None)], sample_count, "uniform", 0)
    colour = np.random.default_rng(1).uniform(*colours, (len(samples), 3))
    colour[:50] = 0
    return types.SimpleNamespace(
        scene=scene,
        tree=build_sample_tree(samples, colour),
        table=ProfileTable.from_medium(Medium.from_preset("marble", scale, "dipole")),
        placement=build_placement(np.stack([np.eye(4), np.array(turn.matrix)])),
    )


def sorted_directions(count):
    """Random directions in the order of their first coordinate."""
    n = np.random.default_rng(2).normal(size=(count, 3))
    order = np.argsort(n[:, 0])
    return n[order] / np.linalg.norm(n, axis=1)[order][:, None]


def all_triples(w):
    """Sum over every triple of ``w.eye`` on ``w.copy``, lights first (AWB08 eq. 7): ``(3, eyes) float``."""
    exitance = np.zeros((3, len(w.eye)))
    leaf = dr.arange(mi.UInt32, w.tree.count)
    for copy in (0, 1):
        si = w.tree.receiver(leaf, w.placement, dr.full(mi.UInt32, copy, w.tree.count))
        entering = irradiance_of_all(w.scene, to_device(w.lights), len(w.lights), si, ETA)[1].numpy().T.astype(float)
        power = entering * w.tree.area[:, None] * w.tree.colour
        here = w.copy == copy
        r2 = ((w.eye[here][:, None].astype(float) - w.tree.p[None]) ** 2).sum(axis=2)
        profile = np.stack([np.array(c) for c in w.table.lookup(mi.Float(r2.ravel()))]).reshape(3, *r2.shape)
        exitance[:, here] = np.einsum("cej,jc->ce", profile, power)
    return exitance
