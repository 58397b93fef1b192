"""How the documentation is built: ``python -m sphinx -W --keep-going docs out/site``."""

import os
import sys
from pathlib import Path
from textwrap import dedent

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.parsers.rst.directives.tables import ListTable
from docutils.statemachine import StringList
from docutils.utils.math.latex2mathml import tex2mathml

import pellucid

sys.path.insert(0, str(Path(__file__).parent))
import live  # which pages run in the site  # isort: skip
import mitsuba as mi  # isort: skip  (after pellucid, which chooses the LLVM)

mi.set_variant("llvm_ad_rgb")  # the classes of the plug-ins exist once a variant is active

project = "pellucid"
author = "The pellucid developers"
project_copyright = author
version = release = pellucid.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["figures", "gallery", "_live"]
suppress_warnings: list[str] = []

nitpicky = True  # a reference to what is not there is a warning, and -W makes warnings errors
nitpick_ignore_regex = [("py:class", ".*")]  # but for types, which docstrings write as prose: ``(n, 3) float``
default_role = "literal"  # single backticks of docstrings

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
nb_execution_mode = (
    "off"  # tests/docs/test_notebook.py executes notebooks, and compares their pictures with those shown here
)

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
napoleon_custom_sections = ["Source"]
# What the pages of Mitsuba's plug-ins call the types of their parameters.
rst_prolog = "\n".join(f".. |{kind}| replace:: {kind}" for kind in ("string", "float", "int", "bool", "rgb", "texture"))

LIVE = Path(os.environ.get("PELLUCID_LIVE", Path(__file__).parent / "_live"))
html_extra_path = [str(LIVE)] if LIVE.exists() else []

html_theme = "furo"
html_title = f"pellucid {version}"
html_theme_options = {"source_directory": "docs/"}
html_copy_source = False
html_show_sphinx = False


class PluginParameters(ListTable):
    """The table of parameters in the docstring of a plug-in, as Mitsuba writes it: name, type, meaning."""

    def run(self):
        """Put the head of the table before its rows."""
        head = ["* - Parameter", "  - Type", "  - Description"]
        rows = dedent("\n".join(self.content)).splitlines()
        self.content = StringList([*head, *rows], self.content.source(0))
        self.options |= {"header-rows": 1, "widths": [20, 15, 65]}
        return super().run()


class LivePage(Directive):
    """An exported page that runs in the site, if ``python docs/live.py`` has written it; else the command that does."""

    required_arguments = 1

    def run(self):
        """Make a frame, or a line of text."""
        name = self.arguments[0]
        shown = f"pellucid {' '.join(live.command(name))}"
        if not (LIVE / "live" / f"{name}.html").exists():
            text = [nodes.Text("A page that turns: "), nodes.literal(shown, shown), nodes.Text(" writes it.")]
            return [nodes.paragraph("", "", *text)]
        place = f"live/{name}.html"
        frame = f'<iframe src="{place}" title="{name}" loading="lazy" width="100%" height="480"></iframe>'
        link = f'<p><a href="{place}">Open it alone</a>: <code>{shown}</code></p>'
        return [nodes.raw("", frame + link, format="html")]


def visit_math(self, node):
    """Write a formula as MathML, which browsers draw without a script from elsewhere."""
    self.body.append(tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def keep_colon(app, what, name, obj, options, lines):
    """Keep napoleon from reading ``coefficient [1/mm]: (3,) float`` as a type and its description."""
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # an empty comment, for it reads the first line only


def setup(app):
    """Register what the docstrings are written with."""
    app.connect("autodoc-process-docstring", keep_colon, priority=400)  # before napoleon, at 500
    app.add_directive("pluginparameters", PluginParameters)
    app.add_directive("live", LivePage)
    app.add_generic_role("monosp", nodes.literal)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))


html_math_renderer = "mathml"
