"""Textures of the diffuse mean free path: the profile is that of the point where light leaves."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid
from pellucid.errors import MediumError, PellucidError, SampleCountError, SceneError
from pellucid.methods.preparation import entering_power, number_of_samples, open_scene
from pellucid.methods.sampled import RadialSampler, StretchedSampler
from pellucid.methods.thin import thin_factor
from pellucid.model.medium import Medium
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scene.samples.surface import FEWEST_SAMPLES, sample_surface
from worlds.balls import T, looking_at, rgb, scene, translucent

COLOUR = (0.8, 0.6, 0.3)
SHORT, LONG = 0.5, 2.0
FEW = {"sample_count": 3000, "sampling": "uniform", "irradiance_paths": 4, "max_depth": 2}


def texture(values):
    """A bitmap of columns of numbers, or of one colour."""
    texels = np.asarray(values, np.float32)[None, :, None]
    return {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True, "filter_type": "nearest"}


def flat(size=10.0, light=1.0, **medium):
    """A flat square under a lamp to one side of its middle; sizes in scene units."""
    bsdf = translucent(**{"reflectance": rgb(*COLOUR), "alpha": 0.0, "specular_reflectance": 0.0} | medium)
    square = {"type": "rectangle", "id": "square", "to_world": T.scale(size), "bsdf": bsdf}
    lamp = {"type": "point", "position": [0.2 * size, 0, 0.4 * size], "intensity": light}
    return scene(square, light=lamp, sensor=looking_at([0, 0, 0], [0, 0, 100 * size], fov=1.1, size=16))


def picture(lit, method="exact", spp=1, **settings):
    integrator = mi.load_dict({"type": f"pellucid_{method}", **FEW, **settings})
    return np.array(mi.render(lit, integrator=integrator, spp=spp), float)


@pytest.mark.parametrize(
    "method, profile, scale", [("two_pass", "tabulated", 1), ("two_pass", "curved", 1), ("exact", "tabulated", 1000)]
)
def test_a_constant_texture_is_a_number(method, profile, scale):
    """Also with another factor in each channel, in metres, and where the profile knows of curve and thickness."""
    size, light = (10.0, 1.0) if scale == 1 else (0.01, 1e-6)
    number = picture(flat(size, light, dmfp=rgb(2, 1, 0.5), scale=scale, profile=profile), method)
    lengths = {"dmfp": texture([4.0]), "dmfp_scale": rgb(0.5, 0.25, 0.125)}
    assert picture(flat(size, light, scale=scale, profile=profile, **lengths), method) == pytest.approx(
        number, rel=1e-5
    )


def test_each_half_is_as_if_all_were_like_it():
    """The profile is that of where light leaves: what else is on the body changes nothing. Discs of samples keep their size."""
    halves = picture(flat(dmfp=texture([SHORT, LONG])))
    for half, length in ((slice(0, 8), SHORT), (slice(8, 16), LONG)):
        whole = picture(flat(dmfp=length))
        assert halves[:, half] == pytest.approx(whole[:, half], rel=2e-3)
    assert not np.allclose(halves[:, :8], whole[:, :8], rtol=0.1)


@pytest.mark.parametrize("profile", ["tabulated", "curved"])
def test_lengths_of_vertices_are_met(profile):
    """Also on the curve, by the mean free path there."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=8.0)

    def seen(dmfp, lengths=None):
        bsdf = translucent(reflectance=rgb(*COLOUR), dmfp=dmfp, alpha=0.0, profile=profile)
        own = mesh_from_arrays("ball", ball.vertices, ball.faces, ball.vertex_normals, bsdf=bsdf, colors=lengths)
        lamp = {"type": "point", "position": [0, 20, 20], "intensity": 1000.0}
        return picture(scene(own, light=lamp, sensor=looking_at([0, 0, 0], [0, 0, 100], fov=9.0, size=16)))

    lengths = np.where(ball.vertices[:, :1] < 0, SHORT, LONG) * np.ones(3)
    halves = seen({"type": "mesh_attribute", "name": "vertex_color"}, lengths)
    near = 2e-3 if profile == "tabulated" else 0.03  # the factor of thin parts is that of where light enters
    assert halves[:, :7] == pytest.approx(seen(SHORT)[:, :7], rel=near, abs=1e-6)
    assert halves[:, 9:] == pytest.approx(seen(LONG)[:, 9:], rel=near, abs=1e-6)


def test_the_factor_of_thin_parts_is_that_of_the_length_there():
    def factors(dmfp):
        bsdf = translucent(reflectance=0.9, dmfp=dmfp, profile="curved")
        (slab,) = open_scene(scene({"type": "cube", "to_world": T.scale([10, 10, 0.5]), "bsdf": bsdf})).bodies
        samples = sample_surface(slab.body.surface(), 4000, "uniform", 0)
        return samples, thin_factor(slab.body, samples)[:, 0]

    (samples, halves), (_, short), (_, long) = (factors(dmfp) for dmfp in (texture([SHORT, LONG]), SHORT, LONG))
    flat_part = (abs(samples.n[:, 2]) > 0.9) & np.all(abs(samples.p[:, :2]) < 8, axis=1)
    for u, whole in ((0.25, short), (0.75, long)):
        here = flat_part & (abs(samples.uv[:, 0] - u) < 0.15)
        assert halves[here].mean() == pytest.approx(whole[here].mean(), rel=0.02)
    assert short[flat_part].mean() > 1.05 * long[flat_part].mean()


def test_the_sum_is_that_of_numpy():
    """``B(x) = sum P_j R_l(|x - x_j|)`` with the medium of the length l at x."""
    prepared = pellucid.prepare(flat(dmfp=texture([SHORT, LONG])), "exact", point_samples=True, **FEW)
    x = np.random.default_rng(1).uniform(-8, 8, (40, 3)) * [1, 1, 0]
    lit = prepared.integrator.prepared.bodies[0]
    r = np.linalg.norm(x[:, None] - lit.samples.p, axis=2)
    media = [Medium.from_reflectance(COLOUR, length) for length in (SHORT, LONG)]
    kernel = np.where((x[:, :1] < 0)[..., None], *(medium.diffuse_reflectance(r) for medium in media))
    assert prepared.exitance(x) == pytest.approx(np.einsum("ijc,jc->ic", kernel, entering_power(lit)), rel=3e-3)


def test_clusters_follow_the_sum():
    exact = picture(flat(dmfp=texture([SHORT, LONG])))
    assert picture(flat(dmfp=texture([SHORT, LONG])), "two_pass") == pytest.approx(exact, rel=0.02)


def test_samples_follow_the_shortest():
    bodies = [open_scene(flat(dmfp=dmfp)).bodies[0].body for dmfp in (SHORT, texture([LONG, SHORT]))]
    one, other = (number_of_samples(body, body.surface(), 0, 10**7) for body in bodies)
    assert one == other > FEWEST_SAMPLES


def test_radii_are_drawn_by_their_density():
    """As many of them fall within a distance as the density says, over channels that are stretched unlike."""
    radial = RadialSampler.from_medium(Medium.from_reflectance(COLOUR, SHORT))
    wide = StretchedSampler(radial, mi.Color3f(1.0, 2.0, 4.0))
    u = (np.arange(20000) + 0.5) / 20000
    r = wide.sample(mi.Float(u)).numpy()
    edges = np.geomspace(1e-4, radial.r_max * 4, 4000)
    middle = 0.5 * (edges[1:] + edges[:-1])
    within = np.cumsum(wide.pdf(mi.Float(middle**2)).numpy() * np.pi * np.diff(edges**2))
    assert within[-1] == pytest.approx(1, abs=0.01)
    for at in (0.2, 1.0, 4.0):
        assert np.mean(r < at) == pytest.approx(np.interp(at, middle, within), abs=0.01)


def test_paths_find_the_same():
    """`sampled` draws light from all over the square for pixels of both halves."""
    lit = flat(dmfp=texture([SHORT, LONG]))
    exact = picture(lit, sampling="relaxed", sample_count=20000)
    mi.render(lit, integrator=(sampled := mi.load_dict({"type": "pellucid_sampled", "max_depth": 2})), spp=1)
    found = np.array(mi.render(lit, integrator=sampled, spp=1024), float)
    for half in (slice(1, 7), slice(9, 15)):
        assert found[4:12, half].mean(axis=(0, 1)) == pytest.approx(exact[4:12, half].mean(axis=(0, 1)), rel=0.06)


def test_what_has_one_profile_a_body_refuses():
    lit = flat(dmfp=texture([SHORT, LONG]))
    for method in ("texture_space", "single_pass"):
        with pytest.raises(SceneError, match=f"'square' is a texture, and pellucid_{method} has one mean free"):
            pellucid.prepare(lit, method)
    with pytest.raises(SceneError, match="the real-time engine has one mean free path a body"):
        pellucid.Engine(lit)


def test_what_no_texture_can_be_is_refused():
    with pytest.raises(MediumError, match="0 mm somewhere on the body 'square'"):
        open_scene(flat(dmfp=texture([0.0, LONG])))
    two = [{"type": "sphere", "bsdf": translucent(reflectance=0.5, dmfp=texture([LONG]), body="one")} for _ in range(2)]
    with pytest.raises(SceneError, match="'one' have a BSDF each, with a texture of dmfp"):
        open_scene(scene(*two))
    with pytest.raises(SampleCountError, match=r"texture of its dmfp goes down to 0\.001 mm"):
        pellucid.prepare(flat(dmfp=texture([1e-3, LONG])))


def test_a_texture_of_lengths_has_no_gradient():
    lit = flat(dmfp=texture([SHORT, LONG]))
    params = mi.traverse(lit)
    dr.enable_grad(params["square.bsdf.dmfp.data"])
    params.update()
    with pytest.raises(
        PellucidError, match=r"'square\.bsdf\.dmfp\.data': those of media, .* and textures of dmfp do not"
    ):
        pellucid.prepare(lit, "exact")
