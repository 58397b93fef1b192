"""Which scenes the browser draws, and which this machine does."""

import pytest
import trimesh

from pellucid.cli.view import other_contents, page_contents
from pellucid.errors import PellucidWarning, SceneError
from pellucid.jobs.job import Request
from worlds.terminal import write_scene


def contents_of(source, **options):
    return page_contents(Request.from_options({"source": str(source), **options}).load())


def test_models_and_bare_meshes_are_drawn_by_the_browser(tmp_path):
    contents, reason = contents_of("horned_head")
    assert contents is not None and not reason and not contents.notes
    trimesh.creation.icosphere(subdivisions=2, radius=20).export(tmp_path / "ball.ply")
    contents, reason = contents_of(tmp_path / "ball.ply")
    assert contents is not None and not reason
    assert contents.head["state"]["floor"] and len(contents.head["state"]["lamps"]) == 2


@pytest.mark.parametrize(
    ("scene", "reason"), [("cornell_box", "opaque shapes are left out"), ("ball.xml", "Sphere: export it as a mesh")]
)
def test_other_scenes_are_drawn_here_and_it_is_said_why(scene, reason, tmp_path):
    source = write_scene(tmp_path / scene) if scene.endswith(".xml") else scene
    contents, why = contents_of(source)
    assert contents is None and reason in why


def test_curved_profiles_are_drawn_by_the_browser_without_a_factor_for_thin_parts():
    with pytest.warns(PellucidWarning, match="The page follows the curve .* has no factor for thin parts"):
        contents, why = contents_of("horned_head", profile="curved")
    assert contents is not None and not why


def test_what_a_page_cannot_show_is_not_opened_in_it():
    request = Request.from_options({"source": "horned_head"})
    with pytest.raises(SceneError, match=r"lamps with an extent are points.*'pellucid view cornell_box' draws it"):
        other_contents(request, "cornell_box")
