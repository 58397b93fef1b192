"""``bumpmap`` and ``normalmap`` turn the normal for the light that enters, the light that leaves and the reflection."""

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.realtime.source import Camera
from pellucid.scene.meshes.buffers import mesh_from_arrays
from pellucid.scene.samples.surface import sample_surface
from worlds.balls import looking_at, scene, translucent

METHODS = {
    "exact": {"sample_count": 4000},
    "two_pass": {"sample_count": 4000},
    "single_pass": {"sample_count": 4000, "direct": 256, "indirect": 300},
    "texture_space": {"sample_count": 4000, "resolution": 128},
    "sampled": {},
}
SIDE, CELLS = 20.0, 64


def normals(u, v):
    """Waves along one axis and an even slope along the other: both sides of a wave, and a mean that is not the normal."""
    slope = np.stack([0.9 * np.sin(4 * np.pi * u), np.full_like(u, 0.35), np.ones_like(u)], axis=-1)
    return slope / np.linalg.norm(slope, axis=-1, keepdims=True)


def plate(bent, bsdf):
    """A square in the plane z = 0 of many cells, with flat or with bent normals."""
    u, v = np.meshgrid(np.linspace(0, 1, CELLS + 1), np.linspace(0, 1, CELLS + 1))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    vertices = np.column_stack([(uv - 0.5) * SIDE, np.zeros(len(uv))])
    first = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel()
    quads = first[:, None] + np.array([0, 1, CELLS + 2, CELLS + 1])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    n = normals(*uv.T) if bent else np.tile([0.0, 0, 1], (len(uv), 1))
    return mesh_from_arrays("plate", vertices, faces, n, uv, bsdf=bsdf)


def normal_map(nested):
    u, v = np.meshgrid((np.arange(512) + 0.5) / 512, (np.arange(4) + 0.5) / 4)
    texels = mi.Bitmap((0.5 * normals(u, v) + 0.5).astype(np.float32))
    return {"type": "normalmap", "normalmap": {"type": "bitmap", "bitmap": texels, "raw": True}, "bsdf": nested}


WRAPPED = {
    "normalmap": normal_map,
    "twosided": lambda nested: {"type": "twosided", "bsdf": normal_map(nested)},
    "mask": lambda nested: {
        "type": "mask",
        "opacity": 1.0,
        "bsdf": {"type": "twosided", "bsdf": normal_map(nested)},
    },
}


def lit(shape):
    lamp = {"type": "directional", "direction": [-1.0, -0.2, -1.0], "irradiance": 3.0}
    sensor = looking_at([0, 0, 0], [40, 10, 50], fov=18.0)
    return scene(shape, light=lamp, sensor=sensor)


def picture(content, method, spp):
    integrator = mi.load_dict({"type": f"pellucid_{method}", **METHODS[method]})
    return np.array(mi.render(content, integrator=integrator, spp=spp), dtype=float)[..., 0]


@pytest.mark.parametrize("method", METHODS)
def test_a_normal_map_looks_like_normals_that_are_bent(method):
    material = translucent(reflectance=0.8, dmfp=0.5, eta=1.5, alpha=0.4)
    spp = 128 if method == "sampled" else 32
    bent, flat, mapped = (
        picture(lit(plate(is_bent, bsdf)), method, spp)
        for is_bent, bsdf in ((True, material), (False, material), (False, WRAPPED["mask"](material)))
    )
    shown = bent > 0.02
    difference = np.sqrt(np.mean((mapped - bent)[shown] ** 2)) / bent[shown].mean()
    without = np.sqrt(np.mean((flat - bent)[shown] ** 2)) / bent[shown].mean()
    assert mapped[shown].mean() == pytest.approx(bent[shown].mean(), rel=0.01)
    assert difference < 0.05 * without


@pytest.mark.parametrize("method", ["texture_space", "hybrid", "image_space"])
def test_a_normal_map_looks_like_normals_that_are_bent_in_the_engine(method):
    material = translucent(reflectance=0.8, dmfp=2.0, eta=1.5, alpha=0.4)
    pictures = []
    for is_bent, bsdf in ((True, material), (False, material), (False, WRAPPED["twosided"](material))):
        engine = pellucid.Engine(lit(plate(is_bent, bsdf)), resolution=128)
        engine.settings.method, engine.settings.samples, engine.settings.gi = method, 4000, False
        pictures.append(engine.linear(Camera((40, 10, 50), (0, 0, 0), (0, 1, 0), 18.0), (24, 24))[..., 0])
        del engine  # before the next: kernels are compiled for all scenes that are alive
    bent, flat, mapped = pictures
    assert mapped.mean() == pytest.approx(bent.mean(), rel=0.02)
    assert np.sqrt(np.mean((mapped - bent) ** 2)) < 0.2 * np.sqrt(np.mean((flat - bent) ** 2))


@pytest.mark.parametrize("wrapper", WRAPPED)
def test_the_normal_is_read_through_every_wrapper(wrapper):
    shape = plate(False, WRAPPED[wrapper](translucent()))
    samples = sample_surface([(shape, None)], 200, "uniform")
    assert samples.sh_n == pytest.approx(normals(*samples.uv.T.astype(float)), abs=0.02)
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], 90).rotate([1, 0, 0], 180).matrix
    moved = sample_surface([(shape, np.array(turned))], 200, "uniform")
    wanted = normals(*moved.uv.T.astype(float)) @ np.array(turned, float)[:3, :3].T
    assert moved.sh_n == pytest.approx(wanted, abs=0.02)


def test_a_bump_map_without_gradient_is_refused_in_one_line():
    bsdf = {"type": "bumpmap", "texture": {"type": "checkerboard"}, "bsdf": translucent()}
    with pytest.raises(pellucid.PellucidError, match=r"bumpmap.*use a 'bitmap'"):
        pellucid.prepare(lit(plate(False, bsdf)), sample_count=100)


def bumps(nested, slope=10.0):
    ramp = mi.Bitmap(np.tile(np.linspace(0, 1, 64, dtype=np.float32)[None, :, None], (4, 1, 1)))
    texture = {"type": "bitmap", "bitmap": ramp, "raw": True}
    return {"type": "bumpmap", "texture": texture, "scale": slope, "bsdf": nested}


TURNED = np.array(mi.ScalarTransform4f().rotate([0, 1, 0], 70).rotate([1, 0, 0], 160).matrix, float)


@pytest.mark.parametrize("turned", [np.eye(4), TURNED], ids=["upright", "turned"])
def test_a_bump_map_turns_normals(turned):
    """Also where the surface does not look along z: a bump map evaluates what it holds in the frame of the surface, not of the scene."""
    n = sample_surface([(plate(False, bumps(translucent())), turned)], 200, "uniform").sh_n
    inside = turned[:3, :3] @ np.array([-10 / SIDE, 0, 1]) / np.hypot(10 / SIDE, 1)
    assert np.median(n, axis=0) == pytest.approx(inside, abs=0.02)


@pytest.mark.parametrize("shape", [{"type": "sphere"}, {"type": "cylinder"}, {"type": "cube"}], ids=lambda s: s["type"])
def test_a_flat_bump_map_changes_nothing(shape):
    samples = sample_surface([(mi.load_dict({**shape, "bsdf": bumps(translucent(), slope=0.0)}), None)], 200, "uniform")
    assert samples.sh_n == pytest.approx(samples.n, abs=1e-3)


@pytest.mark.parametrize("outer", [True, False], ids=["around", "inside"])
def test_bump_maps_and_normal_maps_hold_each_other(outer):
    """A flat bump map around or inside a normal map leaves what that says, wherever the surface looks."""
    flat = bumps(translucent(), slope=0.0)
    bsdf = bumps(normal_map(translucent()), slope=0.0) if outer else normal_map(flat)
    samples = sample_surface([(plate(False, bsdf), TURNED)], 200, "uniform")
    assert samples.sh_n == pytest.approx(normals(*samples.uv.T.astype(float)) @ TURNED[:3, :3].T, abs=0.02)


@pytest.mark.parametrize("how", ["prepare", "engine"])
def test_a_normal_map_with_nan_is_named_whoever_loads_the_scene(how):
    """It was flat, without a word."""
    texels = np.full((4, 4, 3), 0.5, np.float32)
    texels[1, 2] = np.nan
    bad = {"type": "bitmap", "bitmap": mi.Bitmap(texels), "raw": True}
    content = lit(plate(False, {"type": "normalmap", "normalmap": bad, "bsdf": translucent()}))
    with pytest.raises(pellucid.PellucidError, match=r"normalmap.*data' has values that are NaN or infinite"):
        pellucid.prepare(content, sample_count=100) if how == "prepare" else pellucid.Engine(content, resolution=128)
