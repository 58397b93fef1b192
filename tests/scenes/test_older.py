"""Scenes of Mitsuba 0.5 and 0.6 with dipoles load as they are: the same media, and one line about the rest."""

import os
import warnings

import mitsuba as mi
import numpy as np
import pytest

from pellucid.errors import MediumError, PellucidWarning, SceneError
from pellucid.methods.preparation import open_scene
from pellucid.model.materials import SOLIDS
from pellucid.model.medium import Medium
from pellucid.scenes.loading import load_scene
from pellucid.scenes.older import is_older

FRAME = """<?xml version="1.0" encoding="utf-8"?>
<!-- as exporters of the time wrote it -->
<scene version="{version}">
  {integrator}
  <sensor type="perspective">
    <float name="fov" value="40"/> <string name="fovAxis" value="smaller"/>
    <transform name="toWorld"><lookAt origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
    <sampler type="ldsampler"><integer name="sampleCount" value="4"/></sampler>
    <film type="hdrfilm">
      <integer name="width" value="24"/> <integer name="height" value="24"/>
      <string name="pixelFormat" value="rgb"/> <boolean name="banner" value="false"/> <rfilter type="box"/>
    </film>
  </sensor>
  {shapes}
  {emitter}
</scene>
"""
PATH = '<integrator type="path"><integer name="maxDepth" value="7"/></integrator>'
PLASTIC = """<bsdf type="plastic"><spectrum name="diffuseReflectance" value="0"/>
    <string name="intIOR" value="water"/> <string name="extIOR" value="air"/></bsdf>"""
# An arbitrary medium in 1/m, with the index of water.
ARBITRARY = """<string name="intIOR" value="water"/> <string name="extIOR" value="air"/>
    <rgb name="sigmaS" value="87.2, 127.2, 143.2"/> <rgb name="sigmaA" value="1.04, 5.6, 11.6"/>"""
WATER = 1.333 / 1.000277


def dipole(inside, bsdf=PLASTIC, kind="dipole"):
    return f'<shape type="sphere"><subsurface type="{kind}">{inside}</subsurface>{bsdf}</shape>'


def write(path, *shapes, version="0.5.0", integrator=PATH, emitter='<emitter type="constant"/>'):
    text = FRAME.format(version=version, integrator=integrator, shapes="\n".join(shapes), emitter=emitter)
    path.write_text(text)
    return path


def load(path, **parameters):
    """Load a scene; return it, its bodies, and what was said about it, in one line."""
    with pytest.warns(PellucidWarning) as told:
        scene = load_scene(path, parameters)
    about = [str(w.message) for w in told if "Mitsuba 0.x" in str(w.message)]
    assert len(about) == 1 and "\n" not in about[0]
    with warnings.catch_warnings(action="ignore"):
        bodies = [lit.body for lit in open_scene(scene).bodies]
    return scene, bodies, about[0]


def per_unit(body):
    """Coefficients of a body per scene unit, as Mitsuba 0.6 has them once they are multiplied by their scale."""
    return body.medium.sigma_s_prime, body.medium.sigma_a


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("version, scale", [("0.5.0", "scale"), ("0.6.0", "scale"), ("0.3.0", "densityMultiplier")])
def test_measured_materials_are_those_of_our_table(tmp_path, name, version, scale):
    """Per millimetre, times 100 as Mitsuba 0.6 does, times the scale: of chicken and of all others by our numbers."""
    spelled = name.capitalize() if version == "0.6.0" else name
    inside = f'<string name="material" value="{spelled}"/> <float name="{scale}" value="0.25"/>'
    scene, (body,), said = load(write(tmp_path / "old.xml", dipole(inside), version=version))
    assert body.medium == Medium.from_preset(name, 25.0) and "times 100" in said
    assert scene.integrator().method.name == "two_pass" and scene.integrator().method.max_depth == 7


@pytest.mark.parametrize("scale, factor", [("", 1.0), ('<float name="scale" value="0.02"/>', 0.02)])
def test_coefficients_are_per_scene_unit_times_scale(tmp_path, scale, factor):
    _, (body,), said = load(write(tmp_path / "old.xml", dipole(ARBITRARY + scale)))
    sigma_s, sigma_a = per_unit(body)
    assert sigma_s == pytest.approx(np.multiply((87.2, 127.2, 143.2), factor))
    assert sigma_a == pytest.approx(np.multiply((1.04, 5.6, 11.6), factor))
    assert body.medium.eta == pytest.approx(WATER)
    assert "1 shape with a dipole became pellucid_translucent" in said and "'path'" in said


@pytest.mark.parametrize(
    "inside, sigma_s, sigma_a",
    [
        ('<rgb name="sigmaS" value="10, 20, 30"/><rgb name="sigmaA" value="1"/><float name="g" value="0.8"/>', (2, 4, 6), (1, 1, 1)),
        ('<spectrum name="sigmaS" value="10"/><spectrum name="sigmaA" value="1, 2, 3"/>', (10, 10, 10), (1, 2, 3)),
        ('<rgb name="sigmaT" value="10, 20, 40"/><rgb name="albedo" value="0.9, 0.5, 0.75"/>', (9, 10, 30), (1, 10, 10)),
        ('<spectrum name="sigmaT" value="10"/><spectrum name="albedo" value="0.9"/><float name="g" value="0.5"/>', (4.5,) * 3, (1,) * 3),
        ("", Medium.from_preset("skin1", 100).sigma_s_prime, Medium.from_preset("skin1", 100).sigma_a),
        ('<string name="material" value="skin1"/><float name="g" value="0.5"/>', (37, 44, 50.5), (3.2, 17, 48)),
    ],
)  # fmt: skip
def test_every_way_to_write_a_medium(tmp_path, inside, sigma_s, sigma_a):
    _, (body,), _ = load(write(tmp_path / "old.xml", dipole(inside)))
    found_s, found_a = per_unit(body)
    assert found_s == pytest.approx(np.array(sigma_s, float)) and found_a == pytest.approx(np.array(sigma_a, float))


@pytest.mark.parametrize(
    "index, eta",
    [
        ('<float name="intIOR" value="1.4"/><float name="extIOR" value="1"/>', 1.4),
        ('<string name="intIOR" value="Diamond"/>', 2.419 / 1.000277),
        ('<string name="extIOR" value="water"/>', 1.5046 / 1.333),
        ("", 1.5),
    ],
)
def test_the_index_by_number_by_name_or_of_the_material(tmp_path, index, eta):
    _, (body,), _ = load(write(tmp_path / "old.xml", dipole('<string name="material" value="marble"/>' + index)))
    assert body.medium.eta == pytest.approx(eta)


@pytest.mark.parametrize(
    "bsdf, alpha, specular",
    [
        (PLASTIC, 0.0, 1.0),
        ('<bsdf type="roughplastic"><float name="alpha" value="0.2"/></bsdf>', 0.2, 1.0),
        ('<bsdf type="roughplastic"/>', 0.1, 1.0),
        ('<bsdf type="twosided"><bsdf type="plastic"><spectrum name="specularReflectance" value="0.5"/></bsdf></bsdf>', 0, 0.5),
        ('<bsdf type="diffuse"/>', 0.1, 0.0),
        ("", 0.1, 0.0),
    ],
)  # fmt: skip
def test_the_reflection_is_that_of_the_bsdf_beside(tmp_path, bsdf, alpha, specular):
    _, (body,), _ = load(write(tmp_path / "old.xml", dipole(ARBITRARY, bsdf)))
    assert (body.bsdf.alpha, body.bsdf.specular) == pytest.approx((alpha, specular))


def test_a_bsdf_can_be_referred_to(tmp_path):
    shared = '<bsdf type="roughplastic" id="skin"><float name="alpha" value="0.3"/></bsdf>'
    _, (body,), _ = load(write(tmp_path / "old.xml", shared, dipole(ARBITRARY, '<ref id="skin"/>')))
    assert body.bsdf.alpha == pytest.approx(0.3)


def test_shapes_that_share_a_dipole_are_one_solid(tmp_path):
    shared = f'<subsurface type="dipole" id="milk">{ARBITRARY}</subsurface>'
    shape = '<shape type="sphere"><float name="radius" value="{}"/><ref id="milk"/></shape>'
    apart = '<shape type="sphere"><point name="center" x="4" y="0" z="0"/><subsurface type="dipole"/></shape>'
    _, bodies, said = load(write(tmp_path / "old.xml", shared, shape.format(1), shape.format(0.5), apart))
    assert [len(body.parts) for body in bodies] == [2, 1] and "3 shapes" in said


@pytest.mark.parametrize(
    "colour, expected",
    [
        ('<srgb name="reflectance" value="#80ff00"/>', (0.2158605, 1, 0)),
        ('<srgb name="reflectance" value="0.5, 0.25, 1"/>', (0.2140411, 0.0508761, 1)),
        ('<rgb name="reflectance" value="#80ff00"/>', (128 / 255, 1, 0)),
        ('<rgb name="reflectance" intent="reflectance" value="0.5 0.25 1"/>', (0.5, 0.25, 1)),
    ],
)
def test_colours_are_linear_whatever_way_they_were_written(tmp_path, colour, expected):
    floor = f'<shape type="rectangle" id="floor"><bsdf type="diffuse">{colour}</bsdf></shape>'
    scene, _, _ = load(write(tmp_path / "old.xml", dipole(ARBITRARY), floor))
    (colour,) = [value for key, value in mi.traverse(scene).items() if key.endswith("reflectance.value")]
    assert np.array(colour).ravel() == pytest.approx(expected, abs=1e-5)


def test_an_integrator_of_ours_is_kept(tmp_path):
    ours = '<integrator type="pellucid_exact"/>'
    scene, _, said = load(write(tmp_path / "old.xml", dipole(ARBITRARY), integrator=ours))
    assert scene.integrator().method.name == "exact" and "integrator" not in said


def test_the_most_exact_settings_go_to_the_integrator(tmp_path):
    one = '<integer name="irrSamples" value="1234567"/><float name="quality" value="0.3"/>'
    other = '<integer name="irrSamples" value="32"/><float name="quality" value="0.1"/><boolean name="irrIndirect" value="false"/>'
    scene, _, said = load(write(tmp_path / "old.xml", dipole(ARBITRARY + one), dipole(ARBITRARY + other)))
    method = scene.integrator().method
    assert (method.irradiance_paths, method.max_error, method.irradiance_depth) == (1234567, pytest.approx(0.1), 2)
    assert "irradiance_paths 1234567" in said and "irrSamples" not in said


def test_what_has_no_counterpart_is_named(tmp_path):
    inside = ARBITRARY + '<float name="quality" value="0.1"/><float name="sampleMultiplier" value="2"/>'
    sky = '<emitter type="sky"/><emitter type="constant"/>'
    bsdf = '<bsdf type="plastic"><float name="intIOR" value="1.9"/></bsdf>'
    path = write(tmp_path / "old.xml", dipole(inside, bsdf), emitter=sky)
    path.write_text(
        path.read_text()
        .replace("ldsampler", "halton")
        .replace('value="rgb"/>', 'value="rgb"/><float name="exposure" value="1"/>')
    )
    _, _, said = load(path)
    for word in (
        "sampleMultiplier",
        "'sky'",
        "index of plastic, 1.899",
        "'halton' became 'independent'",
        "exposure of hdrfilm",
    ):
        assert word in said, word


def test_files_parameters_and_includes_are_found_from_anywhere(tmp_path, monkeypatch):
    folder = tmp_path / "scene"
    folder.mkdir()
    mi.Bitmap(np.ones((4, 8, 3), np.float32)).write(str(folder / "sky.exr"))
    (folder / "ball.xml").write_text(
        '<scene version="0.5.0"><default name="s" value="1"/>'
        + dipole(ARBITRARY + '<float name="scale" value="$s"/>')
        + "</scene>"
    )
    emitter = '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter>'
    write(folder / "old.xml", '<include filename="ball.xml"/>', emitter=emitter)
    before = sorted(os.listdir(folder)), [str(mi.file_resolver()[k]) for k in range(len(mi.file_resolver()))]
    monkeypatch.chdir(tmp_path)
    _, (body,), _ = load(folder / "old.xml")
    assert per_unit(body)[1] == pytest.approx([1.04, 5.6, 11.6])
    assert before == (sorted(os.listdir(folder)), [str(mi.file_resolver()[k]) for k in range(len(mi.file_resolver()))])
    path = write(
        folder / "other.xml", '<default name="s" value="1"/>', dipole(ARBITRARY + '<float name="scale" value="$s"/>')
    )
    _, (body,), _ = load(path, s="3")
    assert per_unit(body)[1] == pytest.approx(np.multiply(3, [1.04, 5.6, 11.6]))
    with pytest.raises(SceneError, match=r"no \$t to set"):
        load_scene(path, {"t": "3"})


def test_a_dipole_in_a_comment_changes_nothing(tmp_path):
    path = tmp_path / "now.xml"
    path.write_text('<scene version="3.0.0"><!-- was <subsurface type="dipole"/> --><integrator type="path"/></scene>')
    assert not is_older(path, {})


def test_the_picture_is_that_of_the_same_scene_in_the_present_form(tmp_path):
    old, _, _ = load(
        write(
            tmp_path / "old.xml", dipole(ARBITRARY + '<float name="scale" value="0.2"/>', '<bsdf type="roughplastic"/>')
        )
    )
    now = f"""<bsdf type="pellucid_translucent"><rgb name="sigma_s_prime" value="17.44, 25.44, 28.64"/>
      <rgb name="sigma_a" value="0.208, 1.12, 2.32"/><float name="eta" value="{WATER:.9g}"/></bsdf>"""
    text = FRAME.format(
        version="3.0.0",
        integrator='<integrator type="pellucid_two_pass"><integer name="max_depth" value="7"/></integrator>',
        shapes=f'<shape type="sphere">{now}</shape>',
        emitter='<emitter type="constant"/>',
    )
    for older, newer in (
        ("lookAt", "lookat"),
        ("toWorld", "to_world"),
        ("sampleCount", "sample_count"),
        ("pixelFormat", "pixel_format"),
        ("fovAxis", "fov_axis"),
    ):
        text = text.replace(older, newer)
    (tmp_path / "new.xml").write_text(text)
    new = load_scene(tmp_path / "new.xml")
    picture = np.array(mi.render(old, seed=1))
    np.testing.assert_allclose(picture, np.array(mi.render(new, seed=1)), rtol=2e-3, atol=1e-4)
    assert picture[12, 12].min() > 0.05


@pytest.mark.parametrize(
    "shape, error, text",
    [
        (dipole("", kind="singlescatter"), SceneError, "'singlescatter' is not known"),
        (dipole(ARBITRARY + '<string name="material" value="skin1"/>'), SceneError, "described twice"),
        (dipole('</subsurface><subsurface type="dipole">'), SceneError, "2 subsurface models; keep one"),
        (dipole('<string name="material" value="skin3"/>'), MediumError, "did you mean 'skin"),
        (dipole('<string name="intIOR" value="watter"/>'), SceneError, "did you mean 'water'"),
        (dipole('<float name="extIOR" value="0"/>'), SceneError, "extIOR = 0: .* positive"),
        (dipole('<spectrum name="sigmaS" value="400:1, 700:2"/>'), SceneError, "sigmaS"),
    ],
)
def test_refusals_take_one_line(tmp_path, shape, error, text):
    with pytest.raises(error, match=text) as caught:
        load_scene(write(tmp_path / "old.xml", shape))
    assert "\n" not in str(caught.value)
