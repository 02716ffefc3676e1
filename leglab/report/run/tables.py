"""Tables of a report, and bars of errors."""

import json
from collections.abc import Sequence
from typing import Any

from leglab.base.units import shared_unit
from leglab.report.page.outcome import milli
from leglab.report.page.shell import Table
from leglab.report.page.wording import figure, listed, readable
from leglab.report.run.words import change_words, different
from leglab.report.style import SERIES
from leglab.runs.folder import ReportedRun

_NONE = "-"
# Settings whose values are too long for a table with one row per setting.
_HIDDEN = ("elements",)


def error_bars(runs: Sequence[ReportedRun]) -> dict[str, Any] | None:
    """Returns bars of the errors by which runs are ranked; None for a single run.

    A bar has a name, a length [% of the longest bar], the error as text and an index of its colour.
    """
    if len(runs) < 2:
        return None
    first, most = runs[0], max(run.error for run in runs) or 1.0
    comparable = not different(runs)
    rows = []
    for i, run in enumerate(runs):
        text = milli(run.error, run.unit)
        if i and comparable and first.metrics.completed and run.metrics.completed and first.error:
            text += f" ({100.0 * (run.error / first.error - 1.0):+.0f} %)".replace("-", "\u2212")
        text += ", stopped early" * (not run.metrics.completed)
        width = round(100.0 * run.error / most, 2)
        rows.append({"name": run.label, "width": width, "value": text, "color": i % len(SERIES)})
    over = tuple(dict.fromkeys(run.judged_over for run in runs))
    against = f", in brackets against {first.label}" if comparable else ""
    caption = f"RMS tracking error of all joints {listed(over, 'or')}{against}"
    return {"caption": caption, "rows": rows}


def run_table(runs: Sequence[ReportedRun]) -> Table:
    """Returns the table of errors and costs, one row per run."""
    changed = any(run.before for run in runs)
    spans = {run.metrics.adaptation.span_s for run in runs}
    span = f"{spans.pop():g} s" if len(spans) == 1 and None not in spans else "strides"
    last = runs[0].last.name
    unit = shared_unit(run.unit for run in runs)
    head = ["run", *[f"before, {span} [{unit}]"] * changed]
    head += [f"{last} [{unit}]", f"last {span} [{unit}]"]
    head += [f"peak [{unit}]", *[f"damage [{unit}]", "undone [%]", "90 % undone [s]"] * changed]
    # RMS command, energy and power are of the same phase of the run.
    head += [f"RMS command, {last}", f"energy, {last} [J]", f"power, {last} [W]", "came to [s]"]
    rows = []
    for run in runs:
        found, phase = run.metrics.adaptation, run.last
        row = [run.label, *[_milli(found.before_rad)] * changed]
        row += map(_milli, (phase.rms_rad, found.end_rad, phase.peak_rad))
        if changed:
            row.append(figure(found.damage_rad, 1e3, missing=_NONE))
            told = [_NONE, _NONE]
            if found.recovered is not None:
                t90 = "never" if found.t90_s is None else f"{found.t90_s:.2f}"
                told = [f"{round(100 * found.recovered)}", t90]
            row += told
        costs = (phase.effort.get("all"), phase.energy_j.get("all"), run.power)
        row += [figure(value, missing=_NONE) for value in costs]
        rows.append([*row, f"{run.metrics.duration:g} of {run.planned:g}"])
    return Table(caption="RMS tracking error of all joints and its costs", head=head, rows=rows)


def joint_tables(runs: Sequence[ReportedRun]) -> tuple[Table, ...]:
    """Returns the tracking errors of the joints, one table per run."""
    tables = []
    for run in runs:
        found, last = run.metrics.adaptation, run.last
        span = f"{found.span_s or 0:g} s"
        columns = {
            f"RMS before, {span}": found.before_rad,
            f"RMS {last.name}": last.rms_rad,
            f"RMS last {span}": found.end_rad,
            f"95 % {last.name}": last.p95_rad,
            f"peak {last.name}": last.peak_rad,
        }
        shown = {name: values for name, values in columns.items() if values}
        rows = []
        for joint in run.joints:
            cells = (figure(v.get(joint), 1e3, missing=_NONE) for v in shown.values())
            own = run.metrics.error_unit(joint)
            # The unit of a joint is shown if it differs from the unit of the run.
            rows.append([joint if own == run.unit else f"{joint} [{own}]", *cells])
        caption = f"{run.label}: tracking error [{run.unit}]"
        tables.append(Table(caption=caption, head=["joint", *shown], rows=rows))
    return tuple(tables)


def setting_tables(runs: Sequence[ReportedRun]) -> tuple[Table, ...]:
    """Returns tables of settings, changes of the machine and versions, one column per run."""
    labels = [run.label for run in runs]
    settings = [_flat(run.configuration.settings, _units(run)) for run in runs]
    for run, found in zip(runs, settings, strict=True):
        found["folder"] = run.folder.name
        found["stride, window of the moving error [s]"] = f"{run.configuration.window:g}"
        for i, change in enumerate(run.configuration.changes):
            over = f" over {change.ramp_duration:g} s" if change.ramp_duration else ""
            found[f"change {i + 1}"] = f"{change_words(change)}, from {change.start:g} s{over}"
    versions = [dict(run.configuration.versions) for run in runs]
    for run, found in zip(runs, versions, strict=True):
        if run.configuration.code:
            found["digest of the code"] = run.configuration.code[:12]
    tables = []
    for caption, columns in (("Settings", settings), ("Versions of the software", versions)):
        rows = [
            [readable(name), *(column.get(name, _NONE) for column in columns)]
            for name in dict.fromkeys(name for column in columns for name in column)
        ]
        differing = [row for row in rows if len(set(row[1:])) > 1]
        common = [row[:2] for row in rows if row not in differing]
        shared = " that all runs share" * (len(runs) > 1)
        differ, names = f"{caption} in which the runs differ", ["name", *labels]
        tables += [
            Table(caption=differ, head=names, rows=differing, words=len(names)),
            Table(caption=caption + shared, head=["name", "value"], rows=common, words=2),
        ]
    return tuple(table for table in tables if table.rows)


def _units(run: ReportedRun) -> dict[str, str]:
    """Returns units of settings by name; a nested setting has a prefix such as "sensors: "."""
    import leglab.controllers
    import leglab.scenarios  # noqa: F401  registers the scenarios
    from leglab.base.scenario import scenario_names, scenario_severity
    from leglab.base.settings import documented_units
    from leglab.control.contract import CONTROLLERS
    from leglab.machine.sensors import SensorConfiguration
    from leglab.references.base import REFERENCES
    from leglab.runs.preparation import RunSettings

    parts = {"": RunSettings, "sensors: ": SensorConfiguration}
    controller, reference = run.metrics.controller, run.setting("reference")
    if controller in CONTROLLERS.names():
        parts["controller_config: "] = CONTROLLERS.get(controller).configuration
    if reference in REFERENCES.names():
        parts["reference_config: "] = REFERENCES.get(reference).configuration
    units = {
        f"{prefix}{name}": f"[{unit}]"
        for prefix, owner in parts.items()
        for name, unit in documented_units(owner).items()
    }
    if run.metrics.scenario in scenario_names():
        severity = scenario_severity(run.metrics.scenario)
        units["severity"] = f"({severity.meaning})" if severity else ""
    return units


def _flat(settings: dict, units: dict[str, str], prefix: str = "") -> dict[str, str]:
    found = {}
    for key, value in settings.items():
        if key in _HIDDEN:
            continue
        if isinstance(value, dict):
            found.update(_flat(value, units, f"{prefix}{key}: "))
            continue
        name = f"{key} {units.get(prefix + key, '')}".rstrip()
        if isinstance(value, float):
            found[f"{prefix}{name}"] = f"{value:g}"
        else:
            found[f"{prefix}{name}"] = value if isinstance(value, str) else json.dumps(value)
    return found


def _milli(errors: dict[str, float] | None) -> str:
    return figure((errors or {}).get("all"), 1e3, missing=_NONE)
