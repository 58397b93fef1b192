"""Which samples of a pixel share an exitance, and what that changes in pictures."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.light.transport import VERTEX_SLOTS, Vertices
from pellucid.methods.answer import Answer
from worlds.balls import looking_at, scene, translucent

SETTINGS = {"sample_count": 1500, "irradiance_paths": 8}


@pytest.fixture(scope="module")
def lit():
    balls = [
        {"type": "sphere", "radius": 5.0, "center": [x, 0, z], "bsdf": translucent(material=m)}
        for x, z, m in ((0, 0, "marble"), (1.5, -12, "cream"))
    ]
    lamp = {"type": "point", "position": [0, -30, 20], "intensity": 900.0}
    world = scene(*balls, lamp=lamp, sensor=looking_at([0, 0, 0], [0, 0, 60], fov=15, size=48))
    integrator = mi.load_dict({"type": "pellucid_two_pass", **SETTINGS})
    integrator.prepared = integrator.prepare_scene(world)
    return world, integrator


def owners(lit, samples, per_pixel, **method):
    """Ask for the owners of the first vertices of paths: (body, position, normal) each."""
    world, integrator = lit
    vertices = Vertices.empty(len(samples))
    number = dr.arange(mi.UInt32, len(samples))
    body, p, n = (np.array(part) for part in zip(*samples, strict=True))
    si = dr.zeros(mi.SurfaceInteraction3f, len(samples))
    si.p, si.n = mi.Point3f(p.T.astype(np.float32)), mi.Normal3f(n.T.astype(np.float32))
    si.sh_frame = mi.Frame3f(si.n)
    dr.scatter(vertices.p, si.p, number)
    dr.scatter(vertices.n, si.n, number)
    dr.scatter(vertices.body, mi.UInt32(body.astype(np.uint32)), number)
    answer = Answer(integrator.method, world, integrator.prepared, 0, True, per_pixel)
    indirect = dr.arange(mi.UInt32, len(samples) * VERTEX_SLOTS) >= len(samples)
    return answer._owner(vertices, indirect).numpy()[: len(samples)].tolist()


UP, ASIDE = [0, 0, 1.0], [1.0, 0, 0]


def test_samples_share_where_body_place_and_normal_agree(lit):
    mfp = float(np.min(lit[1].prepared.bodies[0].body.medium.mfp))
    first = (1, [0, 0, 0], UP)
    alike = (1, [0.2 * mfp, 0, 0], UP)
    for other in (
        (2, [0, 0, 0], UP),
        (1, [mfp, 0, 0], UP),
        (1, [0, 0, 0.2 * mfp], UP),
        (1, [0, 0, 0], ASIDE),
        (1, [0, 0, 0], [0, 0, -1.0]),
    ):
        assert owners(lit, [first, alike, other, first], 4) == [0, 0, 2, 0]
        assert owners(lit, [first, other, alike, (1, [0.4 * mfp, 0, 0], UP)], 4) == [2, 1, 2, 2]  # that in the middle
        assert owners(lit, [first, alike, first, alike], 2) == [0, 0, 2, 2]  # not beyond the pixel
        assert owners(lit, [first, other, alike, other], 4) == [0, 1, 0, 1]  # and those that are left among themselves


def test_pictures_are_the_same_bits_where_nothing_is_shared(lit, monkeypatch):
    """Where a pixel sees both balls or the rim, each sample has its own exitance; elsewhere the pixel takes one value for its mean."""
    world, integrator = lit
    asked = []
    exitance = type(integrator.method).exitance

    def counting(self, scene, state, points):
        asked.append(dr.width(points.p))
        return exitance(self, scene, state, points)

    monkeypatch.setattr(type(integrator.method), "exitance", counting)
    shared = np.array(integrator.render(world, seed=1, spp=16))
    few = sum(asked)
    monkeypatch.setattr(Answer, "_owner", lambda *_: None)
    own = np.array(integrator.render(world, seed=1, spp=16))
    assert few < 0.8 * (sum(asked) - few)
    seen = own.max(axis=-1) > 0
    assert np.sqrt(np.mean((shared - own)[seen] ** 2)) < 0.005 * own[seen].mean()
    assert np.abs(shared - own).max() < 0.03 * own.max()
    one, other = (np.array(integrator.render(world, seed=1, spp=1)) for _ in range(2))
    monkeypatch.undo()
    np.testing.assert_array_equal(np.array(integrator.render(world, seed=1, spp=1)), one)
    np.testing.assert_array_equal(one, other)


def test_random_estimates_are_not_shared(lit):
    world, _ = lit
    method = mi.load_dict({"type": "pellucid_sampled"}).method
    answer = Answer(method, world, lit[1].prepared, 0, True, 16)
    assert answer._owner(Vertices.empty(32), mi.Bool(False)) is None
