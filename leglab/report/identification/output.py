"""Files of `leglab identify`: identify.json, the model, its C header, the page."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from leglab import __version__
from leglab.base.output import piece, write_atomically
from leglab.identification.c_header import c_header
from leglab.identification.features import Lags, Spline
from leglab.identification.storage import save
from leglab.identification.structure import library
from leglab.identification.structure.identified import Errors, Identified
from leglab.identification.structure.residuals import ResidualTest, residual_tests
from leglab.identification.structure.search import CONSTANT, LINEAR
from leglab.report.figures import png
from leglab.report.identification import figures
from leglab.report.page import shell
from leglab.report.page.shell import Section, Table, inlined, render
from leglab.report.page.wording import number

VERSION = 1
RESULT, PAGE = "identify.json", "identify.html"
_TABLE_POINTS = 41
_MOST_TRIED = 10  # linear structures, and as many nonlinear ones


def stem(found: Identified, models: Mapping[str, Identified]) -> str:
    """File name of a model without its suffix; signs of a column that no file has become _."""
    return "model" if len(models) == 1 else stem_of(found.output)


def stem_of(output: str) -> str:
    """File name where there are several models."""
    return "model_" + re.sub(r"\W", "_", output)


def write_all(models: Mapping[str, Identified], folder: Path) -> dict[str, str]:
    """Writes everything; returns why what could not be written is missing, by file."""
    missing: dict[str, str] = {}
    for found in models.values():
        name = stem(found, models)
        save(found.model, folder / f"{name}.leglab")
        with piece(f"{name}.h", missing):
            header = c_header(found.model, name, found.period)
            _write_text(folder / f"{name}.h", header)
    content = summary(models)
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    with piece(PAGE, missing):
        shell.write_page(page(models), folder / PAGE)
    _write_text(folder / RESULT, text)
    return missing


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda stream: stream.write(text.encode()))


def summary(models: Mapping[str, Identified]) -> dict[str, Any]:
    """Everything that is known of the models, as JSON holds it."""
    return {
        "format": "leglab identification",
        "version": VERSION,
        "leglab": __version__,
        "models": [_model(found, stem(found, models)) for found in models.values()],
    }


def _model(found: Identified, name: str) -> dict[str, Any]:
    deviation = found.problem.deviation
    tests = tests_of(found)
    return {
        "output": found.output,
        "inputs": list(found.inputs),
        "period": found.period,
        "files": {"model": f"{name}.leglab", "c_header": f"{name}.h"},
        "kind": found.kind,
        "scaled_ranges": {s.name: [s.lower, s.upper] for s in found.model.settings.signals},
        "features": features(found),
        "transfer_functions": transfer_functions(found),
        "curves": curves(found),
        "held_out": {
            "eighths": found.chosen.scores[0] * deviation,
            "thirds": found.chosen.scores[1] * deviation,
            "linear": found.linear.score * deviation,
            "constant": found.constant.score * deviation,
            "better_than_a_constant": found.better_than_mean,
        },
        "training": [_errors(e) for e in found.trained],
        "test": [_errors(e) for e in found.tested],
        "residuals": [
            {"with": t.name, "band": t.band, "share_outside": t.outside,
             "correlation": t.correlation.tolist()}
            for t in tests
        ],
        "tried": [
            {"structure": _words(c, found), "held_out": c.score * deviation,
             "path": [s * deviation for s in c.path]}
            for c in found.candidates
        ],
        "notes": list(found.notes),
    }  # fmt: skip


def features(found: Identified) -> list[dict[str, Any]]:
    """Features with their parameters, of signals that are scaled to [-1, 1]."""
    out = []
    blocks = found.model.learned_blocks()
    for feature, (_, theta, _) in zip(found.model.settings.features, blocks, strict=True):
        out.append({"feature": library.name_of(feature), "scaled_parameters": theta.tolist()})
    return out


def transfer_functions(found: Identified) -> list[dict[str, Any]]:
    """Transfer function from each input, about the mean of the training data."""
    at = {name: float(np.mean(values)) for name, values in found.problem.samples.items()}
    out = []
    for name in found.inputs:
        system = found.model.transfer_function(signal=name, at=at, timestep=found.period)
        out.append({
            "input": name,
            "about": at,
            "numerator": np.asarray(system.num[0][0]).tolist(),
            "denominator": np.asarray(system.den[0][0]).tolist(),
        })  # fmt: skip
    return out


def curves(found: Identified) -> list[dict[str, Any]]:
    """Tables of the static curves, in physical units."""
    out = []
    for k, feature in enumerate(found.model.settings.features):
        if isinstance(feature, Spline):
            x = np.linspace(feature.basis.knots[0], feature.basis.knots[-1], _TABLE_POINTS)
            values = found.model.static_spline(k)(x)
            out.append({"of": feature.signal, "lag": feature.lag, "x": x.tolist(),
                        "share": values.tolist()})  # fmt: skip
    return out


def _errors(errors: Errors) -> dict[str, Any]:
    names = ("free_run", "one_step", "fit", "linear", "mean", "online")
    values = {name: float(getattr(errors, name)) for name in names}
    shown = {k: v if np.isfinite(v) else None for k, v in values.items()}
    return {"recording": errors.recording, **shown}


def tests_of(found: Identified) -> tuple[ResidualTest, ...]:
    """Residual tests on the longest record, a test record if there is one."""
    pool = found.tested or found.trained
    errors = max(pool, key=lambda e: len(e.measured))
    records = found.tests or found.problem.records
    record = records[pool.index(errors)]
    residual = (errors.measured - errors.predicted)[found.model.lags :]
    inputs = {n: record.u[found.model.lags :, j] for j, n in enumerate(found.inputs)}
    return residual_tests(residual, inputs)


def _words(candidate: Any, found: Identified) -> str:
    plan = candidate.plan
    linear = len(plan.orders.linear(found.problem))
    bent = len(candidate.fit.features) - linear
    lags = f"{plan.orders.outputs} + {plan.orders.inputs} lags"
    delays = ", ".join(map(str, plan.orders.delays))
    if plan.kind == CONSTANT:
        return "a constant"
    if plan.kind == "one step":
        return f"linear, {lags}, delay {delays}, one-step least squares"
    if plan.kind == "linear":
        return f"linear, {lags}, delay {delays}"
    return f"{bent} {plan.kind}, {lags}, delay {delays}"


def page(models: Mapping[str, Identified]) -> str:
    """The page: one file, no network."""
    parts = [_part(found) for found in models.values()]
    return render(
        "identification.html",
        kind="identification",
        title="Identification of " + ", ".join(models),
        parts_=parts,
    )


def _part(found: Identified) -> dict[str, Any]:
    pool = found.tested or found.trained
    drawn: list[tuple[str, Figure | None]] = [
        (f"free run over {e.recording}", figures.free_run_figure(found, e)) for e in pool[:3]
    ]
    drawn.append(("residual tests", figures.residual_figure(tests_of(found))))
    drawn.append(("parameters over time", figures.parameter_figure(found)))
    drawn.append(("static curves", figures.curve_figure(found)))
    return {
        "headline": headline(found),
        "sections": sections(found),
        "tables": (errors_table(found), _features_table(found), _transfer_table(found),
                   _tried_table(found)),
        "figures": [
            {"name": name, "alt": name, "caption": name, "data": inlined(png(figure))}
            for name, figure in drawn
            if figure is not None
        ],
    }  # fmt: skip


def headline(found: Identified) -> str:
    """What was found, in one sentence."""
    if not found.better_than_mean:
        return f"No model of {found.output} is better than a constant"
    pool = found.tested or found.trained
    where = "test" if found.tested else "training"
    fits = [e.fit for e in pool if np.isfinite(e.fit)]
    if not fits:  # an output that rests has nothing to fit
        return f"{found.output}: free run errs by {number(pool[0].free_run)} on the {where} data"
    return f"{found.output}: free run fits {min(fits):.1f} % of the {where} data"


def sections(found: Identified) -> tuple[Section, ...]:
    """What was found, in words."""
    deviation = found.problem.deviation
    score, linear = found.chosen.score * deviation, found.linear.score * deviation
    constant = found.constant.score * deviation
    held = (
        f"Free run over parts of the training data that neither fit nor choice had seen: RMS "
        f"{number(score)}; best linear model {number(linear)}; a constant {number(constant)}."
    )
    if not found.better_than_mean:
        held += " Do not use this model for simulation."
    elif found.chosen.plan.kind in LINEAR:
        held += " No nonlinear structure was better in both block sizes."
    tests = tests_of(found)
    white = tests[0].outside <= 0.1
    driven = [t.name for t in tests[1:] if t.outside > 0.1]
    residual = (
        "One-step residuals are white within 99 % bands"
        if white
        else "One-step residuals are correlated: noise is coloured, or dynamics are missing"
    )
    residual += (
        f"; they depend on past {', '.join(driven)}, so that input's dynamics are not complete."
        if driven
        else "; they do not depend on past inputs."
    )
    online = [
        f"{e.recording}: free run {number(e.online)} when the structure learns in one pass from "
        f"nothing, {number(e.free_run)} as fitted."
        for e in (found.tested or found.trained)
    ]
    return (
        Section(title="Structure", lines=(f"{found.kind}.",)),
        Section(title="Unseen parts of the training data", lines=(held,)),
        Section(title="Residuals", lines=(residual,)),
        Section(title="Learned online", lines=tuple(online)),
        Section(title="Data", lines=found.notes),
    )


def errors_table(found: Identified) -> Table:
    """Errors on all records."""
    rows = []
    for use, pool in (("training", found.trained), ("test", found.tested)):
        for e in pool:
            fit = f"{e.fit:.1f}" if np.isfinite(e.fit) else "-"
            errors = map(number, (e.free_run, e.one_step, e.linear, e.mean))
            rows.append([e.recording, use, fit, *errors])
    head = ("recording", "use", "fit [%]", "free run", "one step", "linear, free run", "constant")
    return Table(caption=f"RMS errors of {found.output}", head=head, rows=rows, words=2)


def _features_table(found: Identified) -> Table:
    rows = []
    for feature, one in zip(found.model.settings.features, features(found), strict=True):
        values = one["scaled_parameters"]
        many = isinstance(feature, Lags | Spline) and len(values) > 4
        text = ", ".join(number(v) for v in (values[:4] if many else values))
        rows.append([one["feature"], text + (", ..." if many else "")])
    return Table(
        caption=f"{found.output}(t) is the sum of these; parameters of signals scaled to [-1, 1]",
        head=("feature", "parameters"),
        rows=rows,
    )


def _transfer_table(found: Identified) -> Table:
    rows = [
        [one["input"], ", ".join(map(number, one["numerator"])),
         ", ".join(map(number, one["denominator"]))]
        for one in transfer_functions(found)
    ]  # fmt: skip
    caption = "Transfer functions about the mean of the training data, in powers of z"
    return Table(caption=caption, head=("input", "numerator", "denominator"), rows=rows)


def _tried_table(found: Identified) -> Table:
    rows: list[list[str]] = []
    seen: set[str] = set()
    left = {True: _MOST_TRIED, False: _MOST_TRIED}
    best = found.chosen.score
    for candidate in found.candidates:
        words = _words(candidate, found)
        simple = candidate.plan.kind in LINEAR
        if words in seen or not left[simple]:
            continue
        seen.add(words)
        left[simple] -= 1
        ratio = candidate.score / best
        why = "chosen" if not rows else f"{ratio:.2f} times the error of the chosen one"
        if rows and ratio < 1:
            why = "not better than simpler models in both block sizes"
        rows.append([words, why, number(candidate.score * found.problem.deviation)])
    return Table(
        caption="Structures that were tried, by the free run over unseen parts",
        head=("structure", "why not", "RMS"),
        rows=rows,
        words=2,
    )
