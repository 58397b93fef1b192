"""The wheel and the source distribution: built, installed where nothing of the checkout is seen, and used."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import pellucid
from pellucid import _llvm
from pellucid.methods import METHODS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
BUILD = [sys.executable, "-m", "hatchling", "build"]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build both, and the wheel once more from the source distribution: path by kind."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([*BUILD, "-d", str(folder)], cwd=ROOT, check=True, capture_output=True)
    [wheel], [sdist] = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(
            folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {})
        )  # none in Python 3.11.2
    again = folder / "again"
    command = [*BUILD, "-t", "wheel", "-d", str(again)]
    subprocess.run(command, cwd=folder / sdist.name.removesuffix(".tar.gz"), check=True, capture_output=True)
    return {"wheel": wheel, "sdist": sdist, "wheel of sdist": next(again.glob("*.whl"))}


def names(wheel):
    return sorted(zipfile.ZipFile(wheel).namelist())


def test_the_wheel_holds_the_package_and_nothing_else(built):
    found = names(built["wheel"])
    source = ROOT / "src"
    package = {str(p.relative_to(source)) for p in source.rglob("*") if p.is_file() and "__pycache__" not in p.parts}
    info = f"pellucid-{pellucid.__version__}.dist-info/"
    assert "pellucid/py.typed" in package
    assert {name for name in found if not name.startswith(info)} == package
    assert info + "licenses/LICENSE" in found
    assert names(built["wheel of sdist"]) == found


def test_the_version_stands_in_one_place(built):
    metadata = zipfile.ZipFile(built["wheel"]).read(f"pellucid-{pellucid.__version__}.dist-info/METADATA").decode()
    assert f"\nVersion: {pellucid.__version__}\n" in metadata and "version" in PROJECT["dynamic"]
    changes = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(rf"^## {re.escape(pellucid.__version__)}\b", changes, re.MULTILINE)


def test_every_dependency_has_bounds_and_a_reason():
    text = (
        (ROOT / "pyproject.toml")
        .read_text()
        .partition("# Every bound has a reason:")[2]
        .partition("dependencies = [")[0]
    )
    for dependency in PROJECT["dependencies"]:
        name = re.match(r"[\w-]+", dependency).group()
        assert re.search(r">=[\d.]+,<[\d.]+", dependency), dependency
        assert re.search(rf"^# .*\b{name}\b", text, re.MULTILINE), name


USE = f"""
import pellucid, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
assert mi.load_dict({{"type": "pellucid_translucent"}}).medium.name == "marble"
for method in {list(METHODS)}:
    mi.load_dict({{"type": "pellucid_" + method}})
scene = pellucid.load_scene("sphere", resolution=(8, 6), spp=1)
mi.render(scene, integrator=mi.load_dict({{"type": "pellucid_two_pass", "sample_count": 100}}))
print(pellucid.__file__)
"""


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_it_is_installed_and_used(built, kind, tmp_path):
    """Into an environment of its own, which sees the packages of this one but not the checkout."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path)], check=True)
    python = tmp_path / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    place = Path(subprocess.run([python, "-c", ask], check=True, capture_output=True, text=True).stdout.strip())
    (place / "others.pth").write_text(str(Path(pytest.__file__).parents[1]))
    install = ["install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", str(built[kind])]
    subprocess.run([sys.executable, "-m", "pip", "--python", str(python), *install], check=True)

    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    for path in _llvm._candidates()[-1:]:  # this environment's, not that one's
        environment[_llvm.VARIABLE] = str(path)
    used = subprocess.run([python, "-c", USE], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert used.returncode == 0, used.stderr
    assert Path(used.stdout.strip()) == place / "pellucid" / "__init__.py"
    script = [python.with_name("pellucid"), "materials"]
    assert "marble" in subprocess.run(script, check=True, capture_output=True, text=True, env=environment).stdout
