"""Sphinx: `make docs` builds these pages and the API reference into out/docs."""

import re
from importlib import metadata

project = "leglab"
author = "leglab"
release = metadata.version("leglab")
html_title = f"leglab {release}"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "myst_parser",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
# Pages of parts that may not be built in.
OPTIONAL = ("environment", "report", "viewer", "command_line", "data_formats")
templates_path = ["_templates"]
exclude_patterns = ["_templates", "data"]
autosummary_generate = True
# `name` in a docstring is code, as in Markdown.
default_role = "literal"
# Types of other packages are not resolved: the build needs no network. Names without a dot are
# type variables and aliases.
nitpick_ignore_regex = [
    ("py:.*", r"(?!leglab\.).*"),
    ("py:.*", r"leglab\.((.*\.)?_.*|.*\.(Model|Entry|Item|Result|Factory|T))"),
]

# Pages are read on their own as well, so headings are linked to by their text.
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["leglab.css"]
html_theme_options = {"navigation_with_keys": True}
pygments_style = "friendly"
pygments_dark_style = "monokai"
copybutton_prompt_text = "$ "


def _escape_bars(app, what, name, obj, options, lines):
    """|v| in a docstring is a magnitude, not a substitution of reStructuredText."""
    del app, what, name, obj, options
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        lines[i] = "".join(p if p.startswith("`") else p.replace("|", "\\|") for p in parts)


def _drop_missing(app, docname, source):
    """Takes pages that are not there out of the table of contents."""
    if docname == "index":
        for name in OPTIONAL:
            if not (app.srcdir / f"{name}.md").exists():
                source[0] = source[0].replace(f"\n{name}\n", "\n")


def _skip(app, what, name, obj, skip, options):
    """Fields of a named tuple are described by its docstring."""
    del app, what, name, options
    return True if str(obj.__doc__).startswith("Alias for field number") else skip


def setup(app):
    """Connects these."""
    app.connect("autodoc-skip-member", _skip)
    app.connect("autodoc-process-docstring", _escape_bars)
    app.connect("source-read", _drop_missing)
