"""Every block of code in README and docs does what it is there for, as it stands.

Python and shell blocks run, each in a process of its own, in a folder of the page with a ``scene.xml`` and a mesh ``bunny.ply``.
A comment directly above a shell block, ``<!-- long -->``, ``<!-- server -->`` or ``<!-- installation -->``, keeps it from being
run: then its commands and options must exist. ``<!-- file: NAME -->`` writes the block there first.
"""

import re
import shlex
import subprocess

import pytest

from worlds.pages import PAGES, ROOT, Folders, blocks_of, check_command, commands

BLOCKS = [block for page in PAGES for block in blocks_of(page)]
INLINE = re.compile(r"`((?:pellucid |python benchmarks/)[^`\n]*[^`\s]) ?`")


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    return Folders(tmp_path_factory.mktemp("pages"))


@pytest.mark.parametrize("block", BLOCKS, ids=str)
def test_block(block, folders):
    folders.try_out(block)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_within_sentences_exist(page):
    for text in INLINE.findall(page.read_text()):
        for words in commands(text.replace("...", "")):
            check_command([*words, "--help"] if words[0] == "pellucid" and len(words) == 2 else words)


def test_nobody_is_told_to_install_from_an_index():
    """There is no package on one yet; the steps of a release say what comes after."""
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    kinds = (".md", ".rst", ".py", ".ipynb", ".toml", ".cff")
    told = [
        f"{name}: {line}"
        for name in files
        if name.endswith(kinds) and not name.startswith(("tests/docs/", "docs/release.md"))
        for line in (ROOT / name).read_text().splitlines()
        if re.search(r"pip install ['\"]?pellucid", line)
    ]
    assert not told, "\n".join(told)


def test_a_check_finds_what_is_not_there():
    """The checks of commands that are not run fail on what a typing error leaves."""
    for wrong in (
        "pellucid rendr teapot",
        "pellucid render teapot --sampels 3",
        "pellucid render teapot --method exactly",
        "pip install 'pellucid[viewer]'",
        "pip install '.[veiwer]'",
        "python benchmarks/figure3.py --quik",
        "python -m sphynx docs",
        "pellucidd render teapot",
    ):
        with pytest.raises(AssertionError):
            check_command(shlex.split(wrong))
