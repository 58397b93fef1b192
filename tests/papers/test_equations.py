"""The list of equations and the code agree, in both directions."""

import re
import tomllib
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src" / "pellucid"
PAPERS = tomllib.loads((Path(__file__).parent / "equations.toml").read_text())
ENTRIES = [(key, int(n), e) for key, paper in PAPERS.items() for n, e in paper.items() if isinstance(e, dict)]


@pytest.mark.parametrize("key", PAPERS)
def test_every_numbered_equation_is_listed(key):
    numbers = sorted(n for k, n, _ in ENTRIES if k == key)
    assert numbers == list(range(1, PAPERS[key]["count"] + 1))


@pytest.mark.parametrize(("key", "number", "entry"), ENTRIES, ids=lambda v: str(v) if not isinstance(v, dict) else "")
def test_an_entry_says_where_or_why(key, number, entry):
    assert ("in" in entry) != ("why" in entry)
    if "in" in entry:
        path, word = entry["in"]
        assert word in (SOURCE / path).read_text(), f"{key} eq. {number}: '{word}' is not in {path}"


def test_every_equation_cited_in_the_code_is_listed_as_implemented():
    cited = {
        (key, int(number))
        for path in SOURCE.rglob("*.py")
        for key, numbers in re.findall(r"\b(JB02|CLHHC08|AWB08) eqs?\. ([\d, and-]*\d)", path.read_text())
        for number in re.findall(r"\d+", numbers)
    }
    implemented = {(key, number) for key, number, entry in ENTRIES if "in" in entry}
    assert cited, "no equation is cited at all"
    assert cited <= implemented, f"cited but not listed as implemented: {sorted(cited - implemented)}"
