"""Files that `leglab identify` writes: identify.json, models, C headers of models, the page."""

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
from leglab.identification.features import Spline
from leglab.identification.spline_state_space import (
    SplineStateSpace,
    SplineStateSpaceSettings,
    StateSpace,
)
from leglab.identification.storage import save
from leglab.identification.structure import library
from leglab.identification.structure.identified import Errors, Identified
from leglab.identification.structure.plans import CONSTANT, LINEAR
from leglab.identification.structure.residuals import ResidualTest, residual_tests
from leglab.report.figures import png
from leglab.report.identification import figures
from leglab.report.page import shell
from leglab.report.page.shell import Section, Table, inlined, render
from leglab.report.page.wording import number

VERSION = 1
RESULT, PAGE = "identify.json", "identify.html"
_TABLE_POINTS = 41
_ROUNDING = 1e-9  # errors up to this count as rounding, in standard deviations of the output
_MOST_TRIED = 10  # maximum number of linear structures in the table, and of nonlinear ones


def stem(found: Identified, models: Mapping[str, Identified]) -> str:
    """Returns a model's file name without suffix; signs other than letters and digits become _."""
    return "model" if len(models) == 1 else stem_of(found.output)


def stem_of(output: str) -> str:
    """Returns the file name, without suffix, of one of several models."""
    return "model_" + re.sub(r"\W", "_", output)


def write_all(models: Mapping[str, Identified], folder: Path) -> dict[str, str]:
    """Writes all files; returns, by name of the file, reasons why files could not be written."""
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
    """Returns all results on the models as plain types for JSON."""
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
        "at_rest": at_rest(found),
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
    """Returns the features with their parameters, for signals scaled to [-1, 1]."""
    return [
        {"feature": name, "scaled_parameters": theta.tolist()}
        for name, _, theta in library.named_parameters(found.model)
    ]


def transfer_functions(found: Identified) -> list[dict[str, Any]]:
    """Returns the transfer function from each input, linearised at the mean training data."""
    at = {name: float(np.mean(values)) for name, values in found.problem.samples.items()}
    out = []
    for name in found.inputs:
        system = found.model.transfer_function(signal=name, at=at, timestep=found.period)
        out.append({
            "input": name,
            "about": at,
            # Adding 0.0 removes the sign of -0.0.
            "numerator": (np.asarray(system.num[0][0]) + 0.0).tolist(),
            "denominator": (np.asarray(system.den[0][0]) + 0.0).tolist(),
        })  # fmt: skip
    return out


def curves(found: Identified) -> list[dict[str, Any]]:
    """Returns the static curves in physical units, for a state-space model in scaled units."""
    out: list[dict[str, Any]] = []
    model = found.model
    if isinstance(model, SplineStateSpace):
        x = np.linspace(-1.0, 1.0, _TABLE_POINTS)
        basis = model.settings.structure.basis
        for k, curve in enumerate(model.parts().curves, 1):
            values = basis.spline(curve.e)(x)
            out.append({"of": f"z{k}", "x": x.tolist(), "share": values.tolist()})
        return out
    for k, feature in enumerate(model.settings.features):
        if isinstance(feature, Spline):
            x = np.linspace(feature.basis.knots[0], feature.basis.knots[-1], _TABLE_POINTS)
            values = model.static_spline(k)(x)
            out.append({"of": feature.signal, "lag": feature.lag, "x": x.tolist(),
                        "share": values.tolist()})  # fmt: skip
    return out


def at_rest(found: Identified) -> list[dict[str, Any]]:
    """Returns `Identified.at_rest` over the range of each signal, the others at their means."""
    out = []
    for name, samples in found.problem.samples.items():
        if name == found.output and isinstance(found.model, SplineStateSpace):
            continue
        x = np.linspace(samples.min(), samples.max(), _TABLE_POINTS)
        out.append({"of": name, "x": x.tolist(), "predicted": found.at_rest(name, x).tolist()})
    return out


def _errors(errors: Errors) -> dict[str, Any]:
    names = ("free_run", "one_step", "fit", "linear", "mean", "online")
    values = {name: float(getattr(errors, name)) for name in names}
    shown = {k: v if np.isfinite(v) else None for k, v in values.items()}
    return {"recording": errors.recording, **shown}


def tests_of(found: Identified) -> tuple[ResidualTest, ...]:
    """Returns residual tests on the longest test record or, if there is none, training record."""
    pool = found.tested or found.trained
    errors = max(pool, key=lambda e: len(e.measured))
    records = found.tests or found.problem.records
    record = next(r for r in records if r.name == errors.recording)
    residual = (errors.measured - errors.predicted)[found.model.lags :]
    inputs = {n: record.u[found.model.lags :, j] for j, n in enumerate(found.inputs)}
    return residual_tests(residual, inputs)


def _words(candidate: Any, found: Identified) -> str:
    plan = candidate.plan
    if isinstance(structure := candidate.fit.features[0], StateSpace):
        delays = ", ".join(map(str, structure.delays))
        states, curves = _count(structure.states, "states"), _count(structure.curves, "curves")
        return f"{states}, {curves}, delay {delays}"
    linear = len(plan.orders.linear(found.problem))
    bent = len(candidate.fit.features) - linear
    lags = f"{plan.orders.outputs} lags of {found.output}, {plan.orders.inputs} of each input"
    delays = ", ".join(map(str, plan.orders.delays))
    if plan.kind == CONSTANT:
        return "a constant"
    how = f"{lags}, delay {delays}"
    if plan.kind in LINEAR:
        return f"linear, {how}" + (", one-step least squares" if plan.kind == "one step" else "")
    return (
        f"{_count(bent, plan.kind)}, {how}" if bent else f"linear, {how} ({plan.kind} did not help)"
    )


def _count(number: int, plural: str) -> str:
    return f"{number} {plural.removesuffix('s') if number == 1 else plural}"


def page(models: Mapping[str, Identified]) -> str:
    """Returns the page as one file that loads no other."""
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
        (figures.free_run_caption(e), figures.free_run_figure(found, e)) for e in pool[:3]
    ]
    bands = "Grey: 99 % of the values lie there if there is no correlation."
    drawn.append((bands, figures.residual_figure(tests_of(found))))
    states = isinstance(found.model, SplineStateSpace)
    passed = (
        "Scaled parameters while the structure learns the training data once, by the one-step "
        "error. They may end elsewhere than the parameters of the fit."
    )
    if states:
        passed = (
            "Scaled parameters while the model learns the training data once, from straight curves "
            "on. They may end elsewhere than the parameters of the fit."
        )
    drawn.append((passed, figures.parameter_figure(found)))
    bent = "One-step prediction while all lags of one signal have one value, the others their mean."
    if states:
        bent = "Output at rest over one input, the others at their mean."
    drawn.append((bent, figures.curve_figure(found)))
    inner = "Curves inside, of scaled combinations of states and inputs."
    drawn.append((inner, figures.inner_figure(found)))
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
    """Returns the result in one sentence."""
    if not found.better_than_mean:
        return f"No model of {found.output} is better than a constant"
    pool = found.tested or found.trained
    where = "test" if found.tested else "training"
    fits = [e.fit for e in pool if np.isfinite(e.fit)]
    if not fits:  # a constant output has no fit
        return f"{found.output}: free run errs by {number(pool[0].free_run)} on the {where} data"
    return f"{found.output}: free run fits {min(fits):.1f} % of the {where} data"


def sections(found: Identified) -> tuple[Section, ...]:
    """Returns the sections of the page with the result in words."""
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
    data, records = list(found.notes), found.problem.records
    for use, parts, shown in (
        ("training", records, found.trained),
        ("test", found.tests, found.tested),
    ):
        if short := len(parts) - len(shown):
            data.append(f"{short} of {len(parts)} {use} parts are too short to start a free run")
    return (
        Section(title="Structure", lines=_structure(found)),
        Section(title="Unseen parts of the training data", lines=(held,)),
        Section(title="Residuals", lines=(_residuals(found),)),
        Section(title="Learned online", lines=_learned(found)),
        Section(title="Data", lines=tuple(data)),
    )


def _structure(found: Identified) -> tuple[str, ...]:
    """Returns the kind of the model, and a warning if its linear part alone is unstable."""
    largest = float(np.abs(found.model.poles()).max(initial=0.0))
    if largest <= 1.0 or found.chosen.plan.kind in LINEAR:
        return (f"{found.kind}.",)
    return (
        f"{found.kind}.",
        f"The linear part alone is unstable (pole of modulus {largest:.4g}): the model is stable "
        "only as far as its curves or features keep it so.",
    )


def _residuals(found: Identified) -> str:
    """Returns the result of the residual tests."""
    tests = tests_of(found)
    worst = max(e.one_step for e in (found.tested or found.trained))
    if worst <= _ROUNDING * found.problem.deviation:
        return "One-step residuals are rounding errors."
    driven = ", ".join(t.name for t in tests[1:] if t.outside > 0.1)
    untold = ", ".join(t.name for t in tests[1:] if t.band >= 1.0)
    text = (
        "One-step residuals are white at 99 %"
        if tests[0].white
        else "One-step residuals are correlated: noise is coloured, or dynamics are missing"
    )
    if driven:
        text += f"; they depend on past {driven}, so that input's dynamics are not complete."
    else:
        text += "; they do not depend on past inputs."
    return text + f" The samples are too few to test {untold}." * bool(untold)


def _learned(found: Identified) -> tuple[str, ...]:
    """Returns the errors after an online pass, and by which error the model goes on learning."""
    use = "test" if found.tested else "training"
    begun = "straight curves" if isinstance(found.model, SplineStateSpace) else "nothing"
    lines = [
        f"Free run over {e.recording} ({use}): {number(e.free_run)} as fitted, {number(e.online)} "
        f"if the same structure learns the training data online, in one pass from {begun}."
        for e in (found.tested or found.trained)
    ]
    settings = found.model.settings
    simulates = (
        not settings.process_noise
        if isinstance(settings, SplineStateSpaceSettings)
        else settings.output_error_after > 0
    )
    by = "the free run's" if simulates else "the one-step"
    return (*lines, f"The model goes on learning by {by} error.")


def errors_table(found: Identified) -> Table:
    """Returns the table of errors on all records."""
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
    for one in features(found):
        rows.append([one["feature"], ", ".join(map(number, one["scaled_parameters"]))])
    caption = (
        f"{found.output}(t) is the sum of these, with signals scaled to [-1, 1]; hinges and widths "
        "in the units of their signals"
    )
    if isinstance(found.model, SplineStateSpace):
        caption = (
            "x(t+1) = A x + B u + sum of w f(z), "
            f"{found.output}(t) = C x + D u + d + sum of o f(z), with z = v [x; u], curves "
            "f = sum of e N(z) and signals scaled to [-1, 1]; matrices by rows"
        )
    return Table(
        caption=caption,
        head=("feature", "parameters"),
        rows=rows,
        words=2,
    )


def _transfer_table(found: Identified) -> Table:
    rows = [
        [one["input"], ", ".join(map(number, one["numerator"])),
         ", ".join(map(number, one["denominator"]))]
        for one in transfer_functions(found)
    ]  # fmt: skip
    caption = (
        "Transfer functions about the mean of the training data: coefficients from the highest "
        "power of z to its power zero"
    )
    return Table(caption=caption, head=("input", "numerator", "denominator"), rows=rows, words=3)


def _tried_table(found: Identified) -> Table:
    told = {}
    left = {True: _MOST_TRIED, False: _MOST_TRIED}
    for candidate in found.candidates:
        simple = candidate.plan.kind in LINEAR
        if (words := _words(candidate, found)) not in told and left[simple]:
            left[simple] -= 1
            told[words] = candidate
    first, *others = told.items()
    rows: list[list[str]] = []
    for words, candidate in (first, *sorted(others, key=lambda one: one[1].score)):
        ratio = f"{candidate.score / found.chosen.score:.2f}" if rows else "1, chosen"
        if rows and candidate.score < found.chosen.score:
            ratio += ", not better than simpler models in both block sizes"
        rows.append([words, ratio, number(candidate.score * found.problem.deviation)])
    return Table(
        caption=f"Structures that were tried, {len(rows)} of {len(found.candidates)}: RMS of the "
        "free run over unseen parts, geometric mean",
        head=("structure", "RMS over that of the chosen one", "RMS"),
        rows=rows,
        words=2,
    )
