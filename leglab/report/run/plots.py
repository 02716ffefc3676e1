"""Curves of a report as data for the plotting library, with few points to keep a page small."""

import base64
import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leglab.base.units import shared_unit
from leglab.report.page.wording import capital, log_ticks, printable, shortened
from leglab.report.run.words import change_words
from leglab.report.style import SERIES
from leglab.runs.folder import ReportedRun
from leglab.runs.metrics import sliding_rms

_MILLI, _BAR = 1e3, 1e5
# Number of points of a plot for all runs together, and minimum and maximum number per run.
_POINTS, _LEAST, _MOST = 5400, 900, 3000
_DASHES = ("solid", "dash", "dot")
# Maximum number of characters of a name in a legend.
_LONGEST = 40
# Number of strides that the close-up of a change shows before and after the change.
_CLOSE_UP = 2.0
# Temperatures with a smaller range count as constant and are not plotted [degC].
_STEADY = 0.1
# The axis is logarithmic if the ratio of the largest to the smallest error exceeds this.
_LOG_RATIO = 8.0
_PLAIN = {"by_joint": True, "labelled": False, "scale": "linear", "ticks": None, "range": None}


@dataclass(frozen=True, kw_only=True)
class _Quantity:
    """A plot of one quantity with a choice of joints."""

    heading: tuple[str, str, str, str]  # name, title, label of the axis, unit
    caption: str
    curves: tuple[tuple[str, str], ...]  # (suffix of columns, name); the first is drawn solid
    factor: float = 1.0  # from the recording's unit to the shown unit
    shared: str = ""  # suffix of a column that is drawn once for all runs, from the longest run


def plot_data(runs: Sequence[ReportedRun], joints: Sequence[str], first: int) -> dict[str, Any]:
    """Returns all plots with their curves; `first` is the index of the joint shown initially.

    Returns:
        Content for `assets/report.js`: plain types, arrays as base64 of float32.
    """
    count = int(np.clip(_POINTS // len(runs), _LEAST, _MOST))
    end = max(float(run.recording.time[-1]) for run in runs)
    start = min(float(run.recording.time[0]) for run in runs)
    plots = [_error_plot(runs, count)]
    plots += [_joint_plot(q, runs, joints, count) for q in _quantities(runs)]
    return {
        "first_joint": first,
        "span": [start, end],
        "close_up": _close_up(runs, start, end),
        "changes": _changes(runs, end),
        "plots": [plot for plot in plots if plot is not None],
    }


def _close_up(runs: Sequence[ReportedRun], start: float, end: float) -> list[float] | None:
    """Returns the time range of the close-up of the first change [s]; None without a change."""
    starts = [c.start for run in runs for c in run.configuration.changes if start < c.start < end]
    if not starts:
        return None
    margin = _CLOSE_UP * max(run.configuration.window for run in runs)
    return [max(start, min(starts) - margin), min(end, min(starts) + margin)]


def _quantities(runs: Sequence[ReportedRun]) -> tuple[_Quantity, ...]:
    truly = all(_position_name(run) == "truth" for run in runs)
    position = "truth" if truly else "position"
    measured = "" if position == "truth" else ", as measured"
    positions = measured or " as they were"
    unit = shared_unit(run.unit for run in runs)
    whole = unit.replace("mrad", "rad").replace("mm", "m")
    valves = all(run.recording.actuators_are_valves for run in runs)
    asked = "spool's travel" if valves else "range of the actuator's control"
    angle = "angle" if whole == "rad" else "position"
    command = "Valve command" if valves else "Command"
    quantities = (
        _Quantity(
            heading=("deviation", "Tracking error", f"error [{unit}]", unit),
            caption=f"Position less reference{measured}.",
            curves=((f"{position} error", ""),),
            factor=_MILLI,
        ),
        _Quantity(
            heading=("angle", f"{capital(angle)} and reference", f"{angle} [{whole}]", whole),
            caption=f"The broad grey line is the reference; positions{positions}.",
            curves=((position, ""),),
            shared="reference",
        ),
        _Quantity(
            heading=("command", command, "command [1]", ""),
            caption=f"Share of the {asked} that was asked for; the part of the feed-forward "
            "is dashed.",
            curves=(("command", ""), ("feedforward", "feed-forward")),
        ),
        _Quantity(
            heading=("pressure", "Chamber pressures", "pressure [bar]", "bar"),
            caption="Chamber A is the cap side (solid), B the rod side (dashed).",
            curves=(("pressure_a", "A"), ("pressure_b", "B")),
            factor=1 / _BAR,
        ),
        _Quantity(
            heading=("temperature", "Oil temperature", "temperature [°C]", "°C"),
            caption="Temperature of the oil in the cylinder.",
            curves=(("oil_temperature", ""),),
        ),
    )
    samples = [_samples(run, joint, "oil_temperature")[1] for run in runs for joint in run.joints]
    values = np.concatenate(samples)
    return quantities if values.size and np.ptp(values) > _STEADY else quantities[:-1]


def _changes(runs: Sequence[ReportedRun], end: float) -> list[dict[str, Any]]:
    """Returns the changes of the machine; simultaneous changes share one label."""
    marks: dict[tuple[float, float], dict[str, None]] = {}
    for run in runs:
        for change in run.configuration.changes:
            if change.start > 0:
                span = (change.start, change.start + change.ramp_duration)
                marks.setdefault(span, {})[change_words(change)] = None
    found = []
    for (start, stop), words in marks.items():
        text = next(iter(words)) if len(words) == 1 else f"{len(words)} changes"
        label = _text(text if len(text) < 48 else "change of the machine")
        found.append({"start": start, "end": stop, "label": label, "late": start >= 0.5 * end})
    return found


def _error_plot(runs: Sequence[ReportedRun], count: int) -> dict[str, Any] | None:
    traces, values = [], []
    for i, run in enumerate(runs):
        time, error = _moving_error(run)
        if len(time) > 1:
            values.append(_MILLI * error)
            traces.append(_trace(run.label, i, time, values[-1], count, width=1.8))
    if not traces:
        return None
    unit = shared_unit(run.unit for run in runs)
    low, high = min(v.min() for v in values), max(v.max() for v in values)
    log, ticks = low > 0 and high / low > _LOG_RATIO, None
    if log:
        ticks = log_ticks(math.log10(low), math.log10(high), fine=high / low < 1e3)
    return {
        "name": "error",
        "title": "RMS error of all joints over one stride",
        "axis": f"RMS error [{unit}]",
        "unit": unit,
        "caption": "Over the stride that ends at each time."
        + (" The axis is logarithmic: equal distances are equal ratios." if log else ""),
        "by_joint": False,
        "labelled": True,
        "scale": "log" if log else "linear",
        "ticks": ticks,
        "range": None if log else [0.0, 1.06 * float(high)],
        "traces": traces,
    }


def _joint_plot(
    quantity: _Quantity, runs: Sequence[ReportedRun], joints: Sequence[str], count: int
) -> dict[str, Any] | None:
    by_joint = [_joint_traces(quantity, runs, joint, count) for joint in joints]
    if not any(by_joint):
        return None
    heading = zip(("name", "title", "axis", "unit"), quantity.heading, strict=True)
    return {**dict(heading), "caption": quantity.caption, **_PLAIN, "traces": by_joint}


def _joint_traces(
    quantity: _Quantity, runs: Sequence[ReportedRun], joint: str, count: int
) -> list[dict[str, Any]]:
    traces = []
    having = [run for run in runs if joint in run.joints]
    if quantity.shared and having:
        source = max(having, key=lambda run: len(run.recording))
        time, values = _samples(source, joint, quantity.shared)
        name = "reference"
        others = (_samples(run, joint, quantity.shared)[1] for run in having)
        if not all(np.array_equal(values[: len(other)], other) for other in others):
            name = f"reference of {source.label}"
        if len(time) > 1:
            traces.append(_trace(name, -1, time, quantity.factor * values, count, width=5.0))
    for i, run in enumerate(runs):
        for k, (ending, name) in enumerate(quantity.curves if joint in run.joints else ()):
            time, values = _samples(run, joint, ending)
            if len(time) < 2:
                continue
            label = f"{run.label} {name}".strip()
            drawn = _trace(label, i, time, quantity.factor * values, count, width=1.3)
            traces.append({**drawn, "dash": "dot"} if k else drawn)
    return traces


def _samples(run: ReportedRun, joint: str, ending: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns times and finite values of a joint's column with suffix `ending`; may be empty."""
    recording = run.recording
    if ending.endswith(" error"):
        position = recording[f"{joint}_{ending.removesuffix(' error')}"]
        values = position - recording[f"{joint}_reference"]
    elif ending == "command":
        values = recording.command_of(joint)
    else:
        names = [f"{joint}_{ending}", f"{joint}_valve_{ending}"]
        values = next((recording[name] for name in names if name in recording), None)
    if values is None:
        return np.empty(0), np.empty(0)
    finite = np.isfinite(values)
    return recording.time[finite], values[finite]


def _trace(
    name: str, run: int, time: np.ndarray, values: np.ndarray, count: int, *, width: float
) -> dict[str, Any]:
    if len(time) > count:
        from tsdownsample import MinMaxLTTBDownsampler

        curve = map(np.ascontiguousarray, (time, values))
        kept = MinMaxLTTBDownsampler().downsample(*curve, n_out=count)
        time, values = time[kept], values[kept]
    return {
        "name": _text(name),
        "run": run,
        "ink": "reference" if run < 0 else f"run-{run % len(SERIES)}",
        "dash": "solid" if run < 0 else _DASHES[run // len(SERIES) % len(_DASHES)],
        "width": width,
        "x": _packed(time),
        "y": _packed(values),
    }


def _packed(values: np.ndarray) -> dict[str, str]:
    data = base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode()
    return {"dtype": "f4", "bdata": data}


def _text(text: str) -> str:
    """Shortens and escapes a text, since the plotting library interprets some HTML in names."""
    return html.escape(printable(shortened(text, _LONGEST)), quote=False)


def _position_name(run: ReportedRun) -> str:
    """Returns the suffix of position columns: "truth" if it is recorded for all joints."""
    whole = all(f"{joint}_truth" in run.recording for joint in run.joints)
    return "truth" if whole else "position"


def _moving_error(run: ReportedRun) -> tuple[np.ndarray, np.ndarray]:
    """Returns times [s] and RMS errors [rad] of all joints over the stride that ends at a time."""
    positions = run.recording.stack(run.joints, _position_name(run))
    error = positions - run.recording.stack(run.joints, "reference")
    whole = np.isfinite(error).all(axis=1)
    if not whole.any():
        return np.empty(0), np.empty(0)
    time = run.recording.time[whole]
    windowed = sliding_rms(time, error[whole], run.configuration.window)
    full = np.isfinite(windowed)
    return time[full], windowed[full]
