"""Tables of the adaptation, from kept results: `python -m benchmarks adaptation_tables NAME`.

`short`, `scenarios` and `controllers` are of the walking leg, specimens drawn by the seeds unless a
row says "exact machine": RMS over joints of the true tracking error in the last strides in mrad,
means over seeds; `origin` says how they were made. `goals` is what was asked of adaptation and live
names, beside what the kept results show.
"""

import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy import stats

from benchmarks import live_names, pressures, results
from leglab import controller_names, scenario_names
from leglab.base.errors import SettingsError
from leglab.base.scenario import scenario_summary
from leglab.cli.catalogue import severity_text
from leglab.control import controller_summary

# Results by scenario, size (None for the default) and controller, one a seed.
Cells = dict[tuple[str, float | None, str], list[dict[str, Any]]]

ADAPTIVE, CALIBRATED = "bsnn_arx", "static_feedforward"
BANK, WITHOUT = live_names.BANK, live_names.WITHOUT
RIG, EXACT = "leg, walking", "leg, walking, exact machine"
SHOWN = ("static_feedforward", "frozen", ADAPTIVE, "oracle")
# The table of README.md: what a reader asks first.
FEW = ("nominal", "seal_wear", "cold_oil", "supply_drop", "friction_rise", "encoder_shift")
COMPARED = ("static_feedforward", "frozen", ADAPTIVE, "adaptive_backstepping")
MOVING = 0.1  # rad: joints that travel more count in the nominal claim


def by_rig(kept: dict[str, list[dict[str, Any]]]) -> dict[str, Cells]:
    """Results of docs/data by rig."""
    rigs: dict[str, Cells] = {}
    for rig, rows in kept.items():
        for row in rows:
            case = row["scenario"], row["severity"], row["controller"]
            rigs.setdefault(rig, {}).setdefault(case, []).append(row)
    return rigs


def mrad(runs: list[dict[str, Any]], key: str) -> np.ndarray:
    """An error of every run that has it [mrad]; failed runs count as infinite."""
    values = [
        np.inf if not run["completed"] else 1e3 * run[key]
        for run in runs
        if not run["completed"] or run[key] is not None
    ]
    return np.array(values) if values else np.array([np.nan])


def section(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], note: str) -> str:
    """A table under a title, and what is to be said of it."""
    return "\n".join([f"## {title}", "", results.table(columns, rows), *([note] if note else [])])


def claims(cells: Cells, rig: str) -> Iterator[str]:
    """Yields the tables that these results allow."""
    have = {controller for _, _, controller in cells}
    if ("nominal", None, "pd") in cells:
        yield nominal(cells, rig)
    if "oracle" in have:
        yield degraded(cells, rig)
    yield undone(cells, rig)
    yield safety(cells, rig)
    if {"adaptive_backstepping", "arx", "bsnn_arx_paper"} & have:
        yield peers(cells, rig)


def nominal(cells: Cells, rig: str) -> str:
    """Each joint of a machine that does not change, in the last strides."""
    names = ("pd", "pid", CALIBRATED, ADAPTIVE, "oracle")
    runs = {name: cells.get(("nominal", None, name), []) for name in names}
    shown = [name for name in names if runs[name]]
    rows, travel = [], runs[ADAPTIVE][0]["travel"]
    for joint in travel:
        if travel[joint] <= MOVING:
            continue
        rms = {n: np.array([1e3 * r["end_by_joint"][joint] for r in runs[n]]) for n in shown}
        rows.append(
            (
                joint,
                *(interval(rms[n]) for n in shown),
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms['pd']):.3f}",
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms[CALIBRATED]):.2f}",
            )
        )
    columns = ("joint", *(f"{n}, mrad" for n in shown), "of pd", "of static")
    note = f"Asked of {ADAPTIVE}: at most 0.1 of pd, at most 0.5 of static."
    return section(f"Nothing changes: {rig}", columns, rows, note)


def degraded(cells: Cells, rig: str) -> str:
    """Before a change and in the last strides."""
    columns = ("scenario", "before", "static end", "frozen end", "bsnn_arx end", "oracle end")
    rows, failing = [], []
    for name, size in cases(cells):
        ours, oracle = cells[name, size, ADAPTIVE], cells[name, size, "oracle"]
        before, frozen, end = (mrad(ours, key) for key in ("before", "twin_end", "end"))
        hurt = np.mean(frozen) >= 2 * np.mean(before)
        of_frozen, of_oracle = np.mean(end) / np.mean(frozen), _of(ours, oracle)
        told = np.isfinite(of_frozen)
        if (told and hurt and of_frozen > 1 / 3) or of_oracle > 1.25:
            failing.append(label(name, size))
        rows.append(
            (
                label(name, size),
                interval(before),
                interval(mrad(cells.get((name, size, CALIBRATED), []), "end")),
                interval(frozen),
                interval(end),
                interval(mrad(oracle, "end")),
                f"{of_frozen:.2f}{'' if hurt else ' (not doubled)'}" if told else "",
                f"{of_oracle:.2f}",
            )
        )
    note = "Asked: at most 1/3 of frozen where that has at least doubled, at most 1.25 of the "
    note += (
        f"oracle. Not reached: {', '.join(failing)}."
        if failing
        else "oracle. Reached in every row."
    )
    return section(f"After each change: {rig}", (*columns, "of frozen", "of oracle"), rows, note)


def undone(cells: Cells, rig: str) -> str:
    """Added error after a change, share of it undone, and time until it was."""
    columns = ("scenario", "damage, mrad", "undone, %", "least, %", "90 % after, s", "worst, s")
    rows, note = [], ""
    every: list[float] = []
    for name, size in cases(cells):
        runs = [run for run in cells[name, size, ADAPTIVE] if run["told"]]
        if not runs:
            continue
        soon = [np.inf if run["t90"] is None else run["t90"] for run in runs]
        shares = [100 * run["recovered"] for run in runs]
        every += soon
        rows.append(
            (
                label(name, size),
                interval(mrad(runs, "damage")),
                f"{np.median(shares):.0f}",
                f"{min(shares):.0f}",
                times([run["t90"] for run in runs]),
                _time(max(soon)),
            )
        )
    if every:
        never = sum(np.isinf(every))
        note = (
            f"Over all {len(every)} runs: median {_time(float(np.median(every)))} s, worst "
            f"{_time(max(every))} s, never in {never}; asked 2 s and 5 s. Scenarios without "
            "damage, or that never stop changing, have no row."
        )
    return section(f"Damage undone by {ADAPTIVE}: {rig}", columns, rows, note)


def safety(cells: Cells, rig: str) -> str:
    """Worst 2 s window after the first 5 s against the calibrated feed-forward."""
    columns = ("scenario", "worst ratio", "at, s", "bsnn_arx, mrad", "static, mrad")
    rows, over = [], []
    for name, size in cases(cells):
        worst = max(tuple(run["safety"]) for run in cells[name, size, ADAPTIVE])
        if worst[0] > 1.1:
            over.append(label(name, size))
        shown = (f"{x:.{d}f}" for x, d in zip(worst, (2, 1, 2, 2), strict=True))
        rows.append((label(name, size), *shown))
    beyond = f"Beyond: {', '.join(over)}." if over else "Holds in every row."
    note = f"Asked: at most 1.10. {beyond}"
    return section(f"Never worse than the calibration: {rig}", columns, rows, note)


def peers(cells: Cells, rig: str) -> str:
    """The end of every scenario and the time to nine tenths, medians over seeds."""
    names = ("pid", CALIBRATED, "arx", "bsnn_arx_paper", "adaptive_backstepping", ADAPTIVE)
    shown = [n for n in names if any(c == n for _, _, c in cells)]
    columns = ("scenario", *(f"{n}, mrad / s" for n in shown), "of backstepping")
    rows, lost = [], []
    for name, size in [("nominal", None), *cases(cells)]:
        runs = {n: cells.get((name, size, n), []) for n in shown}
        ratio = _of(runs[ADAPTIVE], runs.get("adaptive_backstepping", []))
        if ratio > 1:
            lost.append(label(name, size))
        cell = []
        for n in shown:
            told = [run["t90"] for run in runs[n] if run["told"]]
            cell.append(f"{np.median(mrad(runs[n], 'end')):.2f} / {times(told) if told else '-'}")
        rows.append((label(name, size), *cell, f"{ratio:.2f}"))
    note = (
        "Medians over seeds: error in the last strides, and time until nine tenths of the damage "
        f"that the change did to this controller are undone. {ADAPTIVE} ends above backstepping: "
        f"{', '.join(lost) or 'nowhere'}."
    )
    return section(f"Beside its peers: {rig}", columns, rows, note)


def _of(runs: list[dict[str, Any]], others: list[dict[str, Any]]) -> float:
    """Ratio of the mean errors at the end, over the seeds that both have."""
    seeds = {run["seed"] for run in runs} & {run["seed"] for run in others}
    ours, theirs = (
        np.mean(mrad([r for r in part if r["seed"] in seeds], "end")) for part in (runs, others)
    )
    return float(ours / theirs)


def cases(cells: Cells) -> list[tuple[str, float | None]]:
    """Scenario and size of every case with a change."""
    found = {(n, s) for n, s, c in cells if c == ADAPTIVE and n != "nominal"}
    return sorted(found, key=lambda case: (case[0], case[1] or 0.0))


def label(name: str, size: float | None) -> str:
    """How a case is called."""
    return name if size is None else f"{name} {size:g}"


def interval(values: np.ndarray) -> str:
    """Mean with the half width of its 95 % interval (Student's t)."""
    mean = np.mean(values)
    if np.isnan(mean):
        return ""
    if len(values) < 2 or not np.isfinite(mean):
        return f"{mean:.2f}"
    half = stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{mean:.2f} ± {half:.2f}"


def times(values: list[float | None], unit: str = "") -> str:
    """Median of times [s], and how many are missing."""
    missing = sum(value is None for value in values)
    text = _time(float(np.median([np.inf if value is None else value for value in values])))
    text += unit if text != "never" else ""
    if not missing:
        return text
    share = f"{missing} of {len(values)}"
    return f"never ({share})" if text == "never" else f"{text} (never {share})"


def _time(seconds: float) -> str:
    return f"{seconds:.2f}" if np.isfinite(seconds) else "never"


def end(cells: Cells, scenario: str, controller: str) -> float:
    """Mean over seeds of the error in the last strides [mrad]; NaN where it was not run."""
    if controller == "frozen":  # the twin of the adaptive runs; where nothing changes, the same
        key = "end" if scenario == "nominal" else "twin_end"
        return float(np.mean(mrad(cells.get((scenario, None, ADAPTIVE), []), key)))
    return float(np.mean(mrad(cells.get((scenario, None, controller), []), "end")))


def text(value: float) -> str:
    """Two decimals below 10, one above; nothing where there is no result."""
    if np.isnan(value):
        return ""
    return f"{value:.2f}" if value < 10 else f"{value:.1f}"


def short(rigs: dict[str, Cells]) -> list[str]:
    """A row a scenario of `FEW`, the smallest error in bold; the exact machine last."""
    lines = [
        f"| what happens | {' | '.join(f'`{name}`' for name in COMPARED)} | 90 % undone after |",
        "|---|" + "---:|" * (len(COMPARED) + 1),
    ]
    parts = [(rigs[RIG], name, scenario_summary(name)) for name in FEW]
    parts.append((rigs[EXACT], "nominal", "nothing, on the machine exactly as its model has it"))
    for cells, name, told in parts:
        values = [end(cells, name, controller) for controller in COMPARED]
        best = np.nanmin(values)
        shown = [f"**{text(v)}**" if v == best else text(v) for v in values]
        soon = [run["t90"] for run in cells[name, None, ADAPTIVE] if run["told"]]
        lines.append(f"| {told} | {' | '.join(shown)} | {times(soon, ' s') if soon else ''} |")
    return lines


def scenarios(rigs: dict[str, Cells]) -> list[str]:
    """A row a scenario: what it does, and the error at its end."""
    lines = [
        f"| scenario | what happens | size (`--severity`): default | {' | '.join(SHOWN)} |",
        "|---|---|---|" + "---:|" * len(SHOWN),
    ]
    for name in scenario_names():
        values = " | ".join(text(end(rigs[RIG], name, controller)) for controller in SHOWN)
        lines.append(f"| `{name}` | {scenario_summary(name)} | {severity_text(name)} | {values} |")
    return lines


def controllers(rigs: dict[str, Cells]) -> list[str]:
    """A row a controller: what it does, and its error without and with a change."""
    lines = [
        "| controller | law | `nominal` | `seal_wear` | median of all changes |",
        "|---|---|---:|---:|---:|",
    ]
    for name in controller_names():
        changed = [end(rigs[RIG], s, name) for s in scenario_names() if s != "nominal"]
        known = [value for value in changed if not np.isnan(value)]
        median = float(np.median(known)) if known else np.nan
        values = [end(rigs[RIG], "nominal", name), end(rigs[RIG], "seal_wear", name), median]
        lines.append(f"| `{name}` | {controller_summary(name)} | {' | '.join(map(text, values))} |")
    return lines


# What is measured, what is asked, what is reached, on how many runs.
Goal = tuple[str, str, str, str]


def _number(value: float) -> str:
    return results.number(float(value), 2) if np.isfinite(value) else "never"


def _percent(values: list[bool]) -> str:
    return f"{100 * np.mean(values):.0f} %"


def _clock(cases: list[dict[str, Any]], label: str) -> str:
    """Median and worst time to nine tenths, and how many never get there."""
    median, worst, never = live_names.t90_cells(cases, label)
    return f"{median} / {worst} s, never in {never}"


def names(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `live_names`."""
    cases = kept["cases"]
    on = f"{len(cases)} faults"
    for (start, end), asked in live_names.ASKED.items():
        window = live_names.WINDOWS.index((start, end))
        ratio = np.median([case[BANK]["ratio"][window] for case in cases])
        what = f"error over that of `frozen`, {start:g} to {end:g} s after the change, median"
        yield what, f"{asked:g}", _number(ratio), on
    median, worst = live_names.ASKED_T90
    asked = f"{median:g} / {worst:g} s"
    yield "90 % undone after, median / worst", asked, _clock(cases, BANK), on
    ratios = [
        np.array([case[WITHOUT]["ratio"]]) / np.array([case[ADAPTIVE]["ratio"]]) for case in cases
    ]
    later = np.exp(np.log(np.concatenate(ratios)).mean(axis=0))[1:]
    yield (
        "the fault's kind left out of the bank: error over that of `bsnn_arx` from 0.3 s on, "
        "smallest and largest window, geometric mean",
        "1",
        f"{_number(later.min())} to {_number(later.max())}",
        on,
    )
    over = np.array([case[WITHOUT]["worst"] for case in cases])
    yield (
        "the same: worst 2 s over `static_feedforward`, runs above 1.1",
        "0",
        f"{int((over > 1.1).sum())} (largest {_number(over.max())})",
        on,
    )
    for limit, kind, place in ((0.5, 88, 95), (2.0, 95, 99)):
        told = [case[BANK][f"{limit:g}"] for case in cases]
        said = [t for t in told if t["said"]]
        hurt = [
            c[BANK][f"{limit:g}"]["fault"]
            for c in cases
            if c["frozen_mrad"][3] > 2 * c["before_mrad"]
        ]
        yield (
            f"named within {limit:g} s: kind, of all (of those that double the error); "
            "cylinder, of the named",
            f"{kind} %; {place} %",
            f"{_percent([t['fault'] for t in told])} ({_percent(hurt)}); "
            f"{_percent([t['element'] for t in said])}",
            on,
        )
    sure = [
        t["fault"] and t["element"]
        for case in cases
        for t in [case[BANK]["2"]]
        if t["said"] and t["confidence"] >= 0.9
    ]
    yield "claims at 0.9 that are right", "87 to 97 %", _percent(sure), f"{len(sure)} claims"
    minutes = {label: duration / 60 for label, (_, duration) in live_names.PEACE.items()}
    alarms = sum(len(said) for _, _, said in kept["peace"])
    yield (
        "false alarms while nothing breaks: walking, random strides, cold start",
        "0",
        str(alarms),
        f"{sum(minutes[label] for label, _, _ in kept['peace']):.0f} min",
    )


def payload(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `live_names_elsewhere`."""
    own = [case for case in kept["back"] if case["fault"] == "payload"]
    yield (
        "a payload that is picked up and put down: named, its end told",
        "all",
        ", ".join(str(sum(case[when] is not None for case in own)) for when in ("comes", "goes")),
        f"{len(own)} runs",
    )


def with_pressures(cases: list[dict[str, Any]]) -> Iterator[Goal]:
    """Of `pressures`."""
    on = f"{len(cases)} faults"
    median, worst = pressures.ASKED_T90
    for name in (pressures.OWN, BANK):
        yield (
            f"pressures measured, `{name}`: 90 % undone after, median / worst",
            f"{median:g} / {worst:g} s",
            _clock(cases, name),
            on,
        )
    for name in (pressures.OWN, BANK):
        peer = pressures._of(cases, name, pressures.PEER)
        lower = sum(value < 1 for value in peer.values())
        yield (
            f"end error of `{name}` below that of `adaptive_backstepping`; largest ratio",
            "19 of 22; 1.3",
            f"{lower} of {len(peer)}; {_number(max(peer.values()))}",
            on,
        )
    travel = [
        case[name]["travel"] / case["pd"]["travel"]
        for case in cases
        for name in (pressures.OWN, BANK)
    ]
    yield "valve travel over that of `pd`, largest", "1.5", _number(max(travel)), on


def against_oracle(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `adaptation`."""
    cells = by_rig(kept)[RIG]
    ratios = {}
    for (name, size, controller), runs in cells.items():
        oracle = cells.get((name, size, "oracle"), [])
        if controller == ADAPTIVE and oracle and name != "nominal":
            ratios[name, size] = np.mean(mrad(runs, "end")) / np.mean(mrad(oracle, "end"))
    values = np.array(list(ratios.values()))
    yield (
        "end error of `bsnn_arx` over the aligned oracle's: faults above 1.25, largest",
        "0",
        f"{int((values > 1.25).sum())} of {len(values)}, {_number(values.max())}",
        "10 specimens",
    )


def speed(kept: dict[str, Any]) -> Iterator[Goal]:
    """Of `leg_speed`."""
    yield (
        "speed of the closed loop with bank and monitor over that of `pd`",
        "0.6",
        _number(kept["loop"][BANK]["of_pd"]),
        "20 s",
    )


def goals() -> str:
    """A row a goal."""
    parts = {
        "live_names": names,
        "live_names_elsewhere": payload,
        "pressures": with_pressures,
        "adaptation_results": against_oracle,
        "leg_speed": speed,
    }
    rows = [[*goal, f"`{n}`"] for n, part in parts.items() for goal in part(results.load(n))]
    return results.table(("what", "asked", "reached", "on", "made by"), rows).rstrip()


def main() -> None:
    """Prints a table."""
    known = {"short": short, "scenarios": scenarios, "controllers": controllers}
    name = sys.argv[1] if len(sys.argv) == 2 else ""
    if name == "goals":
        print(goals())
    elif name == "origin":
        print(results.origin_line(results.record("adaptation_results")))
    elif name in known:
        print("\n".join(known[name](by_rig(results.load("adaptation_results")))))
    else:
        allowed = (*known, "goals", "origin")
        raise SettingsError(f"no table {name!r}; allowed: ", given=name, allowed=allowed)
