"""What to cite, the file that says so to services, and the keys in the code agree."""

import re
from pathlib import Path

import pellucid
from pellucid.citation import AUTHORS, PAPERS, TITLE

ROOT = Path(__file__).parents[2]
FILE = (ROOT / "CITATION.cff").read_text()
NO_PAPERS = {"AMD64", "PCG32"}


def fields(text):
    """Read the plain fields of a part of the file."""
    return {name: value.strip('"') for name, value in re.findall(r"^ *(?:- )?([\w-]+): (.+)$", text, re.MULTILINE)}


def test_the_package_is_named_with_its_version():
    head = fields(FILE.partition("references:")[0])
    assert (head["title"], head["version"], head["name"]) == (TITLE, pellucid.__version__, AUTHORS)
    assert head["license"] == "BSD-3-Clause"


def test_the_file_lists_the_papers():
    entries = FILE.partition("references:")[2].split("- type: ")[1:]
    assert len(entries) == len(PAPERS)
    for entry, paper in zip(entries, PAPERS, strict=True):
        found = fields(entry)
        authors = re.findall(r"family-names: ([\w -]+), given-names: ([\w. -]+)\}", entry)
        assert tuple(f"{given} {family}" for family, given in authors) == paper.authors
        assert found["title"] == paper.title and int(found["year"]) == paper.year
        assert f"{found['start']}-{found['end']}" == paper.pages and found.get("doi", "") == paper.doi
        assert found.get("journal", found.get("collection-title")) == paper.journal
        assert (found.get("volume", ""), found.get("issue", "")) == (paper.volume, paper.number)


def test_every_paper_cited_in_the_code_is_listed_and_every_listed_one_is_cited():
    sources = [path for path in (ROOT / "src").rglob("*.py") if path.name != "citation.py"]
    cited = {key for path in sources for key in re.findall(r"\b[A-Z]{2,7}\d\d\b", path.read_text())} - NO_PAPERS
    assert cited == {paper.key for paper in PAPERS}
