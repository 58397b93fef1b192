"""The code blocks of README and docs, and how each kind of them is tried out."""

import importlib.util
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from textwrap import dedent
from xml.etree import ElementTree

import click
import mitsuba as mi
import numpy as np
import trimesh

import pellucid
from pellucid.cli.main import pellucid as command_line

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOT_RUN = ("long", "server", "installation")
"""Marks of shell blocks whose commands are checked instead of run."""
FOREIGN = "another renderer"
"""Mark of a block that is not for this renderer: only its form is checked."""
BLOCK = re.compile(
    r"^(?: *<!-- (?P<mark>[^>]+) -->\n)?^(?P<indent> *)```(?P<language>\S*)[^\n]*\n(?P<text>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)
OF_THE_SYSTEM = (".", "brew", "cd", "export", "git", "sudo")
"""Commands that are not ours and are taken as they stand."""
WRITTEN = re.compile(r"file: (\S+)")
SCENE = """<scene version="3.0.0">
    <integrator type="pellucid_two_pass"/>
    <sensor type="perspective">
        <float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0, -120, 60" target="0, 0, 20" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="36"/></film>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="point"><point name="position" value="60, -60, 90"/><spectrum name="intensity" value="20000"/></emitter>
    <shape type="ply" id="bunny"><string name="filename" value="bunny.ply"/><bsdf type="pellucid_translucent"/></shape>
</scene>
"""


@dataclass(frozen=True)
class Block:
    """One fenced block: its page, the number of its first line, its language, its text and the mark above it."""

    page: Path
    line: int
    language: str
    text: str
    mark: str

    @property
    def file(self):
        """The file that the reader is told to write it to, if any."""
        written = WRITTEN.fullmatch(self.mark)
        return written[1] if written else None

    def __str__(self):
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@cache
def blocks_of(page):
    """List the blocks of a page; those whose language is in braces are directives of the site."""
    text = page.read_text()
    assert len(re.findall("^ *```", text, re.MULTILINE)) % 2 == 0, f"{page.name}: a block does not end"
    return [
        Block(page, text.count("\n", 0, m.start("text")) + 1, m["language"], dedent(m["text"]), m["mark"] or "")
        for m in BLOCK.finditer(text)
        if not m["language"].startswith("{")
    ]


class Folders:
    """A folder for each page, in which its blocks run in their order: later ones may read what earlier ones have written."""

    def __init__(self, parent):
        self.parent = parent
        self.tried = set()

    def of(self, page):
        """Make the folder of a page, with the files that all pages take for granted: a scene, a mesh and a texture of lengths."""
        folder = self.parent / page.stem
        if not folder.exists():
            folder.mkdir()
            trimesh.creation.icosphere(subdivisions=3, radius=20).apply_translation([0, 0, 20]).export(
                folder / "bunny.ply"
            )
            (folder / "scene.xml").write_text(SCENE)
            mi.Bitmap(np.full((2, 2, 1), 0.8, np.float32)).write(str(folder / "lengths.exr"))
        return folder

    def try_out(self, block):
        """Try a block, and before it the earlier ones of its page."""
        for earlier in blocks_of(block.page):
            if earlier not in self.tried and earlier.line <= block.line:
                self.tried.add(earlier)
                _try(earlier, self.of(earlier.page))


def _try(block, folder):
    """Run, load, parse or check a block, by its language and its mark."""
    assert not block.mark or block.file or block.mark in (*NOT_RUN, FOREIGN), f"unknown mark '{block.mark}'"
    if block.file:
        (folder / block.file).write_text(block.text)
    if block.language == "python":
        path = folder / (block.file or f"line_{block.line}.py")
        path.write_text(block.text)
        run([sys.executable, path.name], folder)
    elif block.language == "sh":
        for words in commands(block.text):
            check_command(words, folder)
        if block.mark not in NOT_RUN:
            run(["bash", "-euo", "pipefail", "-c", block.text], folder)
    elif block.language == "xml":
        _load(block, folder)
    elif block.language == "toml":
        tomllib.loads(block.text)
    else:
        assert block.language in ("text", "powershell"), f"{block}: no test knows the language '{block.language}'"


def run(command, folder):
    """Run a command of a page in a process of its own."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.pathsep.join(sys.path)}
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, f"{result.stdout}\n{result.stderr}"
    assert "warning: " not in result.stderr, result.stderr


def _load(block, folder):
    """Parse XML, and let Mitsuba load it; what is no whole scene is put into one."""
    text = block.text if block.text.startswith("<scene") else f'<scene version="3.0.0">\n{block.text}</scene>\n'
    ElementTree.fromstring(text)
    if block.mark != FOREIGN:
        path = folder / (block.file or f"line_{block.line}.xml")
        path.write_text(text)
        assert isinstance(pellucid.load_scene(path), mi.Scene)


def commands(text):
    """Split shell lines into commands, each a list of words."""
    found = []
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="&|;>")
        lexer.whitespace_split = True
        words = []
        for word in [*lexer, ";"]:
            if word in ("&&", "||", "|", ";"):
                found += [words] if words else []
                words = []
            else:
                words.append(word)
    return found


def check_command(words, folder=ROOT):
    """Check that a command, and each of its options, exists."""
    program, arguments = Path(words[0]).name, words[1:]
    if program == "pellucid":
        check_pellucid(arguments)
    elif program == "pip":
        check_extras(arguments)
    elif program in ("python", "python3"):
        check_python(arguments, folder)
    elif program == "ssh":
        check_command(arguments[arguments.index("pellucid") :])
    else:
        assert words[0] in OF_THE_SYSTEM, f"no test knows the command '{program}'"


def check_pellucid(arguments):
    """Let the command line parse arguments without doing what they say."""
    above = click.Context(command_line, **command_line.context_settings)
    try:
        name, command, rest = command_line.resolve_command(above, list(arguments))
        command.make_context(name, rest, parent=above)
    except click.exceptions.Exit:
        pass  # of --help
    except click.ClickException as error:
        raise AssertionError(f"pellucid {shlex.join(arguments)}: {error.format_message()}") from None


def check_extras(arguments):
    """Check that pip installs this checkout or a wheel made of it, and extras that it has."""
    known = extras()
    place = re.fullmatch(r"(?:\.|dist/\S+\.whl)(?:\[([\w,]+)\])?", arguments[-1])
    assert place, f"pip {shlex.join(arguments)}: no index has pellucid yet"
    for extra in (place[1] or "").split(","):
        assert not extra or extra in known, f"there is no extra '{extra}'"


def extras():
    """Read the extras of the package: lists of requirements by name."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def check_python(arguments, folder):
    """Check that a module or a script exists, and that the help of a script names the options."""
    if arguments[0] == "-m":
        required = {re.match(r"[\w-]+", requirement)[0] for some in extras().values() for requirement in some}
        found = arguments[1] in required or importlib.util.find_spec(arguments[1]) is not None
        assert found, f"there is no module {arguments[1]}"
        return
    script = next(path for path in (folder / arguments[0], ROOT / arguments[0]) if path.is_file())
    options = {word.partition("=")[0] for word in arguments[1:] if word.startswith("-")}
    if options:
        help_text = subprocess.run([sys.executable, script, "--help"], capture_output=True, text=True, cwd=ROOT).stdout
        assert all(option in help_text for option in options), f"{arguments}\n{help_text}"
