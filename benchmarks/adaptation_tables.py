"""One table a claim, from the results of `adaptation_claims.py` as `adaptation_data` keeps them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import results
from adaptation_data import ADAPTIVE, Cells, pooled
from rich.table import Table as RichTable
from scipy import stats

# Not one step of one kind: two changes at once, a machine that never stops changing, none at all.
NOT_SINGLE = ("seal_wear_supply_drop", "cold_start", "nominal")
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
    if {"frozen", "oracle"} <= have:
        yield degraded(cells, rig)
        yield readaptation(cells, rig)
    yield safety(cells, rig)
    if {"adaptive_backstepping", "arx", "bsnn_arx_paper"} & have:
        yield peers(cells, rig)


def nominal(cells: Cells, rig: str) -> Table:
    """Each joint of the machine as it was built, from 5 s on."""
    names = ("pd", "static_feedforward", "frozen", ADAPTIVE, "oracle")
    runs = {name: cells.get(("nominal", None, name), []) for name in names}
    shown = [name for name in names if runs[name]]
    table = Table(
        f"Nominal: {rig}", ("joint", *(f"{n}, mrad" for n in shown), "of pd", "of static")
    )
    travel = runs[ADAPTIVE][0]["travel_rad"]
    for joint in travel:
        if travel[joint] <= MOVING:
            continue
        rms = {n: np.array([1e3 * r["settled_rms_rad"][joint] for r in runs[n]]) for n in shown}
        table.rows.append(
            (
                joint,
                *(interval(rms[n]) for n in shown),
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms['pd']):.3f}",
                f"{np.mean(rms[ADAPTIVE]) / np.mean(rms['static_feedforward']):.2f}",
            )
        )
    table.notes.append(f"Asked of {ADAPTIVE}: at most 0.1 of pd, at most 0.5 of static.")
    return table


def degraded(cells: Cells, rig: str) -> Table:
    """Before a change and in the last 5 s."""
    columns = ("scenario", "before", "static end", "frozen end", "bsnn_arx end", "oracle end")
    table = Table(f"After each degradation: {rig}", (*columns, "of frozen", "of oracle"))
    failing = []
    for name, severity in cases(cells):
        end = {
            c: pooled(cells.get((name, severity, c), []), "end_rms_rad")
            for c in ("static_feedforward", "frozen", ADAPTIVE, "oracle")
        }
        before = pooled(cells[name, severity, ADAPTIVE], "settled_rms_rad")
        frozen_before = pooled(cells[name, severity, "frozen"], "settled_rms_rad")
        hurt = before.size and np.mean(end["frozen"]) >= 2 * np.mean(frozen_before)
        of_frozen = np.mean(end[ADAPTIVE]) / np.mean(end["frozen"])
        of_oracle = np.mean(end[ADAPTIVE]) / np.mean(end["oracle"])
        good = (not hurt or of_frozen <= 1 / 3) and of_oracle <= 1.25
        if not good:
            failing.append(label(name, severity))
        table.rows.append(
            (
                label(name, severity),
                interval(before),
                *(interval(end[c]) for c in end),
                f"{of_frozen:.2f}" + ("" if hurt else " (not doubled)"),
                f"{of_oracle:.2f}",
            )
        )
    table.notes.append(
        "Asked: at most 1/3 of frozen where that has at least doubled, at most 1.25 of the oracle. "
        + (f"Not reached: {', '.join(failing)}." if failing else "Reached in every row.")
    )
    return table


def readaptation(cells: Cells, rig: str) -> Table:
    """Until the stride's error stays within 1.25 of that before the change, or of the oracle's."""
    table = Table(
        f"Re-adaptation time: {rig}",
        ("scenario", "to 1.25 before, s", "to 1.25 of the worse of before and oracle, s", "worst"),
    )
    every: list[float] = []
    for name, severity in cases(cells):
        if name in NOT_SINGLE:
            continue
        runs = cells[name, severity, ADAPTIVE]
        strict, fair = (
            [run["readaptation_s"][kind] for run in runs] for kind in ("strict", "fair")
        )
        never = [np.inf if t is None else t for t in fair]
        every += never
        table.rows.append((label(name, severity), times(strict), times(fair), f"{max(never):.2f}"))
    table.notes.append(
        f"Over all: median {np.median(every):.2f} s, worst {max(every):.2f} s; asked 2 s and 5 s."
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
    """The last 5 s of every scenario, median over seeds."""
    names = ("static_feedforward", "arx", "bsnn_arx_paper", "adaptive_backstepping", ADAPTIVE)
    shown = [n for n in names if any(c == n for _, _, c in cells)]
    table = Table(
        f"Beside its peers: {rig}",
        ("scenario", *(f"{n} after / end" for n in shown), "of backstepping"),
    )
    lost = []
    for name, severity in [("nominal", None), *cases(cells)]:
        end = {
            n: np.median(pooled(cells.get((name, severity, n), []), "end_rms_rad")) for n in shown
        }
        after = {n: np.median(whole_after(cells.get((name, severity, n), []))) for n in shown}
        ratio = after[ADAPTIVE] / after.get("adaptive_backstepping", np.nan)
        if ratio > 1:
            lost.append(label(name, severity))
        table.rows.append(
            (
                label(name, severity),
                *(f"{after[n]:.2f} / {end[n]:.2f}" for n in shown),
                f"{ratio:.2f}",
            )
        )
    table.notes.append(
        "Medians over seeds: from the change to the end, and the last 5 s (nominal: all of it). "
        + (f"Worse than backstepping: {', '.join(lost)}." if lost else "Never worse.")
    )
    return table


def cases(cells: Cells) -> list[tuple[str, float | None]]:
    """Scenario and severity of every case with a change."""
    found = {(n, s) for n, s, c in cells if c == ADAPTIVE and n != "nominal"}
    return sorted(found, key=lambda case: (case[0], case[1] or 0.0))


def label(name: str, severity: float | None) -> str:
    """How a case is called."""
    return name if severity is None else f"{name} {severity:g}"


def whole_after(runs: list[dict[str, Any]]) -> np.ndarray:
    """RMS from the change to the end of every run [mrad]."""
    values = [1e3 * run["after_rms_rad"] if run["completed"] else np.inf for run in runs]
    return np.array(values) if values else np.array([np.nan])


def interval(values: np.ndarray) -> str:
    """Mean with the half width of its 95 % interval (Student's t)."""
    mean = np.mean(values)
    if len(values) < 2 or not np.isfinite(mean):
        return f"{mean:.2f}"
    half = stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{mean:.2f} ± {half:.2f}"


def times(values: list[float | None]) -> str:
    """Median of times, and how many are missing."""
    known = [np.inf if value is None else value for value in values]
    missing = sum(value is None for value in values)
    median = np.median(known)
    text = f"{median:.2f}" if np.isfinite(median) else "never"
    return text + (f" ({missing} of {len(values)} never)" if missing else "")
