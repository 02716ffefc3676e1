"""Sphinx: `make docs` builds these pages and the API reference into out/docs."""

import os
import re
import subprocess
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent

project = "leglab"
author = "leglab"
release = metadata.version("leglab")


def _commit():
    """The checkout by its nearest tag and commit, "+" if files were changed; "" outside git."""
    command = ["git", "describe", "--tags", "--always", "--dirty=+"]
    try:
        done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return f" ({done.stdout.strip()})"


html_title = f"leglab {release}{_commit()}"  # on every page: which version it is of
# Address of the published site: canonical links and a sitemap need one.
html_baseurl = os.environ.get("LEGLAB_DOCS_URL", "")
html_baseurl += "/" if html_baseurl and not html_baseurl.endswith("/") else ""

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "myst_parser",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
templates_path = ["_templates"]
exclude_patterns = ["_templates", "_tools", "data"]
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
# For search engines; pages with front matter have descriptions of their own.
myst_html_meta = {
    "description": "leglab: hydraulic humanoid-leg control on MuJoCo, with worn seals, "
    "changing oil, controllers that re-adapt, and a diagnosis that names what a simulation lacks",
}

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_show_copyright = False  # the license says it
html_use_index = False  # one page of all names is 50,000 px high; search finds them
html_static_path = ["_static"]
html_css_files = ["leglab.css"]
html_theme_options = {"navigation_with_keys": True}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
highlight_language = "none"  # of blocks that name none: terminals and formulas
copybutton_prompt_text = "$ "


def _escape_bars(app, what, name, obj, options, lines):
    """|v| in a docstring is a magnitude, not a substitution of reStructuredText."""
    del app, what, name, obj, options
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        lines[i] = "".join(p if p.startswith("`") else p.replace("|", "\\|") for p in parts)


_KEPT = {}


def _keep_attribute(app, what, name, obj, options, lines):
    """Keeps the text beside a field from napoleon, to which a colon in it ends a type."""
    del app, obj, options
    if what == "attribute":
        _KEPT[name] = list(lines)


def _restore_attribute(app, what, name, obj, options, lines):
    """Puts it back."""
    del app, obj, options
    if what == "attribute":
        lines[:] = _KEPT.pop(name)


def _skip(app, what, name, obj, skip, options):
    """Fields of a named tuple are described by its docstring."""
    del app, what, name, options
    return True if str(obj.__doc__).startswith("Alias for field number") else skip


def _write_sitemap(app, exception):
    """Lists all pages for search engines, where the site has an address."""
    if exception or not app.config.html_baseurl or app.builder.name != "html":
        return
    pages = sorted(app.env.found_docs)
    links = "".join(
        f"<url><loc>{app.config.html_baseurl}{page}.html</loc></url>\n" for page in pages
    )
    head = '<?xml version="1.0" encoding="utf-8"?>\n'
    namespace = "http://www.sitemaps.org/schemas/sitemap/0.9"
    text = f'{head}<urlset xmlns="{namespace}">\n{links}</urlset>\n'
    (app.outdir / "sitemap.xml").write_text(text, encoding="utf-8")


def setup(app):
    """Connects these."""
    app.connect("build-finished", _write_sitemap)
    app.connect("autodoc-skip-member", _skip)
    for priority, hook in ((400, _keep_attribute), (600, _restore_attribute), (700, _escape_bars)):
        app.connect("autodoc-process-docstring", hook, priority=priority)
