"""The HTML page of a diagnosis with verdict, numbers and figures, in one self-contained file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from leglab.base.output import cannot_write, piece, write_atomically
from leglab.diagnosis.result import Diagnosis, shown_unit
from leglab.report.diagnosis import words
from leglab.report.diagnosis.figures import CaptionedFigure, pictures
from leglab.report.diagnosis.why import tried_rows
from leglab.report.figures import png
from leglab.report.page import shell
from leglab.report.page.shell import Table, inlined, render
from leglab.report.page.wording import capital, number, readable

_MOST_DEPARTED = 12
# Figures of measured and simulated signals come before all others.
_FIRST = ("overlay", "whole")


def write_page(result: Diagnosis, folder: Path, *, model: str) -> Path:
    """Writes `DIR/diagnosis.html` and `DIR/figures/*.png`; deletes earlier figures.

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
        raise cannot_write(place, error) from error
    drawn = []
    for picture in pictures(result):
        with piece(f"figures/{picture.name}.png", result.missing):
            drawn.append(_drawn(picture, place))
    return shell.write_page(_page(result, drawn, model), folder / "diagnosis.html")


def _drawn(picture: CaptionedFigure, place: Path) -> dict[str, str]:
    """Writes a figure to a folder; returns its name, texts and image data for the page."""
    image = png(picture.figure)
    write_atomically(place / f"{picture.name}.png", lambda file: file.write(image))
    told = {"name": picture.name, "alt": picture.alt, "caption": picture.caption}
    return {**told, "data": inlined(image)}


def _page(result: Diagnosis, figures: Sequence[dict[str, str]], model: str) -> str:
    """Returns the page as well-formed XHTML that is also HTML 5, with figures as base64 data."""
    return render(
        "diagnosis.html",
        kind="diagnosis",
        model=model,
        kind_of_result="Diagnosis" if result.recalibrated else "Fit",
        verdict=readable(result.verdict),
        headline=words.headline(result),
        facts=[(term, text.splitlines()) for term, text in words.facts(result)],
        sections=words.sections(result, model),
        tables=(
            _effects_table(result),
            _correlation_table(result),
            _remaining_table(result),
            _gap_table(result),
            *_calibration_tables(result),
            _moved_table(result),
            Table(
                caption="Fitted sets of effects, with small deviations of all other parameters",
                head=("set", "reason", "noise levels", "nats behind the best"),
                rows=tried_rows(result),
                words=2,
            ),
            Table(
                caption="What these recordings hardly show",
                head=("effect", "element", "to see it"),
                rows=[[readable(n.name), n.element, n.reason] for n in result.not_testable],
                words=3,
            ),
        ),
        improved=result.model,
        changed=result.changed[2:],
        improved_words=words.improved_words(result),
        missing=result.missing,
        first=[figure for figure in figures if figure["name"] in _FIRST],
        figures=[figure for figure in figures if figure["name"] not in _FIRST],
    )


def _effects_table(result: Diagnosis) -> Table:
    rows = []
    for effect, smaller in result.all_effects:
        first = [f"{readable(effect.name)}{' (smaller)' * smaller}", effect.element]
        last = []
        if result.recalibrated:
            last = [words.confidence(result, effect), words.percent(effect.contribution)]
        for parameter in effect.estimates:
            value, ends, nominal, unit = words.parameter_numbers(parameter)
            name = f"{readable(parameter.name)}{', uncertain' * words.uncertain(parameter)}"
            rows.append([*first, name, unit, value, ends, nominal, *last])
            first, last = ["", ""], [""] * len(last)
        if not effect.estimates:
            rows.append([*first, *[""] * 5, *last])
    names = ("effect", "element", "parameter", "unit", "value", "95 % interval")
    told = ("confidence", "of the gap") if result.recalibrated else ()
    head = (*names, result.nominal_words, *told)
    changed = "What changed" if result.calibration else "Missing effects"
    changed = "Fitted parameters" if result.verdict == "fitted" else changed
    # No row headers: the first cell is empty for all but the first parameter of an effect.
    return Table(caption=changed, head=head, rows=rows, words=4, heads=False)


def _correlation_table(result: Diagnosis) -> Table:
    names, matrix = result.covariance or ((), np.zeros((0, 0)))
    spread = np.sqrt(np.diag(matrix))
    rows = [
        [f"{i + 1}: {name}", *(f"{r:.2f}" for r in matrix[i] / (spread[i] * spread))]
        for i, name in enumerate(names if len(names) > 1 else ())
    ]
    head = ("parameter", *(str(i + 1) for i in range(len(names))))
    return Table(caption="Correlation of the estimates", head=head, rows=rows)


def _remaining_table(result: Diagnosis) -> Table:
    rows = []
    for one in result.remaining:
        factor, unit = shown_unit(one.unit)
        errors = [one.before, one.after, *([] if one.learned is None else [one.learned])]
        values = [f"{number(factor * v)} {unit}" for v in errors]
        rows.append([readable(one.channel), *values, words.noise_words(one)])
    caption = f"What is left {words.after_start(result)}, RMS over the held-out recordings"
    told = any(one.learned is not None for one in result.remaining)
    learned = ("with what was learned",) if told else ()
    head = ("measured", "before", "after", *learned, "sensor noise")
    return Table(caption=caption, head=head, rows=rows)


def _calibration_tables(result: Diagnosis) -> tuple[Table, ...]:
    calibration = result.calibration
    if calibration is None:
        return ()
    errors = [[name, number(b), number(a)] for name, b, a in calibration.recordings]
    departed = []
    for effect, element, estimate in calibration.estimates[:_MOST_DEPARTED]:
        value, _, nominal = words.parameter_words(estimate)
        departed.append([readable(effect), element, readable(estimate.name), value, nominal])
    return (
        Table(
            caption="The specimen before: error in the healthy recordings [noise levels]",
            head=("healthy recording", "model as it was", "calibrated"),
            rows=errors,
        ),
        Table(
            caption="The specimen before: what differs most from the model",
            head=("effect", "element", "parameter", "this machine", "in the model"),
            rows=departed,
            words=3,
        ),
    )


def _gap_table(result: Diagnosis) -> Table:
    rows = []
    for r in words.in_order(result):
        baseline = (r.baseline,) if result.recalibrated else ()
        errors = map(number, (r.before, *baseline, r.after))
        rows.append([r.name, "held out" if r.held_out else "fitted", *errors])
    caption = f"{result.gap.metric} (noise alone gives {number(result.gap.noise_floor)})"
    recalibrated = ("recalibrated",) if result.recalibrated else ()
    head = ("recording", "use", "before", *recalibrated, "after")
    return Table(caption=capital(caption), head=head, rows=rows, words=2)


def _moved_table(result: Diagnosis) -> Table:
    rows = []
    for one in result.moved:
        value, ends, nominal, unit = words.parameter_numbers(one.estimate)
        first = (readable(one.effect), one.element, readable(one.estimate.name), unit)
        rows.append([*first, nominal, value, ends, f"{100.0 * one.share:.0f} %"])
    names = ("effect", "element", "parameter", "unit", "in the model", "improved")
    head = (*names, "tolerance, 95 %", "of its tolerance")
    caption = "Parameters that moved within their tolerance"
    return Table(caption=caption, head=head, rows=rows, words=4)
