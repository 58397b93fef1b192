"""Points of a unit sphere, lights of all kinds around it, and how far two sums at points are apart."""

import drjit as dr
import mitsuba as mi
import numpy as np

from pellucid.light.points.records import DIRECTIONAL, OMNI, ORIENTED, LightSamples


def unit(rng, count):
    """Random directions, ``(count, 3)``."""
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def spiral(count):
    """Points of the unit sphere that are spread evenly, ``(count, 3)``: Fibonacci's spiral."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * 2.399963229728653
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)


def spread_on_sphere(count, seed):
    """The same, but not regular."""
    rng = np.random.default_rng(seed)
    p = spiral(count)
    p += rng.normal(size=p.shape) / np.sqrt(count)
    return rng.permutation(p / np.linalg.norm(p, axis=1)[:, None])


def receivers(count, seed=0):
    """Random points of the unit sphere that are to be lit."""
    n = mi.Normal3f(unit(np.random.default_rng(seed), count).T.astype(np.float32))
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p, si.n, si.sh_frame = mi.Point3f(n), n, mi.Frame3f(mi.Vector3f(n))
    return si


def mixed_lights(count=300, seed=3):
    """Bulbs, lamps that face the unit sphere, and a sky, a third each, of very different strength."""
    rng = np.random.default_rng(seed)
    third = count // 3

    def power():
        return rng.exponential(size=(third, 3)) ** 2

    where = unit(rng, third) * rng.uniform(1.5, 4, (third, 1))
    facing = -where / np.linalg.norm(where, axis=1)[:, None]
    return LightSamples.join(
        [
            LightSamples.make(OMNI, 3 * unit(rng, third), 0, power()),
            LightSamples.make(ORIENTED, where, facing, power(), 0.3),
            LightSamples.make(DIRECTIONAL, 0, unit(rng, third), 0.1 * power()),
        ]
    )


def relative_rmse(value, truth):
    """Root mean square error of each channel of ``(n, 3)`` values, relative to the channel's mean."""
    return np.sqrt(((value - truth) ** 2).mean(axis=0)) / truth.mean(axis=0)
