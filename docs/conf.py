"""Sphinx: the docs as HTML, from the pages here and the docstrings of the package.

``python -m sphinx -W -j auto docs docs/_build/html``, from the root of the repository. No network
is used.
"""

import contextlib
import importlib.util
import io
import os
import re
import shutil
from pathlib import Path

import potmesil_mi  # before mitsuba: it offers Dr.Jit a usable LLVM

# isort: split
import mitsuba as mi
from docutils import nodes
from docutils.parsers.rst.directives.tables import ListTable
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.config import Config
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective
from sphinx.writers.html5 import HTML5Translator

from potmesil_mi.plugins import PLUGINS

mi.set_variant("scalar_rgb")  # Classes of plugins derive from types of a variant; any will do.

# ---------------------------------------------------------------- the project

project = "potmesil_mi"
version = release = potmesil_mi.__version__
copyright = "BSD 3-Clause"

# ---------------------------------------------------------------- pages

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build", "extra"]
templates_path = ["_templates"]
root_doc = "index"
html_extra_path = ["extra"]  # Pages of their own, as they are.

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # Notebooks are kept with what they show.

MITSUBA_TYPES = ("bool", "bsdf", "film", "float", "int", "integrator", "point", "sampler", "string")
MITSUBA_TYPES += ("spectrum", "transform", "vector")
rst_prolog = "\n".join(f".. |{name}| replace:: *{name}*" for name in MITSUBA_TYPES)
"""Docstrings of plugins name types as those of Mitsuba do: ``|float|``."""

# ---------------------------------------------------------------- docstrings

autosummary_generate = True
autosummary_context = {"public": potmesil_mi.__all__}
autodoc_mock_imports = [] if importlib.util.find_spec("torch") else ["torch"]  # It is large.
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

nitpicky = True  # A reference to a name that is not there is an error, ...
nitpick_ignore_regex = [
    # ... but types in signatures may be those of other libraries, private, or type variables.
    (
        "py:.*",
        r"(np|numpy|mi|mitsuba|dr|drjit|jit|scipy|torch|OpenEXR|anywidget)\..*|ArrayLike|Table|Console|Path|Lens"
        r"|(abc|argparse|collections|dataclasses|os|pathlib|threading|types|typing|typing_extensions)\..*",
    ),
    ("py:.*", r"(.*\.)?(_\w+|[A-Z])"),
]

# ---------------------------------------------------------------- HTML

html_theme = "furo"
html_title = "potmesil_mi"
html_theme_options = {"navigation_with_keys": True}
html_show_copyright = False
html_show_sphinx = False
html_copy_source = False
html_math_renderer = "mathml"  # which browsers draw by themselves, and nothing is fetched for it


class PluginParameters(ListTable):
    """Mitsuba's directive for the parameters of a plugin: a table of three columns."""

    def run(self) -> list[nodes.Node]:
        """Nodes of the table, with a line of headings."""
        self.options.setdefault("widths", [22, 13, 65])
        self.options.setdefault("header-rows", 1)
        for line in ("  - Meaning", "  - Type", "* - Parameter"):
            self.content.insert(0, line, source=self.content.source(0))
        return super().run()


class CommandHelp(SphinxDirective):
    """``.. command-help:: render``: what ``potmesil render --help`` prints."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The text as it is on a terminal of 88 columns."""
        from potmesil_mi.cli import main

        os.environ.update(COLUMNS="88", NO_COLOR="1")
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            main([*self.arguments, "--help"])
        return [nodes.literal_block(text=printed.getvalue(), language="none")]


BAR = re.compile(rf"``.*?``|\\?\|(?:{'|'.join(MITSUBA_TYPES)})\||(\|)")


def keep_bars(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list) -> None:
    """In a docstring a bar is that of an absolute value, unless it stands around a type."""
    lines[:] = [BAR.sub(lambda bar: r"\|" if bar[1] else bar[0], line) for line in lines]


def skip_public(app: Sphinx, what: str, name: str, member: object, *rest: object) -> bool | None:
    """On the page of a module: what has a page of its own is not described again."""
    is_public = name in potmesil_mi.__all__ and getattr(potmesil_mi, name) is member
    is_plugin = name in {class_name for _, class_name in PLUGINS.values()}
    return True if what == "module" and (is_public or is_plugin) else None


def find_elsewhere(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.Element | None:
    """What a docstring names is in one place, or with a base class.

    ``Window`` is that of another module that is imported, ``Polygon.points`` may be described with
    ``Aperture``.
    """
    if node.get("refdomain") != "py" or node.get("refspecific"):
        return None
    node["refspecific"] = True
    target = node["reftarget"]
    owner, _, member = target.rpartition(".")
    kind = getattr(potmesil_mi, owner.rpartition(".")[2], None) if owner else None
    bases = kind.__mro__[1:] if isinstance(kind, type) else ()
    for name in (target, *(f"{base.__name__}.{member}" for base in bases)):
        found = env.domains.python_domain.resolve_xref(
            env, node["refdoc"], app.builder, node["reftype"], name, node, content
        )
        if found is not None:
            return found
    return None


def copy_notebooks(app: Sphinx, config: Config) -> None:
    """Sphinx reads pages of this folder only, so copies of the notebooks become some of them."""
    here = Path(app.srcdir)
    shutil.rmtree(here / "notebooks", ignore_errors=True)
    shutil.copytree(
        here.parent / "notebooks", here / "notebooks", ignore=lambda _, names: _others(names)
    )


def _others(names: list[str]) -> set[str]:
    return {name for name in names if not name.endswith(".ipynb")}


def link_within(app: Sphinx, page: str, source: list[str]) -> None:
    """Links are those of the repository; here notebooks stand elsewhere, and the rest are files."""
    text = re.sub(r"\]\((?=\.\./(README\.md|CONTRIBUTING\.md)\))", "](path:", source[0])
    text = re.sub(r"\]\(((?:\.\./)*)\.\./(notebooks/\w+\.ipynb)\)", r"](\1\2)", text)
    if page.startswith("notebooks/"):
        text = text.replace("](../docs/", "](../")
    source[0] = text


def math_in_line(writer: HTML5Translator, node: nodes.math) -> None:
    """A formula in a sentence as MathML."""
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def math_block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """A formula on a line of its own as MathML, with its number behind it."""
    number = re.search(r"\\tag\{(.*?)\}", node.astext())
    formula = tex2mathml(re.sub(r"\\tag\{.*?\}", "", node.astext()), as_block=True)
    writer.body.append(f'<div style="text-align: center; margin: 1em 0">{formula}')
    if number:
        writer.body.append(f'<div style="text-align: right">({writer.encode(number[1])})</div>')
    writer.body.append("</div>")
    raise nodes.SkipNode


def open_own_branch(app: Sphinx, page: str, template: str, context: dict, *rest: object) -> None:
    """Of the navigation, only the branch that a page is on is opened.

    A tree of all modules on the page of each of them takes most of the time of a build.
    """
    whole = context["toctree"]
    context["toctree"] = lambda **options: whole(**{**options, "collapse": True})


def setup(app: Sphinx) -> None:
    """Directives of this project, and what is done with docstrings."""
    app.connect("autodoc-skip-member", skip_public)
    app.connect("missing-reference", find_elsewhere)
    app.connect("config-inited", copy_notebooks)
    app.connect("source-read", link_within)
    app.add_html_math_renderer("mathml", (math_in_line, None), (math_block, None))
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("html-page-context", open_own_branch, priority=400)  # Before furo asks for it.
    app.add_directive("pluginparameters", PluginParameters)
    app.add_directive("command-help", CommandHelp)
