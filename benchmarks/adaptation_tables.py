"""One table a claim, from the results of `adaptation_claims.py` as `adaptation_data` keeps them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import results
from adaptation_data import ADAPTIVE, CALIBRATED, Cells, mrad
from rich.table import Table as RichTable
from scipy import stats

MOVING = 0.1  # rad: joints that travel more count in the nominal claim


@dataclass
class Table:
    """Rows of text under a title."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def rich(self) -> RichTable:
        """For the terminal."""
        table = RichTable(title=self.title, title_justify="left", caption="\n".join(self.notes))
        for i, column in enumerate(self.columns):
            table.add_column(column, justify="right" if i else "left")
        for row in self.rows:
            table.add_row(*row)
        return table

    def markdown(self) -> str:
        """For a page."""
        return "\n".join(
            [f"## {self.title}", "", results.table(self.columns, self.rows), *self.notes]
        )


def claims(cells: Cells, rig: str) -> Iterator[Table]:
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


def nominal(cells: Cells, rig: str) -> Table:
    """Each joint of a machine that does not change, in the last strides."""
    names = ("pd", "pid", CALIBRATED, ADAPTIVE, "oracle")
    runs = {name: cells.get(("nominal", None, name), []) for name in names}
    shown = [name for name in names if runs[name]]
    table = Table(
        f"Nothing changes: {rig}",
        ("joint", *(f"{n}, mrad" for n in shown), "of pd", "of static"),
    )
    travel = runs[ADAPTIVE][0]["travel"]
    for joint in travel:
        if travel[joint] <= MOVING:
            continue
        rms = {n: np.array([1e3 * r["end_by_joint"][joint] for r in runs[n]]) for n in shown}
        table.rows.append(
            (
                joint,
                *(interval(rms[n]) for n in shown),
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms['pd']):.3f}",
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms[CALIBRATED]):.2f}",
            )
        )
    table.notes.append(f"Asked of {ADAPTIVE}: at most 0.1 of pd, at most 0.5 of static.")
    return table


def degraded(cells: Cells, rig: str) -> Table:
    """Before a change and in the last strides."""
    columns = ("scenario", "before", "static end", "frozen end", "bsnn_arx end", "oracle end")
    table = Table(f"After each change: {rig}", (*columns, "of frozen", "of oracle"))
    failing = []
    for name, severity in cases(cells):
        ours, oracle = cells[name, severity, ADAPTIVE], cells[name, severity, "oracle"]
        before, frozen, end = (mrad(ours, key) for key in ("before", "twin_end", "end"))
        hurt = np.mean(frozen) >= 2 * np.mean(before)
        of_frozen, of_oracle = np.mean(end) / np.mean(frozen), _of(ours, oracle)
        told = np.isfinite(of_frozen)
        if (told and hurt and of_frozen > 1 / 3) or of_oracle > 1.25:
            failing.append(label(name, severity))
        table.rows.append(
            (
                label(name, severity),
                interval(before),
                interval(mrad(cells.get((name, severity, CALIBRATED), []), "end")),
                interval(frozen),
                interval(end),
                interval(mrad(oracle, "end")),
                f"{of_frozen:.2f}{'' if hurt else ' (not doubled)'}" if told else "",
                f"{of_oracle:.2f}",
            )
        )
    table.notes.append(
        "Asked: at most 1/3 of frozen where that has at least doubled, at most 1.25 of the oracle. "
        + (f"Not reached: {', '.join(failing)}." if failing else "Reached in every row.")
    )
    return table


def undone(cells: Cells, rig: str) -> Table:
    """What the change cost, how much of it was undone, and how soon."""
    table = Table(
        f"Damage undone by {ADAPTIVE}: {rig}",
        ("scenario", "damage, mrad", "undone, %", "least, %", "90 % after, s", "worst, s"),
    )
    every: list[float] = []
    for name, severity in cases(cells):
        runs = [run for run in cells[name, severity, ADAPTIVE] if run["told"]]
        if not runs:
            continue
        soon = [np.inf if run["t90"] is None else run["t90"] for run in runs]
        shares = [100 * run["recovered"] for run in runs]
        every += soon
        table.rows.append(
            (
                label(name, severity),
                interval(mrad(runs, "damage")),
                f"{np.median(shares):.0f}",
                f"{min(shares):.0f}",
                times([run["t90"] for run in runs]),
                _time(max(soon)),
            )
        )
    if every:
        never = sum(np.isinf(every))
        table.notes.append(
            f"Over all {len(every)} runs: median {_time(float(np.median(every)))} s, worst "
            f"{_time(max(every))} s, never in {never}; asked 2 s and 5 s. Scenarios without "
            "damage, or that never stop changing, have no row."
        )
    return table


def safety(cells: Cells, rig: str) -> Table:
    """Worst 2 s window after the first 5 s against the calibrated feed-forward."""
    table = Table(
        f"Never worse than the calibration: {rig}",
        ("scenario", "worst ratio", "at, s", "bsnn_arx, mrad", "static, mrad"),
    )
    over = []
    for name, severity in cases(cells):
        worst = max(tuple(run["safety"]) for run in cells[name, severity, ADAPTIVE])
        if worst[0] > 1.1:
            over.append(label(name, severity))
        table.rows.append(
            (
                label(name, severity),
                *(f"{x:.{d}f}" for x, d in zip(worst, (2, 1, 2, 2), strict=True)),
            )
        )
    table.notes.append(
        "Asked: at most 1.10. " + (f"Beyond: {', '.join(over)}." if over else "Holds in every row.")
    )
    return table


def peers(cells: Cells, rig: str) -> Table:
    """The end of every scenario and the time to nine tenths, medians over seeds."""
    names = (
        "pid",
        CALIBRATED,
        "arx",
        "bsnn_arx_paper",
        "adaptive_backstepping",
        ADAPTIVE,
    )
    shown = [n for n in names if any(c == n for _, _, c in cells)]
    table = Table(
        f"Beside its peers: {rig}",
        ("scenario", *(f"{n}, mrad / s" for n in shown), "of backstepping"),
    )
    lost = []
    for name, severity in [("nominal", None), *cases(cells)]:
        runs = {n: cells.get((name, severity, n), []) for n in shown}
        ratio = _of(runs[ADAPTIVE], runs.get("adaptive_backstepping", []))
        if ratio > 1:
            lost.append(label(name, severity))
        cell = []
        for n in shown:
            told = [run["t90"] for run in runs[n] if run["told"]]
            cell.append(f"{np.median(mrad(runs[n], 'end')):.2f} / {times(told) if told else '-'}")
        table.rows.append((label(name, severity), *cell, f"{ratio:.2f}"))
    table.notes.append(
        "Medians over seeds: error in the last strides, and time until nine tenths of the damage "
        f"that the change did to this controller are undone. {ADAPTIVE} ends above backstepping: "
        + (f"{', '.join(lost)}." if lost else "nowhere.")
    )
    return table


def _of(runs: list[dict[str, Any]], others: list[dict[str, Any]]) -> float:
    """Ratio of the mean errors at the end, over the seeds that both have."""
    seeds = {run["seed"] for run in runs} & {run["seed"] for run in others}
    ours, theirs = (
        np.mean(mrad([r for r in part if r["seed"] in seeds], "end")) for part in (runs, others)
    )
    return float(ours / theirs)


def cases(cells: Cells) -> list[tuple[str, float | None]]:
    """Scenario and severity of every case with a change."""
    found = {(n, s) for n, s, c in cells if c == ADAPTIVE and n != "nominal"}
    return sorted(found, key=lambda case: (case[0], case[1] or 0.0))


def label(name: str, severity: float | None) -> str:
    """How a case is called."""
    return name if severity is None else f"{name} {severity:g}"


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
