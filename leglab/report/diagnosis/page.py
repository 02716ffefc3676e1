"""The page of a diagnosis: verdict in words, numbers, figures; one file, no network."""

import base64
import io
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from leglab.base.errors import LeglabError
from leglab.data import write_atomically
from leglab.diagnosis.result import Diagnosis
from leglab.report.diagnosis.figures import look, pictures
from leglab.report.diagnosis.words import headline, parameter_words, percent, sections
from leglab.report.page.shell import Table, render
from leglab.report.page.wording import capital, number

_DPI = 130
_KINDS = {
    "named": "named",
    "confusion_set": "confusion set",
    "partial": "partly named",
    "unexplained": "unexplained",
    "nothing_missing": "nothing missing",
}


def write_page(result: Diagnosis, folder: Path, *, model: str) -> Path:
    """Writes `DIR/diagnosis.html` and `DIR/figures/*.png`; figures of an earlier diagnosis go.

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
        stream = io.BytesIO()
        with look():
            picture.figure.savefig(stream, format="png", dpi=_DPI)
        image = stream.getvalue()
        write_atomically(place / f"{picture.name}.png", partial(_put, image))
        data = base64.b64encode(image).decode()
        drawn.append({"alt": picture.alt, "caption": picture.caption, "data": data})
    path = folder / "diagnosis.html"
    write_atomically(path, partial(_put, _page(result, drawn, model).encode()))
    return path


def _page(result: Diagnosis, figures: Sequence[dict[str, str]], model: str) -> str:
    """Returns the page as well-formed XHTML that is HTML 5 as well; figures hold base64 data."""
    return render(
        "diagnosis.html",
        kind="diagnosis",
        model=model,
        verdict=_KINDS[result.verdict],
        headline=headline(result),
        sections=sections(result, model),
        tables=(_effects_table(result), _gap_table(result), _nuisance_table(result)),
        improved=result.model,
        figures=figures,
    )


def _effects_table(result: Diagnosis) -> Table:
    rows = []
    for effect in result.effects:
        told = [percent(effect.confidence), percent(effect.contribution)]
        for i, parameter in enumerate(effect.parameters):
            first = [effect.name, effect.element] if i == 0 else ["", ""]
            last = told if i == 0 else ["", ""]
            rows.append([*first, parameter.name, *parameter_words(parameter), *last])
        if not effect.parameters:
            rows.append([effect.name, effect.element, "", "", "", "", *told])
    names = ("effect", "element", "parameter", "value", "95 % interval", "in the model")
    head = (*names, "confidence", "contribution")
    # A further parameter of an effect has an empty first cell, which heads no row.
    return Table(caption="Missing effects", head=head, rows=rows, words=3, heads=False)


def _gap_table(result: Diagnosis) -> Table:
    rows = []
    for r in result.recordings:
        errors = map(number, (r.before, r.baseline, r.after))
        rows.append([r.name, "held out" if r.held_out else "fitted", *errors])
    caption = f"{result.gap.metric} (noise alone gives {number(result.gap.noise_floor)})"
    head = ("recording", "use", "before", "recalibrated", "after")
    return Table(caption=capital(caption), head=head, rows=rows, words=2)


def _nuisance_table(result: Diagnosis) -> Table:
    rows = [[n.name, *parameter_words(n)] for n in result.nuisances]
    head = ("parameter", "refitted", "tolerance, 95 %", "in the model")
    return Table(caption="Parameters refitted within their tolerance", head=head, rows=rows)


def _put(content: bytes, stream: io.BufferedIOBase) -> None:
    stream.write(content)
