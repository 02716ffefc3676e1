"""HTML pages from templates. Pages load no other file; all texts in them are escaped."""

import base64
import functools
import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from leglab.base.output import write_atomically
from leglab.report.page.glossary import Glossary
from leglab.report.page.wording import printable
from leglab.report.style import ORANGE, SERIES

_PACKAGE = "leglab.report.page"

# The colours of SERIES for a dark background, bright enough to be visible on it.
_SERIES_IN_THE_DARK = ("#F2F2F2", "#4DA6E0", ORANGE, "#1DBF91", "#D98DB7", "#A5D8F5")

# Directives of the content security policy that are set to 'none'. `base-uri` and `form-action` do
# not default to `default-src`; the others stay forbidden if `default-src` is loosened later.
_FORBIDDEN = (
    *("default-src", "connect-src", "form-action", "base-uri", "frame-src", "child-src"),
    *("worker-src", "object-src", "font-src", "manifest-src"),
)


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table whose first columns are words and the others numbers."""

    caption: str  #: Content of the table, with the unit
    head: Sequence[str]  #: Names of the columns
    rows: Sequence[Sequence[str]]  #: Cells as text, one per column in each row
    words: int = 1  #: Number of columns that are words
    heads: bool = True  #: Whether the first cell of each row names the row


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of a page: a question and its answer."""

    title: str  #: The question
    lines: tuple[str, ...]  #: Answers, a sentence or two each
    names: tuple[str, ...] = ()  #: Subject of each line; empty if they share one


def render(template: str, *, scripts: Sequence[str] = (), **content: Any) -> str:
    """Fills a template.

    Args:
        template: File name in `templates`.
        scripts: JavaScript to inline, in this order, after `guard.js`, which keeps the reader on
            the page; browsers run no other script.
        content: Variables of the template; all text is escaped.
    """
    page = _environment().get_template(template)
    scripts = (asset("guard.js"), *scripts) if scripts else ()
    css, inlined = Markup(_colors() + asset("page.css")), [Markup(script) for script in scripts]
    given = {"css": css, "policy": _policy(scripts), "scripts": inlined, "words": Glossary()}
    return page.render(**given, **content)


@functools.cache
def asset(name: str) -> str:
    """Returns the text of a style sheet or script of this package."""
    return resources.files(_PACKAGE).joinpath("assets", name).read_text(encoding="utf-8")


def file_link(path: Path, base: Path) -> str:
    """Returns the URL of a file for pages in the folder `base`: relative and quoted."""
    relative = os.path.relpath(path.resolve(), base.resolve())
    # Without "./", a first part with a colon would be read as the scheme of the URL.
    return "./" + quote(Path(relative).as_posix(), errors="surrogateescape")


def inlined(content: bytes) -> str:
    """Encodes a picture or film in base64, for inlining into a page."""
    return base64.b64encode(content).decode()


def link(text: str, path: Path, base: Path) -> Markup:
    """Returns a text that links to a file, for pages in the folder `base`."""
    return Markup('<a href="{}">{}</a>').format(file_link(path, base), printable(text))


def write_page(text: str, path: Path) -> Path:
    """Writes a page, possibly over an earlier page, and returns its path.

    Raises:
        LeglabError: The page cannot be written.
    """
    write_atomically(path, lambda stream: stream.write(text.encode(errors="replace")))
    return path


def inline_json(content: Any) -> Markup:
    """Encodes content as JSON that is safe inside a script element, whatever its texts are."""
    text = json.dumps(content, allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_finished,
    )
    environment.globals["inline_json"] = inline_json
    return environment


def _finished(value: Any) -> Any:
    return printable(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def _policy(scripts: Sequence[str]) -> str:
    """Returns a content security policy: only these scripts run, nothing is loaded or sent."""
    digests = (base64.b64encode(hashlib.sha256(s.encode()).digest()).decode() for s in scripts)
    allowed = {
        "script-src": " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'",
        "style-src": "'unsafe-inline'",
        "img-src": "data: blob:",
        "media-src": "data: blob:",
    }
    rules = dict.fromkeys(_FORBIDDEN, "'none'") | allowed
    return "; ".join(f"{name} {sources}" for name, sources in rules.items())


def _colors() -> str:
    """Returns the colours of the runs as variables of the style sheet."""

    def variables(colors: Sequence[str]) -> str:
        return " ".join(f"--run-{i}: {color};" for i, color in enumerate(colors))

    dark = f"@media (prefers-color-scheme: dark) {{ :root {{ {variables(_SERIES_IN_THE_DARK)} }}"
    return f":root {{ {variables(SERIES)} }}\n{dark} }}\n"
