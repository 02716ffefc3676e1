"""The page of a diagnosis: verdict in words, numbers, figures; one file, no network."""

import base64
import io
from collections.abc import Iterable, Sequence
from functools import partial
from html import escape
from pathlib import Path

from leglab.data import write_atomically
from leglab.diagnosis.result import Diagnosis
from leglab.errors import LeglabError
from leglab.report.diagnosis.figures import (
    Picture,
    gap_picture,
    look,
    ranking_picture,
    rivals_picture,
)
from leglab.report.diagnosis.residuals import residual_pictures
from leglab.report.diagnosis.words import headline, number, parameter_words, percent, sections

_DPI = 130
_KINDS = {
    "named": "named",
    "confusion_set": "confusion set",
    "partial": "partly named",
    "unexplained": "unexplained",
    "nothing_missing": "nothing missing",
}
# In the dark, figures are inverted and their hues turned back: white becomes the page's #1a1a1a.
_CSS = """
:root { color-scheme: light dark; --ink: #1b1b1b; --soft: #595959; --page: #ffffff;
  --line: #d9d9d9; --box: #f4f6f8; --mark: #0072b2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e8e8; --soft: #ababab; --page: #1a1a1a;
  --line: #3d3d3d; --box: #242628; --mark: #6bb8e8; }
  img { filter: invert(0.9) hue-rotate(180deg); } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 50rem; color: var(--ink);
  background: var(--page); font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.3rem 0 1rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 0.6rem; }
.kind { margin: 0; color: var(--mark); font-weight: 600; }
dl { margin: 0; padding: 0.9rem 1.1rem; background: var(--box); border-radius: 0.5rem; }
dt { font-weight: 600; }
dd { margin: 0 0 0.8rem; }
dd:last-child { margin-bottom: 0; }
dd p { margin: 0 0 0.15rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; margin-bottom: 1rem; }
caption { text-align: left; color: var(--soft); padding-bottom: 0.3rem; }
th, td { text-align: left; padding: 0.3rem 0.9rem 0.3rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; overflow-wrap: normal; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: 0 0 2rem; }
figcaption { color: var(--soft); font-size: 0.9rem; margin-top: 0.3rem; }
img { display: block; width: 100%; min-width: 34rem; height: auto; }
a { color: var(--mark); }
"""


def write_page(result: Diagnosis, folder: Path, *, model: str) -> Path:
    """Writes DIR/diagnosis.html and DIR/figures/*.png; figures of an earlier diagnosis go.

    Args:
        result: The diagnosis.
        folder: Existing folder.
        model: Name of the model that was diagnosed.

    Returns:
        Path of the page.

    Raises:
        LeglabError: The folder cannot be written to.
    """
    place = folder / "figures"
    try:
        place.mkdir(exist_ok=True)
        for old in place.glob("*.png"):
            old.unlink()
    except OSError as error:
        raise LeglabError(f"{place}: cannot be written: {error.strerror}") from error
    drawn = []
    for picture in pictures(result):
        image = _png(picture)
        write_atomically(place / f"{picture.name}.png", partial(_put, image))
        drawn.append((picture, image))
    path = folder / "diagnosis.html"
    write_atomically(path, partial(_put, page(result, drawn, model=model).encode()))
    return path


def pictures(result: Diagnosis) -> tuple[Picture, ...]:
    """All figures that the diagnosis has content for, in the order of the page."""
    found = (gap_picture(result), ranking_picture(result), rivals_picture(result))
    return (*(p for p in found if p is not None), *residual_pictures(result))


def page(result: Diagnosis, drawn: Sequence[tuple[Picture, bytes]], *, model: str) -> str:
    """The page as well-formed XHTML that is HTML 5 as well.

    Args:
        result: The diagnosis.
        drawn: Figures, each with its PNG.
        model: Name of the model that was diagnosed.
    """
    title = headline(result)
    figures = "".join(_figure(picture, image) for picture, image in drawn)
    return f"""<!DOCTYPE html>
<html lang="en" xmlns="http://www.w3.org/1999/xhtml">
<head>
<meta charset="utf-8" />
<meta name="viewport" content="width=device-width, initial-scale=1" />
<title>Diagnosis of {_safe(model)}: {_KINDS[result.verdict]}</title>
<style>{_CSS}</style>
</head>
<body>
<main>
<p class="kind">Verdict: {_KINDS[result.verdict]}</p>
<h1>{_safe(title)}</h1>
<dl>
{_story(result, model)}</dl>
<h2>Numbers</h2>
{_effects_table(result)}{_gap_table(result)}{_nuisance_table(result)}{_model_link(result)}
<h2>Figures</h2>
{figures}</main>
</body>
</html>
"""


def _story(result: Diagnosis, model: str) -> str:
    text = ""
    for section in sections(result, model):
        lines = "".join(f"<p>{_safe(line)}</p>" for line in section.lines)
        text += f"<dt>{_safe(section.title)}</dt><dd>{lines}</dd>\n"
    return text


def _effects_table(result: Diagnosis) -> str:
    rows = []
    for effect in result.effects:
        told = [percent(effect.confidence), percent(effect.contribution)]
        for i, parameter in enumerate(effect.parameters):
            head = [effect.name, effect.element] if i == 0 else ["", ""]
            tail = told if i == 0 else ["", ""]
            rows.append([*head, parameter.name, *parameter_words(parameter), *tail])
        if not effect.parameters:
            rows.append([effect.name, effect.element, "", "", "", "", *told])
    head = ["effect", "element", "parameter", "value", "95 % interval", "in the model"]
    return _table("Missing effects", [*head, "confidence", "contribution"], rows, words=3)


def _gap_table(result: Diagnosis) -> str:
    rows = [
        [
            r.name,
            "held out" if r.held_out else "fitted",
            *(number(v) for v in (r.before, r.baseline, r.after)),
        ]
        for r in result.recordings
    ]
    caption = f"{result.gap.metric} (noise alone gives {number(result.gap.noise_floor)})"
    head = ["recording", "use", "before", "recalibrated", "after"]
    return _table(caption[:1].upper() + caption[1:], head, rows, words=2)


def _nuisance_table(result: Diagnosis) -> str:
    rows = [[n.name, *parameter_words(n)] for n in result.nuisances]
    head = ["parameter", "refitted", "tolerance, 95 %", "in the model"]
    return _table("Parameters refitted within their tolerance", head, rows, words=1)


def _table(caption: str, head: Sequence[str], rows: Iterable[Sequence[str]], *, words: int) -> str:
    """A table whose first columns are words and the others numbers; nothing without rows."""
    kinds = ["" if i < words else ' class="number"' for i in range(len(head))]
    lines = "".join(
        f"<tr>{''.join(f'<td{k}>{_safe(v)}</td>' for k, v in zip(kinds, row, strict=True))}</tr>\n"
        for row in rows
    )
    if not lines:
        return ""
    names = "".join(f'<th scope="col"{k}>{_safe(n)}</th>' for k, n in zip(kinds, head, strict=True))
    return (
        f'<div class="wide"><table><caption>{_safe(caption)}</caption>\n'
        f"<thead><tr>{names}</tr></thead>\n<tbody>{lines}</tbody></table></div>\n"
    )


def _model_link(result: Diagnosis) -> str:
    if not result.model:
        return ""
    name = _safe(result.model)
    return f'<p>The model with what was found, ready to run: <a href="{name}">{name}</a>.</p>\n'


def _figure(picture: Picture, image: bytes) -> str:
    data = base64.b64encode(image).decode()
    return (
        f'<figure><div class="wide"><img alt="{_safe(picture.alt)}" '
        f'src="data:image/png;base64,{data}" /></div>\n'
        f"<figcaption>{_safe(picture.caption)}</figcaption></figure>\n"
    )


def _safe(text: str) -> str:
    """Escaped, and without control characters, which no HTML may hold."""
    return escape("".join(c if c.isprintable() or c == " " else "\ufffd" for c in text))


def _png(picture: Picture) -> bytes:
    stream = io.BytesIO()
    with look():
        picture.figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()


def _put(content: bytes, stream: io.BufferedIOBase) -> None:
    stream.write(content)
