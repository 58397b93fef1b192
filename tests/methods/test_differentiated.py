"""Gradients of pictures against finite differences of the whole pipeline, samples and random numbers kept."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pellucid.methods import differentiated, differentiated_light
from pellucid.methods.texture_space import discs, drawing
from pellucid.methods.texture_space import integrator as texture_space

SETTINGS = {"sample_count": 400, "irradiance_paths": 1100, "sampling": "uniform"}
MEDIUM = {"sigma_a": [0.1, 0.2, 0.4], "sigma_s_prime": [4.0, 5.0, 6.0]}
BALL, SLAB = {"type": "sphere"}, {"type": "cube", "to_world": mi.ScalarTransform4f().scale([1, 1, 0.1])}
COLOUR = {"reflectance": [0.6, 0.5, 0.4], "dmfp": [1.0, 0.9, 0.8]}


def colour(value):
    return {"type": "rgb", "value": value} if isinstance(value, list) else value


def build(method="two_pass", other=None, shape=BALL, settings=SETTINGS, **medium):
    """A ball, or another shape, over a coloured floor under a lamp, and a second one if it is given."""
    bsdf = {"type": "pellucid_translucent", "alpha": 0.3} | {k: colour(v) for k, v in medium.items()}
    shapes = {"ball": shape | {"bsdf": bsdf}}
    if other:
        shapes["other"] = {
            "type": "sphere",
            "center": [1.5, 0, 0],
            "radius": 0.4,
            "bsdf": {"type": "pellucid_translucent", **other},
        }
    return mi.load_dict(
        {
            "type": "scene",
            **shapes,
            "floor": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -1]).scale(3),
                "bsdf": {"type": "diffuse", "reflectance": colour([0.7, 0.5, 0.3])},
            },
            "sky": {"type": "constant", "radiance": colour([0.5, 0.6, 0.7])},
            "lamp": {"type": "point", "position": [2, 0, 4], "intensity": colour([20.0, 20.0, 20.0])},
            "integrator": {"type": f"pellucid_{method}", **settings},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([4, 0, 2], [0, 0, -0.2], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 128, "height": 96, "rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": 1},
            },
        },
        optimize=False,
    )


def weights(shape):
    return np.random.default_rng(5).random(shape).astype(np.float32) - 0.2


def picture(scene):
    return mi.render(scene, seed=7).numpy().astype(float)


def by_differences(make, key, step=0.05, where=1.0):
    """How the weighed picture changes when all numbers of a parameter, or those somewhere, grow alike, relative to them."""
    values = []
    for h in (step, -step):
        scene = make()
        params = mi.traverse(scene)
        params[key] *= type(params[key])(1 + h * where)
        params.update()
        image = picture(scene)
        values.append((image * weights(image.shape)).sum())
        del scene, params  # before the next: kernels are compiled for all scenes that are alive
    return (values[0] - values[1]) / (2 * step)


def backward(scene, keys, where=1.0):
    """The same by reverse mode, for several parameters at once."""
    params = mi.traverse(scene)
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    image = mi.render(scene, params, seed=3, seed_grad=7)
    dr.backward(dr.sum(image * mi.TensorXf(weights(image.shape)), axis=None))
    return {key: (dr.grad(params[key]).numpy().astype(float) * params[key].numpy() * where).sum() for key in keys}


def forward(scene, key, where=1.0):
    """The same by forward mode."""
    params = mi.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    dr.set_grad(params[key], dr.detach(params[key]) * where)
    image = scene.integrator().render_forward(scene, params, seed=7).numpy().astype(float)
    return (image * weights(image.shape)).sum()


OF_MEDIUM = ["ball.bsdf.sigma_a", "ball.bsdf.sigma_s_prime", "ball.bsdf.eta", "other.bsdf.sigma_a"]
OF_SCENE = ["floor.bsdf.reflectance.value", "sky.radiance.value", "lamp.intensity.value"]
OTHER = {"reflectance": colour([0.5, 0.6, 0.7]), "dmfp": 0.5}


def two_bodies():
    return build(other=OTHER, **MEDIUM)


TEXTURE = "ball.bsdf.reflectance.data"
TEXELS = np.random.default_rng(1).uniform(0.2, 0.8, (4, 4, 3)).astype(np.float32)
SEEN = np.broadcast_to(np.float32([1, 0, 0, 1]).reshape(1, 4, 1), TEXELS.shape)
"""The texels that face the camera: power goes by the texture over its mean, and does not change where all texels grow alike."""


def textured(make=build):
    return make(reflectance={"type": "bitmap", "data": mi.TensorXf(TEXELS), "raw": True}, dmfp=0.9)


@pytest.fixture(scope="module")
def gradients():
    return backward(two_bodies(), OF_MEDIUM + OF_SCENE)


@pytest.mark.parametrize("key", OF_MEDIUM + OF_SCENE)
def test_gradients_agree_with_differences_of_the_whole_pipeline(gradients, key):
    """The light that the bodies send to each other and to themselves included."""
    step = (
        0.1 if key.endswith("sigma_s_prime") else 0.05
    )  # which samples of a pixel share an exitance jumps with the free path
    assert gradients[key] == pytest.approx(by_differences(two_bodies, key, step), rel=0.01)


@pytest.mark.parametrize("key", ["ball.bsdf.reflectance", "ball.bsdf.dmfp"])
def test_a_medium_of_reflectance_and_free_path(key):
    assert forward(build(**COLOUR), key) == pytest.approx(by_differences(lambda: build(**COLOUR), key), rel=0.01)


def test_a_texture_of_the_reflectance():
    found = backward(textured(), [TEXTURE], SEEN)[TEXTURE]
    assert found == pytest.approx(by_differences(textured, TEXTURE, where=SEEN), rel=0.01)
    assert forward(textured(), TEXTURE, SEEN) == pytest.approx(found, rel=1e-3)


def slab():
    """As thick as a mean free path of blue, with edges: where the surface curves and thin parts return less matters."""
    settings = {"sample_count": 1500, "irradiance_paths": 64, "sampling": "uniform"}
    return build(shape=SLAB, settings=settings, profile="curved", **MEDIUM)


def test_a_curved_profile():
    keys = ["ball.bsdf.sigma_a", "ball.bsdf.sigma_s_prime", "lamp.intensity.value"]
    found = backward(slab(), keys)
    for key in keys:
        assert found[key] == pytest.approx(by_differences(slab, key), rel=0.01), key


def test_the_index_of_a_curved_profile():
    """The bound of mu does not depend on it, and has no gradient here."""
    found = forward(slab(), "ball.bsdf.eta")
    assert found == pytest.approx(by_differences(slab, "ball.bsdf.eta"), rel=0.01)


@pytest.fixture
def drawn(monkeypatch):
    """Let texture_space keep the samples that it draws first, and the sizes of their discs, which are steps from the mean free path on."""
    drawn, mfp, tabulate = {}, [], drawing.SampleSum.of

    def draw(texels, bright, count, *rest):
        return drawn.setdefault(count, drawing.draw_samples(texels, bright, count, *rest))

    def of(medium, extent):
        mfp.append(medium.mfp.min())
        monkeypatch.setattr(discs, "SMALLEST_DISC", 0.06 * mfp[0] / medium.mfp.min())
        return tabulate(medium, extent)

    monkeypatch.setattr(texture_space, "draw_samples", draw)
    monkeypatch.setattr(drawing.SampleSum, "of", of)


def in_texture_space(**medium):
    settings = {"resolution": 32, "sample_count": 400, "irradiance_paths": 512}
    return build("texture_space", settings=settings, **(medium or MEDIUM))


def test_samples_that_are_drawn_from_a_texture(drawn):
    """Also by lights and surfaces that change where light is, and with it how likely samples are: that is kept."""
    keys = ["ball.bsdf.sigma_a", "ball.bsdf.sigma_s_prime", "floor.bsdf.reflectance.value", "lamp.intensity.value"]
    found = backward(in_texture_space(), keys)
    for key in keys:
        assert found[key] == pytest.approx(by_differences(in_texture_space, key), rel=0.01), key
    assert forward(in_texture_space(), keys[1]) == pytest.approx(found[keys[1]], rel=1e-3)


def test_a_texture_of_the_reflectance_in_texture_space(drawn):
    found = backward(textured(in_texture_space), [TEXTURE], SEEN)[TEXTURE]
    assert found == pytest.approx(by_differences(lambda: textured(in_texture_space), TEXTURE, where=SEEN), rel=0.01)


def test_both_directions_agree(gradients):
    key = "ball.bsdf.sigma_s_prime"
    assert forward(two_bodies(), key) == pytest.approx(gradients[key], rel=1e-3)


def test_forward_from_what_parameters_are_computed_from(gradients):
    """A medium and a lamp at once; nothing is prepared anew after it."""
    scene, keys = two_bodies(), ["ball.bsdf.sigma_a", "lamp.intensity.value"]
    params, log = mi.traverse(scene), mi.Float(0)
    dr.enable_grad(log)
    for key in keys:
        params[key] *= dr.exp(log)
    params.update()
    integrator = scene.integrator()
    integrator.prepared = state = integrator.prepare_scene(scene)
    image = mi.render(scene, params, seed=3, seed_grad=7)
    dr.forward(log)
    change = dr.grad(image).numpy().astype(float)
    assert (change * weights(change.shape)).sum() == pytest.approx(sum(gradients[key] for key in keys), rel=1e-3)
    assert integrator.state_of(scene, scene.sensors()[0]) is state


def test_an_optimisation_finds_the_medium_of_a_picture():
    target = mi.TensorXf(picture(build(**MEDIUM)).astype(np.float32))
    start = build(**(MEDIUM | {"sigma_a": [0.2, 0.2, 0.2]}))
    params, key = mi.traverse(start), "ball.bsdf.sigma_a"
    optimiser = mi.ad.Adam(lr=0.25)
    optimiser["log"] = dr.log(mi.Color3f(params[key]))
    losses = []
    for _ in range(4):
        params[key] = dr.exp(optimiser["log"])
        params.update()
        loss = dr.mean(dr.square(mi.render(start, params, seed=7) - target), axis=None)
        dr.backward(loss)
        optimiser.step()
        losses.append(loss.numpy().item())
    assert losses[-1] < 0.5 * losses[0], losses
    found = np.exp(np.ravel(optimiser["log"].numpy()))
    assert (np.abs(np.log(found / MEDIUM["sigma_a"]))[[0, 2]] < 0.5).all(), found


def test_memory_does_not_grow_with_samples_a_pixel(monkeypatch):
    """Paths of a picture are differentiated so many at a time, and so are those of the light on samples."""
    monkeypatch.setattr(differentiated, "PATHS_AT_ONCE", 128 * 96)
    monkeypatch.setattr(differentiated_light, "PATHS_AT_ONCE", 1 << 13)
    scene = build(**MEDIUM)
    params = mi.traverse(scene)
    dr.enable_grad(params["ball.bsdf.sigma_a"])
    params.update()
    integrator = scene.integrator()
    gradient = dr.ones(mi.TensorXf, (96, 128, 3))
    integrator.prepared = integrator.prepare_scene(scene)
    lanes = []
    for spp in (1, 2):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            integrator.render_backward(scene, params, gradient, seed=7, spp=spp)
            lanes.append(max(kernel["size"] for kernel in dr.kernel_history([dr.KernelType.JIT])))
    assert lanes[0] == lanes[1] <= 3 * 128 * 96  # three channels
