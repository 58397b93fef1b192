"""The list of equations, the code and the tests of the equations agree, in both directions."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "pellucid"
PAPERS = tomllib.loads((Path(__file__).parent / "equations.toml").read_text())
ENTRIES = [(key, int(n), e) for key, paper in PAPERS.items() for n, e in paper.items() if isinstance(e, dict)]
TESTS = [Path(__file__).with_name(f"test_{key.lower()}.py") for key in PAPERS]
CITED = re.compile(r"\b(JB02|CLHHC08|AWB08) eqs?\. ([\d, and-]*\d)")

every_entry = pytest.mark.parametrize(
    ("key", "number", "entry"), ENTRIES, ids=lambda v: str(v) if not isinstance(v, dict) else ""
)


def cited_in(text):
    """The equations that a text cites: paper and number."""
    return {(key, int(number)) for key, numbers in CITED.findall(text) for number in re.findall(r"\d+", numbers)}


def functions_of(path):
    """The functions at the top of a file, by name."""
    return {node.name: node for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("key", PAPERS)
def test_every_numbered_equation_is_listed(key):
    numbers = sorted(n for k, n, _ in ENTRIES if k == key)
    assert numbers == list(range(1, PAPERS[key]["count"] + 1))


@every_entry
def test_an_entry_says_where_and_by_which_test_or_why_not(key, number, entry):
    assert ("in" in entry) != ("why" in entry) and ("in" in entry) == ("test" in entry)
    if "in" in entry:
        path, word = entry["in"]
        assert word in (SOURCE / path).read_text(), f"{key} eq. {number}: '{word}' is not in {path}"


@every_entry
def test_the_test_of_an_equation_exists_and_says_which_it_is(key, number, entry):
    if "test" in entry:
        path, name = entry["test"].split("::")
        test = functions_of(ROOT / path).get(name)
        assert test is not None, f"{key} eq. {number}: there is no {entry['test']}"
        assert (key, number) in cited_in(ast.get_docstring(test) or ""), f"{entry['test']}: say '{key} eq. {number}'"
        checks = [node for node in ast.walk(test) if isinstance(node, ast.Assert)]
        assert checks, f"{entry['test']} asserts nothing"


def test_every_test_of_an_equation_is_named_by_it():
    named = {entry["test"].split("::")[1] + entry["test"].split("::")[0] for *_, entry in ENTRIES if "test" in entry}
    there = {n + str(p.relative_to(ROOT)) for p in TESTS for n in functions_of(p) if n.startswith("test_eq_")}
    assert there == named


def test_every_equation_cited_in_the_code_is_listed_as_implemented():
    cited = set().union(*(cited_in(path.read_text()) for path in SOURCE.rglob("*.py")))
    implemented = {(key, number) for key, number, entry in ENTRIES if "in" in entry}
    assert cited, "no equation is cited at all"
    assert cited <= implemented, f"cited but not listed as implemented: {sorted(cited - implemented)}"
