"""The page about the plug-ins names every parameter that their docstrings name, and the other way round."""

import re
from dataclasses import fields
from pathlib import Path

from pellucid.methods import METHODS, method_class
from pellucid.methods.single_pass.integrator import SinglePass
from pellucid.methods.texture_space.integrator import TextureSpace
from pellucid.methods.translucent import TranslucentBSDF
from pellucid.methods.two_pass import TwoPass

PAGE = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text()


def in_docstring(cls):
    lines = re.findall(r"\* - ([\w, ]+)\n", cls.__doc__)
    return {name.strip() for line in lines for name in line.split(",")}


def on_page(heading):
    section = PAGE.split(heading)[1].split("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]*) \|", section, flags=re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


def test_the_page_and_the_docstrings_name_the_same_parameters():
    assert on_page("## `pellucid_translucent`") == in_docstring(TranslucentBSDF)
    assert on_page("## `pellucid_two_pass`") == in_docstring(TwoPass)
    assert on_page("## `pellucid_single_pass`") == in_docstring(SinglePass)
    assert on_page("## `pellucid_texture_space`") == in_docstring(TextureSpace)
    for name in ("exact", "sampled"):
        assert "pellucid_two_pass" in method_class(name).__doc__


def test_docstrings_name_the_parameters_that_there_are():
    for name in ("two_pass", "single_pass", "texture_space"):
        cls = method_class(name)
        assert in_docstring(cls) == {field.name for field in fields(cls)}, name
    assert set(METHODS) == {method_class(name).name for name in METHODS}
