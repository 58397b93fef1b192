"""The documentation builds without a warning, and asks nothing of other hosts when it is read."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from worlds.pages import check_pellucid

DOCS = Path(__file__).parents[2] / "docs"
FETCHED = re.compile(
    r"""<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=["'](?:https?:)?//|@import\s|url\(["']?(?:https?:)?//"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site as contributing.md says."""
    folder, live = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("live")
    (live / "live").mkdir()
    (live / "live" / "antique_head.html").write_text("<!doctype html><title>a page</title>")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "--quiet", DOCS, folder]
    environment = os.environ | {"PELLUCID_LIVE": str(live)}
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    return folder


def test_every_page_is_built(site):
    written = {
        path.relative_to(DOCS).with_suffix("") for kind in ("md", "rst", "ipynb") for path in DOCS.rglob(f"*.{kind}")
    }
    built = {path.relative_to(site).with_suffix("") for path in site.rglob("*.html")}
    assert written and written <= built


def test_pages_fetch_nothing_from_other_hosts(site):
    for path in [*site.rglob("*.html"), *site.rglob("*.css")]:
        found = FETCHED.search(path.read_text())
        assert not found, f"{path}: {found[0]}"


def test_pages_can_be_read_without_a_server(site):
    """Links between pages lead to files: nothing begins at the root of a host, or ends in a folder."""
    for path in site.rglob("*.html"):
        for link in re.findall(r'href="([^"#]+)', path.read_text()):
            if not re.match(r"\w+:", link):
                assert (path.parent / link.split("?")[0]).is_file(), f"{path.name}: {link}"


def test_exported_pages_run_in_the_site(site):
    """Those that were written before; of the others the command is shown that does."""
    text = (site / "gallery.html").read_text()
    assert (site / "live" / "antique_head.html").is_file()
    assert 'src="live/antique_head.html"' in text and "live/longneck.html" not in text
    assert "pellucid export longneck --material cream" in re.sub("<[^>]*>", "", text)


def test_the_commands_of_exported_pages_exist():
    sys.path.insert(0, str(DOCS))
    import live

    for name in live.PAGES:
        check_pellucid(live.command(name))
