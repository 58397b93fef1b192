"""The plug-ins as part of what Mitsuba builds around them: its ``aov`` integrator, its kinds of seeds."""

import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods import METHODS
from worlds.balls import looking_at, scene, translucent

FEW = {
    "two_pass": {"sample_count": 600},
    "exact": {"sample_count": 600},
    "sampled": {},
    "texture_space": {"sample_count": 600, "resolution": 64},
    "single_pass": {"sample_count": 600, "direct": 64, "indirect": 100},
}
DISTANCE, RADIUS = 100.0, 10.0


def lit_ball():
    ball = {"type": "sphere", "radius": RADIUS, "bsdf": translucent(material="marble")}
    return scene(ball, sensor=looking_at([0, 0, 0], [0, 0, DISTANCE], fov=15))


@pytest.mark.parametrize("method", METHODS)
def test_aov_of_mitsuba_around_a_method(method):
    """Depth, normals, albedo and position by Mitsuba, together with extra channels of ours."""
    lit = lit_ball()
    inner = {"type": f"pellucid_{method}", "aovs": "exitance", **FEW[method]}
    integrator = mi.load_dict({"type": "aov", "aovs": "d:depth, n:sh_normal, a:albedo, p:position", "image": inner})
    picture = np.array(mi.render(lit, integrator=integrator, spp=16))
    # Mitsuba puts what it adds last; what is in between it names otherwise than it writes it (in 3.9.1, for its own integrators too).
    own = ["d.T", *(f"{name}.{axis}" for name, axes in (("n", "XYZ"), ("a", "RGB"), ("p", "XYZ")) for axis in axes)]
    channels = dict(zip(own, np.moveaxis(picture[..., -len(own) :], 2, 0), strict=True))
    middle = np.s_[11:13, 11:13]
    assert channels["d.T"][middle] == pytest.approx(DISTANCE - RADIUS, rel=0.02)
    assert channels["n.Z"][middle] == pytest.approx(1, abs=0.02)
    assert channels["p.Z"][middle] == pytest.approx(RADIUS, rel=0.02)
    assert 0.7 < channels["a.R"][middle].mean() < 0.95
    plain = np.array(mi.render(lit, integrator=mi.load_dict(inner), spp=16))
    tolerance = 0.15 if method == "sampled" else 0.02
    assert picture[8:16, 8:16, :3].mean(axis=(0, 1)) == pytest.approx(
        plain[8:16, 8:16, :3].mean(axis=(0, 1)), rel=tolerance
    )
    assert picture[8:16, 8:16, 3:6].mean(axis=(0, 1)) == pytest.approx(
        plain[8:16, 8:16, 3:6].mean(axis=(0, 1)), rel=tolerance
    )


@pytest.mark.parametrize("method", METHODS)
def test_a_seed_may_be_a_number_of_dr_jit(method):
    lit, integrator = lit_ball(), mi.load_dict({"type": f"pellucid_{method}", **FEW[method]})
    pictures = [np.array(mi.render(lit, integrator=integrator, spp=2, seed=seed)) for seed in (1, mi.UInt32(1))]
    assert pictures[0] == pytest.approx(pictures[1], rel=1e-5)
