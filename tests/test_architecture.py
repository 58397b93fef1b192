"""The shape of the house: floors import only downwards, quirks live in one place, files and functions stay small."""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "pellucid"
FLOORS = {
    "model": 0,
    "scene": 1,
    "light": 2,
    "tree": 3,
    "integrators": 4,
    "realtime": 4,
    "bench": 5,
    "cli": 5,
    "viewer": 5,
}
FILES = sorted(SOURCE.rglob("*.py"))


def floor(path: Path) -> int | None:
    return FLOORS.get(path.relative_to(SOURCE).parts[0])


def imports(path: Path):
    """Names of the pellucid modules that a file imports, relative to the package."""
    package = path.relative_to(SOURCE).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            if node.level:
                base = package[: len(package) - node.level + 1]
                yield ".".join([*base, *(node.module or "").split(".")]).strip(".")
            elif (node.module or "").startswith("pellucid"):
                yield node.module.removeprefix("pellucid").strip(".")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_floors_import_only_downwards(path):
    here = floor(path)
    if here is None:
        return
    for name in imports(path):
        there = FLOORS.get(name.split(".")[0])
        assert there is None or there <= here, f"{path.relative_to(SOURCE)} imports {name}, which is above it"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_and_functions_stay_small(path):
    text = path.read_text()
    assert len(text.splitlines()) <= 400
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node, clean=False) or ""
            length = node.end_lineno - node.lineno + 1 - len(docstring.splitlines())
            assert length <= 60, f"{node.name} has {length} lines without its docstring"


def containing(pattern: str) -> set[str]:
    return {str(p.relative_to(SOURCE)) for p in FILES if re.search(pattern, p.read_text())}


def test_scenes_are_loaded_in_one_place():
    assert containing(r"mi\.load_file\(|load_dict\(source") == {"scene/loading.py"}


def test_mesh_buffers_are_touched_in_two_places():
    """Reading in one file, writing in another: a release of Mitsuba that renames them is a change of these two."""
    assert containing(r"vertex_positions|positions_buffer|faces_buffer") <= {"scene/meshes.py", "scene/mesh_arrays.py"}


def test_the_model_needs_no_variant():
    import subprocess
    import sys

    code = "import pellucid.model.medium, pellucid.model.profiles, mitsuba as mi; assert mi.variant() is None"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_project_speaks_of_itself_alone():
    root = SOURCE.parents[1]
    for path in [*FILES, *root.glob("*.md"), *root.glob("docs/**/*.md"), *root.glob("tests/**/*.py")]:
        if path.name != "test_architecture.py":
            assert not re.search(r"/work/|/opt/venv|\bAI\b|assistant|helper agent", path.read_text()), path
