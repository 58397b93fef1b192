"""The table of the README is what `benchmarks/summary.py` makes of the stored results: no number is written by hand."""

from pathlib import Path

import summary

README = Path(__file__).parents[1] / "README.md"


def test_the_table_of_the_readme_is_what_the_benchmarks_found():
    opening, closing = (f"<!-- {slash}{summary.MARK} -->" for slash in ("", "/"))
    shown = README.read_text().split(opening)[1].split(closing)[0]
    assert shown.strip() == summary.block(), "run `python benchmarks/summary.py`"
