"""CLHHC08, equation by equation: what the code gives against the printed formula, or its corrected form, in NumPy."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid
from papers.formulas import diffuse_transmittance, dipole, fresnel_transmittance, medium_of
from pellucid.gather.gather import gather_all
from pellucid.kernels.sequences import even_numbers, hammersley_set
from pellucid.light.irradiance import gather_irradiance
from pellucid.light.transport import Limits
from pellucid.methods.texture_space.pyramid import build_pyramid, build_rows, sample_pyramid, sample_rows, warp_points
from pellucid.model.medium import Medium
from pellucid.model.profiles import ProfileTable
from pellucid.realtime import shading
from pellucid.realtime.gbuffer import FIRST_BODY, Eye
from pellucid.realtime.live_body import LiveBody
from pellucid.scene.atlas.layout import build_atlas
from pellucid.scene.atlas.texels import rasterise
from pellucid.scene.bodies import Body, Part, build_lookup, find_bodies
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scene.samples.surface import sample_surface
from worlds.balls import T, scene, translucent
from worlds.live import CAMERA, assemble
from worlds.slabs import render_slab

MARBLE = Medium.from_preset("marble", profile="dipole")
LIGHT = np.array([0.48, -0.6, 0.64])


def test_eq_2():
    """CLHHC08 eq. 2: ``L = F_t(omega_o) B / pi``, over T_d as in JB02 eq. 14, in the method of the paper."""
    for cosine in (0.9, 0.3):
        settings = {"resolution": 64, "irradiance_paths": 4, "sample_count": 500}
        radiance, exitance = render_slab("texture_space", cosine, settings=settings, profile="dipole")
        expected = fresnel_transmittance(cosine, MARBLE.eta) / (np.pi * diffuse_transmittance(MARBLE.eta))
        assert radiance / exitance == pytest.approx([expected] * 3, rel=2e-3)


def test_eq_3():
    """CLHHC08 eq. 3: B is the integral of E R_d over the surface; here of a light that fades over a plane."""
    bounds = np.concatenate([[0], np.geomspace(0.01, 12, 240)])
    r, ring = (bounds[1:] + bounds[:-1]) / 2, np.pi * np.diff(bounds**2)
    angle = 2 * np.pi * (np.arange(64)[:, None] + 0.5 * np.arange(240)) / 64
    p = np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle], -1).reshape(-1, 3)
    power = np.broadcast_to((np.exp(-(r**2)) * ring / 64)[None, :, None], (64, 240, 3)).reshape(-1, 3)
    found = gather_all(p, power, ProfileTable.from_medium(MARBLE), mi.Point3f(0))
    fine = np.concatenate([[0], np.geomspace(1e-5, 12, 40000)])
    for c in range(3):
        expected = np.trapezoid(np.exp(-(fine**2)) * dipole(fine, *medium_of(MARBLE, c)) * 2 * np.pi * fine, fine)
        assert float(found[c][0]) == pytest.approx(expected, rel=2e-3)


def test_eq_4():
    """CLHHC08 eq. 4: E is the integral of ``L F_t cos`` over the hemisphere, for a sky that is brightest above, and one lamp."""
    rows = 256
    height = np.cos(
        (np.arange(rows) + 0.5) / rows * np.pi
    )  # of the directions of the rows of a latitude-longitude picture
    sky = np.repeat(np.maximum(height, 0)[:, None, None], 2 * rows, axis=1) * np.ones(3)
    lamp = np.array([0.6, 0.8, 0.0])  # the direction to it; y is up
    content = {
        "type": "scene",
        "body": {"type": "rectangle", "to_world": T.rotate([1, 0, 0], -90)},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype(np.float32))},
        "lamp": {"type": "directional", "direction": (-lamp).tolist(), "irradiance": 2.0},
    }
    content = mi.load_dict(content, optimize=False)
    samples = sample_surface([(content.shapes()[0], None)], 500, "uniform", 0)
    entering = gather_irradiance(content, samples, 1.5, Limits(2, 5), 256, 0).entering
    cosine = (np.arange(20000) + 0.5) / 20000
    expected = 2 * np.pi * np.mean(cosine * fresnel_transmittance(cosine, 1.5) * cosine)
    expected += 2.0 * 0.8 * fresnel_transmittance(0.8, 1.5)
    assert entering.mean(axis=0) == pytest.approx([expected] * 3, rel=5e-3)


def test_eq_6():
    """CLHHC08 eq. 6: a texel inside a triangle stands for ``A_S / A_T`` times its own area; the two squares differ in that."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    p = np.concatenate([corners, corners * [2, 1, 1] + [3, 0, 0]])
    uv = np.concatenate([corners[:, :2] * [0.4, 0.4] + [0.05, 0.3], corners[:, :2] * [0.4, 0.4] + [0.55, 0.3]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    atlas = build_atlas(Body("body", None, [Part(mesh_from_arrays("squares", p, faces, uv=uv), None, None)]), 128, 4.0)
    texels = rasterise(atlas)
    for first, surface in ((0, 1.0), (3, 2.0)):
        of_square = texels.samples.p[:, 0] >= first - 1e-3
        of_square &= texels.samples.p[:, 0] <= first + surface + 1e-3
        area = texels.samples.area[of_square].astype(float)
        triangles = np.flatnonzero(np.isclose(atlas.area_surface, surface / 2))
        a, b = (atlas.uv[triangles, k] - atlas.uv[triangles, 0] for k in (1, 2))
        texture = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        assert atlas.area_texture[triangles] == pytest.approx(texture)
        assert np.median(area) == pytest.approx(surface / texture.sum() / 128**2, rel=1e-3)
        assert area.sum() == pytest.approx(surface, rel=1e-4)


def test_eq_7():
    """CLHHC08 eq. 7: E' integrates over the plane to the flux (misprint 5), and E' R_d to what E R_d gives over the triangles."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=3.0)
    mesh = mesh_from_arrays("ball", ball.vertices, ball.faces)
    texels = rasterise(build_atlas(Body("body", None, [Part(mesh, None, None)]), 256, 4.0))
    stretch = texels.samples.area.astype(float) * 256**2  # A_S / A_T of what is in the texel
    image = np.maximum(texels.samples.n @ LIGHT, 0) * stretch  # E'
    flux = ball.area_faces * np.maximum(ball.face_normals @ LIGHT, 0)
    assert image.sum() / 256**2 == pytest.approx(flux.sum(), rel=1e-3)
    for x in np.array([[3.0, 0, 0], [0, 0, 3.0], [0, 3.0, 0]]):
        r = np.linalg.norm(texels.samples.p - x, axis=1)
        by_texture = np.sum(image * dipole(r, *medium_of(MARBLE, 0))) / 256**2
        by_surface = np.sum(flux * dipole(np.linalg.norm(ball.triangles_center - x, axis=1), *medium_of(MARBLE, 0)))
        assert by_texture == pytest.approx(by_surface, rel=0.01)


@pytest.mark.parametrize("order", ["mipmap", "rows", "plane"])
def test_eq_9(order):
    """CLHHC08 eq. 9: texels are drawn with the probability ``E' / E'_avg``; even numbers draw each as often as that, but for one."""
    count, resolution = 1 << 16, 16
    rng = np.random.default_rng(3)
    values = rng.exponential(size=resolution**2).astype(np.float32) * (rng.random(resolution**2) < 0.7)
    if order == "plane":
        texel, drawn = warp_points(build_pyramid(mi.Float(values), resolution), *hammersley_set(mi.Float, count))
    elif order == "rows":
        texel, drawn = sample_rows(build_rows(mi.Float(values), resolution), even_numbers(mi.Float, count))
    else:
        texel, drawn = sample_pyramid(build_pyramid(mi.Float(values), resolution), even_numbers(mi.Float, count))
    probability = values.astype(float) / values.sum(dtype=float)
    times = np.bincount(texel.numpy(), minlength=resolution**2)
    assert times == pytest.approx(count * probability, abs=2 if order != "plane" else 0.003 * count**0.5 * 16)
    assert np.array_equal(drawn.numpy(), values[texel.numpy()])


def test_eq_10():
    """CLHHC08 eq. 10: ``B = E'_avg / N`` times the sum of R_d over the samples; E'_avg of a ball under parallel light is known."""
    radius, count, irradiance = 4.0, 700, 3.0
    light = {"type": "directional", "direction": (-LIGHT).tolist(), "irradiance": irradiance}
    body = {"type": "sphere", "radius": radius, "bsdf": translucent(material="marble", profile="dipole")}
    settings = {"sample_count": count, "point_samples": True, "resolution": 256, "irradiance_paths": 2, "max_depth": 2}
    prepared = pellucid.prepare(scene(body, light=light), "texture_space", **settings)
    drawn = prepared.integrator.prepared.bodies[0].state.drawn.p.numpy().T.astype(float)
    assert len(drawn) == count
    average = np.pi * radius**2 * irradiance * diffuse_transmittance(MARBLE.eta)  # the flux that enters
    n = np.random.default_rng(5).normal(size=(100, 3))
    x = radius * n / np.linalg.norm(n, axis=1, keepdims=True)
    r = np.linalg.norm(x[:, None] - drawn, axis=-1)
    expected = np.stack([average / count * dipole(r, *medium_of(MARBLE, c)).sum(axis=1) for c in range(3)], axis=1)
    assert prepared.exitance(x) == pytest.approx(expected, rel=5e-3)


def test_eq_11():
    """CLHHC08 eq. 11: the radiance of a pixel is ``F_t(omega_o) / pi`` times its exitance, over T_d, for every angle of a ball."""
    content = assemble()
    bodies = find_bodies(content)
    lookup = build_lookup(content, bodies)
    eye = Eye(content, lookup, keep_hits=False)
    eye.look(CAMERA, (48, 48), (0.5, 0.5))
    exitance = mi.Color3f(1.0, 2.0, 3.0)
    radiance = shading.translucent(eye.gbuffer, exitance, shading.leave_table([LiveBody(bodies[0], 0, lookup, 64)]))
    seen = eye.gbuffer.kind.numpy() == FIRST_BODY
    p = eye.gbuffer.p.numpy().T[seen].astype(float)
    ahead = p - np.array(CAMERA.origin)
    cosine = -np.sum(p * ahead, axis=1) / np.linalg.norm(p, axis=1) / np.linalg.norm(ahead, axis=1)
    eta = bodies[0].medium.eta
    leaves = fresnel_transmittance(cosine, eta) / (np.pi * diffuse_transmittance(eta))
    assert seen.sum() > 200 and cosine.min() < 0.3
    assert radiance.numpy().T[seen] == pytest.approx(leaves[:, None] * np.array([1.0, 2.0, 3.0]), rel=5e-3, abs=1e-3)
