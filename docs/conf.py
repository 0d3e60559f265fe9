"""Sphinx: the docs as HTML, from the pages here and the docstrings of the package.

``python -m sphinx -W docs docs/_build/html``, from the root of the repository. No network is used.
"""

import contextlib
import io
import os
import re

import potmesil_mi  # before mitsuba: it offers Dr.Jit a usable LLVM

# isort: split
import mitsuba as mi
from docutils import nodes
from docutils.parsers.rst.directives.tables import ListTable
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxDirective

from potmesil_mi.plugins import PLUGINS

mi.set_variant("scalar_rgb")  # Classes of plugins derive from types of a variant; any will do.

# ---------------------------------------------------------------- the project

project = "potmesil_mi"
version = release = potmesil_mi.__version__
copyright = "BSD 3-Clause"

# ---------------------------------------------------------------- pages

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build", "extra"]
templates_path = ["_templates"]
root_doc = "index"
html_extra_path = ["extra"]  # Pages of their own, as they are.

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3

MITSUBA_TYPES = ("bool", "bsdf", "film", "float", "int", "integrator", "point", "sampler", "string")
MITSUBA_TYPES += ("spectrum", "transform", "vector")
rst_prolog = "\n".join(f".. |{name}| replace:: *{name}*" for name in MITSUBA_TYPES)
"""Docstrings of plugins name types as those of Mitsuba do: ``|float|``."""

# ---------------------------------------------------------------- docstrings

autosummary_generate = True
autosummary_context = {"public": potmesil_mi.__all__}
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
        r"(np|numpy|mi|mitsuba|dr|drjit|jit|scipy|OpenEXR)\..*|ArrayLike|Table|Console|Path|Lens"
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


def link_as_files(app: Sphinx, page: str, source: list[str]) -> None:
    """Pages beside this folder are files here: they are made for reading in the repository."""
    source[0] = re.sub(
        r"\]\((?=\.\./(README\.md|CONTRIBUTING\.md|notebooks/\w+\.ipynb)\))", "](path:", source[0]
    )


def setup(app: Sphinx) -> None:
    """Directives of this project, and what is done with docstrings."""
    app.connect("autodoc-skip-member", skip_public)
    app.connect("missing-reference", find_elsewhere)
    app.connect("source-read", link_as_files)
    app.connect("autodoc-process-docstring", keep_bars)
    app.add_directive("pluginparameters", PluginParameters)
    app.add_directive("command-help", CommandHelp)
