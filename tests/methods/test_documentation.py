"""The page about the plug-ins names every parameter that their docstrings name, and the other way round."""

import re
from pathlib import Path

from pellucid.methods.exact import ExactIntegrator
from pellucid.methods.sampled import SampledIntegrator
from pellucid.methods.single_pass.integrator import SinglePassIntegrator
from pellucid.methods.texture_space.integrator import TextureSpaceIntegrator
from pellucid.methods.translucent import TranslucentBSDF
from pellucid.methods.two_pass import TwoPassIntegrator

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
    assert on_page("## `pellucid_two_pass`") == in_docstring(TwoPassIntegrator)
    assert on_page("## `pellucid_single_pass`") == in_docstring(SinglePassIntegrator)
    assert on_page("## `pellucid_texture_space`") == in_docstring(TextureSpaceIntegrator)
    for cls in (ExactIntegrator, SampledIntegrator):
        assert "pellucid_two_pass" in cls.__doc__
