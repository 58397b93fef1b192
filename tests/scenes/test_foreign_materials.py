"""Materials of other formats: principled ones in scenes, files of MaterialX, the media of glTF."""

import json
import sys
import warnings

import mitsuba as mi
import numpy as np
import pytest
import trimesh

import pellucid
from pellucid.errors import EnvironmentProblem, MediumError, PellucidWarning, SceneError
from pellucid.methods.preparation import open_scene
from pellucid.model import Medium
from pellucid.model.conventions import colour_to_albedo, medium_of_colour, principled_dmfp
from pellucid.model.photon_simulation import simulate
from pellucid.scenes.loading import load_scene
from worlds.balls import rgb

MARBLE = """
<materialx version="1.39" colorspace="lin_rec709">
  <surfacematerial name="Marble" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface" />
  </surfacematerial>
  <open_pbr_surface name="surface" type="surfaceshader">
    <input name="specular_roughness" type="float" value="0.2" />
    <input name="subsurface_weight" type="float" value="1.0" />
    <input name="subsurface_color" type="color3" value="0.830, 0.791, 0.753" />
    <input name="subsurface_radius_scale" type="color3" value="0.851, 0.557, 0.395" />
  </open_pbr_surface>
</materialx>
"""
COLOUR, RADII = (0.830, 0.791, 0.753), np.array([0.851, 0.557, 0.395])


def body_of(scene):
    with warnings.catch_warnings(action="ignore"):
        (lit,) = open_scene(scene).bodies
    return lit.body


def ball(**bsdf):
    return {"type": "scene", "ball": {"type": "sphere", "radius": 20.0, "bsdf": bsdf}, "sky": {"type": "constant"}}


def assert_same(medium, other):
    """Files have numbers of single precision."""
    for name in ("sigma_s_prime", "sigma_a", "eta", "g"):
        assert getattr(medium, name) == pytest.approx(getattr(other, name), rel=1e-4)


@pytest.fixture
def material(tmp_path):
    def write(text=MARBLE, name="marble.mtlx"):
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    return write


# ------------------------------------------------------------------ MaterialX


def test_a_file_gives_the_medium_of_its_formula(material):
    bsdf = body_of(load_scene(ball(type="pellucid_translucent", material=material()))).bsdf
    assert_same(bsdf.medium, medium_of_colour(COLOUR, RADII, 1.5))
    assert bsdf.alpha == pytest.approx(0.04) and bsdf.specular == 1


def test_lengths_are_in_scene_units_or_as_stated(material):
    file = material()
    metres = body_of(load_scene(ball(type="pellucid_translucent", material=file, scale=1000.0)))
    assert metres.medium.sigma_t == pytest.approx(1 / RADII)  # of a scene unit
    centimetres = body_of(load_scene(ball(type="pellucid_translucent", material=file, unit=10.0)))
    assert centimetres.medium.sigma_t == pytest.approx(0.1 / RADII)
    value = '<input name="subsurface_radius" type="float" value="1" unittype="distance" unit="centimeter" />'
    file = material(MARBLE.replace('<input name="subsurface_color"', f'{value}<input name="subsurface_color"'))
    named = body_of(load_scene(ball(type="pellucid_translucent", material=file, unit=77.0)))
    assert named.medium.sigma_t == pytest.approx(0.1 / RADII)


def test_a_radius_can_be_the_diffuse_one(material):
    """The examples of OpenPBR have the numbers of JMLH01 in centimetres."""
    body = body_of(load_scene(ball(type="pellucid_translucent", material=material(), unit=10.0, radius="dmfp")))
    assert body.medium.dmfp == pytest.approx(Medium.from_preset("marble").dmfp, rel=2e-3)


def test_colours_are_converted_to_the_primaries_of_rec_709(material):
    file = material(MARBLE.replace("lin_rec709", "acescg").replace("0.830, 0.791, 0.753", "0.5, 0.5, 0.5"))
    medium = body_of(load_scene(ball(type="pellucid_translucent", material=file))).medium
    assert medium.albedo == pytest.approx(colour_to_albedo(0.5), abs=1e-5)  # grey stays grey
    assert 1 / medium.sigma_t == pytest.approx([1.0717, 0.5205, 0.3632], abs=1e-3)
    file = material(MARBLE.replace("lin_rec709", "acescg").replace("0.830, 0.791, 0.753", "0.5, 0.01, 0.01"))
    medium = body_of(load_scene(ball(type="pellucid_translucent", material=file))).medium
    assert medium.albedo[1] == pytest.approx(0, abs=1e-5)  # red beyond what Rec. 709 can show
    file = material(MARBLE.replace("lin_rec709", "srgb_texture").replace("0.830, 0.791, 0.753", "0.5, 0.5, 0.5"))
    medium = body_of(load_scene(ball(type="pellucid_translucent", material=file))).medium
    assert medium.albedo == pytest.approx(colour_to_albedo(0.21404), abs=1e-4)


def test_the_standard_surface_is_the_same_by_other_names(material):
    text = MARBLE.replace("open_pbr_surface", "standard_surface").replace("subsurface_weight", "subsurface")
    text = text.replace("subsurface_radius_scale", "subsurface_radius")
    body = body_of(load_scene(ball(type="pellucid_translucent", material=material(text))))
    assert_same(body.medium, medium_of_colour(COLOUR, RADII, 1.5))


def test_one_of_several_materials_is_chosen_by_name(material):
    second = MARBLE.replace("Marble", "Jade").replace('"surface"', '"second"').replace("0.830", "0.230")
    text = MARBLE.replace("</materialx>", second.split(">", 1)[1])
    with pytest.raises(SceneError, match="has the materials Marble, Jade: write"):
        load_scene(ball(type="pellucid_translucent", material=material(text)))
    body = body_of(load_scene(ball(type="pellucid_translucent", material=material(text) + ":Jade")))
    assert body.medium.albedo[0] == pytest.approx(colour_to_albedo(0.230))


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('weight" type="float" value="1.0"', 'weight" type="float" value="0.0"', "nothing of it is translucent"),
        ("0.830, ", "1.830, ", "colour = 1.83 in the red channel"),
        ("0.851, ", "0.0, ", "radius = 0 in the red channel"),
        ("lin_rec709", "lin_mars", "the colour space 'lin_mars' of subsurface_"),
        ('value="0.830, 0.791, 0.753"', 'nodename="noise"', "comes from another node"),
        ("open_pbr_surface name", "gltf_pbr name", "no material of a surface that is understood"),
        ("</materialx>", "", "cannot be read as MaterialX"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(material, old, new, message):
    text = MARBLE.replace(old, new).replace(
        "</open_pbr_surface>", "</gltf_pbr>" if "gltf" in new else "</open_pbr_surface>"
    )
    if "noise" in new:
        text = text.replace("<open_pbr_surface name", '<constant name="noise" type="color3" /><open_pbr_surface name')
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(ball(type="pellucid_translucent", material=material(text)))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_and_options_without_one(material):
    with pytest.raises(SceneError, match=r"There is no material file .none\.mtlx."):
        load_scene(ball(type="pellucid_translucent", material="none.mtlx"))
    with pytest.raises(SceneError, match="unit belongs to a material file"):
        load_scene(ball(type="pellucid_translucent", material="marble", unit=10.0))
    with pytest.raises(SceneError, match="radius = 'big'"):
        load_scene(ball(type="pellucid_translucent", material=material(), radius="big"))


def test_without_the_library_it_says_what_to_install(material, monkeypatch):
    monkeypatch.setitem(sys.modules, "MaterialX", None)
    with pytest.raises(EnvironmentProblem, match=r"'.\[materialx\]'"):
        load_scene(ball(type="pellucid_translucent", material=material()))


def test_what_is_not_shown_is_told(material):
    text = MARBLE.replace('value="1.0" />', 'value="0.5" /><input name="coat_weight" type="float" value="0.3" />')
    with pytest.warns(PellucidWarning) as told:
        load_scene(ball(type="pellucid_translucent", material=material(text)))
    said = " ".join(str(w.message) for w in told)
    assert "subsurface_weight 0.5 is taken for 1" in said and "coat_weight 0.3" in said


def test_scene_files_find_a_material_beside_them(material, tmp_path):
    material()
    text = '<bsdf type="pellucid_translucent"><string name="material" value="marble.mtlx"/><float name="alpha" value="0.3"/></bsdf>'
    scene = f'<scene version="3.5.0"><shape type="sphere">{text}</shape><emitter type="constant"/></scene>'
    (tmp_path / "scene.xml").write_text(scene)
    bsdf = body_of(load_scene(tmp_path / "scene.xml")).bsdf
    assert_same(bsdf.medium, medium_of_colour(COLOUR, RADII, 1.5))
    assert bsdf.alpha == pytest.approx(0.3)  # what is given beside the file is meant


# ------------------------------------------------------------------ principled

PRINCIPLED = {
    "type": "principled",
    "base_color": rgb(0.8, 0.5, 0.3),
    "roughness": 0.4,
    "eta": 1.4,
    "subsurface_weight": 1.0,
}


def test_a_principled_material_returns_its_colour():
    radius = {"subsurface_radius": rgb(1.0, 0.2, 0.1), "subsurface_scale": 30.0}
    bsdf = body_of(load_scene(ball(**PRINCIPLED, **radius))).bsdf
    assert bsdf.medium.total_diffuse_reflectance == pytest.approx((0.8, 0.5, 0.3), rel=1e-5)
    assert bsdf.medium.dmfp == pytest.approx(principled_dmfp([0.8, 0.5, 0.3], [30, 6, 3]), rel=1e-5)
    assert (bsdf.medium.eta, bsdf.alpha) == (1.4, pytest.approx(0.16))


def test_a_principled_material_of_skin_has_its_radius_as_diffuse_free_path():
    bsdf = body_of(load_scene(ball(**PRINCIPLED, subsurface_method="random_walk_skin", scale=10.0))).bsdf
    assert bsdf.medium.dmfp == pytest.approx([0.05, 0.01, 0.005])  # scene units: Blender's own scale and radius


def test_the_radius_of_a_principled_material_can_be_a_texture():
    texels = mi.Bitmap(np.full((2, 2, 3), [1.0, 0.2, 0.1], np.float32))
    radius = {"subsurface_radius": {"type": "bitmap", "bitmap": texels, "raw": True}, "subsurface_scale": 3.0}
    bsdf = body_of(load_scene(ball(**PRINCIPLED, **radius, scale=10.0))).bsdf
    assert bsdf.medium.dmfp * 10 == pytest.approx(principled_dmfp([0.8, 0.5, 0.3], [30, 6, 3]), rel=1e-5)


def test_scene_files_have_principled_materials_too(tmp_path):
    inside = '<float name="subsurface_weight" value="1"/><rgb name="subsurface_radius" value="9, 8, 7"/>'
    inside += '<string name="subsurface_method" value="random_walk_skin"/><float name="subsurface_scale" value="1"/>'
    texture = '<texture type="checkerboard" name="base_color"/>'
    text = '<scene version="3.5.0"><bsdf type="twosided" id="skin"><bsdf type="principled">{}</bsdf></bsdf>{}</scene>'
    shape = '<shape type="sphere"><ref id="skin"/></shape><emitter type="constant"/>'
    (tmp_path / "scene.xml").write_text(text.format(texture + inside, shape))
    bsdf = body_of(load_scene(tmp_path / "scene.xml")).bsdf
    assert bsdf.texture is not None and bsdf.medium.dmfp == pytest.approx([9, 8, 7])


def test_a_principled_material_without_subsurface_stays_one(tmp_path):
    for own in ({"flatness": 0.5}, {"subsurface_weight": 0.0, "subsurface_radius": rgb(1, 2, 3)}):
        scene = load_scene(ball(type="principled", base_color=rgb(0.5, 0.4, 0.3), **own))
        assert "Principled" in scene.shapes()[0].bsdf().class_name()
    inside = '<float name="subsurface_scale" value="1"/><float name="subsurface_weight" value="0"/>'
    text = f'<scene version="3.5.0"><shape type="sphere"><bsdf type="principled">{inside}</bsdf></shape></scene>'
    (tmp_path / "scene.xml").write_text(text)
    assert "Principled" in load_scene(tmp_path / "scene.xml").shapes()[0].bsdf().class_name()


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"sheeen": 1.0}, "there is no parameter 'sheeen'"),
        ({"subsurface_scale": 0.0}, "must be positive"),
        ({"subsurface_scale": {"type": "checkerboard"}}, "must be numbers, not a texture"),
        ({"subsurface_method": "walk"}, "one of random_walk"),
    ],
)
def test_principled_materials_that_cannot_be(wrong, message):
    with pytest.raises((SceneError, MediumError), match=message):
        load_scene(ball(**PRINCIPLED | wrong))


def test_what_of_a_principled_material_is_not_shown_is_told():
    with pytest.warns(PellucidWarning, match="metallic, sheen, subsurface_weight 0.5, which is taken for 1"):
        load_scene(ball(**PRINCIPLED | {"metallic": 0.2, "sheen": 1.0, "subsurface_weight": 0.5}))


# ------------------------------------------------------------------ glTF

VOLUME = {"attenuationColor": [0.95, 0.85, 0.75], "attenuationDistance": 0.01, "thicknessFactor": 1.0}
SIGMA_T = -np.log(VOLUME["attenuationColor"]) / 10.0  # per millimetre


def gltf(path, extensions, **material):
    """A ball of 40 mm, as glTF has it: in metres."""
    files = trimesh.Scene(trimesh.creation.icosphere(subdivisions=2, radius=0.02)).export(file_type="gltf")
    for name, part in files.items():
        (path.parent / name).write_bytes(part)
    content = json.loads((path.parent / "model.gltf").read_text())
    content["materials"] = [{"name": "wax", "extensions": extensions, **material}]
    content["meshes"][0]["primitives"][0]["material"] = 0
    content["meshes"][0]["primitives"][0]["attributes"].pop("COLOR_0", None)
    path.write_text(json.dumps(content))
    return path


def scattering(**scatter):
    defaults = {"scatterStrengthFactor": 1.0, "multiscatterColorFactor": [0.8, 0.6, 0.5], "scatterAnisotropy": 0.2}
    return {
        "KHR_materials_scatter": defaults | scatter,
        "KHR_materials_transmission": {"transmissionFactor": 1.0},
        "KHR_materials_volume": VOLUME,
    }


def test_a_gltf_medium_is_that_of_its_formula(tmp_path):
    path = gltf(tmp_path / "wax.gltf", scattering(), pbrMetallicRoughness={"roughnessFactor": 0.5})
    bsdf = body_of(load_scene(path)).bsdf
    assert bsdf.medium.sigma_t == pytest.approx(SIGMA_T)
    assert bsdf.medium.albedo == pytest.approx(colour_to_albedo([0.8, 0.6, 0.5], 0.2))
    assert (bsdf.medium.g, bsdf.medium.eta, bsdf.alpha) == (0.2, 1.5, 0.25)


def test_a_mesh_that_is_scaled_keeps_its_look(tmp_path):
    path = gltf(tmp_path / "wax.gltf", scattering())
    assert body_of(load_scene(path, size=80.0)).medium.sigma_t == pytest.approx(SIGMA_T / 2, rel=1e-3)


def test_the_older_draft_leaves_g_out_of_the_albedo(tmp_path):
    extensions = {
        "KHR_materials_volume_scatter": {"multiscatterColor": [0.572, 0.227, 0.075], "scatterAnisotropy": 0.3},
        "KHR_materials_volume": VOLUME,
        "KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 1.0},
        "KHR_materials_ior": {"ior": 1.4},
    }
    medium = body_of(load_scene(gltf(tmp_path / "wax.gltf", extensions))).medium
    assert medium.sigma_t == pytest.approx(SIGMA_T) and (medium.g, medium.eta) == (0.3, 1.4)
    assert medium.albedo == pytest.approx(colour_to_albedo([0.572, 0.227, 0.075]))


def test_the_strength_dims_the_scatter_colour(tmp_path):
    path = gltf(tmp_path / "wax.gltf", scattering(scatterStrengthFactor=0.5, scatterAnisotropy=0.0))
    assert body_of(load_scene(path)).medium.albedo == pytest.approx(colour_to_albedo([0.4, 0.3, 0.25]))


def test_the_base_colour_tints_what_enters_and_what_leaves(tmp_path):
    base = {"baseColorFactor": [0.9, 0.5, 1.0, 1.0]}
    plain = body_of(load_scene(gltf(tmp_path / "white.gltf", scattering()))).medium
    tinted = body_of(load_scene(gltf(tmp_path / "wax.gltf", scattering(), pbrMetallicRoughness=base))).medium
    ratio = tinted.total_diffuse_reflectance / plain.total_diffuse_reflectance
    assert ratio == pytest.approx([0.81, 0.25, 1.0], rel=1e-4) and tinted.dmfp == pytest.approx(plain.dmfp, rel=1e-4)


@pytest.mark.parametrize("lacking", ["KHR_materials_volume", "KHR_materials_transmission", "KHR_materials_scatter"])
def test_without_its_companions_the_extension_has_no_effect(tmp_path, lacking):
    extensions = scattering()
    del extensions[lacking]
    assert body_of(load_scene(gltf(tmp_path / "wax.gltf", extensions))).medium == Medium.from_preset("marble")


def test_another_material_takes_the_place_of_that_of_the_file(tmp_path):
    path = gltf(tmp_path / "wax.gltf", scattering())
    with pytest.warns(PellucidWarning, match="material 'wax': the medium that the file describes is not shown"):
        scene = load_scene(path, bsdf={"type": "pellucid_translucent", "material": "skin1"})
    assert body_of(scene).medium == Medium.from_preset("skin1")


def test_a_channel_that_is_not_attenuated_is_refused(tmp_path):
    extensions = scattering() | {"KHR_materials_volume": VOLUME | {"attenuationColor": [1.0, 0.5, 0.5]}}
    with pytest.raises(SceneError, match=r"'wax': attenuationColor \[1.0, 0.5, 0.5\] at attenuationDistance 0.01 m"):
        load_scene(gltf(tmp_path / "wax.gltf", extensions))


# ------------------------------------------------------------------ the flat patch


WAX = {"multiscatterColorFactor": [0.5] * 3, "scatterAnisotropy": 0.0}


def patch(bsdf):
    """The part of the entering light that a wide disk returns under light that falls straight on it, in its middle."""
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0}
    disk = {"type": "disk", "to_world": mi.ScalarTransform4f().scale(40.0), "bsdf": bsdf}
    scene = load_scene({"type": "scene", "disk": disk, "sun": light})
    x, y = np.random.default_rng(1).uniform(-15, 15, (2, 400))
    with warnings.catch_warnings(action="ignore"):
        prepared = pellucid.prepare(scene, "two_pass", sample_count=30_000, irradiance_paths=1)
    eta = prepared.integrator.prepared.bodies[0].body.medium.eta
    return prepared.exitance(np.stack([x, y, 0 * x], 1)).mean(axis=0) / (1 - ((eta - 1) / (eta + 1)) ** 2)


def test_flat_patches_return_what_each_format_means_by_a_colour_of_a_half(material, tmp_path):
    """OpenPBR, MaterialX and glTF: what photons return behind an index of 1.5; principled: the colour itself."""
    text = MARBLE.replace("0.830, 0.791, 0.753", "0.5, 0.5, 0.5")
    openpbr = patch({"type": "pellucid_translucent", "material": material(text)})
    principled = patch(
        {**PRINCIPLED, "base_color": rgb(0.5, 0.5, 0.5), "subsurface_radius": rgb(9, 9, 9), "subsurface_scale": 1.0}
    )
    dense = {"KHR_materials_volume": VOLUME | {"attenuationDistance": 1e-4}}
    medium = body_of(load_scene(gltf(tmp_path / "wax.gltf", scattering(**WAX) | dense))).medium
    wax = patch(
        {
            "type": "pellucid_translucent",
            "sigma_s_prime": rgb(*medium.sigma_s_prime),
            "sigma_a": rgb(*medium.sigma_a),
            "eta": medium.eta,
        }
    )
    photons = simulate(float(colour_to_albedo(0.5)), 0.0, 1.5, 1 << 18).total
    assert photons == pytest.approx(0.26, abs=0.005)
    assert openpbr == pytest.approx(photons, rel=0.03) and wax == pytest.approx(photons, rel=0.03)
    assert principled == pytest.approx(0.5, rel=0.03)
