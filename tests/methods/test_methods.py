"""Every method on scenes with known answers, and against its twin."""

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.model.fresnel import external_diffuse_transmittance
from worlds.balls import T, looking_at, scene, translucent


def render(scene, method, spp=16, **settings):
    integrator = mi.load_dict({"type": f"pellucid_{method}", **settings})
    return np.array(mi.render(scene, integrator=integrator, spp=spp), dtype=float)


def disk_exitance(medium, radius):
    """Exitance in the middle of an evenly lit disk for unit entering flux density: eq. 8 integrated in closed form."""
    total = 0.0
    for z in (medium.z_r, medium.z_v):
        d = np.sqrt(radius**2 + z**2)
        total += 0.5 * medium.albedo_prime * (np.exp(-medium.sigma_tr * z) - z / d * np.exp(-medium.sigma_tr * d))
    return total


@pytest.mark.parametrize("material", ["spectralon", "marble", "skin1"])
@pytest.mark.parametrize("method", ["two_pass", "exact", "sampled"])
def test_an_evenly_lit_disk_reflects_the_integral_of_the_profile(method, material):
    """The furnace in closed form; with the reflection of the surface, an infinite slab of spectralon has 1."""
    medium = pellucid.Medium.from_preset(material, profile="dipole")
    radius = 60 * float(np.max(medium.mfp))
    # Lit from above only: the disk is open, and its lower side would double the light.
    dome = {"type": "disk", "to_world": T.translate([0, 0, -0.01 * radius]).scale(50 * radius)}
    dome["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    disk = {
        "type": "disk",
        "to_world": T.scale(radius),
        "bsdf": translucent(material=material, profile="dipole", alpha=0.0, specular_reflectance=0.0),
    }
    # The middle of the picture is some mean free paths wide: at a single point the samples leave 3 % of noise (skin1, blue).
    sensor = looking_at([0, 0, 0], [0, 0, 10 * radius], fov=3, size=8)
    settings = {"sample_count": 60000, "irradiance_paths": 64} if method != "sampled" else {}
    image = render(
        scene(disk, dome, sensor=sensor), method, 16384 if method == "sampled" else 4, max_depth=2, **settings
    )
    transmittance = external_diffuse_transmittance(medium.eta)
    normal = 4 * medium.eta / (medium.eta + 1) ** 2  # Fresnel transmittance straight up
    expected = disk_exitance(medium, radius) * transmittance * normal / transmittance
    assert image[3:5, 3:5].mean(axis=(0, 1)) == pytest.approx(expected, rel=0.03)


def furnace(method, **settings):
    ball = {"type": "sphere", "radius": 20.0, "bsdf": translucent(material="marble", scale=0.5)}
    sensor = looking_at([0, 0, 0], [0, 0, 200], fov=8, size=16)
    return render(scene(ball, sensor=sensor), method, **settings)


def test_all_methods_agree_on_a_ball_under_a_sky():
    settings = {"sample_count": 4000, "irradiance_paths": 64}
    exact = furnace("exact", **settings)
    two_pass = furnace("two_pass", **settings)
    sampled = furnace("sampled", spp=1024)
    middle = np.s_[4:12, 4:12]
    assert two_pass[middle].mean(axis=(0, 1)) == pytest.approx(exact[middle].mean(axis=(0, 1)), rel=2e-3)
    assert sampled[middle].mean(axis=(0, 1)) == pytest.approx(exact[middle].mean(axis=(0, 1)), rel=0.02)


def test_two_pass_with_zero_error_is_exact():
    settings = {"sample_count": 3000, "irradiance_paths": 4}
    assert furnace("two_pass", max_error=0.0, **settings) == pytest.approx(
        furnace("exact", **settings), rel=2e-5, abs=1e-6
    )


def test_a_smaller_max_error_is_nearer_to_exact():
    settings = {"sample_count": 20000, "irradiance_paths": 4}
    light = {"type": "directional", "direction": [-1, 0, -0.3], "irradiance": 3.0}
    ball = {"type": "sphere", "radius": 20.0, "bsdf": translucent(material="marble")}
    lit = scene(ball, sensor=looking_at([0, 0, 0], [0, 0, 200], fov=10), light=light)
    exact = render(lit, "exact", spp=4, **settings)
    errors = [
        np.sqrt(np.mean((render(lit, "two_pass", spp=4, max_error=e, **settings) - exact) ** 2))
        for e in (2.0, 0.5, 0.1)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.002 * exact.mean()


def test_light_travels_through_a_body_and_not_through_two():
    """Half-lit: the dark side of a ball glows; when its halves are bodies of their own, the dark one stays dark."""
    light = {"type": "directional", "direction": [-1, 0, 0], "irradiance": 3.0}

    def halves(name):
        return [
            {
                "type": "cube",
                "to_world": T.translate([x, 0, 0]).scale([1, 4, 4]),
                "bsdf": translucent(material="wholemilk", body=name and "both", specular_reflectance=0.0),
            }
            for x in (-1.001, 1.001)
        ]

    sensor = looking_at([-1, 0, 0], [-60, 0, 0], fov=4, size=16)
    joined = render(scene(*halves("both"), light=light, sensor=sensor), "two_pass")
    apart = render(scene(*halves(""), light=light, sensor=sensor), "two_pass")
    assert joined[6:10, 6:10].mean() > 1e-3
    assert apart[6:10, 6:10].mean() < 1e-3 * joined[6:10, 6:10].mean()


def test_inverted_winding_changes_nothing():
    def ball(flip):
        shape = {"type": "sphere", "radius": 20.0, "flip_normals": flip, "bsdf": translucent(material="skin1")}
        return render(scene(shape, sensor=looking_at([0, 0, 0], [0, 0, 200], fov=8)), "two_pass", sample_count=4000)

    assert ball(True)[8:16, 8:16].mean() == pytest.approx(ball(False)[8:16, 8:16].mean(), rel=5e-3)


def test_scale_law():
    """A scene in centimetres with scale 10 looks like the same scene in millimetres."""

    def picture(unit):
        ball = {"type": "sphere", "radius": 20.0 / unit, "bsdf": translucent(material="marble", scale=unit)}
        sensor = looking_at([0, 0, 0], [0, 0, 200 / unit], fov=8)
        return render(scene(ball, sensor=sensor), "two_pass", sample_count=4000)

    middle = np.s_[8:16, 8:16]
    assert picture(10.0)[middle].mean(axis=(0, 1)) == pytest.approx(picture(1.0)[middle].mean(axis=(0, 1)), rel=5e-3)


def test_superposition():
    def picture(red, blue):
        light = {
            "type": "directional",
            "direction": [-1, 0, -1],
            "irradiance": {"type": "rgb", "value": [red, 0.0, blue]},
        }
        ball = {"type": "sphere", "radius": 10.0, "bsdf": translucent(material="marble")}
        return render(
            scene(ball, light=light, sensor=looking_at([0, 0, 0], [0, 0, 200], fov=5)), "two_pass", sample_count=3000
        )

    assert picture(1.0, 0.0) + picture(0.0, 2.0) == pytest.approx(picture(1.0, 2.0), rel=1e-3, abs=1e-5)


def test_the_same_seed_gives_the_same_picture():
    for method, settings in (("two_pass", {"sample_count": 3000, "irradiance_paths": 4}), ("sampled", {})):
        assert np.array_equal(furnace(method, **settings), furnace(method, **settings))


def test_exitance_is_the_same_bit_for_bit_from_every_camera():
    """Turntable without flicker: what a surface point sends out does not depend on who looks, nor on its neighbours."""
    ball = {"type": "sphere", "radius": 20.0, "bsdf": translucent(material="marble")}
    prepared = pellucid.prepare(scene(ball), sample_count=5000)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(3000, 3))
    points *= 20 / np.linalg.norm(points, axis=1, keepdims=True)
    whole = prepared.exitance(points)
    order = rng.permutation(3000)
    assert np.array_equal(prepared.exitance(points[order]), whole[order])
    assert np.array_equal(prepared.exitance(points[17:18]), whole[17:18])
    # a second preparation, as for another frame of an animation
    assert np.array_equal(pellucid.prepare(scene(ball), sample_count=5000).exitance(points), whole)


def test_translucent_bodies_light_each_other():
    """Two balls light each other with their exitance in the extra pass, in place of the diffuse stand-in."""
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": 3.0}
    shapes = [
        {"type": "sphere", "radius": 10.0, "center": [-10.5, 0, 0], "bsdf": translucent(material="cream")},
        {"type": "sphere", "radius": 10.0, "center": [10.5, 0, 0], "bsdf": translucent(material="cream")},
    ]
    lit = scene(*shapes, light=light)
    light_on = {
        passes: pellucid.prepare(lit, sample_count=4000, irradiance_paths=64, translucent_passes=passes)
        for passes in (0, 1)
    }
    bodies = {passes: p.integrator.prepared.bodies[0] for passes, p in light_on.items()}
    total = {passes: body.irradiance.total.astype(float).sum(axis=0) for passes, body in bodies.items()}
    direct = pellucid.prepare(lit, sample_count=4000, irradiance_depth=2).integrator.prepared.bodies[0].irradiance
    bounced = {passes: total[passes] - direct.total.astype(float).sum(axis=0) for passes in total}
    assert (bounced[0] > 0).all()
    # The stand-in has the same total reflectance: the light exchanged is alike, though not equal.
    assert bounced[1] == pytest.approx(bounced[0], rel=0.35)
    assert not np.allclose(bounced[1], bounced[0], rtol=1e-3)


def test_colours_bleed_to_the_opaque_rest_of_the_scene():
    floor = {
        "type": "rectangle",
        "to_world": T.translate([0, -10, 0]).rotate([1, 0, 0], -90).scale(100),
        "bsdf": {"type": "diffuse", "reflectance": 0.9},
    }
    ball = {"type": "sphere", "radius": 10.0, "bsdf": translucent(material="ketchup")}
    light = {"type": "directional", "direction": [0, -1, -0.2], "irradiance": 3.0}
    sensor = looking_at([0, -10, 12], [0, 60, 120], fov=2, size=8)
    coloured = render(scene(ball, floor, light=light, sensor=sensor), "two_pass", spp=256, max_depth=4)
    direct = render(scene(ball, floor, light=light, sensor=sensor), "two_pass", spp=256, max_depth=2)
    bleed = (coloured - direct).mean(axis=(0, 1))
    assert bleed[0] > 2 * bleed[2] > 0


def test_aovs():
    ball = {
        "type": "sphere",
        "radius": 20.0,
        "bsdf": translucent(material="marble", profile="dipole", single_scattering=True),
    }
    lit = scene(ball, sensor=looking_at([0, 0, 0], [0, 0, 200], fov=8))
    image = render(lit, "two_pass", spp=64, sample_count=4000, aovs="exitance,irradiance,single_scattering")
    assert image.shape[-1] == 12
    exitance, irradiance, single = (image[8:16, 8:16, k : k + 3].mean(axis=(0, 1)) for k in (3, 6, 9))
    medium = pellucid.Medium.from_preset("marble", profile="dipole")
    assert irradiance == pytest.approx(np.pi, rel=0.02)
    entering = np.pi * external_diffuse_transmittance(1.5)
    assert exitance == pytest.approx(entering * medium.total_diffuse_reflectance, rel=0.05)
    without = render(
        scene(
            {**ball, "bsdf": translucent(material="marble", profile="dipole")},
            sensor=looking_at([0, 0, 0], [0, 0, 200], fov=8),
        ),
        "two_pass",
        spp=64,
        sample_count=4000,
    )
    difference = image[8:16, 8:16, :3].mean(axis=(0, 1)) - without[8:16, 8:16].mean(axis=(0, 1))
    assert single == pytest.approx(difference, rel=0.15)


def test_a_reflectance_texture_is_met():
    """Under an even sky the exitance is the texture times what enters: not its square, not half of it."""
    dark, bright = 0.2, 0.8
    board = {
        "type": "checkerboard",
        "color0": {"type": "rgb", "value": [dark] * 3},
        "color1": {"type": "rgb", "value": [bright] * 3},
    }
    board["to_uv"] = mi.ScalarTransform3f().scale([1.0, 1.0])
    slab = {
        "type": "rectangle",
        "to_world": T.scale(40.0),
        "bsdf": translucent(reflectance=board, dmfp=1.0, eta=1.0, alpha=0.0),
    }
    floor = {
        "type": "rectangle",
        "to_world": T.translate([0, 0, -0.1]).scale(4000.0),
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
    }
    lit = scene(slab, floor, sensor=looking_at([0, 0, 0], [0, 0, 400], fov=11, size=32))
    for method, settings in (("two_pass", {"sample_count": 40000}), ("sampled", {})):
        image = render(lit, method, spp=16 if method == "two_pass" else 1024, max_depth=2, **settings)[..., 0]
        corners = sorted(
            [image[6:10, 6:10].mean(), image[6:10, 22:26].mean(), image[22:26, 6:10].mean(), image[22:26, 22:26].mean()]
        )
        assert corners[:2] == pytest.approx([dark, dark], rel=0.05)
        assert corners[2:] == pytest.approx([bright, bright], rel=0.05)


def test_instances_are_bodies_of_their_own():
    group = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 5.0, "bsdf": translucent(material="cream")}}

    def at(x, s):
        return {
            "type": "instance",
            "group": {"type": "ref", "id": "group"},
            "to_world": T.translate([x, 0, 0]).scale(s),
        }

    lit = mi.load_dict(
        {
            "type": "scene",
            "group": group,
            "a": at(-20, 1.0),
            "b": at(20, [1.0, 2.0, 1.0]),
            "light": {"type": "constant"},
            "sensor": looking_at([0, 0, 0], [0, 0, 300], fov=14, size=48),
        },
        optimize=False,
    )
    prepared = pellucid.prepare(lit, sample_count=3000)
    assert prepared.bodies == ["a.ball", "b.ball"]
    x = [body.samples.p[:, 0].mean() for body in prepared.integrator.prepared.bodies]
    assert x == pytest.approx([-20, 20], abs=0.2)
    image = render(lit, "two_pass", sample_count=3000)
    ball = render(
        scene(
            {"type": "sphere", "radius": 5.0, "center": [-20, 0, 0], "bsdf": translucent(material="cream")},
            sensor=looking_at([0, 0, 0], [0, 0, 300], fov=14, size=48),
        ),
        "two_pass",
        sample_count=3000,
    )
    left = np.s_[22:26, 10:14]
    assert image[left].mean() == pytest.approx(ball[left].mean(), rel=0.02)


def test_a_mirror_shows_what_the_eye_sees():
    """A ball beside the camera, seen in a mirror, looks like the ball seen from behind the mirror."""
    light = {"type": "directional", "direction": [-1, -1, 0], "irradiance": 3.0}
    bsdf = translucent(material="marble", profile="dipole", specular_reflectance=0.0)
    ball = {"type": "sphere", "radius": 10.0, "bsdf": bsdf}
    mirror = {
        "type": "rectangle",
        "to_world": T.translate([0, 0, 100]).rotate([0, 1, 0], 180).scale(50),
        "bsdf": {"type": "conductor", "material": "none"},
    }
    settings = {"spp": 64, "sample_count": 20000, "irradiance_paths": 4}
    behind = looking_at([0, 0, 0], [0, 0, 150], fov=8)
    direct = render(scene(ball, light=light, sensor=behind), "two_pass", **settings)
    before = looking_at([0, 0, 100], [0, 0, 50], fov=8)
    reflected = render(scene(ball, mirror, light=light, sensor=before), "two_pass", **settings)[:, ::-1]
    row, column = np.mgrid[-11.5:12, -11.5:12]
    lit = (direct.mean(axis=-1) > 0.3 * direct.max()) & (row**2 + column**2 < 9**2)  # without the silhouette
    assert reflected[lit] == pytest.approx(direct[lit], rel=0.06)
    assert reflected[lit].mean() == pytest.approx(direct[lit].mean(), rel=0.01)


@pytest.mark.parametrize("kind", ["multijitter", "stratified", "orthogonal", "ldsampler"])
def test_samplers_that_round_their_count_survive_several_passes(kind, monkeypatch):
    sensor = looking_at([0, 0, 0], [0, 0, 200], fov=8, size=16)
    sensor["sampler"] = {"type": kind, "sample_count": 14}
    ball = {"type": "sphere", "radius": 10.0, "bsdf": translucent(material="marble")}
    lit = scene(ball, sensor=sensor)
    whole = render(lit, "two_pass", spp=14, sample_count=2000)
    monkeypatch.setattr("pellucid.methods.film.PATHS_A_PASS", 16 * 16 * 7)
    parts = render(lit, "two_pass", spp=14, sample_count=2000)
    assert parts.mean() == pytest.approx(whole.mean(), rel=0.02)
