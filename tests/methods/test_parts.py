"""Parts of the samples: what each of them gives at points adds up to what all give at once."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import EnvironmentProblem, PellucidError
from pellucid.kernels.memory import rows
from pellucid.kernels.sequences import fibonacci_lattice
from pellucid.methods import method_class
from pellucid.methods.elsewhere import Asked, Known, points_of
from pellucid.methods.preparation import open_scene
from pellucid.methods.surface_samples import stretches_of_part
from pellucid.scene.samples.draw import Surface
from pellucid.scene.samples.surface import sample_surface
from worlds.balls import T, scene, translucent
from worlds.points import relative_rmse, spiral

CURVED = {"sigma_s_prime": 1.2, "sigma_a": 0.0016, "eta": 1.3, "profile": "curved"}
COUNT = 1000


def ball_and_block():
    """A lamp far away, and one a little above the block: nearer than samples are to each other."""
    ball = {"type": "sphere", "radius": 8.0, "bsdf": translucent(**CURVED)}
    block = {
        "type": "cube",
        "to_world": T.translate([25, 0, 0]).scale([8, 8, 2]),
        "bsdf": translucent(**CURVED),
    }
    far = {"type": "point", "position": [10.0, 60, 80], "intensity": 1e4}
    near = {"type": "point", "position": [25, 0.1, 2.2], "intensity": 1.0}
    return scene(ball, block, light=far, near=near)


def seen():
    """Points all over the ball, and on the top of the block."""
    across = np.random.default_rng(0).uniform(-7.9, 7.9, (COUNT, 2))
    ball, block = spiral(COUNT), np.column_stack([25 + across[:, 0], across[:, 1], np.full(COUNT, 2.0)])
    n = np.concatenate([ball, np.tile([0.0, 0, 1], (COUNT, 1))])
    about = np.repeat([[1.0, 1], [2, 1]], COUNT, axis=0)
    return np.concatenate([8 * ball, block]), n, about


@pytest.mark.filterwarnings("ignore:The light of lamps close by")
def test_parts_add_up():
    """The curve, thin parts and lamps close by included: the sides of the block come from all of it, and rays count once."""
    lit, points = ball_and_block(), points_of(np.concatenate(seen(), axis=1).astype(np.float32))
    method = method_class("two_pass").from_properties({"sample_count": 6000, "irradiance_paths": 64, "max_depth": 2})
    whole = rows(method.exitance(lit, method.prepare(lit, open_scene(lit)), points))
    single = method.prepare_part(lit, open_scene(lit), 0, 1)
    np.testing.assert_array_equal(rows(method.exitance(lit, single, points)), whole)
    parts = [method.prepare_part(lit, open_scene(lit), k, 3) for k in range(3)]
    sizes = [[0 if each.state is None else len(each.samples) for each in part.bodies] for part in parts]
    assert sizes == [[4000, 0], [2000, 2000], [0, 4000]]
    summed = sum(rows(method.exitance(lit, part, points)) for part in parts)
    for body in (slice(0, COUNT), slice(COUNT, None)):
        assert relative_rmse(summed[body], whole[body]).max() < 0.012  # another seed: .004 and .009
        np.testing.assert_allclose(summed[body].mean(axis=0), whole[body].mean(axis=0), rtol=4e-3)
    assert parts[1].bodies[1].close is not None and parts[2].bodies[1].close is None


@pytest.mark.parametrize("factor", [1, 2], ids=["ball", "egg"])
def test_stretches_of_a_surface_make_the_whole(factor):
    """Of triangles, which are cut, and of a shape that a transform makes larger in one place than in another."""
    ball, cube = mi.load_dict({"type": "sphere", "radius": 3.0}), mi.load_dict({"type": "cube"})
    surface = Surface([(ball, np.diag([1.0, factor, 1, 1])), (cube, None)])
    parts = [surface.stretch(k / 5, (k + 1) / 5) for k in range(5)]
    weights = np.array([part.area for part in parts]) / surface.area
    assert weights.sum() == pytest.approx(1) and (factor > 1 or weights == pytest.approx(0.2))
    drawn = [rows(part.draw(4000, 1, fibonacci_lattice).p) for part in parts]
    whole = rows(surface.draw(20_000, 1, fibonacci_lattice).p)
    for power in (1, 2):
        mean = sum(weight * (p**power).mean(axis=0) for weight, p in zip(weights, drawn, strict=True))
        np.testing.assert_allclose(mean, (whole**power).mean(axis=0), atol=0.02 * factor**2)
    boxes = [np.prod(np.ptp(p, axis=0)) for p in drawn]
    assert max(boxes) < 0.6 * np.prod(np.ptp(whole, axis=0))
    inside_out = mi.load_dict({"type": "sphere", "radius": 3.0, "flip_normals": True})
    assert sample_surface(Surface([(inside_out, None)]).stretch(0, 0.1), 100, "uniform").outside == -1


def test_who_has_what():
    """Each sample belongs to one part, and no part has a larger share than another."""
    counts = [7, 100, 1, 40]
    found = np.zeros((4, 5))
    for k in range(5):
        for body, first, last in stretches_of_part(counts, k, 5):
            found[body, k] = counts[body] * (last - first)
    np.testing.assert_allclose(found.sum(axis=1), counts)
    np.testing.assert_allclose(found.sum(axis=0), 148 / 5)
    assert stretches_of_part(counts, 0, 1) == [(body, 0.0, 1.0) for body in range(4)]


def test_points_are_found_however_they_are_asked_for():
    numbers = np.concatenate(seen(), axis=1).astype(np.float32)
    asked = Asked()
    for chunk in (numbers[:700], numbers[700:], numbers[:50]):
        assert not rows(asked.exitance(points_of(chunk))).any()
    listed = asked.points()
    assert len(listed) == len(numbers)
    known = Known(listed, listed[:, :3] * 2)
    np.testing.assert_array_equal(rows(known.exitance(points_of(numbers[300:900]))), numbers[300:900, :3] * 2)
    numbers[5, 7] = 4  # seen by way of another surface
    with pytest.raises(EnvironmentProblem, match="gave different points"):
        known.exitance(points_of(numbers[:10]))


@pytest.mark.parametrize("asked", [{"translucent_passes": 1}, {"aovs": "exitance, irradiance"}])
def test_what_needs_all_samples_is_refused(asked):
    with pytest.raises(PellucidError, match="all samples at once: leave it out, or --sample-parts"):
        method_class("two_pass").from_properties(asked).check_parts()
