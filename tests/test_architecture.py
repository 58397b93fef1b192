"""The shape of the house: no import circles, floors import only from floors below, quirks live in one place, files stay small."""

import ast
import re
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "pellucid"
FLOORS = (
    "kernels",
    "model",
    "scene",
    "scenes",
    "light",
    "gather",
    "methods",
    "api",
    "fitting",
    "realtime",
    "page",
    "viewer",
    "jobs",
    "cluster",
    "cli",
)
"""From the ground up. The rest are the basement, which may be imported from everywhere, and the doors, from nowhere."""
BASEMENT = ("errors", "effort", "progress", "metrics", "citation", "version", "_llvm", "_kernel_folder")
DOORS = ("__main__", "")
FILES = sorted(SOURCE.rglob("*.py"))


def module_name(path: Path, root: Path) -> str:
    """Name a file relative to the package: ``scene/bodies.py`` is ``scene.bodies``, the package itself the empty name."""
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix("__init__").rstrip(".")


def import_graph(root: Path) -> dict[str, set[str]]:
    """Read which modules of the package at ``root`` import which, ``TYPE_CHECKING`` and imports inside functions included."""
    files = {module_name(path, root): path for path in root.rglob("*.py")}
    graph: dict[str, set[str]] = {name: set() for name in files}
    for name, path in files.items():
        package = path.relative_to(root).parts[:-1]
        for node in ast.walk(ast.parse(path.read_text())):
            for target in imported(node, package, root.name):
                found = next((t for t in (target, target.rpartition(".")[0]) if t in files), None)
                if found is not None and found != name:
                    graph[name].add(found)
    return graph


def imported(node: ast.AST, package: tuple[str, ...], root: str):
    """Name what an import statement may import, relative to the package: a module, or a name in a module."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            if alias.name == root or alias.name.startswith(root + "."):
                yield alias.name.removeprefix(root).lstrip(".")
    elif isinstance(node, ast.ImportFrom):
        if node.level:
            base = [*package[: len(package) - node.level + 1], *(node.module or "").split(".")]
        elif (node.module or "").split(".")[0] == root:
            base = (node.module or "").split(".")[1:]
        else:
            return
        base = [part for part in base if part]
        for alias in node.names:
            yield ".".join([*base, alias.name])


def find_circle(graph: dict[str, set[str]]) -> list[str] | None:
    """Find modules that import each other in a circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return None


def reached(graph: dict[str, set[str]], start: str) -> set[str]:
    """Find everything that a module imports, directly or not."""
    found: set[str] = set()
    todo = [start]
    while todo:
        new = graph[todo.pop()] - found
        found |= new
        todo += new
    return found


def upward(graph: dict[str, set[str]]) -> list[str]:
    """List the imports that do not lead to a floor below, or within a floor."""
    height = {name: k for k, name in enumerate((*BASEMENT, *FLOORS, *DOORS))}
    for name in BASEMENT:
        height[name] = -1
    wrong = []
    for name, targets in graph.items():
        for target in targets:
            here, there = name.split(".")[0], target.split(".")[0]
            if here != there and not height[there] < height[here] and not height[there] == height[here] == -1:
                wrong.append(f"{name or 'pellucid'} imports {target or 'pellucid'}")
    return wrong


GRAPH = import_graph(SOURCE)


def test_every_module_has_a_floor():
    assert {name.split(".")[0] for name in GRAPH} == {*FLOORS, *BASEMENT, *DOORS}


def test_there_are_no_import_circles():
    assert find_circle(GRAPH) is None


def test_floors_import_only_from_floors_below():
    assert upward(GRAPH) == []


def test_two_pass_does_not_reach_point_lights():
    assert not {name for name in reached(GRAPH, "methods.two_pass") if name.startswith("light.points")}


def test_the_two_algorithms_of_the_single_pass_do_not_know_each_other():
    """They share the trees below them."""
    room = "methods.single_pass."
    for one, other in (("paper", "adaptive"), ("adaptive", "paper"), ("trees", "paper"), ("trees", "adaptive")):
        known = {t for name in GRAPH if name.startswith(room + one) for t in reached(GRAPH, name)}
        assert not {name for name in known if name.startswith((room + other, room + "integrator", room + "state"))}


def test_methods_do_not_know_each_other():
    methods = ("exact", "sampled", "two_pass", "texture_space", "single_pass")
    for one in methods:
        known = {t for name in GRAPH if f"{name}.".startswith(f"methods.{one}.") for t in reached(GRAPH, name)}
        for other in methods:
            assert one == other or not {name for name in known if f"{name}.".startswith(f"methods.{other}.")}


# ------------------------------------------------------------------ the checks above find what they are for

CIRCLES = {
    "hidden behind TYPE_CHECKING": {
        "aovs": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .base import Answer\n",
        "base": "from . import aovs\n",
    },
    "inside a function": {
        "records": "def discretise():\n    from .emitters import find\n",
        "emitters": "from .records import Lights\n",
    },
    "of four": {
        "emission": "from .records import a\n",
        "records": "from .emitters import a\n",
        "emitters": "from .virtual import a\n",
        "virtual": "from .emission import a\n",
    },
    "by an absolute name": {"a": "import house.b\n", "b": "from house.a import x\n"},
    "between folders": {"one/a": "from ..two.b import x\n", "two/b": "from ..one import a\n"},
}


def build(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize("files", CIRCLES.values(), ids=CIRCLES)
def test_circles_are_found(tmp_path, files):
    assert set(find_circle(import_graph(build(tmp_path / "house", files)))) == {
        name.replace("/", ".") for name in files
    }


def test_arrows_upward_are_found(tmp_path):
    files = {
        "light/direct": "from ..gather.octree import x\n",
        "gather/octree": "from ..errors import y\n",
        "errors": "",
    }
    files |= {"viewer/page": "def late():\n    from ..cli.session import z\n", "cli/session": "from .. import light\n"}
    files |= {"light/__init__": ""}
    wrong = upward(import_graph(build(tmp_path / "pellucid", files)))
    assert sorted(wrong) == ["light.direct imports gather.octree", "viewer.page imports cli.session"]


# ------------------------------------------------------------------ sizes, and one place for each thing


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_and_functions_stay_small(path):
    text = path.read_text()
    assert len(text.splitlines()) <= 400
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node, clean=False) or ""
            length = node.end_lineno - node.lineno + 1 - len(docstring.splitlines())
            assert length <= 60, f"{node.name} has {length} lines without its docstring"


def test_modules_of_the_page_stay_small():
    for path in SOURCE.rglob("*.js"):
        lines = path.read_text().splitlines()
        assert len(lines) <= 400 and max(map(len, lines)) <= 150, path


def containing(pattern: str) -> set[str]:
    return {str(p.relative_to(SOURCE)) for p in FILES if re.search(pattern, p.read_text())}


def test_scenes_are_loaded_in_one_place():
    assert containing(r"mi\.load_file\(|load_dict\(source") == {"scenes/loading.py"}


def test_mesh_buffers_are_touched_in_one_place():
    """A release of Mitsuba that renames them is a change of this one."""
    assert containing(r"vertex_positions|positions_buffer|faces_buffer") == {"scene/meshes/buffers.py"}


def test_the_model_needs_no_variant():
    code = "import pellucid.model.medium, pellucid.model.profiles, mitsuba as mi; assert mi.variant() is None"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_project_speaks_of_itself_alone():
    root = SOURCE.parents[1]
    for path in [
        *FILES,
        *SOURCE.rglob("*.js"),
        *root.glob("*.md"),
        *root.glob("docs/**/*.md"),
        *root.glob("tests/**/*.py"),
    ]:
        if path.name != "test_architecture.py":
            assert not re.search(r"/work/|/opt/venv|\bAI\b|assistant|helper agent", path.read_text()), path
