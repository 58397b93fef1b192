"""Media that are found from pictures of them."""

import json

import mitsuba as mi
import numpy as np
import pytest

import pellucid
from pellucid.errors import PellucidError
from pellucid.fitting.photos import read_photo

TRUE = {"sigma_a": [0.05, 0.1, 0.2], "sigma_s_prime": [3.0, 4.0, 5.0]}
START = {"sigma_a": [0.1, 0.1, 0.1], "sigma_s_prime": [4.0, 4.0, 4.0]}
SIZE = (60, 45)


def build(**medium):
    bsdf = {"type": "pellucid_translucent", "eta": 1.4, "alpha": 0.3}
    bsdf |= {name: {"type": "rgb", "value": value} for name, value in medium.items()}

    def camera(x, y):
        return {
            "type": "perspective",
            "fov": 35,
            "to_world": mi.ScalarTransform4f().look_at([x, y, 3], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}},
        }

    return mi.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": bsdf},
            "lamp": {"type": "point", "position": [3, 0, 3], "intensity": {"type": "rgb", "value": [30.0, 30.0, 30.0]}},
            "front": camera(3, 0),
            "side": camera(0, 3),
        },
        optimize=False,
    )


def photos():
    """Pictures from other samples, with other random numbers."""
    scene = build(**TRUE)
    integrator = mi.load_dict({"type": "pellucid_two_pass", "seed": 9, "sample_count": 6000, "irradiance_paths": 128})
    integrator.prepared = integrator.prepare_scene(scene)
    return [mi.render(scene, sensor=k, integrator=integrator, spp=16, seed=50 + k).numpy() for k in range(2)]


def test_coefficients_are_found_within_two_percent(tmp_path):
    found = pellucid.fit(build(**START), photos(), sample_count=4000, irradiance_paths=128, spp=16)
    ratio = {name: getattr(found.medium, name) / true for name, true in TRUE.items()}
    print(ratio, found.standard_deviation, found.condition_number, found.residual, found.evaluations)
    for name, true in TRUE.items():
        value = getattr(found.medium, name)
        np.testing.assert_allclose(value, true, rtol=0.02)
    found.write(tmp_path / "ball.json")
    bsdf = mi.load_dict({"type": "pellucid_translucent", "material": str(tmp_path / "ball.json")})
    assert bsdf.medium == found.medium
    assert json.loads((tmp_path / "ball.json").read_text())["fit"]["condition_number"] == found.condition_number


def test_a_curved_photo_is_refused_unless_it_is_to_be_linearised(tmp_path):
    grey = mi.Bitmap(np.full((SIZE[1], SIZE[0], 3), 188, np.uint8))
    grey.write(str(tmp_path / "grey.png"))
    with pytest.raises(PellucidError, match=r"8 bits.*linearise"):
        pellucid.fit(build(**START), [tmp_path / "grey.png"])
    from pellucid.fitting.photos import read_photo

    np.testing.assert_allclose(read_photo(tmp_path / "grey.png", True), 0.5, atol=0.01)


@pytest.mark.parametrize(
    "given, said",
    [
        ({"photos": [np.ones((3, 4, 3))]}, "Photo 0 has 4x3 pixels and its camera 60x45"),
        ({"photos": [np.ones((45, 60, 3))] * 3}, "There are 3 photos and 2 cameras"),
        ({"photos": [np.ones((45, 60, 3))], "masks": [np.zeros((45, 60))]}, "No pixel of the photos is left"),
        (
            {"photos": [np.ones((45, 60, 3))], "exposure": "auto"},
            "exposure is one of known, free, shared; found 'auto'",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(given, said):
    with pytest.raises(PellucidError, match=said):
        pellucid.fit(build(**START), **given)


def test_a_file_that_is_no_material_is_refused(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(RuntimeError, match="no material file of pellucid fit"):
        mi.load_dict({"type": "pellucid_translucent", "material": str(tmp_path / "x.json")})


def test_a_photo_may_have_layers(tmp_path):
    """As pictures of the command line do: the picture itself comes first."""
    channels = np.random.default_rng(0).random((4, 5, 6), np.float32)
    names = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B"]
    mi.Bitmap(channels, channel_names=names).write(str(tmp_path / "photo.exr"))
    assert np.array_equal(read_photo(tmp_path / "photo.exr", False), channels[:, :, :3])
