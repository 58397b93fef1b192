"""What is public: its names, its types, and what it says of itself."""

import os
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import pytest

import pellucid

HERE = Path(__file__).parent
SOURCE = Path(pellucid.__file__).parents[1]
EVERYTHING = HERE / "typed" / "everything.py"


def test_dir_lists_the_public_names_and_no_others():
    assert sorted(dir(pellucid)) == sorted(pellucid.__all__)
    for name in dir(pellucid):
        assert getattr(pellucid, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'prepar'"):
        _ = pellucid.prepar


def test_the_docstring_names_what_is_public():
    for name in pellucid.__all__:
        assert name == "__version__" or f"`{name}`" in pellucid.__doc__


@pytest.fixture(scope="module")
def known_types(tmp_path_factory):
    """Return the folder in which what mypy found in libraries is kept, for all scripts."""
    return tmp_path_factory.mktemp("known_types")


def check(script, known_types):
    """Check a script as somebody would who has installed the package: of the package itself only its types count."""
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file", os.devnull]
    command += ["--cache-dir", str(known_types), str(script)]
    environment = os.environ | {"MYPYPATH": str(SOURCE)}
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=known_types)


def test_types_at_the_public_edge(known_types):
    text = EVERYTHING.read_text()
    for name in pellucid.__all__:
        assert name in text
    done = check(EVERYTHING, known_types)
    assert done.returncode == 0, done.stdout


def test_wrong_types_are_found(tmp_path, known_types):
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        "import pellucid\n"
        "a: int = pellucid.Medium.from_preset('marble')\n"
        "b: str = pellucid.Medium.from_preset('marble').dmfp\n"
        "pellucid.Medium(1.0)\n"
        "pellucid.load_scene(3)\n"
        "c: int = pellucid.prepare(pellucid.load_scene('teapot')).exitance([0, 0, 0])\n"
        "pellucid.Engine('teapot').frame(1, 2, 3)\n"
        "d: int = pellucid.PellucidError('no')\n"
        "pellucid.nothing\n"
    )
    found = {int(line.split(":")[1]) for line in check(wrong, known_types).stdout.splitlines() if ": error:" in line}
    assert found >= {2, 3, 4, 5, 6, 7, 8}


def test_a_medium_says_what_it_is():
    text = repr(pellucid.Medium.from_preset("marble", profile="dipole"))
    for part in (
        "Medium 'marble': eta 1.5, g 0, dipole",
        "mm and 1/mm",
        "red",
        "green",
        "blue",
        "total_diffuse_reflectance",
    ):
        assert part in text
    rows = {line.split()[0]: line.split()[1:] for line in text.strip("<>").splitlines()[1:]}
    assert list(rows)[1:] == ["sigma_s_prime", "sigma_a", "albedo_prime", "mfp", "dmfp", "total_diffuse_reflectance"]
    assert rows["sigma_s_prime"] == ["2.19", "2.62", "3"] and rows["dmfp"] == ["8.509", "5.566", "3.951"]
    assert repr(pellucid.Medium(1, 0)).startswith("<Medium: eta 1.3") and "inf" in repr(pellucid.Medium(1, 0))


def test_points_that_lie_on_no_surface_are_told(recwarn):
    ball = {"type": "scene", "ball": {"type": "sphere", "radius": 20.0, "bsdf": {"type": "pellucid_translucent"}}}
    prepared = pellucid.prepare(mi.load_dict(ball | {"sky": {"type": "constant"}}), sample_count=500)
    prepared.exitance([[0, 0, 20], [20.2, 0, 0]])
    assert not [w for w in recwarn if "nearest" in str(w.message)]
    with pytest.warns(pellucid.PellucidWarning, match=r"The point \[0.0, 5.0, 0.0\] is 15 away from the nearest"):
        prepared.exitance([[0, 0, 20], [0, 5, 0]])


def test_an_engine_and_a_prepared_scene_say_what_they_hold():
    bsdf = {"type": "pellucid_translucent", "material": "cream", "scale": 10.0}
    light = {"type": "point", "position": [0, 0, 5], "intensity": 3.0}
    scene = pellucid.load_scene({"type": "scene", "ball": {"type": "sphere", "bsdf": bsdf}, "lamp": light})
    engine = pellucid.Engine(scene, 128)
    engine.settings.samples = 333
    for part in ("128 x 128 texels", "bodies: ball (cream, 20 mm)", "lights: lamp (point, intensity 3)", "samples=333"):
        assert part in repr(engine)
    prepared = repr(pellucid.prepare(scene, sample_count=100))
    assert "two_pass" in prepared and "ball" in prepared
    assert "material = cream" in str(scene.shapes()[0].bsdf()) and "scale = 10.0" in str(scene.shapes()[0].bsdf())
